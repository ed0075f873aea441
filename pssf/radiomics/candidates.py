"""The few best places of the whole joint, each with the medial compartment's best place near it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..data.localisation import Localisation
from .edges import Pyramid
from .patches import Template, poses
from .search import Match, score_maps, vertex


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A match of the whole joint, and the best of the medial compartment near it."""

    wide: Match
    narrow: Match

    @property
    def both(self) -> float:
        """Mean of both scores."""
        return (self.wide.score + self.narrow.score) / 2

    @property
    def excess(self) -> float:
        """Sum of both scores, each beyond chance."""
        return self.wide.excess + self.narrow.excess


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Matches of the whole joint in an image, of all sizes, sides and ways.

    rise  of the narrow score that chance gives, by the natural logarithm of the size of a pixel
    """

    image: Pyramid
    templates: tuple[Template, ...]
    matches: Sequence[Match]
    table: Localisation
    rise: float

    def best(self, way: str, side: str) -> Pair:
        """Of the few best whole joints of a way and side the one that is best with its medial compartment.

        A knee of a wrong size matches as a whole about as well as one of the right size that is not the templates'
        shape; its medial compartment does not.
        """
        return max((self._pair(wide) for wide in self._few(way, side)), key=lambda pair: pair.excess)

    def highest(self, way: str, *sides: str) -> float:
        """The highest score of a whole joint of a way and some sides."""
        return max(match.score for match in self.matches if match.way == way and match.side in sides)

    def _pair(self, wide: Match) -> Pair:
        narrow = _refined(self.image, self.templates, wide, self.table)
        return Pair(wide=wide, narrow=replace(narrow, chance=self.rise * float(np.log(wide.unit_mm))))

    def _few(self, way: str, side: str) -> list[Match]:
        """The best, and those nearly as good at another place or of another size."""
        search, few = self.table.search, list[Match]()
        of = sorted((m for m in self.matches if (m.way, m.side) == (way, side)), key=lambda match: -match.excess)
        for match in of:
            if len(few) == search.candidates or match.excess < of[0].excess - search.nearly:
                break
            if not any(_alike(match, one, self.table) for one in few):
                few.append(match)
        return [_between_sizes(match, self.matches) for match in few]


def evidence(score: float, other: float) -> float:
    """By how much a score is above another, over what the better of both leaves unexplained."""
    return (score - other) / max(1.0 - max(score, other), 1e-6)


def _alike(one: Match, other: Match, table: Localisation) -> bool:
    """Whether the medial compartment is looked for in about the same place and size for both."""
    away_mm = np.hypot(one.row - other.row, one.col - other.col) * other.unit_mm
    sizes = abs(np.log(one.unit_mm / other.unit_mm))
    same = away_mm <= table.search.reach_mm and sizes <= 2 * np.log(table.search.scale_step)
    return bool(same) and one.polarity == other.polarity


def _between_sizes(best: Match, matches: Sequence[Match]) -> Match:
    """The match with the size at the vertex of the scores of its own and its neighbours'."""
    alike = [m for m in matches if (m.side, m.way, m.polarity) == (best.side, best.way, best.polarity)]
    sizes = sorted(alike, key=lambda match: match.unit_mm)
    at = sizes.index(best)
    offset = float(np.clip(vertex(np.array([match.score for match in sizes]), at), -1.0, 1.0))
    if offset == 0.0:
        return best
    neighbour = sizes[at + (1 if offset > 0 else -1)].unit_mm
    return replace(best, unit_mm=best.unit_mm * (neighbour / best.unit_mm) ** abs(offset))


def _refined(image: Pyramid, templates: tuple[Template, ...], wide: Match, table: Localisation) -> Match:
    """The best narrow match within reach of the wide one."""
    law, best = table.narrow, replace(wide, score=-1.0)
    ours = [pose for pose in poses(templates, law) if (pose.side, pose.way) == (wide.side, wide.way)]
    extent_mm = max(law.up_mm, law.down_mm, law.lateral_mm, law.medial_mm) + table.search.reach_mm + 2 * law.tile_mm
    (top, bottom), (left, right) = (
        (max(0, int(at - extent_mm / wide.unit_mm)), int(at + extent_mm / wide.unit_mm) + 2)
        for at in (wide.row, wide.col)
    )
    near = Pyramid(image.levels[0][top:bottom, left:right])
    sign = 1.0 if wide.polarity == "bone bright" else -1.0
    for scale in table.search.narrow_scales:
        zoom = wide.unit_mm / scale / law.pitch_mm
        field = near.edges(zoom, law.tile_mm / law.pitch_mm)
        rows, cols = (
            (np.arange(length) + 0.5) / zoom - 0.5 + start
            for length, start in zip(field.shape[1:], (top, left), strict=True)
        )
        reach = table.search.reach_mm / wide.unit_mm
        within = (_span(rows, wide.row, reach), _span(cols, wide.col, reach))
        rows, cols = rows[within[0]], cols[within[1]]
        away = np.hypot(rows[:, None] - wide.row, cols - wide.col)
        for _, maps in score_maps(field, ours, within):
            allowed = np.where(away <= reach, sign * maps, -1.0)
            patch, row, col = (int(at) for at in np.unravel_index(np.argmax(allowed), allowed.shape))
            peak = allowed[patch]
            if peak[row, col] > best.score:
                best = replace(
                    wide,
                    score=float(peak[row, col]),
                    row=float(rows[row] + vertex(peak[:, col], row) / zoom),
                    col=float(cols[col] + vertex(peak[row], col) / zoom),
                )
    return best


def _span(places: Array, about: float, reach: float) -> slice:
    """Of ascending places those within reach, and one more each way."""
    first, last = np.searchsorted(places, (about - reach, about + reach))
    return slice(max(0, int(first) - 1), min(len(places), int(last) + 1))
