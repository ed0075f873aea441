"""Segmentation of the bone in a region, so that shape features measure its outline and not the region's square."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, grey_closing, label
from scipy.ndimage import gaussian_gradient_magnitude as gradient_magnitude
from skimage.filters import threshold_otsu
from skimage.segmentation import watershed

from ..core.checks import Array

_SMOOTH_MM = 0.8  # standard deviation of the Gaussian before thresholds: wider than noise and trabeculae
_EDGE_MM = 0.8  # the same before the gradient; finer ones follow the noise, and so do perimeters then
_SPACE_MM = 10.0  # height that a dip of density has at most if it is surely joint space
_WIDEST_MM = 16.0  # height of the widest joint space at the detector, with its mouth at the notch
_BAND_MM = 8.0  # from Otsu's outline inwards: soft tissue or bone, which the gradient decides
_SEAM_MM = 2.0  # beside the joint space and outside Otsu's outline: the same
_HEIGHT_MM = 16.0  # of the joint space, with the notch, about the middle row
_LEAST_DIP = 0.04  # of ln(signal): 4 % more signal in the joint space than above and below it; less is noise
_LEAST_SPACE = 0.002  # of the region; smaller pieces of joint space are gaps between trabeculae
_LEAST_BONE = 0.05  # of the bone; smaller pieces are noise
_SOFT, _BONE = 1, 2


def bone_mask(region: NDArray[np.generic], pixel_mm: float) -> NDArray[np.bool_]:
    """Segment the bone by a watershed of the gradient from markers (Meyer and Beucher 1990, J Vis Commun Image R 1).

    Bone is marked deep inside the limb's dense part, as Otsu's threshold (Otsu 1979) of the log signal finds it; soft
    tissue outside of that, and in the joint space: what is brighter than the bone above and below it (black top-hat;
    Serra 1982). Between the markers the strongest gradient is the outline, whatever soft tissue lies over either side.

    Parameters
    ----------
    region : (rows, cols) array, DN
        Linear signal, or any signal whose logarithm falls with attenuation; the joint line is at the middle row.
    pixel_mm : float
        Side of a pixel, in mm.

    Returns
    -------
    (rows, cols) bool array
        True where bone is; all True for a region of one grey value.
    """
    log_signal = np.log(np.maximum(region.astype(np.float64), 1.0))
    density = -gaussian_filter(log_signal, _SMOOTH_MM / pixel_mm)
    if np.ptp(density) == 0:
        return np.ones(region.shape, dtype=bool)
    markers = _markers(density, pixel_mm)
    if not (markers == _BONE).any():
        bone = density >= threshold_otsu(density)  # less than the band is wide; there is no inside to start from
    else:
        bone = watershed(gradient_magnitude(log_signal, _EDGE_MM / pixel_mm), markers) == _BONE
    return _without_small(bone, _LEAST_BONE * int(bone.sum()))


def _markers(density: Array, pixel_mm: float) -> NDArray[np.int32]:
    """Mark what is surely soft tissue and what is surely bone; 0 between them."""
    dense = density >= threshold_otsu(density)
    deep = _away(dense) > _BAND_MM / pixel_mm
    near_joint = np.abs(np.arange(density.shape[0]) - density.shape[0] // 2)[:, None] < _HEIGHT_MM / pixel_mm
    dip, wide_dip = (_dip(density, height_mm / pixel_mm) for height_mm in (_SPACE_MM, _WIDEST_MM))
    about_joint = dip[deep & near_joint]
    least = max(_LEAST_DIP, threshold_otsu(about_joint)) if about_joint.size and np.ptp(about_joint) > 0 else np.inf
    space = dense & near_joint & (dip > least)
    space = _without_small(space, _LEAST_SPACE * density.size)
    markers = np.zeros(density.shape, np.int32)
    seam = _SEAM_MM / pixel_mm
    markers[space | (~dense & (_away(~dense) > seam))] = _SOFT
    may_be_space = near_joint & (wide_dip > least)
    markers[deep & (dip < least / 2) & ~may_be_space & (_away(~space) > seam)] = _BONE
    return markers


def _dip(density: Array, height_px: float) -> Array:
    """Compute the black top-hat of columns: the depth of each pixel below those above and below it within a height."""
    return np.asarray(grey_closing(density, size=(2 * int(height_px / 2) + 1, 1)) - density)


def _away(inside: NDArray[np.bool_]) -> Array:
    """Distance of each pixel from the nearest that is not inside, in pixels; infinite where all are."""
    return np.full(inside.shape, np.inf) if inside.all() else np.asarray(distance_transform_edt(inside))


def _without_small(mask: NDArray[np.bool_], least_px: float) -> NDArray[np.bool_]:
    """Leave out connected pieces of fewer pixels."""
    pieces, _ = label(mask)
    return mask & (np.bincount(pieces.ravel()) >= least_px)[pieces]
