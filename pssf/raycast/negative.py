"""Paths of less than nothing: where they are, why, and which are refused."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..core.checks import InputError
from ..geometry.scene import Scene
from ..geometry.view import View
from . import scanline
from .overlaps import contradictions, folded
from .paths import FOLD_MM
from .rays import to_mm
from .sheets import BAND_ROWS, frame_of, sheet_of


class Least(NamedTuple):
    """The shortest path in a material over the rays of a view, and on how many rays it is negative."""

    mm: float
    row: int
    col: int
    negative: int


# Paths are exact to a millionth of a millimetre, or 1e-4 mm by Embree.
_ROUNDING_MM = 1e-4


def least_paths(scene: Scene, view: View) -> dict[str, Least]:
    """Material -> the shortest path in it, of every one but the ambient; densities are taken as the materials' own."""
    least = {material: Least(0.0, 0, 0, 0) for material in scene.materials[1:]}
    sheets, frame = [sheet_of(surface.solid, view) for surface in scene.surfaces], frame_of(view)
    for first in range(0, view.rows, BAND_ROWS):
        stop = min(first + BAND_ROWS, view.rows)
        sums = {material: np.zeros((stop - first, view.cols)) for material in least}
        for surface, sheet in zip(scene.surfaces, sheets, strict=True):
            top, bottom = max(first, sheet.rows[0]), min(stop, sheet.rows[1])
            if top < bottom:
                chord = scanline.chords(sheet, top, bottom)
                for material, sign in ((surface.inside, 1), (surface.outside, -1)):
                    if material in sums:
                        sums[material][top - first : bottom - first, slice(*sheet.cols)] += sign * chord
        for material, fraction in sums.items():
            path_mm = to_mm(fraction, frame, first)
            row, col = np.unravel_index(path_mm.argmin(), path_mm.shape)
            before, negative = least[material], int((path_mm < -_ROUNDING_MM).sum())
            here = Least(float(path_mm[row, col]), first + int(row), int(col), 0)
            least[material] = min(before, here)._replace(negative=before.negative + negative)
    return least


def require_paths(held: Mapping[str, Any], scene: Scene, view: View) -> None:
    """Refuse paths of less than nothing: by more than folds of a mesh and rounding bring about.

    held    material -> (rows, cols)  path lengths of the scene in the view, mm
    raises  InputError naming material, length, pixel and the surfaces that are in the way of a right answer
    """
    for material, lengths in held.items():
        if not lengths.min() >= -FOLD_MM:
            path_mm = np.asarray(lengths)
            row, col = map(int, np.unravel_index(path_mm.argmin(), path_mm.shape))
            reason = why_negative(scene, view, material, row, col)
            raise InputError(
                f"{material}: path length {path_mm[row, col]:.4g} mm at pixel ({row}, {col}): {reason}; "
                f"allowed: {-FOLD_MM:g} mm or more"
            )


def why_negative(scene: Scene, view: View, material: str, row: int, col: int) -> str:
    """What surfaces or densities make the path in a material negative at a pixel, in words."""
    x, y, z = view.corner_mm
    pixel = (x + col * view.pixel_mm, y, z - row * view.pixel_mm)
    ray = View(source_mm=view.source_mm, centre_mm=pixel, rows=1, cols=1, pixel_mm=view.pixel_mm)
    contrary = contradictions(scene, ray)
    reasons = [f"{what.surface}: {what}" for what in contrary if what.says == material]
    concerned = [s for s in scene.surfaces if material in (s.inside, s.outside)]
    for fold in folded(scene, ray):
        if (surface := scene.surfaces[fold.surface]) in concerned:
            reasons.append(f"{surface.name}: its mesh overlaps itself or is folded inside out there")
    varying = any(s.inside_density if s.inside == material else s.outside_density for s in concerned)
    if not reasons and varying:
        reasons = ["a density integrates to less than 0"]
    return "; ".join(reasons) or "a surface has it outside where it is not, or two surfaces overlap"
