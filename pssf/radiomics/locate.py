"""Where the joint is on any radiograph or film, which side and way up, and how large; or why it is not told."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.blocks import block_mean
from ..core.checks import Array, InputError, require, require_choice
from ..data.localisation import Localisation
from .candidates import Candidates, Pair, evidence
from .edges import Pyramid
from .patches import LINEAR_MM, SIDES, WAYS, Template, density_of, poses
from .region import region_fits
from .search import Match, matches
from .sides import side_evidence

STATUSES = ("found", "no knee", "upside down", "wrong side", "wrong scale", "low score", "leaves image")


@dataclass(frozen=True, kw_only=True)
class Located:
    """What the search gave; of the best match even where it is refused.

    row, col     medial joint line, pixels of the film
    status       one of STATUSES
    score        correlation of edges with the whole joint's, -1 to 1
    narrow       the same of the medial compartment alone
    side         right | left: as it is given, else the one that matches better
    side_margin  by how much the highest score of that side is above that of the other, wherever they are
    side_evidence  for that side: about 1 for a knee of it, -1 for one of the other, see `sides`
    way          upright | upside down
    way_margin   by how much that way's score is above the other's
    polarity     bone bright | bone dark
    scale        size of the knee at the film over the standard knee's at its detector
    pixel_mm     pitch: as it is given, else estimated from the size of the joint
    pixel_from   given | plateau
    apart_mm     how far above or below the wide match the narrow one is, mm of the standard knee
    seen         share of the whole joint's patch within the film
    pixel_height of the film's pixels over their width, which pixel_mm is
    """

    row: float
    col: float
    status: str
    score: float
    narrow: float
    side: str
    side_margin: float
    side_evidence: float
    way: str
    way_margin: float
    polarity: str
    scale: float
    pixel_mm: float
    pixel_from: str
    apart_mm: float
    seen: float
    pixel_height: float = 1.0

    @property
    def square_row(self) -> float:
        """Row on `aspect.with_square_pixels`."""
        return (self.row + 0.5) * self.pixel_height - 0.5

    @property
    def both(self) -> float:
        """Mean of both scores, by which it is judged whether there is a knee."""
        return (self.score + self.narrow) / 2

    @property
    def way_evidence(self) -> float:
        """The way's margin over what the better of both leaves unexplained; below 0 where that is the other.

        Where a knee's shape is not the templates', both ways match it worse and their difference tells less.
        """
        return evidence(self.score, self.score - self.way_margin)


def find_joint(
    pixels: NDArray[np.integer | np.floating],
    templates: Sequence[Template],
    table: Localisation,
    *,
    side: str,
    pixel_mm: float,
    region_px: int = 512,
) -> Located:
    """`locate` on linear pixels of a radiograph of known side and pitch.

    pixels  (rows, cols) linear, DN; columns run to world +x, so medial is right in a right knee and left in a left one
    raises  InputError as `locate`
    """
    step = max(1, int(LINEAR_MM / pixel_mm))
    joint = locate(density_of(block_mean(pixels, step)), templates, table, side=side, pixel_mm=pixel_mm * step)
    joint = in_pixels(joint, step, pixel_mm)
    if joint.status == "found" and not region_fits(pixels.shape, joint.row, joint.col, region_px):
        return replace(joint, status="leaves image")
    return joint


def in_pixels(joint: Located, step: int, pixel_mm: float) -> Located:
    """The same place in the pixels of an image, where it was found in means of step x step of them."""
    row, col = (at * step + (step - 1) / 2 for at in (joint.row, joint.col))
    return replace(joint, row=row, col=col, pixel_mm=pixel_mm)


def locate(
    density: Array | Pyramid,
    templates: Sequence[Template],
    table: Localisation,
    *,
    side: str | None = None,
    pixel_mm: float | None = None,
    region_px: int | None = None,
    least_share: float = 0.0,
    severe: bool = False,
) -> Located:
    """Where the medial joint line is.

    Directions of edges are correlated, relative to the strength of the edges about, so that any display's tone will do.
    First the whole joint is looked for at a coarse pitch: over places, sizes, both sides, upright and upside down, bone
    bright and dark; where the pitch is not known, sizes are weighed by how far a score is beyond what chance gives.
    Then the medial compartment near the best few of these: over templates, turns and sizes, to a fraction of a pixel;
    of the few that is taken which is best by both. What is given is checked against what is found.

    density    (rows, cols) bone bright, any unit that is monotone: minus the logarithm of a signal, or a film as
               displayed; row 0 proximal, and a right knee's fibula on the left; or a pyramid of it, see `searched`
    templates  standard knees: the first and last or severe ones are looked for whole, all in the medial compartment
    table      by which it is looked for, and refused
    side       right | left; None where it is not known
    pixel_mm   pitch at the film; None where it is not known, and it is estimated
    region_px  side of the region that must fit into the image around the joint line
    least_share  of the film's width, which the plateau takes at least where the pitch is not known
    severe     whether severe knees are looked for, and usual ones in the medial compartment alone
    raises     InputError for an unknown side, a pitch out of range, no template, or one without its plateau's
               width where the pitch is not known
    """
    if side is not None:
        require_choice("side", side, SIDES)
    if all(template.severe for template in templates):
        raise InputError("templates = none; allowed: one or more")
    search, of_sides = searched(density, templates, table, pixel_mm, least_share, severe)
    for_right = side_evidence(search.image, of_sides, table)
    chosen = side or _side_of(of_sides, for_right, table)
    best, mirrored = of_sides[chosen], SIDES[1 - SIDES.index(chosen)]
    wide, narrow = best.wide, best.narrow
    pitch_mm, pixel_from, scale = _size(wide, templates[0], pixel_mm, table)
    located = Located(
        row=narrow.row,
        col=narrow.col,
        status="found",
        score=wide.score,
        narrow=narrow.score,
        side=chosen,
        side_margin=search.highest(wide.way, chosen) - search.highest(wide.way, mirrored),
        side_evidence=for_right if chosen == SIDES[0] else -for_right,
        way=wide.way,
        way_margin=wide.score - search.highest(WAYS[1 - WAYS.index(wide.way)], *SIDES),
        polarity=wide.polarity,
        seen=wide.seen,
        apart_mm=abs(narrow.row - wide.row) * wide.unit_mm,
        pixel_mm=pitch_mm,
        pixel_from=pixel_from,
        scale=scale,
    )
    return replace(located, status=_status(located, density.shape, region_px, table, side))


def searched(
    density: Array | Pyramid,
    templates: Sequence[Template],
    table: Localisation,
    pixel_mm: float | None,
    least_share: float = 0.0,
    severe: bool = False,
) -> tuple[Candidates, dict[str, Pair]]:
    """All matches of the whole joint, and of each side the best, with its medial compartment.

    density    (rows, cols) bone bright, any unit that is monotone; or a pyramid of it, which keeps what is seen of it
    templates  and what else is given: as in `locate`
    raises  InputError for a pitch out of range, or an image that cannot hold a joint
    """
    image = density if isinstance(density, Pyramid) else Pyramid(density)
    usual = tuple(template for template in templates if not template.severe)
    added = tuple(template for template in templates if severe and template.severe)
    whole = poses(added or tuple(dict.fromkeys((usual[0], usual[-1]))), table.wide)
    units = _units(density.shape, usual[0], pixel_mm, table, least_share)
    matched = list(matches(image, units, whole, table.wide, table.search.least_seen))
    if pixel_mm is None:
        matched = [replace(match, chance=_chance(density.shape, match.unit_mm, table)) for match in matched]
    if not matched:
        raise InputError(f"image of {density.shape} pixels of {pixel_mm} mm; allowed: one that holds a knee joint")
    chance = _rise(pixel_mm, table)
    search = Candidates(image=image, templates=(*usual, *added), matches=matched, table=table, rise=chance)
    of_sides = _upright_or_not(search)
    if pixel_mm is not None and max(pair.both for pair in of_sides.values()) < table.thresholds.both:
        matched += matches(image, _smaller(pixel_mm, table), whole, table.wide, table.search.least_seen)
        of_sides = _upright_or_not(search)
    return search, of_sides


def _upright_or_not(search: Candidates) -> dict[str, Pair]:
    """Side -> the best match, upright unless one upside down is better by more than chance, and the narrow one too."""
    upright = {side: search.best(WAYS[0], side) for side in SIDES}
    best = max(upright.values(), key=lambda pair: pair.excess)
    if evidence(search.highest(WAYS[1], *SIDES), best.wide.score) <= search.table.thresholds.way:
        return upright
    turned = {side: search.best(WAYS[1], side) for side in SIDES}
    other = max(turned.values(), key=lambda pair: pair.excess)
    return turned if other.narrow.score > best.narrow.score else upright


def _side_of(pairs: dict[str, Pair], for_right: float, table: Localisation) -> str:
    """The better side; of two at one joint the one that its edges tell, since matches are much alike."""
    one, other = (pairs[side].wide for side in SIDES)
    apart_mm = abs(one.row - other.row) * other.unit_mm
    alike = abs(np.log(one.unit_mm / other.unit_mm)) <= 2 * np.log(table.search.scale_step)
    if alike and apart_mm <= table.search.reach_mm:
        return SIDES[0] if for_right > 0 else SIDES[1]
    return max(SIDES, key=lambda side: pairs[side].excess)


def _units(
    shape: tuple[int, ...], template: Template, pixel_mm: float | None, table: Localisation, least_share: float
) -> list[float]:
    """mm of the template a pixel of the image, of each size to look for."""
    if pixel_mm is not None:
        require("pixel_mm", pixel_mm, 0.001, 50, "mm")
        smallest, largest = table.search.known_scale
        return [pixel_mm / scale for scale in _steps(smallest, largest, table)]
    plateau_mm = template.known_plateau_mm
    shares = (share for share in _steps(*table.search.plateau_share, table) if share >= least_share)
    units = (plateau_mm / (share * shape[1]) for share in shares)
    # What is coarser than the whole joint's template holds no place to within millimetres.
    return [unit_mm for unit_mm in units if unit_mm <= table.wide.pitch_mm]


def _smaller(pixel_mm: float, table: Localisation) -> list[float]:
    return [pixel_mm / scale for scale in _steps(table.search.smaller_scale, table.search.known_scale[0], table)]


def _steps(low: float, high: float, table: Localisation) -> list[float]:
    count = int(np.ceil(np.log(high / low) / np.log(table.search.scale_step))) + 1
    return [float(value) for value in np.geomspace(low, high, count)]


def _size(best: Match, template: Template, pixel_mm: float | None, table: Localisation) -> tuple[float, str, float]:
    """Pitch, where it is from, and the size of the knee over the standard one."""
    if pixel_mm is not None:
        return pixel_mm, "given", pixel_mm / best.unit_mm
    scale = table.plateau.mean_mm / template.known_plateau_mm
    return best.unit_mm * scale, "plateau", scale


def _rise(pixel_mm: float | None, table: Localisation) -> float:
    """How the narrow score that chance gives rises with the size of a pixel; 0 where sizes are not to be weighed."""
    return table.chance.narrow_rise if pixel_mm is None else 0.0


def _chance(shape: tuple[int, ...], unit_mm: float, table: Localisation) -> float:
    """The best score that chance gives over a film for a knee of one size: the smaller, the more places there are.

    Expected largest of so many normal values (Cramer 1946, leading term).
    """
    law, by_chance = table.wide, table.chance
    patch_mm = (law.up_mm + law.down_mm, law.lateral_mm + law.medial_mm)
    free_mm = (length * unit_mm - by_chance.held * side for length, side in zip(shape, patch_mm, strict=True))
    places = float(np.prod([max(1.0, free / by_chance.cell_mm) for free in free_mm]))
    return float(by_chance.sd * np.sqrt(2 * np.log(max(2.0, places))))


def _status(
    joint: Located, shape: tuple[int, ...], region_px: int | None, table: Localisation, given: str | None = None
) -> str:
    """The first reason to refuse, or found; a side that nobody told cannot be wrong."""
    limit = table.thresholds
    reasons = {
        "no knee": joint.both < limit.both or (joint.pixel_from == "plateau" and _doubtful(joint, table)),
        "upside down": joint.way != WAYS[0],
        "wrong side": given is not None and joint.side_evidence < -limit.side,
        "wrong scale": joint.pixel_from == "given" and not limit.scale[0] <= joint.scale <= limit.scale[1],
        "low score": joint.apart_mm > limit.apart_mm,
        "leaves image": not region_fits(shape, joint.row, joint.col, 1 if region_px is None else region_px),
    }
    return next((reason for reason, holds in reasons.items() if holds), "found")


def _doubtful(joint: Located, table: Localisation) -> bool:
    """Whether a match is no better, and as like its mirror image, as some place on a leg without bones."""
    limit = table.thresholds
    return joint.both < limit.doubtful and abs(joint.side_evidence) < limit.sided
