"""Films whose pixels are not square: crops that were resized into one shape, and nothing in them says so."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from ..core.checks import Array
from ..data.localisation import Localisation
from .locate import Located, locate
from .patches import Template


def locate_film(
    film: Array,
    templates: Sequence[Template],
    table: Localisation,
    *,
    side: str | None = None,
    pixel_mm: float | None = None,
) -> Located:
    """`locate`, and how high the film's pixels are over their width.

    They are square where the pitch is known, or a joint is found on them. Else it is looked for on the film with its
    pixels taken as higher or wider, too. What matches best of all is taken where it is found, and where it matches
    better than so many looks give by chance.

    film    (rows, cols) bone bright, any unit that is monotone
    side    right | left; None where it is not known
    raises  InputError as `locate`
    """
    square = locate(film, templates, table, side=side, pixel_mm=pixel_mm)
    if square.status == "found" or pixel_mm is not None:
        return square
    looks = [square]
    for height in table.search.pixel_heights:
        joint = locate(with_square_pixels(film, height), templates, table, side=side)
        looks.append(replace(joint, row=(joint.row + 0.5) / height - 0.5, pixel_height=height))
    best = max(looks, key=lambda joint: joint.both)
    return best if best.status == "found" and best.both >= table.thresholds.stretched else square


def with_square_pixels(film: NDArray[np.integer | np.floating], height: float) -> Array:
    """(rows x height, cols)  a film whose pixels are so high over their width, on square ones

    film  (rows, cols)  any unit
    """
    if height == 1.0:
        return np.asarray(film, np.float64)
    return np.asarray(zoom(film, (height, 1.0), np.float64, order=1, mode="nearest", grid_mode=True))
