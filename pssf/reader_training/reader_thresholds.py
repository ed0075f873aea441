"""Mean shape of simulated knees, and thresholds below which the reader refuses a knee.

The thresholds are set on simulated radiographs that were not used for training, and on images that are wrong on
purpose: knees upside down, on their side or outside the image, and things that are no knee.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..reader.knee_reading import Reader, read_knees
from ..reader.networks import Network
from ..reader.reader_table import ReaderTable
from .locator_batches import make_wrong_image
from .training_images import STORED_PLATEAU_PX, STORED_PX, TrainingImages

# Number of images without a knee.
_WRONG_IMAGES = 300
# Least score of a place at which landmarks are looked for.
_MIN_SCORE = 0.1
# Fraction of wrong images that are refused by the confidence of their landmarks, unless their shape is refused.
_REFUSED = 0.99
# Largest shape residual relative to that of the most unusual simulated knee: patients vary more than simulated knees
# (assumed).
_RESIDUAL_FACTOR = 1.25
# Least probability of a side. It has no effect on simulated knees, whose sides are nearly certain (assumed).
_MIN_SIDE_CONFIDENCE = 0.62


def compute_mean_shape(images: TrainingImages) -> tuple[tuple[float, float], ...]:
    """Compute the mean position of each landmark in the frame of the knee.

    Parameters
    ----------
    images : TrainingImages
        Images of simulated knees.

    Returns
    -------
    tuple of (float, float)
        Row and column of the sixteen landmarks, as fractions of the plateau width.
    """
    shape = (images.landmarks_px - (STORED_PX - 1) / 2).mean(axis=0) / STORED_PLATEAU_PX
    return tuple((round(float(row), 5), round(float(col), 5)) for row, col in shape)


def set_thresholds(
    locator: Network,
    sides: Network,
    landmarks: Network,
    training: TrainingImages,
    radiographs: Iterable[NDArray[np.uint8]],
    seed: int,
) -> ReaderTable:
    """Set the thresholds of the reader.

    Parameters
    ----------
    locator, sides, landmarks : Network
        Trained networks.
    training : TrainingImages
        Images that were used for training.
    radiographs : iterable of (rows, cols) uint8 array
        Whole radiographs of single knees that were not used for training.
    seed : int
        Seed of the images that are wrong on purpose.

    Returns
    -------
    ReaderTable
        Mean shape and thresholds.
    """
    rng = np.random.default_rng(seed)
    mean_shape = compute_mean_shape(training)
    open_table = ReaderTable(
        min_score=_MIN_SCORE,
        min_side_confidence=0.0,
        min_confidence=0.0,
        max_shape_residual=np.inf,
        mean_shape=mean_shape,
    )
    reader = Reader(locator=locator, sides=sides, landmarks=landmarks, table=open_table)
    residuals: list[float] = []
    wrong_images: list[NDArray[Any]] = []
    for pixels in radiographs:
        residuals += [knee.shape_residual for knee in read_knees(pixels.astype(np.float32), None, reader)]
        wrong_images.append(_turn(pixels, int(rng.integers(4))))
    wrong_images += [make_wrong_image(training, locator.settings.crop_px, rng) for _ in range(_WRONG_IMAGES)]
    max_residual = round(_RESIDUAL_FACTOR * max(residuals), 4)
    confidences = [_find_confidence(image, reader, max_residual) for image in wrong_images]
    return ReaderTable(
        min_score=_MIN_SCORE,
        min_side_confidence=_MIN_SIDE_CONFIDENCE,
        min_confidence=round(float(np.quantile(confidences, _REFUSED)), 4),
        max_shape_residual=max_residual,
        mean_shape=mean_shape,
    )


def _turn(pixels: NDArray[np.uint8], way: int) -> NDArray[np.uint8]:
    """Return a radiograph upside down (0, 1: with or without mirroring) or on its side (2, 3)."""
    return (pixels[::-1], pixels[::-1, ::-1], np.rot90(pixels), np.rot90(pixels, 3))[way]


def _find_confidence(image: NDArray[Any], reader: Reader, max_residual: float) -> float:
    """Return the highest median confidence of knees with an allowed shape; 0 if there are none."""
    knees = read_knees(np.ascontiguousarray(image, np.float32), None, reader)
    allowed = [knee for knee in knees if knee.shape_residual <= max_residual]
    return max((float(np.median(list(knee.confidence.values()))) for knee in allowed), default=0.0)
