"""Mean shape of simulated knees, and thresholds below which the reader refuses a knee.

The thresholds are set on simulated radiographs that were not used for training, and on images that are wrong on
purpose: knees upside down, on their side or outside the image, and things that are no knee.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..reader.knee_finder import find_knees
from ..reader.knee_reading import Reader, read_knees
from ..reader.networks import Network
from ..reader.reader_table import ReaderTable
from .locator_batches import make_wrong_image
from .training_images import STORED_PLATEAU_PX, STORED_PX, TrainingImages

# Number of images that are wrong on purpose.
_WRONG_IMAGES = 300
# Fraction of these images in which nothing may be found, and range of the resulting threshold.
_REJECTED = 0.99
_MIN_SCORE_RANGE = (0.1, 0.5)
# Thresholds of refusal relative to the most unusual simulated knee: patients vary more than simulated knees (assumed).
_RESIDUAL_FACTOR = 1.25
_CONFIDENCE_FACTOR = 0.6
_SCORE_FACTOR = 0.6
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
    wrong = [_score(make_wrong_image(training, locator.settings.crop_px, rng), locator) for _ in range(_WRONG_IMAGES)]
    min_score = float(np.clip(np.quantile(wrong, _REJECTED), *_MIN_SCORE_RANGE))
    open_table = ReaderTable(
        min_score=min_score,
        min_sure_score=0.0,
        min_side_confidence=0.0,
        min_confidence=0.0,
        max_shape_residual=np.inf,
        mean_shape=compute_mean_shape(training),
    )
    reader = Reader(locator=locator, sides=sides, landmarks=landmarks, table=open_table)
    knees = [knee for pixels in radiographs for knee in read_knees(pixels.astype(np.float32), None, reader)]
    confidence = min(float(np.median(list(knee.confidence.values()))) for knee in knees)
    return ReaderTable(
        min_score=round(min_score, 4),
        min_sure_score=round(max(min_score, _SCORE_FACTOR * min(knee.score for knee in knees)), 4),
        min_side_confidence=_MIN_SIDE_CONFIDENCE,
        min_confidence=round(_CONFIDENCE_FACTOR * confidence, 4),
        max_shape_residual=round(_RESIDUAL_FACTOR * max(knee.shape_residual for knee in knees), 4),
        mean_shape=open_table.mean_shape,
    )


def _score(image: Array, locator: Network) -> float:
    """Return the highest score of a knee on an image."""
    return max((knee.score for knee in find_knees(image.astype(np.float32), locator, 0.0)), default=0.0)
