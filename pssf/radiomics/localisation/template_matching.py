"""Template matching: correlation of edge fields over positions, sizes and poses."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ...data.analysis.localisation_table import PatchSettings
from .edge_field import Pyramid
from .templates import Pose, compute_spectra

# Fourier-transform lengths are rounded up to multiples of this number of pixels to limit the number of lengths.
_LENGTH_STEP_PX = 16
# Minimum number of rows and columns of an edge field in which a template is searched for, in pixels.
_MIN_SIDE_PX = 8
Window = tuple[slice, slice]
POLARITIES = ("bone bright", "bone dark")


@dataclass(frozen=True, kw_only=True)
class Match:
    """Best match of a template patch in an image.

    Attributes
    ----------
    score : float
        Correlation of image edges with template edges, -1 to 1. The score is lower where the image has less structure.
    side : {"right", "left"}
        Left or right knee.
    orientation : {"upright", "upside down"}
        Orientation of the knee.
    polarity : {"bone bright", "bone dark"}
        Polarity of the grey values.
    row : float
        Row of the medial joint line, in pixels of the image.
    col : float
        Column of the medial joint line, in pixels of the image.
    template_mm_per_px : float
        Knee size, as mm of the template per pixel of the image.
    visible_fraction : float
        Fraction of the patch weight that is inside the image.
    chance_score : float
        Expected score in an image without a knee, if scores of different sizes are compared; else 0.
    """

    score: float
    side: str
    orientation: str
    polarity: str
    row: float
    col: float
    template_mm_per_px: float
    visible_fraction: float
    chance_score: float = 0.0

    @property
    def excess(self) -> float:
        """Score minus chance score, dimensionless."""
        return self.score - self.chance_score


def find_matches(
    image: Pyramid, units_mm: Iterable[float], patches: Iterable[Pose], law: PatchSettings, min_visible_fraction: float
) -> Iterator[Match]:
    """Find the best match of each pose, polarity and size.

    Parameters
    ----------
    image : Pyramid
        Image to search.
    units_mm : iterable of float
        Knee sizes to search for, as mm of the template per pixel of the image.
    patches : iterable of Pose
        Poses to search for.
    law : PatchSettings
        Patch settings.
    min_visible_fraction : float
        Minimum fraction of a patch that must be inside the image.

    Yields
    ------
    Match
        Best match of a pose, polarity and size. Sizes for which the image has too few pixels are omitted.
    """
    patches = tuple(patches)
    for unit_mm in units_mm:
        zoom = unit_mm / law.pitch_mm
        field = image.edges(zoom, law.tile_mm / law.pitch_mm)
        if min(field.shape[1:]) >= _MIN_SIDE_PX:
            for pose, score in compute_score_maps(field, patches):
                yield from _find_best_matches(
                    score, _compute_visible_fraction(field.shape[1:], pose), min_visible_fraction, pose, zoom, unit_mm
                )


def compute_score_maps(
    field: NDArray[np.float32], patches: Iterable[Pose], window: Window | None = None
) -> Iterator[tuple[Pose, NDArray[np.float32]]]:
    """Compute the score of every patch of each pose at the pixels of an edge field.

    The correlation is normalised by the edge power of the patch and the image; the image power is at least the patch
    power. Air and muscle, which have weak edges, therefore have low scores.

    Parameters
    ----------
    field : (2, rows, cols) float32 array
        Edge field at the pixel size of the patches, dimensionless; see `compute_edge_field`.
    patches : iterable of Pose
        Poses whose patches are correlated with the edge field.
    window : tuple of slice or None
        Rows and columns for which scores are computed; None for all.

    Yields
    ------
    pose : Pose
        Pose to which the scores belong.
    scores : (patches, rows, cols) float32 array
        Score of each patch at each pixel, at which the medial joint line of the patch is placed, dimensionless.
    """
    places = window or _full_window(field.shape[1:])
    parts = np.stack([*field, (field**2).sum(axis=0)])
    seen_by, spectrum = None, parts
    for pose in patches:
        near, wanted, shape = _plan_windows(field.shape[1:], pose, places)
        if seen_by != (near, shape):
            seen_by, spectrum = (near, shape), fft.rfft2(parts[:, *near], shape)
        down, right, squares = spectrum
        ready = compute_spectra(pose, shape)
        power = fft.irfft2(squares * ready.weight, shape)[wanted]
        alike = fft.irfft2(down * ready.fields[:, 0] + right * ready.fields[:, 1], shape)[:, *wanted]
        own = np.array(pose.power, np.float32)[:, None, None]
        yield pose, alike / np.sqrt(own * np.maximum(power, own))


@lru_cache(maxsize=256)  # The cache size is sufficient for all knee sizes tested in one image.
def _compute_visible_fraction(image: tuple[int, ...], pose: Pose) -> NDArray[np.float32]:
    """Compute the fraction of the patch weight that is inside an image.

    The returned array (rows, cols) has one value per position of the joint line.
    """
    _, wanted, shape = _plan_windows(image, pose, _full_window(image))
    inside = fft.rfft2(np.ones(image, np.float32), shape)
    return np.asarray(fft.irfft2(inside * compute_spectra(pose, shape).weight, shape)[wanted] / pose.weight.sum())


def _full_window(image: tuple[int, ...]) -> Window:
    """Return the window of row and column slices that covers a whole image."""
    rows, cols = image
    return slice(0, rows), slice(0, cols)


def _plan_windows(image: tuple[int, ...], pose: Pose, window: Window) -> tuple[Window, Window, tuple[int, int]]:
    """Return the image window that patches overlap, the slices of `window` in it, and the Fourier-transform shape."""
    near, wanted, shape = [], [], []
    for length, side, before, at in zip(image, pose.weight.shape, pose.anchor, window, strict=True):
        after = side - 1 - before
        first, last = max(0, at.start - before), min(length, at.stop + after)
        beyond = max(0, before - at.start, at.stop + after - length)
        near.append(slice(first, last))
        wanted.append(slice(at.start - first, at.stop - first))
        shape.append(_fast_length(max(last - first + beyond, side)))
    return (near[0], near[1]), (wanted[0], wanted[1]), (shape[0], shape[1])


def _fast_length(length: int) -> int:
    """Round a length up to a multiple of 16 pixels, and then to a length with a fast Fourier transform."""
    return int(fft.next_fast_len(-(-length // _LENGTH_STEP_PX) * _LENGTH_STEP_PX, real=True))


def _find_best_matches(
    score: NDArray[np.float32],
    visible_fraction: NDArray[np.float32],
    min_visible_fraction: float,
    pose: Pose,
    zoom: float,
    unit_mm: float,
) -> Iterator[Match]:
    """Find the best match of each polarity in the score maps of a pose."""
    hidden = visible_fraction < min_visible_fraction
    for polarity, sign in zip(POLARITIES, (1.0, -1.0), strict=True):
        allowed = np.where(hidden, -1.0, sign * score)
        patch, row, col = (int(at) for at in np.unravel_index(np.argmax(allowed), allowed.shape))
        peak = allowed[patch]
        yield Match(
            score=float(peak[row, col]),
            side=pose.side,
            orientation=pose.orientation,
            polarity=polarity,
            row=(row + fit_peak_offset(peak[:, col], row) + 0.5) / zoom - 0.5,
            col=(col + fit_peak_offset(peak[row, :], col) + 0.5) / zoom - 0.5,
            template_mm_per_px=unit_mm,
            visible_fraction=float(visible_fraction[row, col]),
        )


def fit_peak_offset(score: NDArray[np.floating], index: int) -> float:
    """Fit a parabola through a score peak and its two neighbours, and return the offset of the vertex.

    Parameters
    ----------
    score : (n,) array, dimensionless
        Scores at equidistant positions.
    index : int
        Index of the peak.

    Returns
    -------
    float
        Offset of the vertex from `index`; 0 if the peak is the first or last score.
    """
    if not 0 < index < len(score) - 1:
        return 0.0
    before, peak, after = (float(value) for value in score[index - 1 : index + 2])
    bend = before - 2 * peak + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
