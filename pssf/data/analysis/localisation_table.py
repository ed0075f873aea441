"""Localisation of the joint and its side (``data/localisation.toml`` and ``data/side_pattern.toml``).

Lengths in mm are those of a standard knee's radiograph under the protocol ``reference``.
"""

from functools import cache

from ..data_files import load_data_table
from ..table_records import (
    Numbers,
    Pair,
    Record,
    Rows,
    parse_record,
)


class PatchSettings(Record, frozen=True):
    """Size and sampling of the patch that is cut out of a template around its medial joint line.

    Attributes
    ----------
    pitch_mm : float
        Pixel size of the patch, in mm.
    up_mm : float
        Extent above the joint line, in mm.
    down_mm : float
        Extent below the joint line, in mm.
    lateral_mm : float
        Extent to lateral, in mm.
    medial_mm : float
        Extent to medial, in mm.
    height_mm : float
        SD of the Gaussian weight around the joint line, in mm.
    turns_deg : tuple of float
        Rotations of the template that are tried, in degrees.
    tile_mm : float
        Size of the neighbourhood that normalises the strength of edges, in mm.
    """

    pitch_mm: float
    up_mm: float
    down_mm: float
    lateral_mm: float
    medial_mm: float
    height_mm: float
    turns_deg: Numbers
    tile_mm: float


class SearchSettings(Record, frozen=True):
    """Sizes, positions and pixel shapes that the search tries.

    Attributes
    ----------
    scale_step : float
        Ratio of consecutive sizes.
    scale_range : (float, float)
        Size of the knee relative to the standard knee, if the pixel size is known.
    fallback_min_scale : float
        Smallest relative size that is tried if no knee was found.
    plateau_share : (float, float)
        Width of the plateau relative to the width of the image, if the pixel size is unknown.
    first_min_plateau_fraction : float
        Smallest such width in the first attempt.
    narrow_scales : tuple of float
        Sizes of the medial compartment relative to the match of the whole joint.
    reach_mm : float
        Largest distance of the compartment match from the joint match, in mm.
    min_visible_fraction : float
        Smallest fraction of the joint patch that is inside the image.
    candidates : int
        Largest number of joint matches per side around which the medial compartment is searched.
    max_score_deficit : float
        Largest difference of a candidate's score from the best score.
    pixel_aspect_ratios : tuple of float
        Ratios of pixel height to width that are tried in addition to 1, if the pixel size is unknown.
    """

    scale_step: float
    scale_range: Pair
    fallback_min_scale: float
    plateau_share: Pair
    first_min_plateau_fraction: float
    narrow_scales: Numbers
    reach_mm: float
    min_visible_fraction: float
    candidates: int
    max_score_deficit: float
    pixel_aspect_ratios: Numbers


class ChanceScore(Record, frozen=True):
    """Model of the best score that chance gives, if the pixel size is unknown.

    Attributes
    ----------
    sd : float
        SD of scores at random positions.
    cell_mm : float
        Distance between positions with independent scores, in mm.
    visible_fraction : float
        Fraction of the patch that is inside the image.
    narrow_rise : float
        Increase of the compartment score per unit of the natural logarithm of the pixel size, since smooth images are
        more alike.
    """

    sd: float
    cell_mm: float
    visible_fraction: float
    narrow_rise: float


class PlateauWidth(Record, frozen=True):
    """Width of the tibial plateau on patient radiographs.

    Attributes
    ----------
    mean_mm : float
        Mean, in mm.
    sd_mm : float
        SD, in mm.
    """

    mean_mm: float
    sd_mm: float


class AcceptanceThresholds(Record, frozen=True):
    """Thresholds at which a match is rejected; `pssf validate --tables localisation` derives each.

    Scores are the mean of the joint score and the compartment score.

    Attributes
    ----------
    min_score : float
        Lowest score of a knee.
    max_opposite_side_evidence : float
        Largest evidence for the side opposite to the given one (`JointLocation.side_evidence`).
    min_score_unknown_pitch : float
        Lowest score if the pixel size is unknown, unless the evidence for a side reaches the next value.
    min_side_evidence_unknown_pitch : float
        Evidence for a side that replaces this score.
    min_score_square_pixels : float
        Score from which other pixel shapes are not tried.
    min_score_further_attempts : float
        Lowest score of a match with other pixel shapes or with severe knees.
    stretch_penalty : float
        Deduction from the score of a match with other pixel shapes.
    min_score_stop_search : float
        Score from which the search ends, whether the match is accepted or not.
    max_upside_down_evidence : float
        Largest evidence for an upside-down image that chance gives (`JointLocation.orientation_evidence`).
    max_match_distance_mm : float
        Largest vertical distance between the joint match and the compartment match, in mm.
    accepted_scale_range : (float, float)
        Size of a knee relative to the standard knee.
    """

    min_score: float
    max_opposite_side_evidence: float
    min_score_unknown_pitch: float
    min_side_evidence_unknown_pitch: float
    min_score_square_pixels: float
    min_score_further_attempts: float
    stretch_penalty: float
    min_score_stop_search: float
    max_upside_down_evidence: float
    max_match_distance_mm: float
    accepted_scale_range: Pair


class LateralityWeights(Record, frozen=True):
    """Weights of edges that distinguish a right knee from a left one.

    Attributes
    ----------
    block : int
        Side of the block of pixels of the joint patch that shares one weight, in px.
    down : tuple of tuple of float
        (rows, cols) weights of downward edges.
    right : tuple of tuple of float
        (rows, cols) weights of rightward edges.
    """

    block: int
    down: Rows
    right: Rows


class LocalisationSettings(Record, frozen=True):
    """All settings of the localisation.

    Attributes
    ----------
    wide : PatchSettings
        Patch of the whole joint.
    narrow : PatchSettings
        Patch of the medial compartment.
    search : SearchSettings
        Sizes and positions that are tried.
    chance : ChanceScore
        Scores that chance gives.
    plateau : PlateauWidth
        Width of the plateau on patient radiographs.
    thresholds : AcceptanceThresholds
        Thresholds of acceptance.
    sides : LateralityWeights
        Weights that distinguish right from left.
    """

    wide: PatchSettings
    narrow: PatchSettings
    search: SearchSettings
    chance: ChanceScore
    plateau: PlateauWidth
    thresholds: AcceptanceThresholds
    sides: LateralityWeights


@cache
def load_localisation_settings() -> LocalisationSettings:
    """Load the settings of the localisation.

    Returns
    -------
    LocalisationSettings
        Content of both tables.
    """
    return parse_record(
        LocalisationSettings,
        load_data_table("localisation") | {"sides": load_data_table("side_pattern")},
        "localisation",
    )
