"""Parsing and validation of the JSON requests that the explore page sends."""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import msgspec

from ..core.checks import (
    InputError,
    require_choice,
    require_integer,
    require_seed,
)
from ..data.imaging.explore_table import load_page_settings
from ..data.knees.field_definitions import load_field_specs
from ..data.knees.oarsi_table import OarsiThresholds, load_oarsi_thresholds
from ..data.table_records import MSGSPEC_LOCK, Record
from ..model.kellgren_lawrence import allowed_grades
from ..model.knee import Knee, knee_from_dict
from ..model.protocol import Protocol, protocol_from_dict
from ..model.sampling.knee_sampling import sample_knee
from .page_listing import MAX_SIDE_PX, knee_to_page_dict

MESH_KINDS = ("stl", "ply", "glb", "3mf")
RADIOGRAPH_KINDS = ("tif", "dcm", "presentation.dcm", "png", "json")
TEXT_KINDS = ("knee.toml", "protocol.toml", "py")
FILE_KINDS = (*RADIOGRAPH_KINDS, *MESH_KINDS, *TEXT_KINDS)
RecordType = TypeVar("RecordType", bound=Record)
# Allowed range of the longer side of a preview image, in pixels.
_SIDE_RANGE_PX = (32, MAX_SIDE_PX)


class PageState(Record, frozen=True):
    """State of the explore page, as received in a request.

    Attributes
    ----------
    tab : str
        Name of the browser tab. A new request supersedes older requests from the same tab.
    knee : dict
        Values of knee fields, keyed by field name.
    protocol : dict
        Values of protocol fields, keyed by field name.
    seed : int or str
        Noise seed. Large integers are strings, because JavaScript would round them.
    processing : str
        Name of a display processing method, or ``"linear"`` for pixels without display processing.
    side : int
        Longer side of a preview with the same field of view, in pixels; 0 for full resolution.
    kind : str
        File format for export; empty if no file is requested.
    row : int
        Row of the pixel whose path lengths are requested.
    col : int
        Column of the pixel whose path lengths are requested.
    """

    tab: str
    knee: dict[str, Any]
    protocol: dict[str, Any]
    seed: int | str = 0
    processing: str = "linear"
    side: int = 0
    kind: str = ""
    row: int = 0
    col: int = 0


class SampleKneeRequest(Record, frozen=True):
    """Request to sample a knee, with the arguments of `sample_knee`.

    Attributes
    ----------
    grade : int
        KL grade.
    grade_table : str
        Name of a grade table in the package.
    seed : int
        Seed for sampling the knee.
    """

    grade: int
    grade_table: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class ResolvedRequest:
    """Validated request for the worker process.

    Attributes
    ----------
    knee : Knee
        Parameters of the knee.
    protocol : Protocol
        Protocol with the requested resolution.
    full_protocol : Protocol
        Protocol with full resolution.
    seed : int
        Noise seed.
    processing : str
        Name of a display processing method, or ``"linear"`` for pixels without display processing.
    kind : str
        File format for export; empty if no file is requested.
    pixel : tuple of int
        Row and column of the pixel whose path lengths are requested.
    """

    knee: Knee
    protocol: Protocol
    full_protocol: Protocol
    seed: int
    processing: str
    kind: str
    pixel: tuple[int, int]


def parse_state(body: bytes) -> PageState:
    """Parse the state of the page from the body of a request.

    Parameters
    ----------
    body : bytes
        Body of a request.

    Returns
    -------
    PageState
        State of the page, in which knee and protocol are not yet validated.

    Raises
    ------
    InputError
        If the body is not a valid state of the page.
    """
    state = _decode(body, PageState)
    if not 1 <= len(state.tab) <= 64:
        raise InputError(f"tab must have 1 to 64 characters, got {state.tab[:70]!r}")
    return state


def resolve_state(state: PageState) -> ResolvedRequest:
    """Validate the state of the page and convert it to a request for the worker.

    Parameters
    ----------
    state : PageState
        State of the page.

    Returns
    -------
    ResolvedRequest
        Validated request.

    Raises
    ------
    InputError
        If a value is invalid. The message contains the field name, the invalid value and the allowed values.
    """
    require_choice("processing", state.processing, tuple(load_page_settings().processing))
    require_choice("kind", state.kind, ("", *FILE_KINDS))
    if state.side:
        require_integer("side", state.side, *_SIDE_RANGE_PX, "pixels")
    seed = _parse_whole_number(state.seed)
    require_seed(seed)
    named = {name for name, law in load_field_specs("knee").items() if law.integer_range}
    knee = {name: _parse_whole_number(value) if name in named else value for name, value in state.knee.items()}
    protocol = protocol_from_dict(state.protocol, "protocol")
    if protocol.knee_distance_mm:
        raise InputError(
            f"knee_distance_mm must be 0 mm on the page, got {protocol.knee_distance_mm:g} mm: the page shows one knee"
        )
    for name in ("rows", "cols"):
        require_integer(f"{name} of the page", getattr(protocol, name), 1, MAX_SIDE_PX, "pixels")
    return ResolvedRequest(
        knee=_resolve_page_knee(knee, load_oarsi_thresholds()),
        protocol=coarsen_protocol(protocol, state.side),
        full_protocol=protocol,
        seed=seed,
        processing=state.processing,
        kind=state.kind,
        pixel=(state.row, state.col),
    )


def _resolve_page_knee(fields: dict[str, Any], cuts: OarsiThresholds) -> Knee:
    """Build the knee on the page.

    A KL grade that contradicts the anatomy is replaced by the grade derived from the anatomy.
    """
    anatomy = knee_from_dict({**fields, "grade": None, "grade_table": None})
    low, high = allowed_grades(anatomy, cuts)
    grade = fields.get("grade")
    if isinstance(grade, int) and not low <= grade <= high:
        return anatomy
    return knee_from_dict(fields)


def coarsen_protocol(protocol: Protocol, max_side_px: int) -> Protocol:
    """Reduce the resolution of a protocol for a preview with the same field of view.

    Parameters
    ----------
    protocol : Protocol
        Protocol with full resolution.
    max_side_px : int
        Maximum number of rows or columns; 0 for full resolution.

    Returns
    -------
    Protocol
        Protocol of the preview, or the unmodified protocol if it does not exceed the maximum size.

    Notes
    -----
    A preview uses the scatter kernel instead of a Monte Carlo scatter simulation, and blur instead of a sampled focal
    spot. The replaced methods are slow and have little effect on the appearance.
    """
    step = max(protocol.rows, protocol.cols) / max_side_px if max_side_px else 0.0
    if step <= 1:
        return protocol
    rows, cols = (max(1, round(count / step)) for count in (protocol.rows, protocol.cols))
    scatter = "kernel" if protocol.scatter == "monte_carlo" else protocol.scatter
    pixel_mm = protocol.pixel_mm * step
    return replace(protocol, rows=rows, cols=cols, pixel_mm=pixel_mm, scatter=scatter, focal_spot="blur")


def sample_page_knee(body: bytes) -> dict[str, Any]:
    """Sample a knee with a KL grade and a seed, and return its field values for the page.

    Parameters
    ----------
    body : bytes
        Body of a request with a `SampleKneeRequest` as JSON.

    Returns
    -------
    dict
        Values of the knee fields, keyed by field name.

    Raises
    ------
    InputError
        If the body is invalid, or if the KL grade or the grade table is unknown.
    """
    from ..data.knees.grade_tables import list_grade_tables

    asked = _decode(body, SampleKneeRequest)
    # Only grade tables in the package are allowed, because a path would give the page access to files on the disk.
    require_choice("grade_table", asked.grade_table, list_grade_tables())
    require_seed(asked.seed)
    return knee_to_page_dict(sample_knee(grade=asked.grade, rng=asked.seed, grade_table=asked.grade_table))


def _decode(body: bytes, kind: type[RecordType]) -> RecordType:
    """Decode the JSON body of a request to a record type."""
    try:
        with MSGSPEC_LOCK:
            return msgspec.json.decode(body, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        why = f"{len(body)} bytes: {str(error)[:200]}"
        raise InputError(f"request must be JSON with the fields that the page sends, got {why}") from None


def _parse_whole_number(value: Any) -> Any:
    """Convert a string of digits to an integer and return any other value unchanged.

    The page sends large integers as strings.
    """
    digits = isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 19
    return int(value) if digits else value
