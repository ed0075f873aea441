"""Films whose pixels are not square: crops that were resized into one shape, and nothing in them says so."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from ..core.checks import Array
from ..data.localisation import Localisation
from .edges import Pyramid
from .locate import Located, locate
from .patches import WAYS, Template


def locate_film(
    film: Array,
    templates: Sequence[Template],
    table: Localisation,
    *,
    side: str | None = None,
    pixel_mm: float | None = None,
) -> Located:
    """`locate`, and how high the film's pixels are over their width.

    They are square where the pitch is known. Where it is not, and no joint is clear on square ones, pixels are taken as
    higher and wider too, knees as severe, and where that does not help as small. The best look is taken, where it
    matches better than so many give by chance, and none upside down matches better.

    film    (rows, cols) bone bright, any unit that is monotone
    side    right | left; None where it is not known
    raises  InputError as `locate`
    """
    if pixel_mm is not None:
        return locate(film, templates, table, side=side, pixel_mm=pixel_mm)
    limits, heights, large = table.thresholds, table.search.pixel_heights, table.search.large_share
    seen = cache(lambda height: Pyramid(with_square_pixels(film, height)))
    looked = partial(_looked, seen, templates, table, side)
    best = square = looked(1.0, large)
    if square.both >= limits.sure:
        return square
    if square.status == "found" and square.both >= limits.clear:
        return _better(square, looked(1.0, large, severe=True), table)
    for least_share in (large, 0.0):
        square = square if least_share == large else looked(1.0, 0.0)
        usual = _best([square, *(looked(one, least_share) for one in heights)], table)
        severe = _best([looked(one, least_share, severe=True) for one in (1.0, *heights)], table)
        best = _better(usual, severe, table)
        if best.status == "found":
            break
    return best


def _looked(
    film: Callable[[float], Pyramid],
    templates: Sequence[Template],
    table: Localisation,
    side: str | None,
    height: float,
    least_share: float,
    *,
    severe: bool = False,
) -> Located:
    """`locate` on a film whose pixels are so high over their width."""
    joint = locate(film(height), templates, table, side=side, least_share=least_share, severe=severe)
    return replace(joint, row=(joint.row + 0.5) / height - 0.5, pixel_height=height)


def _better(usual: Located, severe: Located, table: Localisation) -> Located:
    """The severe knee where one is found that matches better, or no usual one is, and its edges are of its side."""
    limits = table.thresholds
    sound = severe.status == "found" and severe.both >= limits.many_looks and severe.side_evidence >= -limits.side
    return severe if sound and (usual.status != "found" or severe.both > usual.both) else usual


def _best(looks: Sequence[Located], table: Localisation) -> Located:
    """The best look that a joint is found in or that is upside down; the first where there are none such.

    looks  on square pixels first
    """
    limits = table.thresholds

    def beyond_square(look: Located) -> float:
        return look.both - (limits.stretched if look is not looks[0] else 0.0)

    joints = [look for look in looks if look.status == "found" and (look is looks[0] or look.both >= limits.many_looks)]
    against = [look for look in looks if look.way != WAYS[0]]
    return max((*joints, *against), key=beyond_square, default=looks[0])


def with_square_pixels(film: NDArray[np.integer | np.floating], height: float) -> Array:
    """(rows x height, cols)  a film whose pixels are so high over their width, on square ones

    film  (rows, cols)  any unit
    """
    if height == 1.0:
        return np.asarray(film, np.float64)
    return np.asarray(zoom(film, (height, 1.0), np.float64, order=1, mode="nearest", grid_mode=True))
