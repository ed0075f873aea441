"""The region of interest: the medial joint line is found by template matching, as it is on a real radiograph."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from skimage.feature import match_template

from ..core.checks import Array, InputError, require, require_choice

# Pitch of the two searches and extent of their patches, mm at the detector. The wide patch holds both compartments,
# which tells medial from lateral; the narrow one holds the medial joint space and the rim of its plateau.
_WIDE_MM, _NARROW_MM = 1.2, 0.3
_WIDE_EXTENT_MM = (36.0, 66.0, 36.0)  # above and below, lateral, medial
_NARROW_EXTENT_MM = (12.0, 20.0, 24.0)
_REACH_MM = 8.0  # how far the narrow search may move from the wide one's place
# Sizes of the bone relative to the template's, magnification included.
_SCALES = (0.76, 0.82, 0.88, 0.94, 1.0, 1.06, 1.12)


@dataclass(frozen=True, kw_only=True, eq=False)
class Template:
    """A radiograph of a standard right knee without noise.

    pixels    (rows, cols) linear in the signal
    row, col  its medial joint line, pixels
    pixel_mm  pitch of the detector
    raises    InputError for a joint line outside the image, or a pitch out of range
    """

    pixels: NDArray[np.generic]
    row: float
    col: float
    pixel_mm: float

    def __post_init__(self) -> None:
        require("template row", self.row, 0, self.pixels.shape[0] - 1, "px")
        require("template col", self.col, 0, self.pixels.shape[1] - 1, "px")
        require("template pixel_mm", self.pixel_mm, 0.001, 50, "mm")


@dataclass(frozen=True, kw_only=True)
class Joint:
    """What the search gave.

    row, col  medial joint line, pixels; of the best match even where it is refused
    score     normalised cross-correlation of the wide match, -1 to 1
    scale     size of this knee relative to the template's
    status    found | low score | leaves image
    """

    row: float
    col: float
    score: float
    scale: float
    status: str


def find_joint(
    pixels: NDArray[np.generic],
    templates: Sequence[Template],
    *,
    side: str,
    pixel_mm: float,
    region_px: int = 512,
    min_score: float = 0.5,
) -> Joint:
    """Where the medial joint line is.

    The logarithm of the signal is matched (Lewis 1995, normalised cross-correlation), first the whole joint at a pitch
    of 1.2 mm over a few scales, then the medial compartment at 0.3 mm near that place, to a fraction of a pixel. The
    first template is for both; of all, whichever fits the compartment best tells its joint line, since its middle in a
    narrow joint space is not where a wide one would have it.

    pixels     (rows, cols) linear; columns run to world +x, so medial is right in a right knee and left in a left one
    templates  standard knees that differ in their joint space, the widest first
    side       right | left
    region_px  side of the region that must fit into the image around the joint line
    min_score  a wide match below it is refused
    raises     InputError for an unknown side, or no template
    """
    require_choice("side", side, ("right", "left"))
    if not templates:
        raise InputError("templates = none; allowed: one or more")
    match = (-2.0, 0.0, 0.0, 1.0)
    image, step = _log_mean(pixels, _WIDE_MM / pixel_mm)
    for scale in _SCALES:
        patch, anchor = _patch(templates[0], side, scale, step * pixel_mm, _WIDE_EXTENT_MM)
        score, row, col = _best(image, patch, anchor)
        match = max(match, (score, row * step + (step - 1) / 2, col * step + (step - 1) / 2, scale))
    score, row, col, scale = match
    if score <= -2.0:
        raise InputError(f"image of {pixels.shape} pixels of {pixel_mm} mm; allowed: one that holds a knee joint")
    row, col = _refine(pixels, templates, side, scale, pixel_mm, row, col)
    status = "found" if region_fits(pixels.shape, row, col, region_px) else "leaves image"
    return Joint(row=row, col=col, score=score, scale=scale, status=status if score >= min_score else "low score")


def cut_region(pixels: NDArray[np.generic], row: float, col: float, size: int = 512) -> NDArray[np.generic]:
    """The square of `size` pixels about (row, col), rounded to whole pixels.

    returns  (size, size), a view of `pixels`
    raises   InputError where it leaves the image
    """
    if not region_fits(pixels.shape, row, col, size):
        raise InputError(f"region of {size} px about ({row:.0f}, {col:.0f}) leaves the image of {pixels.shape} px")
    top, left = _corner(row, col, size)
    return pixels[top : top + size, left : left + size]


def region_fits(shape: tuple[int, ...], row: float, col: float, size: int) -> bool:
    """Whether `cut_region` would stay inside an image of this shape."""
    top, left = _corner(row, col, size)
    return 0 <= top <= shape[0] - size and 0 <= left <= shape[1] - size


def _corner(row: float, col: float, size: int) -> tuple[int, int]:
    return round(row) - size // 2, round(col) - size // 2


def _refine(
    pixels: NDArray[np.generic],
    templates: Sequence[Template],
    side: str,
    scale: float,
    pixel_mm: float,
    row: float,
    col: float,
) -> tuple[float, float]:
    """(row, col) of the best narrow match within reach of (row, col); the latter where the image has no room for it."""
    reach_px = (max(_NARROW_EXTENT_MM) * max(1.0, scale) + _REACH_MM) / pixel_mm
    top, left = (max(0, int(at - reach_px)) for at in (row, col))
    near = pixels[top : int(row + reach_px) + 1, left : int(col + reach_px) + 1]
    image, step = _log_mean(near, _NARROW_MM / pixel_mm)
    patches = [_patch(template, side, scale, step * pixel_mm, _NARROW_EXTENT_MM) for template in templates]
    score, fine_row, fine_col = max(_best(image, patch, anchor) for patch, anchor in patches)
    if score <= -2.0:
        return row, col
    return top + fine_row * step + (step - 1) / 2, left + fine_col * step + (step - 1) / 2


def _log_mean(pixels: NDArray[np.generic], step: float) -> tuple[Array, int]:
    """(rows, cols) logarithm of the mean over squares of about `step` pixels, and the side of a square."""
    side = max(1, round(step))
    rows, cols = (length // side for length in pixels.shape)
    # Rows first: adding whole rows is several times faster than adding within squares.
    strips = pixels[: rows * side, : cols * side].reshape(rows, side, cols * side).mean(axis=1, dtype=np.float64)
    return np.log(np.maximum(strips.reshape(rows, cols, side).mean(axis=2), 1.0)), side


@lru_cache(maxsize=64)  # the same few patches serve a whole cohort
def _patch(
    template: Template, side: str, scale: float, pitch_mm: float, extent_mm: tuple[float, float, float]
) -> tuple[Array, tuple[int, int]]:
    """(rows, cols) of the template at a pitch and scale, and where in it the joint line is."""
    image, step = _log_mean(template.pixels, pitch_mm / scale / template.pixel_mm)
    up, lateral, medial = (int(length * scale / pitch_mm) for length in extent_mm)
    in_squares = pitch_mm / scale / (template.pixel_mm * step)
    rows = (template.row - (step - 1) / 2) / step + np.arange(-up, up + 1) * in_squares
    cols = (template.col - (step - 1) / 2) / step + np.arange(-lateral, medial + 1) * in_squares
    patch = map_coordinates(image, np.meshgrid(rows, cols, indexing="ij"), order=1, mode="nearest")
    if side == "left":
        return patch[:, ::-1], (up, medial)
    return patch, (up, lateral)


def _best(image: Array, patch: Array, anchor: tuple[int, int]) -> tuple[float, float, float]:
    """(score, row, col) of the best place of the patch's anchor in the image; score -2 where it does not fit in."""
    if any(inner > outer for inner, outer in zip(patch.shape, image.shape, strict=True)):
        return -2.0, 0.0, 0.0
    score = match_template(image, patch)
    row, col = (int(at) for at in np.unravel_index(np.argmax(score), score.shape))
    return (
        float(score[row, col]),
        row + anchor[0] + _vertex(score[:, col], row),
        col + anchor[1] + _vertex(score[row, :], col),
    )


def _vertex(score: Array, at: int) -> float:
    """Offset from `at` of the vertex of the parabola through the peak and its neighbours; 0 at an edge."""
    if not 0 < at < len(score) - 1:
        return 0.0
    before, peak, after = score[at - 1 : at + 2]
    bend = before - 2 * peak + after
    return float(0.5 * (before - after) / bend) if bend < 0 else 0.0
