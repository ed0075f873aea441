"""Find negative path lengths, explain their cause, and raise an error for path lengths beyond the tolerance."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..core.checks import InputError
from ..geometry.scene import Scene
from ..geometry.view import View
from .engines import scanline
from .engines.pixel_rays import convert_to_mm
from .engines.projected_surface import BAND_ROWS, make_ray_frame, project_surface
from .path_lengths import OVERLAP_TOLERANCE_MM
from .surface_overlaps import find_contradictions, find_self_overlaps


class ShortestPath(NamedTuple):
    """Shortest path length in one material over all rays of a view.

    Attributes
    ----------
    min_path_mm : float
        Shortest path length, in mm; 0 if no path length is negative.
    row, col : int
        Row and column of the pixel with the shortest path.
    negative_rays : int
        Number of rays with a path length below -1e-4 mm, the limit of rounding errors.
    """

    min_path_mm: float
    row: int
    col: int
    negative_rays: int


# Largest rounding error of path lengths, in mm; it is 1e-6 for the scanline engine and 1e-4 for Embree.
_ROUNDING_MM = 1e-4


def find_shortest_paths(scene: Scene, view: View) -> dict[str, ShortestPath]:
    """Compute the shortest path length in every material except the ambient material.

    Parameters
    ----------
    scene : Scene
        Closed surfaces; every material is traced with a constant density.
    view : View
        Source and detector that define the rays.

    Returns
    -------
    dict of str to ShortestPath
        Shortest path of each material, keyed by material name.
    """
    least = {material: ShortestPath(0.0, 0, 0, 0) for material in scene.materials[1:]}
    sheets, frame = [project_surface(surface.solid, view) for surface in scene.surfaces], make_ray_frame(view)
    for first in range(0, view.rows, BAND_ROWS):
        stop = min(first + BAND_ROWS, view.rows)
        sums = {material: np.zeros((stop - first, view.cols)) for material in least}
        for surface, sheet in zip(scene.surfaces, sheets, strict=True):
            top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
            if top < bottom:
                chord = scanline.trace_chords(sheet, top, bottom)
                for material, sign in ((surface.inside, 1), (surface.outside, -1)):
                    if material in sums:
                        sums[material][top - first : bottom - first, slice(*sheet.cols)] += sign * chord
        for material, fraction in sums.items():
            path_mm = convert_to_mm(fraction, frame, first)
            row, col = np.unravel_index(path_mm.argmin(), path_mm.shape)
            before, negative = least[material], int((path_mm < -_ROUNDING_MM).sum())
            here = ShortestPath(float(path_mm[row, col]), first + int(row), int(col), 0)
            least[material] = min(before, here)._replace(negative_rays=before.negative_rays + negative)
    return least


def require_nonnegative_paths(path_maps: Mapping[str, Any], scene: Scene, view: View) -> None:
    """Raise an error if a path length is too negative to be explained by small mesh folds and rounding.

    Parameters
    ----------
    path_maps : mapping of str to (rows, cols) array, mm
        Path length per material.
    scene : Scene
        Traced scene.
    view : View
        Source and detector that define the rays.

    Raises
    ------
    InputError
        If a path length is below -0.05 mm. The message reports the material, the path length, the pixel and the
        surfaces that cause the error.
    """
    for material, lengths in path_maps.items():
        if not lengths.min() >= -OVERLAP_TOLERANCE_MM:
            path_mm = np.asarray(lengths)
            row, col = map(int, np.unravel_index(path_mm.argmin(), path_mm.shape))
            reason = explain_negative_path(scene, view, material, row, col)
            raise InputError(
                f"{material}: path length must be {-OVERLAP_TOLERANCE_MM:g} mm or more, got "
                f"{path_mm[row, col]:.4g} mm at pixel ({row}, {col}): {reason}"
            )


def explain_negative_path(scene: Scene, view: View, material: str, row: int, col: int) -> str:
    """Explain which surfaces or densities cause a negative path length.

    Parameters
    ----------
    scene : Scene
        Traced scene.
    view : View
        Source and detector that define the rays.
    material : str
        Material whose path length is negative.
    row, col : int
        Row and column of a pixel with a negative path length.

    Returns
    -------
    str
        Explanations, separated by semicolons.
    """
    x, y, z = view.first_pixel_mm
    pixel = (x + col * view.pixel_mm, y, z - row * view.pixel_mm)
    ray = View(source_mm=view.source_mm, centre_mm=pixel, rows=1, cols=1, pixel_mm=view.pixel_mm)
    contrary = find_contradictions(scene, ray)
    reasons = [f"{what.surface}: {what}" for what in contrary if what.stated_material == material]
    concerned = [s for s in scene.surfaces if material in (s.inside, s.outside)]
    for fold in find_self_overlaps(scene, ray):
        if (surface := scene.surfaces[fold.surface]) in concerned:
            reasons.append(f"{surface.name}: mesh overlaps itself or is inside out along this ray")
    varying = any(s.inside_density if s.inside == material else s.outside_density for s in concerned)
    if not reasons and varying:
        reasons = ["the integral of a density is negative"]
    return "; ".join(reasons) or "a surface has the wrong outside material, or two surfaces overlap"
