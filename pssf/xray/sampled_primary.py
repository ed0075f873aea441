"""Primary signal averaged over several points of the focal spot and of the pixel area."""

import numpy as np
from numpy.typing import NDArray

from ..geometry.mesh import Mesh
from ..geometry.mesh_topology import body_volumes_mm3, label_bodies
from ..geometry.scene import Scene
from ..geometry.view import View, depth_fraction, make_corner_view, make_focal_spot_views
from ..raycast import trace_sparse
from .primary_beam import Signal, apply_field_factors, compute_bare_primary, compute_primary
from .resolved_technique import Technique

# Number of source points along each side of the focal spot, for a sampled focal spot.
FOCAL_SPOT_POINTS = 3
# Largest number of rays that are traced at once, which limits the memory for their path lengths.
_MOST_RAYS = 4_500_000
# Deviation of a pixel from the mean of its neighbours, relative to this mean, above which one ray is not enough.
_UNRESOLVED = 0.01
# Smallest relative depth of a surface between source and detector, and smallest thickness in mm.
_LEAST_DEPTH = 1e-6
# Largest number of rays along the side of a pixel.
_MOST_SUBPIXELS = 16


def has_unresolved_edges(kev: NDArray[np.float32]) -> bool:
    """Return whether one ray per pixel misses details of a signal.

    Parameters
    ----------
    kev : (rows, cols) float32 array, keV
        Primary signal with one ray per pixel.

    Returns
    -------
    bool
        True if a pixel deviates from the mean of its two neighbours in a row or column by more than 1 % of it. The
        mean over the area of such a pixel can differ from the signal at its centre by up to a quarter of this
        deviation or, at a sharp edge, by up to half of the step.
    """
    for signal in (kev, kev.T):
        middle = signal[:, 1:-1]
        mean = (signal[:, :-2] + signal[:, 2:]) / 2
        if np.any(np.abs(middle - mean) > _UNRESOLVED * mean):
            return True
    return False


def count_rays_for_thin_bodies(scene: Scene, view: View) -> int:
    """Compute how many rays along the side of a pixel are enough to hit the thinnest surface of a scene.

    Parameters
    ----------
    scene : Scene
        Closed surfaces.
    view : View
        Source and detector.

    Returns
    -------
    int
        1 to 16. The thickness of each body of a surface is estimated as 4 x volume / area, which is the diameter of a
        wire and twice the thickness of a foil. Rays are at most a third of its projection apart, up to 16 rays.
    """
    thinnest_mm = min(
        (_thinnest_projection_mm(surface.mesh_arrays, view) for surface in scene.surfaces), default=np.inf
    )
    return int(np.clip(np.ceil(3 * view.pixel_mm / max(thinnest_mm, _LEAST_DEPTH)), 1, _MOST_SUBPIXELS))


def _thinnest_projection_mm(mesh: Mesh, view: View) -> float:
    """Compute the smallest projected thickness of the bodies of a mesh, in mm on the detector."""
    points, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    body, count = label_bodies(faces, len(points))
    volumes = np.abs(body_volumes_mm3(points, faces, body, count))
    owner, corners = body[faces[:, 0]], points[faces]
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    areas = np.bincount(owner, doubled / 2, minlength=count)
    depths = np.full(count, 1.0)
    np.minimum.at(depths, owner, depth_fraction(corners[:, 0], view))
    solid = areas > 0
    thickness = 4 * volumes[solid] / areas[solid] / np.maximum(depths[solid], _LEAST_DEPTH)
    return float(thickness.min(initial=np.inf))


def compute_sampled_primary(
    scene: Scene,
    technique: Technique,
    engine: str,
    workers: int,
    points_per_side: int = FOCAL_SPOT_POINTS,
    subpixels: int = 1,
) -> Signal:
    """Compute the primary as the mean over source points of a sampled focal spot and over the pixel area.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials.
    technique : Technique
        Resolved protocol.
    engine : {"embree", "scanline"}
        Ray casting engine.
    workers : int
        Number of threads; it does not change the result.
    points_per_side : int, default 3
        Number of points along each side of the focal spot, as in `geometry.view.make_focal_spot_views`; 1 is the
        centre of the focal spot.
    subpixels : int, default 1
        Square root of the number of rays per pixel and source point.

    Returns
    -------
    Signal
        Mean absorbed energy per pixel, and its variance divided by its mean.
    """
    protocol, shape = technique.protocol, (technique.view.rows, technique.view.cols)
    sources = make_focal_spot_views(protocol, points_per_side) if points_per_side > 1 else [(technique.view, 1.0)]
    if subpixels > 1:
        return _compute_area_primary(scene, technique, engine, workers, sources, subpixels)
    kev, square = (np.zeros(shape, np.float32) for _ in range(2))
    for view, share in sources:
        path_mm, _ = trace_sparse(scene, view, engine=engine, texture=protocol.texture != "none", workers=workers)
        one = compute_primary(path_mm, technique, workers, view)
        kev += np.float32(share) * one.kev
        square += np.float32(share) * one.kev * one.photon_kev
    return Signal(kev, np.divide(square, kev, out=np.zeros_like(kev), where=kev > 0))


def _compute_area_primary(
    scene: Scene, technique: Technique, engine: str, workers: int, sources: list[tuple[View, float]], subpixels: int
) -> Signal:
    """Compute the primary as the mean over the pixel area by the trapezoidal rule, for weighted source points.

    The points of a pixel are the corners of ``subpixels`` x ``subpixels`` squares. Points on the border of a pixel are
    shared with its neighbours, so the number of rays per pixel is ``subpixels**2``. Every edge that crosses a pixel
    separates two of its corners, so the signal of the pixel is between the signals on both sides of the edge.
    """
    protocol, view = technique.protocol, technique.view
    kev, square = (np.zeros((view.rows, view.cols), np.float32) for _ in range(2))
    band_rows = max(1, _MOST_RAYS // (view.cols * subpixels**2))
    for source, share in sources:
        for first in range(0, view.rows, band_rows):
            band = slice(first, min(first + band_rows, view.rows))
            corners = make_corner_view(source, band.start, band.stop - band.start, subpixels)
            path_mm, _ = trace_sparse(
                scene, corners, engine=engine, texture=protocol.texture != "none", workers=workers
            )
            one = compute_bare_primary(path_mm, technique, workers, corners)
            kev[band] += np.float32(share) * _sum_over_pixels(one.kev, subpixels)
            square[band] += np.float32(share) * _sum_over_pixels(one.kev * one.photon_kev, subpixels)
    photon_kev = np.divide(square, kev, out=np.zeros_like(kev), where=kev > 0)
    return apply_field_factors(Signal(kev, photon_kev), technique)


def _sum_over_pixels(corners: NDArray[np.float32], subpixels: int) -> NDArray[np.float32]:
    """Sum values at the corners of squares, (rows x subpixels + 1, cols x subpixels + 1), over pixels (rows, cols)."""
    weights = np.ones(subpixels + 1, np.float32)
    weights[[0, -1]] = 0.5
    for _ in range(2):  # rows first, then columns
        stop = len(corners) - subpixels
        total = sum(weight * corners[k : stop + k : subpixels] for k, weight in enumerate(weights))
        corners = np.asarray(total).T
    return corners
