"""Laterality: evidence for a right or left knee from edges that differ from their mirror image."""

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
    """Compute the evidence for a right knee; the weights of its edges were fitted to simulated knees.

    Parameters
    ----------
    image : Pyramid
        Image that is searched.
    pairs_by_side : dict of str to MatchPair
        Side to the best match of a joint of that side.
    table : LocalisationSettings
        Settings with the weights of the edges.

    Returns
    -------
    float
        About 1 for a right knee and -1 for a left one, whatever the grey scale of the radiograph.
    """
    weights = np.array([table.sides.down, table.sides.right])
    return float((weights * compute_mirror_difference(image, pairs_by_side, table)).sum())


def compute_mirror_difference(
    image: Pyramid, pairs_by_side: Mapping[str, MatchPair], table: LocalisationSettings
) -> NDArray[np.float64]:
    """Compute the edges of an image as a right knee, minus those of its mirror image as a right knee.

    Parameters
    ----------
    image : Pyramid
        Image that is searched.
    pairs_by_side : dict of str to MatchPair
        Side to the best match of a joint of that side.
    table : LocalisationSettings
        Settings of the patch and of the blocks.

    Returns
    -------
    (2, rows, cols) array
        Difference of the edges down and right, averaged over blocks, dimensionless.
    """
    seen = [_sample_edges(image, pairs_by_side[side].joint_match, table.wide, table.sides.block) for side in SIDES]
    return seen[0] - seen[1]


def _sample_edges(image: Pyramid, match: Match, law: PatchSettings, block: int) -> NDArray[np.float64]:
    """Sample the edges (2, rows, cols) about a match, averaged over blocks, as of an upright right knee.

    They are 0 outside of the image.
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
    """Return pixel offsets about the joint line, or those of the reversed direction."""
    first, last = (before, after) if forwards else (after, before)
    return np.arange(-first, last + 1.0)
