"""A request of the page, checked at the door: JSON -> records that the worker takes."""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import msgspec

from ..core.checks import InputError, require_choice, require_seed, require_whole
from ..data.fields import field_laws
from ..data.oarsi import OarsiCuts, oarsi_cuts
from ..data.records import TYPES_LOCK, Record
from ..model.draw import draw_knee
from ..model.kellgren_lawrence import allowed_grades
from ..model.knee import Knee, knee_from
from ..model.protocol import Protocol, protocol_from
from .listing import MOST_PIXELS, page_knee

LOOKS = ("linear", "processed", "film")
MESHES = ("stl", "ply", "glb", "3mf")
RADIOGRAPHS = ("tif", "dcm", "presentation.dcm", "png", "json")
TEXTS = ("knee.toml", "protocol.toml", "py")
KINDS = (*RADIOGRAPHS, *MESHES, *TEXTS)
Kind = TypeVar("Kind", bound=Record)
_BOUNDS_SIDE = (32, MOST_PIXELS)


class State(Record, frozen=True):
    """What the page shows; fields of a knee and of a protocol as their tables have them.

    tab   of the browser, whose older requests give way to its newer ones
    look  of the pixels: linear, or a rendering for eyes
    side  the most pixels of a side, for a coarser picture of the same field; 0: all
    kind  of a file that is wanted
    row, col  of a pixel that is asked for
    """

    tab: str
    knee: dict[str, Any]
    protocol: dict[str, Any]
    seed: int | str = 0
    look: str = "linear"
    side: int = 0
    kind: str = ""
    row: int = 0
    col: int = 0


class Draw(Record, frozen=True):
    """Ask for a sampled knee, with the arguments of `draw_knee`."""

    grade: int
    grade_table: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What the worker takes; fields as in `State`, resolved.

    whole  the protocol with all its pixels
    """

    knee: Knee
    protocol: Protocol
    whole: Protocol
    seed: int
    look: str
    kind: str
    place: tuple[int, int]


def read_state(body: bytes) -> State:
    """raises  InputError for what is no state"""
    state = _decoded(body, State)
    if not 1 <= len(state.tab) <= 64:
        raise InputError(f"tab = {state.tab[:70]!r}; allowed: 1 to 64 letters")
    return state


def resolve(state: State) -> Wanted:
    """raises  InputError naming a field, its value and what is allowed"""
    require_choice("look", state.look, LOOKS)
    require_choice("kind", state.kind, ("", *KINDS))
    if state.side:
        require_whole("side", state.side, *_BOUNDS_SIDE, "pixels")
    seed = _whole(state.seed)
    require_seed(seed)
    named = {name for name, law in field_laws("knee").items() if law.whole}
    knee = {name: _whole(value) if name in named else value for name, value in state.knee.items()}
    protocol = protocol_from(state.protocol, "protocol")
    if protocol.apart_mm:
        raise InputError(f"apart_mm = {protocol.apart_mm:g} mm; allowed: 0, since the page shows one knee")
    for name in ("rows", "cols"):
        require_whole(f"{name} of the page", getattr(protocol, name), 1, MOST_PIXELS, "pixels")
    return Wanted(
        knee=_of_page(knee, oarsi_cuts()),
        protocol=coarser(protocol, state.side),
        whole=protocol,
        seed=seed,
        look=state.look,
        kind=state.kind,
        place=(state.row, state.col),
    )


def _of_page(fields: dict[str, Any], cuts: OarsiCuts) -> Knee:
    """The knee that the page shows: where a slider has moved its anatomy beyond its grade, the grade is derived."""
    anatomy = knee_from({**fields, "grade": None, "grade_table": None})
    low, high = allowed_grades(anatomy, cuts)
    grade = fields.get("grade")
    if isinstance(grade, int) and not low <= grade <= high:
        return anatomy
    return knee_from(fields)


def coarser(protocol: Protocol, side: int) -> Protocol:
    """The same field on a detector of at most so many pixels a side; as it is where it has no more, or side is 0.

    What takes long and changes little to the eye is left to the whole size: followed photons, a sampled focal spot.
    """
    step = max(protocol.rows, protocol.cols) / side if side else 0.0
    if step <= 1:
        return protocol
    rows, cols = (max(1, round(count / step)) for count in (protocol.rows, protocol.cols))
    scatter = "kernel" if protocol.scatter == "monte_carlo" else protocol.scatter
    pixel_mm = protocol.pixel_mm * step
    return replace(protocol, rows=rows, cols=cols, pixel_mm=pixel_mm, scatter=scatter, focal_spot="blur")


def drawn(body: bytes) -> dict[str, Any]:
    """A knee drawn by a grade and a seed, as the page holds it.

    raises  InputError for an unknown grade or table
    """
    from ..data.grade_tables import grade_tables

    asked = _decoded(body, Draw)
    # A path would be read from the disk.
    require_choice("grade_table", asked.grade_table, grade_tables())
    require_seed(asked.seed)
    return page_knee(draw_knee(grade=asked.grade, rng=asked.seed, grade_table=asked.grade_table))


def _decoded(body: bytes, kind: type[Kind]) -> Kind:
    try:
        with TYPES_LOCK:
            return msgspec.json.decode(body, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        why = f"request = {len(body)} bytes, {str(error)[:200]}"
        raise InputError(f"{why}; allowed: JSON as the page sends it") from None


def _whole(value: Any) -> Any:
    """A whole number from its digits, as a browser holds large ones; anything else as it is."""
    digits = isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 19
    return int(value) if digits else value
