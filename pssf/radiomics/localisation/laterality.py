"""Laterality: evidence for a right or left knee from the differences between image edges and mirrored image edges."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...core.checks import Array
from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import LocalisationSettings, PatchSettings
from .edge_field import Pyramid
from .joint_candidates import MatchPair
from .template_matching import POLARITIES, Match
from .templates import (
    ORIENTATIONS,
    SIDES,
    orient_field,
    reach_px,
)


def compute_side_evidence(image: Pyramid, pairs_by_side: Mapping[str, MatchPair], table: LocalisationSettings) -> float:
    """Compute the evidence for a right knee, with edge weights fitted to simulated knees.

    Parameters
    ----------
    image : Pyramid
        Image that shows the knee.
    pairs_by_side : dict of str to MatchPair
        Best match of each side, from `find_candidates`.
    table : LocalisationSettings
        Localisation settings with the edge weights.

    Returns
    -------
    float
        About 1 for a right knee and about -1 for a left knee.
    """
    weights = np.array([table.sides.down, table.sides.right])
    return float((weights * compute_mirror_difference(image, pairs_by_side, table)).sum())


def compute_mirror_difference(
    image: Pyramid, pairs_by_side: Mapping[str, MatchPair], table: LocalisationSettings
) -> NDArray[np.float64]:
    """Compute the edges around the best right-knee match minus the mirrored edges around the best left-knee match.

    Parameters
    ----------
    image : Pyramid
        Image that shows the knee.
    pairs_by_side : dict of str to MatchPair
        Best match of each side, from `find_candidates`.
    table : LocalisationSettings
        Localisation settings, which include the patch size and the block size.

    Returns
    -------
    (2, rows, cols) array
        Difference of the downward and rightward edge components, averaged over blocks, dimensionless.
    """
    seen = [_sample_edges(image, pairs_by_side[side].joint_match, table.wide, table.sides.block) for side in SIDES]
    return seen[0] - seen[1]


def _sample_edges(image: Pyramid, match: Match, law: PatchSettings, block: int) -> NDArray[np.float64]:
    """Sample the edge field (2, rows, cols) around a match, as an upright right knee, averaged over blocks.

    The sampled edge field is 0 outside the image.
    """
    zoom = match.template_mm_per_px / law.pitch_mm
    sign = 1.0 if match.polarity == POLARITIES[0] else -1.0
    field = sign * image.edges(zoom, law.tile_mm / law.pitch_mm)
    up, down, lateral, medial = reach_px(law)
    rows = _pixel_offsets(up, down, match.orientation == ORIENTATIONS[0]) + (match.row + 0.5) * zoom - 0.5
    cols = _pixel_offsets(lateral, medial, match.side == SIDES[0]) + (match.col + 0.5) * zoom - 0.5
    places = np.meshgrid(rows, cols, indexing="ij")
    cut = [ndimage.map_coordinates(of, places, order=1, mode="constant") for of in field]
    turned = orient_field(np.stack(cut), match.side, match.orientation)
    whole = [length // block * block for length in turned.shape[1:]]
    return np.stack([downsample_by_blocks(of[: whole[0], : whole[1]], block) for of in turned])


def _pixel_offsets(before: int, after: int, forwards: bool) -> Array:
    """Return pixel offsets from the joint line along the image axis, in reverse order if `forwards` is False."""
    first, last = (before, after) if forwards else (after, before)
    return np.arange(-first, last + 1.0)
