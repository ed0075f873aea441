"""Which side a knee is of, by what of its edges is not the same in the mirror, weighed as drawn knees teach it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.blocks import block_mean
from ..core.checks import Array
from ..data.localisation import Localisation, PatchLaw
from .candidates import Pair
from .edges import Pyramid
from .patches import SIDES, WAYS, posed, reach_px
from .search import POLARITIES, Match


def side_evidence(image: Pyramid, of_sides: Mapping[str, Pair], table: Localisation) -> float:
    """For a right knee: about 1 for one, -1 for a left one, whatever the film's tone.

    of_sides  side -> the best match of a joint of that side
    """
    weights = np.array([table.sides.down, table.sides.right])
    return float((weights * mirror_difference(image, of_sides, table)).sum())


def mirror_difference(image: Pyramid, of_sides: Mapping[str, Pair], table: Localisation) -> NDArray[np.float64]:
    """(2, rows, cols)  edges down and right of a film as a right knee's, less those of its mirror image as one's

    of_sides  side -> the best match of a joint of that side
    """
    seen = [_edges(image, of_sides[side].wide, table.wide, table.sides.block) for side in SIDES]
    return seen[0] - seen[1]


def _edges(image: Pyramid, match: Match, law: PatchLaw, block: int) -> NDArray[np.float64]:
    """(2, rows, cols)  means over blocks of the edges about a match, turned to a right knee upright; 0 off the film"""
    zoom = match.unit_mm / law.pitch_mm
    sign = 1.0 if match.polarity == POLARITIES[0] else -1.0
    field = sign * image.edges(zoom, law.tile_mm / law.pitch_mm)
    up, down, lateral, medial = reach_px(law)
    rows = _span(up, down, match.way == WAYS[0]) + (match.row + 0.5) * zoom - 0.5
    cols = _span(lateral, medial, match.side == SIDES[0]) + (match.col + 0.5) * zoom - 0.5
    places = np.meshgrid(rows, cols, indexing="ij")
    cut = [ndimage.map_coordinates(of, places, order=1, mode="constant") for of in field]
    turned = posed(np.stack(cut), match.side, match.way)
    whole = [length // block * block for length in turned.shape[1:]]
    return np.stack([block_mean(of[: whole[0], : whole[1]], block) for of in turned])


def _span(before: int, after: int, forwards: bool) -> Array:
    first, last = (before, after) if forwards else (after, before)
    return np.arange(-first, last + 1.0)
