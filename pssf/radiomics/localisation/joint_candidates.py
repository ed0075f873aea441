"""Joint candidates: the best whole-joint matches, each with the best medial-compartment match nearby."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.checks import Array
from ...data.analysis.localisation_table import LocalisationSettings
from .edge_field import Pyramid
from .template_matching import Match, compute_score_maps, fit_peak_offset
from .templates import Template, make_poses


@dataclass(frozen=True, kw_only=True)
class MatchPair:
    """Whole-joint match, and the best medial-compartment match near it.

    Attributes
    ----------
    joint_match : Match
        Match of the whole joint.
    compartment_match : Match
        Match of the medial compartment.
    """

    joint_match: Match
    compartment_match: Match

    @property
    def mean_score(self) -> float:
        """Mean of the whole-joint score and the compartment score, dimensionless."""
        return (self.joint_match.score + self.compartment_match.score) / 2

    @property
    def excess(self) -> float:
        """Sum of the whole-joint and compartment scores, each minus its chance score, dimensionless."""
        return self.joint_match.excess + self.compartment_match.excess


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Whole-joint matches in an image, for all sizes, left and right knees, and orientations.

    Attributes
    ----------
    image : Pyramid
        Image to search.
    templates : tuple of Template
        Template radiographs for the medial compartment.
    matches : sequence of Match
        Whole-joint matches.
    table : LocalisationSettings
        Search settings and thresholds.
    chance_slope : float
        Increase in the chance score of compartment matches per unit of ln(pixel size).
    """

    image: Pyramid
    templates: tuple[Template, ...]
    matches: Sequence[Match]
    table: LocalisationSettings
    chance_slope: float

    def select_pair(self, way: str, side: str) -> MatchPair:
        """Select the pair of whole-joint and compartment match with the highest sum of scores, for one side.

        The whole-joint score alone is not sufficient. If the bone shape differs from the templates, a wrong size can
        have as high a whole-joint score as the true size. The compartment score is lower for a wrong size.

        Parameters
        ----------
        way : {"upright", "upside down"}
            Orientation of the knee.
        side : {"right", "left"}
            Left or right knee.

        Returns
        -------
        MatchPair
            Pair with the highest sum of scores.
        """
        return max((self._make_pair(wide) for wide in self._select_candidates(way, side)), key=lambda pair: pair.excess)

    def highest_score(self, way: str, *sides: str) -> float:
        """Return the highest whole-joint score for one orientation and one or both sides.

        Parameters
        ----------
        way : {"upright", "upside down"}
            Orientation of the knee.
        *sides : str
            Knee sides ("right", "left") to include.

        Returns
        -------
        float
            Highest whole-joint score, dimensionless.
        """
        return max(match.score for match in self.matches if match.orientation == way and match.side in sides)

    def _make_pair(self, wide: Match) -> MatchPair:
        """Make a pair of a whole-joint match and the best medial-compartment match near it."""
        narrow = _find_compartment_match(self.image, self.templates, wide, self.table)
        return MatchPair(
            joint_match=wide,
            compartment_match=replace(narrow, chance_score=self.chance_slope * float(np.log(wide.template_mm_per_px))),
        )

    def _select_candidates(self, way: str, side: str) -> list[Match]:
        """Select the best whole-joint match, and almost equally good matches at other positions or of other sizes."""
        search, few = self.table.search, list[Match]()
        of = sorted(
            (m for m in self.matches if (m.orientation, m.side) == (way, side)), key=lambda match: -match.excess
        )
        for match in of:
            if len(few) == search.candidates or match.excess < of[0].excess - search.max_score_deficit:
                break
            if not any(_is_same_place(match, one, self.table) for one in few):
                few.append(match)
        return [_interpolate_size(match, self.matches) for match in few]


def relative_margin(score: float, other: float) -> float:
    """Compute the difference between two scores, divided by 1 minus the higher score.

    Parameters
    ----------
    score : float
        First score, at most 1.
    other : float
        Second score, at most 1.

    Returns
    -------
    float
        Relative margin, dimensionless; negative if `other` is higher.
    """
    return (score - other) / max(1.0 - max(score, other), 1e-6)


def _is_same_place(one: Match, other: Match, table: LocalisationSettings) -> bool:
    """Report whether two matches have about the same position and size, so that their compartment searches overlap."""
    away_mm = np.hypot(one.row - other.row, one.col - other.col) * other.template_mm_per_px
    sizes = abs(np.log(one.template_mm_per_px / other.template_mm_per_px))
    same = away_mm <= table.search.reach_mm and sizes <= 2 * np.log(table.search.scale_step)
    return bool(same) and one.polarity == other.polarity


def _interpolate_size(best: Match, matches: Sequence[Match]) -> Match:
    """Refine the size of a match by a parabola through its score and the scores of the two adjacent sizes."""
    alike = [m for m in matches if (m.side, m.orientation, m.polarity) == (best.side, best.orientation, best.polarity)]
    sizes = sorted(alike, key=lambda match: match.template_mm_per_px)
    at = sizes.index(best)
    offset = float(np.clip(fit_peak_offset(np.array([match.score for match in sizes]), at), -1.0, 1.0))
    if offset == 0.0:
        return best
    neighbour = sizes[at + (1 if offset > 0 else -1)].template_mm_per_px
    return replace(
        best, template_mm_per_px=best.template_mm_per_px * (neighbour / best.template_mm_per_px) ** abs(offset)
    )


def _find_compartment_match(
    image: Pyramid, templates: tuple[Template, ...], wide: Match, table: LocalisationSettings
) -> Match:
    """Find the best medial-compartment match within the search distance of a whole-joint match."""
    law, best = table.narrow, replace(wide, score=-1.0)
    ours = [
        pose for pose in make_poses(templates, law) if (pose.side, pose.orientation) == (wide.side, wide.orientation)
    ]
    extent_mm = max(law.up_mm, law.down_mm, law.lateral_mm, law.medial_mm) + table.search.reach_mm + 2 * law.tile_mm
    (top, bottom), (left, right) = (
        (max(0, int(at - extent_mm / wide.template_mm_per_px)), int(at + extent_mm / wide.template_mm_per_px) + 2)
        for at in (wide.row, wide.col)
    )
    near = Pyramid(image.levels[0][top:bottom, left:right])
    sign = 1.0 if wide.polarity == "bone bright" else -1.0
    for scale in table.search.narrow_scales:
        zoom = wide.template_mm_per_px / scale / law.pitch_mm
        field = near.edges(zoom, law.tile_mm / law.pitch_mm)
        rows, cols = (
            (np.arange(length) + 0.5) / zoom - 0.5 + start
            for length, start in zip(field.shape[1:], (top, left), strict=True)
        )
        reach = table.search.reach_mm / wide.template_mm_per_px
        within = (_slice_within_reach(rows, wide.row, reach), _slice_within_reach(cols, wide.col, reach))
        rows, cols = rows[within[0]], cols[within[1]]
        away = np.hypot(rows[:, None] - wide.row, cols - wide.col)
        for _, maps in compute_score_maps(field, ours, within):
            allowed = np.where(away <= reach, sign * maps, -1.0)
            patch, row, col = (int(at) for at in np.unravel_index(np.argmax(allowed), allowed.shape))
            peak = allowed[patch]
            if peak[row, col] > best.score:
                best = replace(
                    wide,
                    score=float(peak[row, col]),
                    row=float(rows[row] + fit_peak_offset(peak[:, col], row) / zoom),
                    col=float(cols[col] + fit_peak_offset(peak[row], col) / zoom),
                )
    return best


def _slice_within_reach(positions: Array, centre: float, reach: float) -> slice:
    """Return the slice of ascending positions within a distance of a centre, extended by one position at each end."""
    first, last = np.searchsorted(positions, (centre - reach, centre + reach))
    return slice(max(0, int(first) - 1), min(len(positions), int(last) + 1))
