"""Joint localisation in images whose pixels may not be square, such as crops resized to a fixed shape."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from ...core.checks import Array
from ...data.analysis.localisation_table import LocalisationSettings
from .edge_field import Pyramid
from .joint_localisation import JointLocation, locate_joint
from .templates import ORIENTATIONS, Template


def locate_joint_in_film(
    film: Array,
    templates: Sequence[Template],
    table: LocalisationSettings,
    *,
    side: str | None = None,
    pixel_mm: float | None = None,
) -> JointLocation:
    """Locate the joint, and estimate the ratio of pixel height to pixel width; see `locate_joint`.

    If the pixel size is known, pixels are assumed to be square. Otherwise, if the score on square pixels is low, other
    aspect ratios, severely deformed knees and small knees are tried. The best result is accepted if its score exceeds
    the threshold for repeated attempts, and no upside-down match is better.

    Parameters
    ----------
    film : (rows, cols) array, any unit
        Image values that increase with attenuation (bone bright).
    templates : sequence of Template
        Template radiographs.
    table : LocalisationSettings
        Search settings and rejection thresholds.
    side : {"right", "left"} or None
        Left or right knee; None if unknown.
    pixel_mm : float or None
        Pixel size, in mm; None if unknown.

    Returns
    -------
    JointLocation
        Location in pixels of the image, with the ratio of pixel height to width.

    Raises
    ------
    InputError
        The arguments are invalid; see `locate_joint`.
    """
    if pixel_mm is not None:
        return locate_joint(film, templates, table, side=side, pixel_mm=pixel_mm)
    limits, heights, large = table.thresholds, table.search.pixel_aspect_ratios, table.search.first_min_plateau_fraction
    seen = cache(lambda height: Pyramid(resample_to_square_pixels(film, height)))
    looked = partial(_locate_at_pixel_height, seen, templates, table, side)
    best = square = looked(1.0, large)
    if square.mean_score >= limits.min_score_stop_search:
        return square
    if square.status == "found" and square.mean_score >= limits.min_score_square_pixels:
        return _select_usual_or_severe(square, looked(1.0, large, severe=True), table)
    for least_share in (large, 0.0):
        square = square if least_share == large else looked(1.0, 0.0)
        usual = _select_best_location([square, *(looked(one, least_share) for one in heights)], table)
        severe = _select_best_location([looked(one, least_share, severe=True) for one in (1.0, *heights)], table)
        best = _select_usual_or_severe(usual, severe, table)
        if best.status == "found":
            break
    return best


def _locate_at_pixel_height(
    film: Callable[[float], Pyramid],
    templates: Sequence[Template],
    table: LocalisationSettings,
    side: str | None,
    pixel_height: float,
    min_plateau_fraction: float,
    *,
    severe: bool = False,
) -> JointLocation:
    """Locate the joint for an assumed ratio of pixel height to pixel width."""
    joint = locate_joint(
        film(pixel_height), templates, table, side=side, min_plateau_fraction=min_plateau_fraction, severe=severe
    )
    return replace(joint, row=(joint.row + 0.5) / pixel_height - 0.5, pixel_height=pixel_height)


def _select_usual_or_severe(usual: JointLocation, severe: JointLocation, table: LocalisationSettings) -> JointLocation:
    """Select the severe-osteoarthritis result if it is plausible and better, else the usual result."""
    limits = table.thresholds
    sound = (
        severe.status == "found"
        and severe.mean_score >= limits.min_score_further_attempts
        and severe.side_evidence >= -limits.max_opposite_side_evidence
    )
    return severe if sound and (usual.status != "found" or severe.mean_score > usual.mean_score) else usual


def _select_best_location(locations: Sequence[JointLocation], table: LocalisationSettings) -> JointLocation:
    """Select the best location among accepted and upside-down matches; if there is none, select the first location.

    The first location must be the location for square pixels.
    """
    limits = table.thresholds

    def beyond_square(look: JointLocation) -> float:
        return look.mean_score - (limits.stretch_penalty if look is not locations[0] else 0.0)

    joints = [
        look
        for look in locations
        if look.status == "found" and (look is locations[0] or look.mean_score >= limits.min_score_further_attempts)
    ]
    against = [look for look in locations if look.orientation != ORIENTATIONS[0]]
    return max((*joints, *against), key=beyond_square, default=locations[0])


def resample_to_square_pixels(film: NDArray[np.integer | np.floating], pixel_height: float) -> Array:
    """Resample an image to square pixels.

    Parameters
    ----------
    film : (rows, cols) array, any unit
        Image to resample.
    pixel_height : float
        Pixel height divided by pixel width.

    Returns
    -------
    (rows * pixel_height, cols) array
        Image with square pixels.
    """
    if pixel_height == 1.0:
        return np.asarray(film, np.float64)
    return np.asarray(zoom(film, (pixel_height, 1.0), np.float64, order=1, mode="nearest", grid_mode=True))
