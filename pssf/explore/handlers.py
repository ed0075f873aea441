"""Request handlers, which answer each type of request with a JSON-ready header and binary content."""

from collections.abc import Callable
from os import getpid
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..detector import render_for_display
from ..geometry.view import magnification, project_points, resolve_view
from ..io.meshes.knee_viewer import build_solids_page
from ..io.to_bytes import encode_meshes, encode_radiograph
from ..model.knee import knee_to_dict
from ..model.protocol import protocol_to_dict
from ..model.radiograph import Radiograph, Truth
from ..quality.beam_quality import entrance_kerma_ugy
from ..quality.exposure_index import exposure_index
from ..raycast import compute_face_silhouette
from ..simulation import simulate
from .python_snippet import format_python_lines
from .request_schema import MESH_KINDS, TEXT_KINDS, ResolvedRequest
from .stage_cache import ENGINE, SimulatedImage, StageCache

Header = dict[str, Any]
Answer = tuple[Header, bytes]
# Approximate maximum number of rows or columns for the computation of exposure values. Larger images are subsampled.
_STATISTICS_SIDE_PX = 512
# Half the edge length of the square region at the joint in which scatter is measured, in mm on the detector.
_ROI_HALF_MM = 3.0
# Maximum deviation from the original surface when surfaces are simplified for the 3D view, in mm.
_MESH_TOLERANCE_MM = 0.1


def handle_radiograph(cache: StageCache, request: ResolvedRequest) -> Answer:
    """Simulate a radiograph for the explore page.

    Parameters
    ----------
    cache : StageCache
        Cache of knees, path lengths and images.
    request : ResolvedRequest
        Validated request from the page.

    Returns
    -------
    header : dict
        Image size, exposure values and computing times, and the labels if the image has full resolution.
    content : bytes
        Pixels with the requested display processing, as little-endian uint16 in row-major order.
    """
    began = process_time()
    made = cache.simulate_image(request.knee, request.protocol, request.seed)
    whole = request.protocol == request.full_protocol
    pixels = made.image.pixels
    assert pixels is not None
    protocol, view = made.protocol, resolve_view(made.protocol)
    header = {
        "rows": protocol.rows,
        "cols": protocol.cols,
        "whole": whole,
        "processing": request.processing,
        "joint_mm_per_px": protocol.pixel_mm / magnification(view),
        "rays_traced": made.rays_traced,
        "audit": made.cached_paths.paths.audit.counts(),
        "seconds": made.seconds,
        "beam_angle_deg": protocol.beam_angle_deg,
        **_compute_exposure_figures(made),
        "truth": _labels_to_dict(made.truth) if whole else None,
    }
    content = _render_pixels(pixels, made, request).astype("<u2", copy=False).tobytes()
    return {**header, "cpu_s": process_time() - began, "process": getpid()}, content


def _render_pixels(pixels: NDArray[np.uint16], result: SimulatedImage, request: ResolvedRequest) -> NDArray[np.uint16]:
    """Render the image with the requested display processing and 16 bits per pixel."""
    if request.processing == "linear":
        return pixels
    bare = Radiograph(pixels=pixels, protocol=result.protocol, seed=request.seed)
    return np.asarray(render_for_display(bare, bits=16, processing=request.processing), np.uint16)


def _compute_exposure_figures(result: SimulatedImage) -> Header:
    """Compute exposure index, entrance air kerma, and scatter-to-primary ratios of the limb and at the joint.

    A value that cannot be computed is None.
    """
    image, protocol = result.image, result.protocol
    step = max(1, max(protocol.rows, protocol.cols) // _STATISTICS_SIDE_PX)
    some = (slice(None, None, step), slice(None, None, step))
    limb = result.cached_paths.paths.path_mm["muscle"][some] > 0
    primary = image.computed_primary.kev[some].astype(np.float64)
    scatter = None if image.scatter is None else image.scatter[some].astype(np.float64)
    seen = bool(limb.any())
    total = primary if scatter is None else primary + scatter
    return {
        "exposure_index": exposure_index(total[limb], result.technique) if seen else None,
        "entrance_kerma_ugy": entrance_kerma_ugy(result.technique),
        "spr_limb": _scatter_to_primary(scatter, primary, limb) if seen else None,
        "spr_joint": _scatter_to_primary(scatter, primary, _joint_region(result, step, primary.shape)),
    }


def _scatter_to_primary(scatter: Array | None, primary: Array, where: Any) -> float | None:
    """Return the scatter-to-primary ratio in a region, or None if the image has no scatter or primary signal."""
    if scatter is None or not primary[where].sum() > 0:
        return None
    return float(scatter[where].sum() / primary[where].sum())


def _joint_region(result: SimulatedImage, step: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return row and column slices of a square around the knee centre in the subsampled image."""
    view = resolve_view(result.protocol)
    row, col = project_points(np.zeros((1, 3)), view)[0]
    half = max(1, round(_ROI_HALF_MM / result.protocol.pixel_mm / step))
    rows, cols = (min(max(round(place / step), half), size - 1) for place, size in zip((row, col), shape, strict=True))
    return slice(rows - half, rows + half + 1), slice(cols - half, cols + half + 1)


def _labels_to_dict(truth: Truth) -> Header:
    """Convert the labels of a radiograph to a JSON-ready dict."""
    return {
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "grade": truth.grade,
        "landmarks_px": {name: list(place) for name, place in truth.landmarks_px.items()},
        "attrition_mm": dict(truth.attrition_mm),
    }


def handle_probe(cache: StageCache, request: ResolvedRequest) -> Answer:
    """Return the path lengths along the ray to one pixel.

    Parameters
    ----------
    cache : StageCache
        Cache of knees, path lengths and images.
    request : ResolvedRequest
        Validated request from the page, with row and column of the pixel.

    Returns
    -------
    header : dict
        ``path_mm``: path length in each material, in mm. The value is None if the path lengths are not cached or the
        pixel is outside the image.
    content : bytes
        Empty bytes object.
    """
    row, col = request.pixel
    paths = cache.find_paths(request.knee, request.protocol)
    inside = 0 <= row < request.protocol.rows and 0 <= col < request.protocol.cols
    if paths is None or not inside:
        return {"path_mm": None}, b""
    # Path lengths are not rounded, because the page rounds them. Rounding twice would change 1.7449 to 1.75.
    along = {name: float(values[row, col]) for name, values in paths.path_mm.items()}
    return {"path_mm": {name: mm for name, mm in along.items() if mm > 5e-4}}, b""


def handle_masks(cache: StageCache, request: ResolvedRequest) -> Answer:
    """Compute a mask for each bone, osteophyte and cyst.

    Parameters
    ----------
    cache : StageCache
        Cache of knees, path lengths and images.
    request : ResolvedRequest
        Validated request from the page.

    Returns
    -------
    header : dict
        Names of the masks and image size.
    content : bytes
        Masks with one bit per pixel, in row-major order. Each mask starts at a byte boundary.
    """
    built = cache.build_knee(request.knee, request.protocol)
    protocol = built.aim_beam(request.protocol)
    view = resolve_view(protocol)
    seen = {name: compute_face_silhouette(mesh, view) for name, mesh in built.mask_meshes().items()}
    header = {"names": list(seen), "rows": protocol.rows, "cols": protocol.cols}
    return header, b"".join(np.packbits(mask.ravel()).tobytes() for mask in seen.values())


def handle_solids(cache: StageCache, request: ResolvedRequest) -> Answer:
    """Build an HTML page with a 3D view of the knee surfaces, the beam and the detector.

    Parameters
    ----------
    cache : StageCache
        Cache of knees, path lengths and images.
    request : ResolvedRequest
        Validated request from the page.

    Returns
    -------
    header : dict
        Empty dict.
    content : bytes
        HTML page in UTF-8.
    """
    built = cache.build_knee(request.knee, request.protocol)
    view = resolve_view(built.aim_beam(request.protocol))
    return {}, build_solids_page(built.scene, view, tolerance_mm=_MESH_TOLERANCE_MM).encode()


def handle_file(cache: StageCache, request: ResolvedRequest) -> Answer:
    """Encode a file for export. Radiographs are exported at full resolution.

    Parameters
    ----------
    cache : StageCache
        Cache of knees, path lengths and images.
    request : ResolvedRequest
        Validated request from the page, with the file format.

    Returns
    -------
    header : dict
        Dict with the file name under the key ``name``.
    content : bytes
        Content of the file.

    Raises
    ------
    InputError
        If the request does not specify a file format.
    """
    knee, protocol, kind = request.knee, request.full_protocol, request.kind
    stem = f"knee_{protocol.name}_seed{request.seed}"
    if kind in TEXT_KINDS:
        text = {
            "knee.toml": _format_toml(knee_to_dict(knee)),
            "protocol.toml": _format_toml(protocol_to_dict(protocol)),
        }
        text["py"] = format_python_lines(knee, protocol, request.seed, request.processing)
        return {"name": kind if kind != "py" else f"{stem}.py"}, text[kind].encode()
    if kind in MESH_KINDS:
        name, content = encode_meshes(cache.build_knee(knee, protocol).scene, kind, "knee")
        return {"name": name}, content
    if not kind:
        raise InputError(f"kind must be a file format, got {kind!r}")
    built = cache.build_knee(knee, protocol)
    paths = cache.find_paths(knee, protocol) if protocol.subpixels == 1 else None
    done = simulate(built, protocol, rng=request.seed, engine=ENGINE, paths=paths)
    return {"name": f"{stem}.{kind}"}, encode_radiograph(done, kind)


def _format_toml(table: Header) -> str:
    """Format a table as TOML, without entries whose value is None."""
    import tomli_w

    return tomli_w.dumps({name: value for name, value in table.items() if value is not None})


HANDLERS: dict[str, Callable[[StageCache, ResolvedRequest], Answer]] = {
    "probe": handle_probe,
    "radiograph": handle_radiograph,
    "masks": handle_masks,
    "solids": handle_solids,
    "file": handle_file,
}
