"""Joint localisation: position of the medial joint line in a radiograph, with knee side, orientation and size."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
)
from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import LocalisationSettings
from .edge_field import Pyramid
from .joint_candidates import Candidates, MatchPair, relative_margin
from .laterality import compute_side_evidence
from .region_of_interest import region_fits
from .template_matching import Match, find_matches
from .templates import (
    MAX_SEARCH_PIXEL_MM,
    ORIENTATIONS,
    SIDES,
    Template,
    compute_density,
    make_poses,
)

# Row and column of each landmark, in pixels.
Landmarks = Mapping[str, tuple[float, float]]
STATUSES = ("found", "no knee", "upside down", "wrong side", "wrong scale", "low score", "leaves image")


@dataclass(frozen=True, kw_only=True)
class JointLocation:
    """Result of the joint localisation: the best match, accepted or rejected.

    Attributes
    ----------
    row : float
        Row of the medial joint line, in pixels of the radiograph.
    col : float
        Column of the medial joint line, in pixels of the radiograph.
    status : str
        One of STATUSES: "found", or the reason why the match is rejected.
    score : float
        Correlation of the image edges with the template edges of the whole joint, -1 to 1.
    compartment_score : float
        Correlation of the image edges with the template edges of the medial compartment, -1 to 1.
    side : {"right", "left"}
        Left or right knee: the specified side, or the better matching side if none is specified.
    side_margin : float
        Highest whole-joint score of `side` minus the highest whole-joint score of the opposite side, over all
        positions.
    side_evidence : float
        Evidence for `side`: about 1 if the side is correct, about -1 if it is wrong; see `compute_side_evidence`.
    orientation : {"upright", "upside down"}
        Orientation of the knee.
    orientation_margin : float
        Highest score of `orientation` minus the highest score of the opposite orientation.
    polarity : {"bone bright", "bone dark"}
        Polarity of the grey values.
    scale : float
        Size of the knee on the radiograph divided by the size of the template knee on its own detector, dimensionless.
    pixel_mm : float
        Pixel size, in mm: the specified pixel size, or an estimate from the joint size if none is specified.
    pixel_mm_source : {"given", "plateau"}
        Source of the pixel size: specified ("given"), or estimated from the width of the tibial plateau ("plateau").
    match_distance_mm : float
        Vertical distance between the whole-joint match and the compartment match, in mm at the size of the template
        knee.
    visible_fraction : float
        Fraction of the whole-joint patch that is inside the radiograph.
    pixel_height : float
        Pixel height divided by pixel width; `pixel_mm` is the width.
    bones : (rows, cols) bool array or None
        Mask of femur and tibia in the radiograph; None if the localisation does not segment the bones.
    landmarks_px : dict of str to (row, column) tuple, or None
        Landmarks of the tibia, in pixels of the radiograph; None if the localisation does not find landmarks.
    jsw_shares : (float, float) or None
        Minimum medial and lateral joint space as fractions of the plateau width; None if it is not measured.
    """

    row: float
    col: float
    status: str
    score: float
    compartment_score: float
    side: str
    side_margin: float
    side_evidence: float
    orientation: str
    orientation_margin: float
    polarity: str
    scale: float
    pixel_mm: float
    pixel_mm_source: str
    match_distance_mm: float
    visible_fraction: float
    pixel_height: float = 1.0
    bones: NDArray[np.bool_] | None = field(default=None, repr=False, compare=False)
    landmarks_px: Landmarks | None = field(default=None, repr=False, compare=False)
    jsw_shares: tuple[float, float] | None = field(default=None, repr=False, compare=False)

    @property
    def square_pixel_row(self) -> float:
        """Row of the medial joint line after resampling to square pixels; see `resample_to_square_pixels`."""
        return (self.row + 0.5) * self.pixel_height - 0.5

    @property
    def mean_score(self) -> float:
        """Mean of whole-joint and compartment score, dimensionless; images with a low mean are rejected ("no knee")."""
        return (self.score + self.compartment_score) / 2

    @property
    def orientation_evidence(self) -> float:
        """Relative margin of the orientation, see `relative_margin`; negative if the other orientation matches better.

        The margin is relative, because the score difference between orientations is less reliable if the bone shape
        differs from the templates and both scores are low.
        """
        return relative_margin(self.score, self.score - self.orientation_margin)


def locate_joint_in_radiograph(
    pixels: NDArray[np.integer | np.floating],
    templates: Sequence[Template],
    table: LocalisationSettings,
    *,
    side: str,
    pixel_mm: float,
    region_px: int = 512,
) -> JointLocation:
    """Locate the joint in the linear pixels of a radiograph with known side and pixel size; see `locate_joint`.

    Parameters
    ----------
    pixels : (rows, cols) array, DN
        Linear pixels. Medial is to the right in a right knee and to the left in a left knee.
    templates : sequence of Template
        Template radiographs.
    table : LocalisationSettings
        Search settings and rejection thresholds.
    side : {"right", "left"}
        Left or right knee.
    pixel_mm : float
        Pixel size, in mm.
    region_px : int
        Edge length of the region around the joint line that must be inside the image, in pixels.

    Returns
    -------
    JointLocation
        Location of the joint, in pixels of the radiograph.

    Raises
    ------
    InputError
        The arguments are invalid; see `locate_joint`.
    """
    step = max(1, int(MAX_SEARCH_PIXEL_MM / pixel_mm))
    joint = locate_joint(
        compute_density(downsample_by_blocks(pixels, step)), templates, table, side=side, pixel_mm=pixel_mm * step
    )
    joint = scale_to_full_resolution(joint, step, pixel_mm)
    if joint.status == "found" and not region_fits(pixels.shape, joint.row, joint.col, region_px):
        return replace(joint, status="leaves image")
    return joint


def scale_to_full_resolution(joint: JointLocation, step: int, pixel_mm: float) -> JointLocation:
    """Convert a joint location from a block-averaged image to full resolution.

    Parameters
    ----------
    joint : JointLocation
        Location in the block-averaged image.
    step : int
        Edge length of a block, in full-resolution pixels.
    pixel_mm : float
        Full-resolution pixel size, in mm.

    Returns
    -------
    JointLocation
        Location in the full-resolution image.
    """
    row, col = (at * step + (step - 1) / 2 for at in (joint.row, joint.col))
    return replace(joint, row=row, col=col, pixel_mm=pixel_mm)


def locate_joint(
    density: Array | Pyramid,
    templates: Sequence[Template],
    table: LocalisationSettings,
    *,
    side: str | None = None,
    pixel_mm: float | None = None,
    region_px: int | None = None,
    min_plateau_fraction: float = 0.0,
    severe: bool = False,
) -> JointLocation:
    """Locate the medial joint line in an image.

    Parameters
    ----------
    density : (rows, cols) array, any unit, or Pyramid
        Image values that increase with attenuation: the negative logarithm of a signal, or a displayed radiograph. Row
        0 is proximal, and the fibula of a right knee is on the left. A Pyramid caches edge fields for further searches.
    templates : sequence of Template
        Template radiographs. If `severe` is True, the whole joint is matched with the templates of knees with severe
        osteoarthritis. Otherwise, it is matched with the first and the last of the other templates. The medial
        compartment is matched with all templates.
    table : LocalisationSettings
        Search settings and rejection thresholds.
    side : {"right", "left"} or None
        Left or right knee; None if unknown.
    pixel_mm : float or None
        Pixel size, in mm; if None, the pixel size is estimated from the joint size.
    region_px : int or None
        Edge length of the region around the joint line that must be inside the image, in pixels; None to require only
        the joint line.
    min_plateau_fraction : float
        Smallest width of the tibial plateau in the search, as a fraction of the image width. It is used only if the
        pixel size is unknown.
    severe : bool
        If True, search for a knee with severe osteoarthritis; templates of other knees are then used for the medial
        compartment only.

    Returns
    -------
    JointLocation
        Location of the best match; the status reports whether the match is accepted.

    Raises
    ------
    InputError
        `side` is unknown, `pixel_mm` is out of range, all templates show severe osteoarthritis, or the pixel size must
        be estimated but the template has no plateau width.

    Notes
    -----
    The correlation uses edge directions, weighted by edge strength relative to the surroundings. Display processing
    therefore has little effect.

    1. The whole joint is searched for at a coarse pixel size, over all positions, sizes, sides, orientations and
       polarities. If the pixel size is unknown, the chance score is subtracted before scores of different sizes are
       compared.
    2. The medial compartment is searched for near the best whole-joint matches, over all templates, rotations and
    sizes, with subpixel precision. The pair of whole-joint and compartment matches with the largest sum of scores is
    the result. 3. The specified side and pixel size are compared with the best pair.
    """
    if side is not None:
        require_choice("side", side, SIDES)
    if all(template.severe for template in templates):
        raise InputError(
            f"templates must include a knee without severe osteoarthritis, got {len(templates)} severe templates"
        )
    search, of_sides = find_candidates(density, templates, table, pixel_mm, min_plateau_fraction, severe)
    for_right = compute_side_evidence(search.image, of_sides, table)
    chosen = side or _select_side(of_sides, for_right, table)
    best, mirrored = of_sides[chosen], SIDES[1 - SIDES.index(chosen)]
    wide, narrow = best.joint_match, best.compartment_match
    pitch_mm, pixel_from, scale = _estimate_pitch_and_scale(wide, templates[0], pixel_mm, table)
    located = JointLocation(
        row=narrow.row,
        col=narrow.col,
        status="found",
        score=wide.score,
        compartment_score=narrow.score,
        side=chosen,
        side_margin=search.highest_score(wide.orientation, chosen) - search.highest_score(wide.orientation, mirrored),
        side_evidence=for_right if chosen == SIDES[0] else -for_right,
        orientation=wide.orientation,
        orientation_margin=wide.score
        - search.highest_score(ORIENTATIONS[1 - ORIENTATIONS.index(wide.orientation)], *SIDES),
        polarity=wide.polarity,
        visible_fraction=wide.visible_fraction,
        match_distance_mm=abs(narrow.row - wide.row) * wide.template_mm_per_px,
        pixel_mm=pitch_mm,
        pixel_mm_source=pixel_from,
        scale=scale,
    )
    return replace(located, status=_decide_status(located, density.shape, region_px, table, side))


def find_candidates(
    density: Array | Pyramid,
    templates: Sequence[Template],
    table: LocalisationSettings,
    pixel_mm: float | None,
    min_plateau_fraction: float = 0.0,
    severe: bool = False,
) -> tuple[Candidates, dict[str, MatchPair]]:
    """Find all whole-joint matches, and for each side the best pair of whole-joint and compartment match.

    Parameters
    ----------
    density : (rows, cols) array, any unit, or Pyramid
        Image values that increase with attenuation (bone bright).
    templates : sequence of Template
        Template radiographs.
    table : LocalisationSettings
        Search settings and rejection thresholds.
    pixel_mm : float or None
        Pixel size, in mm; None if unknown.
    min_plateau_fraction : float
        Smallest width of the tibial plateau in the search, as a fraction of the image width.
    severe : bool
        If True, search for a knee with severe osteoarthritis.

    Returns
    -------
    candidates : Candidates
        Whole-joint matches.
    pairs : dict of str to MatchPair
        Best pair of whole-joint and compartment match, keyed by side.

    Raises
    ------
    InputError
        The pixel size is out of range, or the image is too small for a joint.
    """
    image = density if isinstance(density, Pyramid) else Pyramid(density)
    usual = tuple(template for template in templates if not template.severe)
    added = tuple(template for template in templates if severe and template.severe)
    whole = make_poses(added or tuple(dict.fromkeys((usual[0], usual[-1]))), table.wide)
    units = _list_units_mm(density.shape, usual[0], pixel_mm, table, min_plateau_fraction)
    matched = list(find_matches(image, units, whole, table.wide, table.search.min_visible_fraction))
    if pixel_mm is None:
        matched = [
            replace(match, chance_score=_compute_chance_score(density.shape, match.template_mm_per_px, table))
            for match in matched
        ]
    if not matched:
        raise InputError(
            f"image must be large enough for a knee joint, got {density.shape} pixels with pixel size {pixel_mm} mm"
        )
    chance = _chance_slope(pixel_mm, table)
    search = Candidates(image=image, templates=(*usual, *added), matches=matched, table=table, chance_slope=chance)
    of_sides = _select_orientation(search)
    if pixel_mm is not None and max(pair.mean_score for pair in of_sides.values()) < table.thresholds.min_score:
        matched += find_matches(
            image, _list_smaller_units_mm(pixel_mm, table), whole, table.wide, table.search.min_visible_fraction
        )
        of_sides = _select_orientation(search)
    return search, of_sides


def _select_orientation(search: Candidates) -> dict[str, MatchPair]:
    """Select the best pair of each side, upright unless an upside-down pair matches clearly better.

    The whole-joint score of an upside-down pair must exceed the upright score by a threshold. The compartment score of
    the upside-down pair must also be higher.
    """
    upright = {side: search.select_pair(ORIENTATIONS[0], side) for side in SIDES}
    best = max(upright.values(), key=lambda pair: pair.excess)
    if (
        relative_margin(search.highest_score(ORIENTATIONS[1], *SIDES), best.joint_match.score)
        <= search.table.thresholds.max_upside_down_evidence
    ):
        return upright
    turned = {side: search.select_pair(ORIENTATIONS[1], side) for side in SIDES}
    other = max(turned.values(), key=lambda pair: pair.excess)
    return turned if other.compartment_match.score > best.compartment_match.score else upright


def _select_side(pairs: dict[str, MatchPair], right_evidence: float, table: LocalisationSettings) -> str:
    """Select the side that matches better.

    If right and left match at the same position, their scores are nearly equal, and the side evidence decides.
    """
    one, other = (pairs[side].joint_match for side in SIDES)
    apart_mm = abs(one.row - other.row) * other.template_mm_per_px
    alike = abs(np.log(one.template_mm_per_px / other.template_mm_per_px)) <= 2 * np.log(table.search.scale_step)
    if alike and apart_mm <= table.search.reach_mm:
        return SIDES[0] if right_evidence > 0 else SIDES[1]
    return max(SIDES, key=lambda side: pairs[side].excess)


def _list_units_mm(
    shape: tuple[int, ...],
    template: Template,
    pixel_mm: float | None,
    table: LocalisationSettings,
    min_plateau_fraction: float,
) -> list[float]:
    """List the knee sizes to be tested, as mm of the template per pixel of the image."""
    if pixel_mm is not None:
        require_in_range("pixel_mm", pixel_mm, 0.001, 50, "mm")
        smallest, largest = table.search.scale_range
        return [pixel_mm / scale for scale in _geometric_steps(smallest, largest, table)]
    plateau_mm = template.known_plateau_mm
    shares = (share for share in _geometric_steps(*table.search.plateau_share, table) if share >= min_plateau_fraction)
    units = (plateau_mm / (share * shape[1]) for share in shares)
    # Pixels larger than those of the whole-joint patch cannot locate the joint with millimetre accuracy.
    return [unit_mm for unit_mm in units if unit_mm <= table.wide.pitch_mm]


def _list_smaller_units_mm(pixel_mm: float, table: LocalisationSettings) -> list[float]:
    """List knee sizes below the usual search range, as mm of the template per pixel of the image."""
    return [
        pixel_mm / scale
        for scale in _geometric_steps(table.search.fallback_min_scale, table.search.scale_range[0], table)
    ]


def _geometric_steps(low: float, high: float, table: LocalisationSettings) -> list[float]:
    """List sizes from low to high, with a constant ratio that does not exceed the scale step."""
    count = int(np.ceil(np.log(high / low) / np.log(table.search.scale_step))) + 1
    return [float(value) for value in np.geomspace(low, high, count)]


def _estimate_pitch_and_scale(
    best: Match, template: Template, pixel_mm: float | None, table: LocalisationSettings
) -> tuple[float, str, float]:
    """Return the pixel size in mm, its source, and the knee size divided by the size of the template knee."""
    if pixel_mm is not None:
        return pixel_mm, "given", pixel_mm / best.template_mm_per_px
    scale = table.plateau.mean_mm / template.known_plateau_mm
    return best.template_mm_per_px * scale, "plateau", scale


def _chance_slope(pixel_mm: float | None, table: LocalisationSettings) -> float:
    """Return the increase in the chance score of compartment matches per unit of ln(pixel size).

    If the pixel size is known, the increase is 0, because scores of different sizes are not compared.
    """
    return table.chance.narrow_rise if pixel_mm is None else 0.0


def _compute_chance_score(shape: tuple[int, ...], unit_mm: float, table: LocalisationSettings) -> float:
    """Compute the chance score: the expected best score in an image without a knee, for one knee size.

    Smaller knees have more possible positions in an image. The chance score is the expected maximum of as many normally
    distributed values as there are positions (Cramer 1946, leading term).
    """
    law, by_chance = table.wide, table.chance
    patch_mm = (law.up_mm + law.down_mm, law.lateral_mm + law.medial_mm)
    free_mm = (
        length * unit_mm - by_chance.visible_fraction * side for length, side in zip(shape, patch_mm, strict=True)
    )
    places = float(np.prod([max(1.0, free / by_chance.cell_mm) for free in free_mm]))
    return float(by_chance.sd * np.sqrt(2 * np.log(max(2.0, places))))


def _decide_status(
    joint: JointLocation,
    shape: tuple[int, ...],
    region_px: int | None,
    table: LocalisationSettings,
    given_side: str | None = None,
) -> str:
    """Return the first reason to reject a match, or "found"; the side is checked only if it is specified."""
    limit = table.thresholds
    reasons = {
        "no knee": joint.mean_score < limit.min_score
        or (joint.pixel_mm_source == "plateau" and _is_doubtful(joint, table)),
        "upside down": joint.orientation != ORIENTATIONS[0],
        "wrong side": given_side is not None and joint.side_evidence < -limit.max_opposite_side_evidence,
        "wrong scale": joint.pixel_mm_source == "given"
        and not limit.accepted_scale_range[0] <= joint.scale <= limit.accepted_scale_range[1],
        "low score": joint.match_distance_mm > limit.max_match_distance_mm,
        "leaves image": not region_fits(shape, joint.row, joint.col, 1 if region_px is None else region_px),
    }
    return next((reason for reason, holds in reasons.items() if holds), "found")


def _is_doubtful(joint: JointLocation, table: LocalisationSettings) -> bool:
    """Report whether the score and the side evidence of a match are as low as for simulated legs without bones."""
    limit = table.thresholds
    return (
        joint.mean_score < limit.min_score_unknown_pitch
        and abs(joint.side_evidence) < limit.min_side_evidence_unknown_pitch
    )
