"""Find surfaces whose stated outside material differs from the material that rays find around them.

At each point of a ray, every material has a count. The count is the number of enclosing surfaces with the material
inside, minus the number with the material outside. In a correct scene, one material has the count 1 and all others have
0. Where a count is negative, the surfaces crossed before and after the point are examined. The outside material of each
   examined surface is compared with the inside material of the innermost enclosing surface.
"""

from bisect import bisect
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.density import Density
from ..geometry.scene import Scene
from ..geometry.view import View
from .density_mismatch import is_same_density
from .engines import scanline
from .engines.pixel_rays import convert_to_mm
from .engines.projected_surface import (
    BAND_ROWS,
    ProjectedSurface,
    make_ray_frame,
    project_surface,
)
from .path_lengths import OVERLAP_TOLERANCE_MM

# Suffix of the found material if it differs from the stated outside material only in density.
_OTHER_DENSITY_SUFFIX = " of another density"


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """Surface whose stated outside material differs from the material that rays find around it.

    Attributes
    ----------
    surface : str
        Name of the surface.
    stated_material : str
        Outside material that the scene specifies for the surface.
    found_material : str
        Material that rays find around the surface.
    found_surface : str
        Name of the surface that contains the found material; ``""`` for the ambient material.
    rays : int
        Number of affected rays.
    longest_mm : float
        Longest ray segment with wrong material counts due to the contradiction, in mm.
    """

    surface: str
    stated_material: str
    found_material: str
    found_surface: str
    rays: int = 0
    longest_mm: float = 0.0

    @property
    def is_density_only(self) -> bool:
        """True if the stated and the found material are the same and only their densities differ."""
        return self.found_material == self.stated_material + _OTHER_DENSITY_SUFFIX

    def __str__(self) -> str:
        whose = f" ({self.found_surface})" if self.found_surface else ""
        where = f"over up to {self.longest_mm:.3g} mm of a ray"
        return f"outside is {self.stated_material}, but rays find {self.found_material}{whose}, {where}"


class _OrderedCrossings(NamedTuple):
    """Crossings of rays with all surfaces of a scene, in order along each ray.

    For each ray and surface, the number of exits equals the number of entries. The arrays have shape (n,): ray number,
    distance from the source in mm, sign (-1 on entry, +1 on exit) and surface number.
    """

    ray: NDArray[np.int64]
    distance_mm: Array
    sign: NDArray[np.int64]
    surface: NDArray[np.int64]

    def select(self, which: slice | NDArray[np.int64]) -> "_OrderedCrossings":
        """Select crossings by number.

        Parameters
        ----------
        which : slice or (k,) int64 array
            Numbers of the crossings to select, in the required order.

        Returns
        -------
        _OrderedCrossings
            The selected crossings.
        """
        return _OrderedCrossings(self.ray[which], self.distance_mm[which], self.sign[which], self.surface[which])


def find_contradictions(scene: Scene, view: View) -> tuple[Contradiction, ...]:
    """Find surfaces whose stated outside material differs from the material that the rays of a view find.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials and densities.
    view : View
        Source and detector that define the rays.

    Returns
    -------
    tuple of Contradiction
        Contradictions that affect more than 0.05 mm of a ray.
    """
    longest: dict[Contradiction, Array] = defaultdict(lambda: np.zeros(view.rows * view.cols))
    for first, along in enumerate(_iterate_bands(scene, view)):
        for pattern, rays, at_mm in _group_by_pattern(scene, along):
            for what, run, shared in _find_pattern_contradictions(scene, pattern):
                # The reported length is the segment inside both surfaces where the material counts are wrong.
                ways_mm = np.minimum(*(at_mm[:, stop] - at_mm[:, start] for start, stop in (run, shared)))
                place = first * BAND_ROWS * view.cols + rays
                longest[what][place] = np.maximum(longest[what][place], ways_mm)
    return tuple(
        replace(what, rays=int((ways_mm > OVERLAP_TOLERANCE_MM).sum()), longest_mm=float(ways_mm.max()))
        for what, ways_mm in longest.items()
        if ways_mm.max() > OVERLAP_TOLERANCE_MM
    )


class SelfOverlap(NamedTuple):
    """Mesh that encloses the same points more than once, or is partly inside out.

    Attributes
    ----------
    surface : int
        Number of the surface in the scene.
    rays : int
        Number of affected rays.
    longest_mm : float
        Length of the longest affected ray segment, in mm.
    """

    surface: int
    rays: int
    longest_mm: float


def find_self_overlaps(scene: Scene, view: View) -> list[SelfOverlap]:
    """Find meshes that overlap themselves or are inside out along the rays of a view.

    Mesh parts that only touch are not an overlap.

    Parameters
    ----------
    scene : Scene
        Closed surfaces.
    view : View
        Source and detector that define the rays.

    Returns
    -------
    list of SelfOverlap
        Overlaps that affect more than 0.05 mm of a ray, at most one per surface.
    """
    rays, longest = np.zeros(len(scene.surfaces), int), np.zeros(len(scene.surfaces))
    for along in _iterate_bands(scene, view):
        ray, at_mm, sign, surface = along.select(np.lexsort((along.distance_mm, along.ray, along.surface)))
        # The crossing signs of each ray and surface add up to zero, so one cumulative sum is correct for all rays and
        # surfaces.
        around = -np.cumsum(sign)
        stretch_mm = _distance_to_next_mm(ray, at_mm) * ((around < 0) | (around > 1))
        for number in np.unique(surface[stretch_mm > OVERLAP_TOLERANCE_MM]):
            own = (surface == number) & (stretch_mm > OVERLAP_TOLERANCE_MM)
            rays[number] += len(np.unique(ray[own]))
            longest[number] = max(longest[number], stretch_mm[own].max())
    return [SelfOverlap(int(k), int(rays[k]), float(longest[k])) for k in np.flatnonzero(rays)]


def _iterate_bands(scene: Scene, view: View) -> Iterator[_OrderedCrossings]:
    """Yield the ordered crossings of all surfaces for each band of rows."""
    sheets = [project_surface(surface.solid, view) for surface in scene.surfaces]
    for first in range(0, view.rows, BAND_ROWS):
        stop = min(first + BAND_ROWS, view.rows)
        length_mm = convert_to_mm(np.ones((stop - first, view.cols)), make_ray_frame(view), first)
        rays, at_mm, signs, surfaces = zip(
            *(_find_surface_crossings(sheet, number, length_mm, first) for number, sheet in enumerate(sheets)),
            strict=True,
        )
        along = _OrderedCrossings(*map(np.concatenate, (rays, at_mm, signs, surfaces)))
        yield along.select(np.lexsort((along.distance_mm, along.ray)))


def _find_surface_crossings(sheet: ProjectedSurface, number: int, length_mm: Array, first: int) -> _OrderedCrossings:
    """Find all crossings of rays with one surface, in the band that starts at row `first`.

    `length_mm` (rows, cols) are the ray lengths.
    """
    rows, cols = length_mm.shape
    top, bottom = max(first, sheet.rows[0]), min(first + rows, sheet.rows[1])
    if top >= bottom or sheet.cols[0] >= sheet.cols[1]:
        return _OrderedCrossings(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64))
    crossings = scanline.find_crossings(sheet, top, bottom)
    pixels = (np.arange(top - first, bottom - first)[:, None] * cols + np.arange(*sheet.cols)).ravel()
    ray, sign = np.repeat(pixels, np.diff(crossings.starts)), crossings.sign.astype(np.int64)
    # A ray with more exits than entries starts inside the surface, so an entry is added at the source.
    total = np.bincount(ray, sign, rows * cols).astype(np.int64)
    begun = np.flatnonzero(total)
    ray, sign = np.concatenate((begun, ray)), np.concatenate((-total[begun], sign))
    at = np.concatenate((np.zeros(len(begun)), np.minimum(crossings.depth, 1.0)))
    return _OrderedCrossings(ray, at * length_mm.ravel()[ray], sign, np.full(len(ray), number))


def _distance_to_next_mm(ray: NDArray[np.int64], at_mm: Array) -> Array:
    """Compute the distance (n,) from each crossing to the next crossing of its ray, in mm; 0 for the last crossing."""
    stretch_mm = np.zeros(len(ray))
    stretch_mm[:-1] = np.where(ray[1:] == ray[:-1], np.diff(at_mm), 0.0)
    return stretch_mm


def _find_inconsistent(scene: Scene, along: _OrderedCrossings) -> NDArray[np.bool_]:
    """Mark the crossings (n,) after which any material has a negative count."""
    wrong = np.zeros(len(along.ray), np.bool_)
    sides, ambient = _number_contents(scene)
    for content in np.unique(np.append(sides, ambient)):
        gained = (sides[:, 0] == content) - (sides[:, 1] == content) * 1
        wrong |= (content == ambient) - np.cumsum(along.sign * gained[along.surface]) < 0
    return wrong


def _number_contents(scene: Scene) -> tuple[NDArray[np.int64], int]:
    """Number the contents of a scene; a content is a material together with its density.

    Returns the numbers of the contents inside and outside each surface, (surfaces, 2), and of the ambient content.
    """
    known: list[tuple[str, Density | None]] = [(scene.ambient, None)]

    def number(material: str, density: Density | None) -> int:
        for place, (name, other) in enumerate(known):
            if name == material and is_same_density(density, other):
                return place
        known.append((material, density))
        return len(known) - 1

    sides = [(number(s.inside, s.inside_density), number(s.outside, s.outside_density)) for s in scene.surfaces]
    return np.array(sides), 0


class _CrossingPattern(NamedTuple):
    """Sequence of crossings that is common to a group of rays.

    All fields have one entry per crossing: surface number, sign, whether material counts are wrong after the crossing,
    and whether the next crossing is more than 0.05 mm away.
    """

    surface: tuple[int, ...]
    sign: tuple[int, ...]
    inconsistent: tuple[bool, ...]
    next_is_far: tuple[bool, ...]


def _group_by_pattern(
    scene: Scene, along: _OrderedCrossings
) -> Iterator[tuple[_CrossingPattern, NDArray[np.int64], Array]]:
    """Group the rays with wrong material counts by their crossing pattern.

    Yields the pattern, the ray numbers (k,) and the distances of the crossings (k, n) from the source, in mm.
    """
    wrong, long = (
        _find_inconsistent(scene, along),
        _distance_to_next_mm(along.ray, along.distance_mm) > OVERLAP_TOLERANCE_MM,
    )
    columns = np.column_stack((along.surface, along.sign, wrong, long))
    alike: dict[bytes, list[int]] = {}
    numbers = np.unique(along.ray[wrong & long])
    starts, stops = np.searchsorted(along.ray, numbers), np.searchsorted(along.ray, numbers, side="right")
    for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        alike.setdefault(columns[start:stop].tobytes(), []).append(k)
    for those in alike.values():
        surface, sign, beyond, far = columns[starts[those[0]] : stops[those[0]]].T.tolist()
        places = starts[those][:, None] + np.arange(len(surface))
        yield (
            _CrossingPattern(tuple(surface), tuple(sign), tuple(beyond), tuple(far)),
            numbers[those],
            along.distance_mm[places],
        )


# First and last crossing number of a range.
_Span = tuple[int, int]


def _find_pattern_contradictions(
    scene: Scene, pattern: _CrossingPattern
) -> Iterator[tuple[Contradiction, _Span, _Span]]:
    """Find the contradictions in a crossing pattern.

    Yields each contradiction with two ranges of crossings: where material counts are wrong, and where both surfaces
    enclose the ray. Because two surfaces may share a boundary, crossings less than 0.05 mm apart are reordered to a
    consistent sequence if possible.
    """
    spans, runs, of_surface = (
        _find_spans(pattern),
        _find_inconsistent_runs(pattern),
        defaultdict[int, list[_Span]](list),
    )
    sides, ambient = _number_contents(scene)
    for k, span in spans.items():
        of_surface[pattern.surface[k]].append(span)
    entered, first = list[int](), 0
    for last in range(len(pattern.sign)):
        if not pattern.next_is_far[last] and last < len(pattern.sign) - 1:
            continue
        run = runs[last] or (runs[first - 1] if first else None)
        left = [k for k in range(first, last + 1) if k in spans]
        first = last + 1
        while left:
            around = {k: [n for n in entered if n != pattern.surface[k]] for k in left}
            there = {k: sides[around[k][-1], 0] if around[k] else ambient for k in left}
            right = [k for k in left if sides[pattern.surface[k], 1] == there[k]]
            k = (right or left)[0]
            if not right and run:
                owner = around[k][-1] if around[k] else None
                shared = spans[k] if owner is None else _intersect_spans(spans[k], of_surface[owner], k)
                yield _make_contradiction(scene, pattern.surface[k], owner), run, shared
            left.remove(k)
            entered = [*around[k], pattern.surface[k]] if pattern.sign[k] < 0 else around[k]


def _make_contradiction(scene: Scene, number: int, owner: int | None) -> Contradiction:
    """Describe the contradiction between a surface and its innermost enclosing surface (`owner`)."""
    surface, around = scene.surfaces[number], None if owner is None else scene.surfaces[owner]
    there, name = (scene.ambient, "") if around is None else (around.inside, around.name)
    if there == surface.outside:
        there += _OTHER_DENSITY_SUFFIX
    return Contradiction(
        surface=surface.name, stated_material=surface.outside, found_material=there, found_surface=name
    )


def _find_spans(pattern: _CrossingPattern) -> dict[int, _Span]:
    """Map each crossing to the entry and the exit of its surface, for surfaces that do not overlap themselves."""
    around, begun, spans = dict[int, int](), dict[int, int](), dict[int, _Span]()
    for k, (number, sign) in enumerate(zip(pattern.surface, pattern.sign, strict=True)):
        before = around.get(number, 0)
        around[number] = before - sign
        if before == 0 and sign < 0:
            begun[number] = k
        elif before > 0 and around[number] == 0:
            spans[begun[number]] = spans[k] = begun[number], k
    return spans


def _find_inconsistent_runs(pattern: _CrossingPattern) -> list[_Span | None]:
    """For each crossing, return the range of wrong material counts around it, or None if the counts are correct."""
    runs: list[_Span | None] = [None] * len(pattern.sign)
    stretches = list(enumerate(zip(pattern.inconsistent, pattern.next_is_far, strict=True)))
    wrong = [k for k, (amiss, long) in stretches if amiss and long]
    right = [k for k, (amiss, long) in stretches if long and not amiss]
    for _, same in groupby(wrong, key=lambda k: bisect(right, k)):
        first, *others = same
        last = others[-1] if others else first
        runs[first : last + 1] = [(first, last + 1)] * (last + 1 - first)
    return runs


def _intersect_spans(span: _Span, others: list[_Span], crossing: int) -> _Span:
    """Among `others`, select the span closest to a crossing, and return its intersection with `span`."""
    nearest = min(others, key=lambda other: max(other[0] - crossing, crossing - other[1], 0))
    start = max(span[0], nearest[0])
    return start, max(start, min(span[1], nearest[1]))
