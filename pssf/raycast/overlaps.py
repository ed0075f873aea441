"""Where surfaces contradict each other: what rays find outside of a surface, against what it says is there.

At every place along a ray each material is there as often as surfaces around the place have it inside, less as often as
they have it outside. In a scene that is right, one material is there once. Where one is there less than not at all, it
is asked which of the surfaces crossed before and behind are not in what they say: in the inside of the surface that was
entered last and not yet left.
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
from . import scanline
from .density_mismatch import is_same_density
from .paths import FOLD_MM
from .rays import to_mm
from .sheets import BAND_ROWS, Sheet, frame_of, sheet_of

# What follows a material whose density is not the one that a surface names.
_OTHER_DENSITY = " of another density"


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A surface that says what rays do not find.

    surface     that says so
    says        material that it has outside
    there       material that rays find there
    owner       surface that has that inside; "" for the ambient material
    rays        that show it
    longest_mm  longest way along a ray on which materials do not add up because of it
    """

    surface: str
    says: str
    there: str
    owner: str
    rays: int = 0
    longest_mm: float = 0.0

    @property
    def is_of_density(self) -> bool:
        """Tell whether the material is the one that the surface names and only its density differs."""
        return self.there == self.says + _OTHER_DENSITY

    def __str__(self) -> str:
        whose = f" ({self.owner})" if self.owner else ""
        where = f"over up to {self.longest_mm:.3g} mm of a ray"
        return f"outside is {self.says}, but {self.there}{whose} is there, {where}"


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
        """Those crossings alone, in that order.

        which  (k,)  numbers of crossings, or a slice of them
        """
        return _Along(self.ray[which], self.at_mm[which], self.sign[which], self.surface[which])


def contradictions(scene: Scene, view: View) -> tuple[Contradiction, ...]:
    """What surfaces say that the rays of a view do not find, where that concerns more than FOLD_MM of a ray."""
    longest: dict[Contradiction, Array] = defaultdict(lambda: np.zeros(view.rows * view.cols))
    for first, along in enumerate(_bands(scene, view)):
        for pattern, rays, at_mm in _patterns(scene, along):
            for what, run, shared in _along_pattern(scene, pattern):
                # Of what does not add up, what lies within both surfaces.
                ways_mm = np.minimum(*(at_mm[:, stop] - at_mm[:, start] for start, stop in (run, shared)))
                place = first * BAND_ROWS * view.cols + rays
                longest[what][place] = np.maximum(longest[what][place], ways_mm)
    return tuple(
        replace(what, rays=int((ways_mm > FOLD_MM).sum()), longest_mm=float(ways_mm.max()))
        for what, ways_mm in longest.items()
        if ways_mm.max() > FOLD_MM
    )


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
        length_mm = to_mm(np.ones((stop - first, view.cols)), frame_of(view), first)
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
    sides, ambient = _contents(scene)
    for content in np.unique(np.append(sides, ambient)):
        gained = (sides[:, 0] == content) - (sides[:, 1] == content) * 1
        wrong |= (content == ambient) - np.cumsum(along.sign * gained[along.surface]) < 0
    return wrong


def _contents(scene: Scene) -> tuple[NDArray[np.int64], int]:
    """Numbers of contents, which are materials each with the density that it has: (surfaces, 2) inside and outside, and
    the ambient one.
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


class _Pattern(NamedTuple):
    """What rays have in common that cross the same surfaces in the same order.

    surface, sign  of each crossing, as in _Along
    wrong          whether materials do not add up behind it
    long           whether the next crossing is further than FOLD_MM
    """

    surface: tuple[int, ...]
    sign: tuple[int, ...]
    wrong: tuple[bool, ...]
    long: tuple[bool, ...]


def _patterns(scene: Scene, along: _Along) -> Iterator[tuple[_Pattern, NDArray[np.int64], Array]]:
    """Rays along which materials do not add up: what they have in common, their numbers (k,), places (k, n) in mm."""
    wrong, long = _wrong(scene, along), _stretch_mm(along.ray, along.at_mm) > FOLD_MM
    columns = np.column_stack((along.surface, along.sign, wrong, long))
    alike: dict[bytes, list[int]] = {}
    numbers = np.unique(along.ray[wrong & long])
    starts, stops = np.searchsorted(along.ray, numbers), np.searchsorted(along.ray, numbers, side="right")
    for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        alike.setdefault(columns[start:stop].tobytes(), []).append(k)
    for those in alike.values():
        surface, sign, beyond, far = columns[starts[those[0]] : stops[those[0]]].T.tolist()
        places = starts[those][:, None] + np.arange(len(surface))
        yield _Pattern(tuple(surface), tuple(sign), tuple(beyond), tuple(far)), numbers[those], along.at_mm[places]


_Span = tuple[int, int]


def _along_pattern(scene: Scene, pattern: _Pattern) -> Iterator[tuple[Contradiction, _Span, _Span]]:
    """What surfaces say that rays do not find, between which crossings materials do not add up, and both surfaces lie.

    Crossings within FOLD_MM are taken in whatever order makes sense of them, as where surfaces share a wall.
    """
    spans, runs, of_surface = _spans(pattern), _runs(pattern), defaultdict[int, list[_Span]](list)
    sides, ambient = _contents(scene)
    for k, span in spans.items():
        of_surface[pattern.surface[k]].append(span)
    entered, first = list[int](), 0
    for last in range(len(pattern.sign)):
        if not pattern.long[last] and last < len(pattern.sign) - 1:
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
                shared = spans[k] if owner is None else _shared(spans[k], of_surface[owner], k)
                yield _contradiction(scene, pattern.surface[k], owner), run, shared
            left.remove(k)
            entered = [*around[k], pattern.surface[k]] if pattern.sign[k] < 0 else around[k]


def _contradiction(scene: Scene, number: int, owner: int | None) -> Contradiction:
    """What a surface says, against what is there: the inside of another surface, or the ambient material."""
    surface, around = scene.surfaces[number], None if owner is None else scene.surfaces[owner]
    there, name = (scene.ambient, "") if around is None else (around.inside, around.name)
    if there == surface.outside:
        there += _OTHER_DENSITY
    return Contradiction(surface=surface.name, says=surface.outside, there=there, owner=name)


def _spans(pattern: _Pattern) -> dict[int, _Span]:
    """Crossing -> those at which its surface is entered and left, if it is then around the ray once and not before."""
    around, begun, spans = dict[int, int](), dict[int, int](), dict[int, _Span]()
    for k, (number, sign) in enumerate(zip(pattern.surface, pattern.sign, strict=True)):
        before = around.get(number, 0)
        around[number] = before - sign
        if before == 0 and sign < 0:
            begun[number] = k
        elif before > 0 and around[number] == 0:
            spans[begun[number]] = spans[k] = begun[number], k
    return spans


def _runs(pattern: _Pattern) -> list[_Span | None]:
    """For each crossing, those between which materials do not add up, if they do not behind it."""
    runs: list[_Span | None] = [None] * len(pattern.sign)
    stretches = list(enumerate(zip(pattern.wrong, pattern.long, strict=True)))
    wrong = [k for k, (amiss, long) in stretches if amiss and long]
    right = [k for k, (amiss, long) in stretches if long and not amiss]
    for _, same in groupby(wrong, key=lambda k: bisect(right, k)):
        first, *others = same
        last = others[-1] if others else first
        runs[first : last + 1] = [(first, last + 1)] * (last + 1 - first)
    return runs


def _shared(span: _Span, others: list[_Span], crossing: int) -> _Span:
    """What a surface's span has in common with that of another around one of its crossings."""
    nearest = min(others, key=lambda other: max(other[0] - crossing, crossing - other[1], 0))
    start = max(span[0], nearest[0])
    return start, max(start, min(span[1], nearest[1]))
