"""The bone in a region, so that shape has something to measure: a fixed square has the same shape in every knee."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, gaussian_filter, gaussian_filter1d, label
from skimage.filters import threshold_otsu

_SMALLEST_SHARE = 0.05  # of the bone; smaller pieces are noise
_SMOOTH_SHARE = 1 / 256  # of the region's side: 2 of 512 pixels
_BASELINE_SHARE = 1 / 64


def bone_mask(region: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Where bone is: what attenuates more than the soft tissue of its column, by Otsu's threshold (Otsu 1979).

    The soft tissue of a column is the brightest of its middle half, where the joint space is; so the fall of soft
    tissue towards the skin, a larger step than bone, is taken out. Holes are filled; pieces of less than 5 % of the
    bone are left out.

    region   (size, size) linear
    returns  (size, size); all True for a region of one grey value
    """
    size = region.shape[1]
    grey = gaussian_filter(np.log(np.maximum(region.astype(np.float64), 1.0)), _SMOOTH_SHARE * size)
    half = slice(size // 4, size - size // 4)
    soft = gaussian_filter1d(grey[half].max(axis=0), _BASELINE_SHARE * size)
    grey -= np.minimum(
        soft, soft[half].max()
    )  # beyond the bone, where the limb thins, tissue is brighter than any here
    if np.ptp(grey[half, half]) == 0:
        return np.ones(region.shape, dtype=bool)
    pieces, _ = label(binary_fill_holes(grey <= threshold_otsu(grey[half, half])))
    area = np.bincount(pieces.ravel())
    area[0] = 0
    return np.isin(pieces, np.flatnonzero(area >= _SMALLEST_SHARE * area.sum())) & (pieces > 0)
