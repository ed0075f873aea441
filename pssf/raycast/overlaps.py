"""Where surfaces contradict each other: what rays find on a side of a surface, against what it says is there.

At every place along a ray each material is there as often as surfaces around the place have it inside, less as often as
they have it outside. In a scene that is right, one material is there once. Where one is there less than not at all, the
surfaces crossed on the way in and on the way out say what was not so.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.scene import Scene
from ..geometry.view import View
from . import scanline
from .paths import FOLD_MM
from .rays import to_mm
from .sheets import BAND_ROWS, Sheet, frame_of, sheet_of


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A surface that says what rays do not find.

    surface     that says so
    side        "outside" or "inside", of which it says so
    says        material that it names
    there       material that rays find
    owner       surface that has that inside; "" for the ambient material
    rays        that show it
    longest_mm  longest way along a ray on which materials do not add up because of it
    """

    surface: str
    side: str
    says: str
    there: str
    owner: str
    rays: int = 0
    longest_mm: float = 0.0

    def __str__(self) -> str:
        whose = f" ({self.owner})" if self.owner else ""
        where = f"over up to {self.longest_mm:.3g} mm of a ray"
        return f"{self.side} is {self.says}, but {self.there}{whose} is there, {where}"


class _Along(NamedTuple):
    """Crossings of rays with all surfaces of a scene, in order along each ray; each surface is left as it is entered.

    ray      (n,)  number of the ray
    at_mm    (n,)  from the source
    sign     (n,)  -1 for each entry, +1 for each exit
    surface  (n,)  number in the scene
    """

    ray: NDArray[np.int64]
    at_mm: Array
    sign: NDArray[np.int64]
    surface: NDArray[np.int64]

    def picked(self, which: slice | NDArray[np.int64]) -> "_Along":
        """Those crossings alone, in that order."""
        return _Along(self.ray[which], self.at_mm[which], self.sign[which], self.surface[which])


def contradictions(scene: Scene, view: View) -> tuple[Contradiction, ...]:
    """What surfaces say that the rays of a view do not find, where that concerns more than FOLD_MM of a ray."""
    tally: dict[Contradiction, list[float]] = {}
    for along in _bands(scene, view):
        wrong, long = _wrong(scene, along), _stretch_mm(along.ray, along.at_mm) > FOLD_MM
        for ray in np.unique(along.ray[wrong & long]):
            of_ray = slice(*np.searchsorted(along.ray, [ray, ray + 1]))
            longest: dict[Contradiction, float] = {}
            for what, length_mm in _along_ray(scene, along.picked(of_ray), wrong[of_ray], long[of_ray]):
                longest[what] = max(length_mm, longest.get(what, 0.0))
            for what, length_mm in longest.items():
                tally.setdefault(what, []).append(length_mm)
    return tuple(replace(what, rays=len(lengths), longest_mm=max(lengths)) for what, lengths in tally.items())


class Fold(NamedTuple):
    """Where a mesh goes around a place twice or backwards.

    surface     number in the scene
    rays        that show it
    longest_mm  longest way along a ray on which it does
    """

    surface: int
    rays: int
    longest_mm: float


def folded(scene: Scene, view: View) -> list[Fold]:
    """Meshes that overlap themselves or are folded inside out, for more than FOLD_MM of a ray of a view.

    Walls of a mesh that touch are no fold.
    """
    rays, longest = np.zeros(len(scene.surfaces), int), np.zeros(len(scene.surfaces))
    for along in _bands(scene, view):
        ray, at_mm, sign, surface = along.picked(np.lexsort((along.at_mm, along.ray, along.surface)))
        # The signs of every ray and surface add up to zero, so one sum serves all of them.
        around = -np.cumsum(sign)
        stretch_mm = _stretch_mm(ray, at_mm) * ((around < 0) | (around > 1))
        for number in np.unique(surface[stretch_mm > FOLD_MM]):
            own = (surface == number) & (stretch_mm > FOLD_MM)
            rays[number] += len(np.unique(ray[own]))
            longest[number] = max(longest[number], stretch_mm[own].max())
    return [Fold(int(k), int(rays[k]), float(longest[k])) for k in np.flatnonzero(rays)]


def _bands(scene: Scene, view: View) -> Iterator[_Along]:
    sheets = [sheet_of(surface.solid, view) for surface in scene.surfaces]
    for first in range(0, view.rows, BAND_ROWS):
        stop = min(first + BAND_ROWS, view.rows)
        length_mm = np.empty((stop - first, view.cols))
        to_mm(np.ones_like(length_mm), frame_of(view), first, length_mm)
        rays, at_mm, signs, surfaces = zip(
            *(_of_surface(sheet, number, length_mm, first) for number, sheet in enumerate(sheets)), strict=True
        )
        along = _Along(*map(np.concatenate, (rays, at_mm, signs, surfaces)))
        yield along.picked(np.lexsort((along.at_mm, along.ray)))


def _of_surface(sheet: Sheet, number: int, length_mm: Array, first: int) -> _Along:
    """Crossings with one surface in a band that starts at row `first` and whose rays have lengths (rows, cols)."""
    rows, cols = length_mm.shape
    top, bottom = max(first, sheet.rows[0]), min(first + rows, sheet.rows[1])
    if top >= bottom or sheet.cols[0] >= sheet.cols[1]:
        return _Along(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64))
    crossings = scanline.crossings(sheet, top, bottom)
    pixels = (np.arange(top - first, bottom - first)[:, None] * cols + np.arange(*sheet.cols)).ravel()
    ray, sign = np.repeat(pixels, np.diff(crossings.starts)), crossings.sign.astype(np.int64)
    # Who leaves more often than he enters was inside from the start.
    total = np.bincount(ray, sign, rows * cols).astype(np.int64)
    begun = np.flatnonzero(total)
    ray, sign = np.concatenate((begun, ray)), np.concatenate((-total[begun], sign))
    at = np.concatenate((np.zeros(len(begun)), np.minimum(crossings.depth, 1.0)))
    return _Along(ray, at * length_mm.ravel()[ray], sign, np.full(len(ray), number))


def _stretch_mm(ray: NDArray[np.int64], at_mm: Array) -> Array:
    """(n,)  from each crossing to the next of its ray; 0 for the last"""
    stretch_mm = np.zeros(len(ray))
    stretch_mm[:-1] = np.where(ray[1:] == ray[:-1], np.diff(at_mm), 0.0)
    return stretch_mm


def _wrong(scene: Scene, along: _Along) -> NDArray[np.bool_]:
    """(n,)  whether some material is there less than not at all, behind each crossing"""
    wrong = np.zeros(len(along.ray), np.bool_)
    for material in scene.materials:
        gained = np.array([(s.inside == material) - (s.outside == material) * 1 for s in scene.surfaces])
        wrong |= (material == scene.ambient) - np.cumsum(along.sign * gained[along.surface]) < 0
    return wrong


def _along_ray(
    scene: Scene, along: _Along, wrong: NDArray[np.bool_], long: NDArray[np.bool_]
) -> Iterator[tuple[Contradiction, float]]:
    """What surfaces say that one ray does not find, and for how long materials do not add up, mm.

    Crossings within FOLD_MM are taken in whatever order makes sense of them, as where surfaces share a wall.
    wrong, long  (n,)  whether materials do not add up behind a crossing, and whether the next is further than FOLD_MM
    """
    good, first, last = -1, -1, -1
    for k in range(len(along.ray)):
        if wrong[k] and long[k]:
            first, last = (k if first < 0 else first), k
        elif long[k] or k == len(along.ray) - 1:
            if first >= 0:
                length_mm = float(along.at_mm[last + 1] - along.at_mm[first])
                for what in _unmatched(scene, along, good, range(good + 1, first + 1), -1):
                    yield what, length_mm
                for what in _unmatched(scene, along, k, range(last + 1, k + 1), +1):
                    yield what, length_mm
            good, first = k, -1


def _unmatched(scene: Scene, along: _Along, known: int, crossings: range, way: int) -> list[Contradiction]:
    """Crossings that no order of them makes sense of, from a stretch that is right on to one that is wrong.

    known  crossing behind which the ray is right; -1 before the first
    way    -1 where the crossings lie behind that stretch, +1 where they lie before it: what enters leaves, seen from it
    """
    around = np.bincount(along.surface[: known + 1], -along.sign[: known + 1], len(scene.surfaces))
    counts = dict.fromkeys(scene.materials, 0.0) | {scene.ambient: 1.0}
    for surface, times in zip(scene.surfaces, around, strict=True):
        counts[surface.inside] += times
        counts[surface.outside] -= times
    there = max(counts, key=counts.__getitem__)
    left = []
    for k in crossings:
        number, enters = int(along.surface[k]), along.sign[k] == way
        # Entered twice, or left without having been entered: that is between the mesh and itself.
        if (around[number] < 1) == enters:
            left.append((number, "outside" if enters else "inside"))
    while match := next((one for one in left if getattr(scene.surfaces[one[0]], one[1]) == there), None):
        left.remove(match)
        number, side = match
        there = scene.surfaces[number].inside if side == "outside" else scene.surfaces[number].outside
        around[number] += 1 if side == "outside" else -1
    within = [s.name for s, times in zip(scene.surfaces, around, strict=True) if times >= 1 and s.inside == there]
    owner = within[-1] if within else ""
    concerned = [(scene.surfaces[number], side) for number, side in left]
    return [
        Contradiction(surface=s.name, side=side, says=getattr(s, side), there=there, owner=owner)
        for s, side in concerned
    ]
