"""Answers: a request, and what is kept, -> a header and bytes."""

from collections.abc import Callable
from os import getpid
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..detector import present
from ..geometry.view import magnification, project, view_of
from ..io.parcels import mesh_bytes, radiograph_bytes
from ..io.viewer import solids_page
from ..model.knee import knee_table
from ..model.protocol import protocol_table
from ..model.radiograph import Radiograph, Truth
from ..quality.beam import entrance_kerma_ugy
from ..quality.exposure import exposure_index
from ..raycast import shadow
from ..simulation import simulate
from .asked import MESHES, TEXTS, Wanted
from .python import python_lines
from .warm import ENGINE, Exposed, Warm

Header = dict[str, Any]
Answer = tuple[Header, bytes]
# Figures of the exposure are read in every so-manieth pixel of a large detector.
_FIGURE_SIDE = 512
# Half the side of the square at the joint in which scatter is read, mm at the detector.
_HALF_MM = 3.0
# Surfaces of the solids may move by so much to save triangles.
_TOLERANCE_MM = 0.1


def radiograph(warm: Warm, wanted: Wanted) -> Answer:
    """Pixels of the look, uint16 little-endian, and all figures of the exposure."""
    began = process_time()
    made = warm.exposed(wanted.knee, wanted.protocol, wanted.seed)
    whole = wanted.protocol == wanted.whole
    pixels = made.image.pixels
    assert pixels is not None
    protocol, view = made.protocol, view_of(made.protocol)
    header = {
        "rows": protocol.rows,
        "cols": protocol.cols,
        "whole": whole,
        "look": wanted.look,
        "joint_mm_per_px": protocol.pixel_mm / magnification(view),
        "rays_traced": made.rays,
        "audit": made.traced.paths.audit.counts(),
        "seconds": made.seconds,
        "beam_angle_deg": protocol.beam_angle_deg,
        **_figures(made),
        "truth": _labels_of(made.truth) if whole else None,
    }
    content = _shown(pixels, made, wanted).astype("<u2", copy=False).tobytes()
    return {**header, "cpu_s": process_time() - began, "process": getpid()}, content


def _shown(pixels: NDArray[np.uint16], made: Exposed, wanted: Wanted) -> NDArray[np.uint16]:
    """The pixels as the look has them; for eyes in all 16 bits."""
    if wanted.look == "linear":
        return pixels
    bare = Radiograph(pixels=pixels, protocol=made.protocol, seed=wanted.seed)
    return np.asarray(present(bare, bits=16, look=wanted.look), np.uint16)


def _figures(made: Exposed) -> Header:
    """Exposure index, entrance kerma, scatter over primary in the limb and at the joint; None where there is none."""
    image, protocol = made.image, made.protocol
    step = max(1, max(protocol.rows, protocol.cols) // _FIGURE_SIDE)
    some = (slice(None, None, step), slice(None, None, step))
    limb = made.traced.paths.path_mm["muscle"][some] > 0
    primary = image.straight.kev[some].astype(np.float64)
    scatter = None if image.scatter is None else image.scatter[some].astype(np.float64)
    seen = bool(limb.any())
    total = primary if scatter is None else primary + scatter
    return {
        "exposure_index": exposure_index(total[limb], made.technique) if seen else None,
        "entrance_kerma_ugy": entrance_kerma_ugy(made.technique),
        "spr_limb": _ratio(scatter, primary, limb) if seen else None,
        "spr_joint": _ratio(scatter, primary, _joint(made, step, primary.shape)),
    }


def _ratio(scatter: Array | None, primary: Array, where: Any) -> float | None:
    if scatter is None or not primary[where].sum() > 0:
        return None
    return float(scatter[where].sum() / primary[where].sum())


def _joint(made: Exposed, step: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """A square about where the knee's middle is seen."""
    view = view_of(made.protocol)
    row, col = project(np.zeros((1, 3)), view)[0]
    half = max(1, round(_HALF_MM / made.protocol.pixel_mm / step))
    rows, cols = (min(max(round(place / step), half), size - 1) for place, size in zip((row, col), shape, strict=True))
    return slice(rows - half, rows + half + 1), slice(cols - half, cols + half + 1)


def _labels_of(truth: Truth) -> Header:
    return {
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "grade": truth.grade,
        "landmarks_px": {name: list(place) for name, place in truth.landmarks_px.items()},
        "attrition_mm": dict(truth.attrition_mm),
    }


def probe(warm: Warm, wanted: Wanted) -> Answer:
    """Path lengths at a pixel, mm by material, and its linear value; nothing where they are not kept."""
    row, col = wanted.place
    paths = warm.known(wanted.knee, wanted.protocol)
    inside = 0 <= row < wanted.protocol.rows and 0 <= col < wanted.protocol.cols
    if paths is None or not inside:
        return {"path_mm": None}, b""
    # Whole, since the page rounds what it shows: rounded twice, 1.7449 would be read as 1.75.
    along = {name: float(values[row, col]) for name, values in paths.path_mm.items()}
    return {"path_mm": {name: mm for name, mm in along.items() if mm > 5e-4}}, b""


def masks(warm: Warm, wanted: Wanted) -> Answer:
    """Where each bone and osteophyte is seen: a bit a pixel, rows one after another, each mask from a whole byte on."""
    built = warm.built(wanted.knee, wanted.protocol)
    protocol = built.aimed(wanted.protocol)
    seen = {name: shadow(mesh, protocol) for name, mesh in built.solids().items()}
    header = {"names": list(seen), "rows": protocol.rows, "cols": protocol.cols}
    return header, b"".join(np.packbits(mask.ravel()).tobytes() for mask in seen.values())


def solids(warm: Warm, wanted: Wanted) -> Answer:
    """The page of the solids, with beam and detector."""
    built = warm.built(wanted.knee, wanted.protocol)
    view = view_of(built.aimed(wanted.protocol))
    return {}, solids_page(built.scene, view, tolerance_mm=_TOLERANCE_MM).encode()


def file(warm: Warm, wanted: Wanted) -> Answer:
    """A file of what is shown; a radiograph has all its pixels."""
    knee, protocol, kind = wanted.knee, wanted.whole, wanted.kind
    stem = f"knee_{protocol.name}_seed{wanted.seed}"
    if kind in TEXTS:
        text = {"knee.toml": _toml(knee_table(knee)), "protocol.toml": _toml(protocol_table(protocol))}
        text["py"] = python_lines(knee, protocol, wanted.seed)
        return {"name": kind if kind != "py" else f"{stem}.py"}, text[kind].encode()
    if kind in MESHES:
        name, content = mesh_bytes(warm.built(knee, protocol).scene, kind, "knee")
        return {"name": name}, content
    if not kind:
        raise InputError("kind = ''; allowed: a kind of file")
    built = warm.built(knee, protocol)
    done = simulate(built, protocol, rng=wanted.seed, engine=ENGINE, paths=warm.known(knee, protocol))
    return {"name": f"{stem}.{kind}"}, radiograph_bytes(done, kind)


def _toml(table: Header) -> str:
    import tomli_w

    return tomli_w.dumps({name: value for name, value in table.items() if value is not None})


ANSWERS: dict[str, Callable[[Warm, Wanted], Answer]] = {
    "probe": probe,
    "radiograph": radiograph,
    "masks": masks,
    "solids": solids,
    "file": file,
}
