"""Localisation of the knee joint and its laterality (``data/localisation.toml`` and ``data/side_pattern.toml``).

Lengths in mm refer to the radiograph of a standard knee with the protocol ``reference``.
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
    """Size and sampling of the image patch that is cropped from a template around the medial joint line.

    Attributes
    ----------
    pitch_mm : float
        Pixel size of the patch, in mm.
    up_mm : float
        Extent of the patch above the joint line, in mm.
    down_mm : float
        Extent of the patch below the joint line, in mm.
    lateral_mm : float
        Lateral extent of the patch, in mm.
    medial_mm : float
        Medial extent of the patch, in mm.
    height_mm : float
        SD of the Gaussian that weights pixels by their distance from the joint line, in mm.
    turns_deg : tuple of float
        Rotations of the template in the search, in degrees.
    tile_mm : float
        Size of the neighbourhood within which edge strength is normalised, in mm.
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
    """Sizes, positions and pixel aspect ratios in the template search.

    Attributes
    ----------
    scale_step : float
        Ratio between consecutive template sizes in the search.
    scale_range : (float, float)
        Range of the knee size relative to the standard knee, if the pixel size is known.
    fallback_min_scale : float
        Smallest relative size in a second search, after the first search found no knee.
    plateau_share : (float, float)
        Range of the plateau width relative to the image width, if the pixel size is unknown.
    first_min_plateau_fraction : float
        Smallest plateau width relative to the image width in the first search, if the pixel size is unknown.
    narrow_scales : tuple of float
        Sizes of the compartment template relative to the size of the joint match.
    reach_mm : float
        Largest distance of the compartment match from the joint match, in mm.
    min_visible_fraction : float
        Smallest fraction of the joint patch that must be inside the image.
    candidates : int
        Maximum number of joint matches near which the medial compartment is searched for, separately for right and left
        knees.
    max_score_deficit : float
        Largest difference between the best joint score and the score of a candidate.
    pixel_aspect_ratios : tuple of float
        Ratios of pixel height to width in the search, in addition to 1, if the pixel size is unknown.
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
    """Model of the best template score expected by chance, if the pixel size is unknown.

    Attributes
    ----------
    sd : float
        SD of scores at random positions.
    cell_mm : float
        Distance between positions with independent scores, in mm.
    visible_fraction : float
        Assumed fraction of the patch that is inside the image.
    narrow_rise : float
        Increase of the compartment score by chance per unit of the natural logarithm of the pixel size, because
        smoother images are more similar.
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
        Mean plateau width, in mm.
    sd_mm : float
        SD of the plateau width, in mm.
    """

    mean_mm: float
    sd_mm: float


class AcceptanceThresholds(Record, frozen=True):
    """Thresholds for the acceptance of a match, derived by `pssf validate --tables localisation`.

    All scores are means of the joint score and the compartment score.

    Attributes
    ----------
    min_score : float
        Lowest accepted score if the pixel size is known.
    max_opposite_side_evidence : float
        Largest accepted evidence for the side opposite to the specified side (`JointLocation.side_evidence`).
    min_score_unknown_pitch : float
        Lowest accepted score if the pixel size is unknown and the evidence for a side is below
        `min_side_evidence_unknown_pitch`.
    min_side_evidence_unknown_pitch : float
        Lowest evidence for a side at which a score below `min_score_unknown_pitch` is accepted.
    min_score_square_pixels : float
        Score at or above which no other pixel aspect ratios are tested.
    min_score_further_attempts : float
        Lowest accepted score of a match with another pixel aspect ratio or with a template of severe osteoarthritis.
    stretch_penalty : float
        Deduction from the score of a match with another pixel aspect ratio.
    min_score_stop_search : float
        Score at or above which the search stops, even if the match is rejected for other reasons.
    max_upside_down_evidence : float
        Largest evidence for an upside-down image expected by chance (`JointLocation.orientation_evidence`).
    max_match_distance_mm : float
        Largest vertical distance between the joint match and the compartment match, in mm.
    accepted_scale_range : (float, float)
        Accepted range of the knee size relative to the standard knee.
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
    """Edge weights that distinguish a right knee from a left knee.

    Attributes
    ----------
    block : int
        Side length of the blocks of the joint patch that have a common weight, in pixels.
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
        Sizes and positions in the search.
    chance : ChanceScore
        Scores expected by chance.
    plateau : PlateauWidth
        Width of the plateau on patient radiographs.
    thresholds : AcceptanceThresholds
        Thresholds for the acceptance of a match.
    sides : LateralityWeights
        Weights that distinguish right from left knees.
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
        Settings from ``data/localisation.toml`` and ``data/side_pattern.toml``.
    """
    return parse_record(
        LocalisationSettings,
        load_data_table("localisation") | {"sides": load_data_table("side_pattern")},
        "localisation",
    )
