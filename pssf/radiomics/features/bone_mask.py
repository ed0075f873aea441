"""Bone mask: segmentation of the bone in a region, so that shape features measure its outline."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, grey_closing, label
from scipy.ndimage import gaussian_gradient_magnitude as gradient_magnitude
from skimage.filters import threshold_otsu
from skimage.segmentation import watershed

from ...core.checks import Array

_DENSITY_SD_MM = 0.8  # standard deviation of the Gaussian before thresholds; wider than noise and trabeculae
_GRADIENT_SD_MM = 0.8  # the same before the gradient; a narrower one lets the outline follow the noise
_MAX_SURE_SPACE_MM = 10.0  # largest height of a dip in density that is definitely joint space
_MAX_SPACE_MM = 16.0  # largest height of a joint space at the detector, at its opening to the notch
_BAND_MM = 8.0  # width inside Otsu's outline in which the gradient decides between soft tissue and bone
_SEAM_MM = 2.0  # the same beside the joint space and outside Otsu's outline
_JOINT_REACH_MM = 16.0  # distance of joint space and notch from the middle row
_MIN_DIP = 0.04  # of ln(signal): a joint space has at least 4 % more signal than above and below; less is noise
_MIN_SPACE_FRACTION = 0.002  # of the region; smaller pieces of joint space are gaps between trabeculae
_MIN_BONE_FRACTION = 0.05  # of the bone; smaller pieces are noise
_SOFT = 1  # marker of soft tissue
_BONE = 2  # marker of bone


def segment_bone(region: NDArray[np.generic], pixel_mm: float) -> NDArray[np.bool_]:
    """Segment the bone by a watershed of the gradient from markers (Meyer and Beucher 1990, J Vis Commun Image R 1).

    Parameters
    ----------
    region : (rows, cols) array, DN
        Linear signal, or any signal whose logarithm decreases with attenuation. The joint line is at the middle row.
    pixel_mm : float
        Pixel size, in mm.

    Returns
    -------
    (rows, cols) bool array
        True inside bone; all True for a region of one grey value.

    Notes
    -----
    Bone markers are deep inside the dense part of the limb, which Otsu's threshold (Otsu 1979) of the log signal gives.
    Soft tissue markers are outside of that part, and in the joint space. The joint space is where the signal is higher
    than above and below it (black top-hat; Serra 1982). The outline is the strongest gradient between the markers,
    whatever soft tissue overlies it.
    """
    log_signal = np.log(np.maximum(region.astype(np.float64), 1.0))
    density = -gaussian_filter(log_signal, _DENSITY_SD_MM / pixel_mm)
    if np.ptp(density) == 0:
        return np.ones(region.shape, dtype=bool)
    markers = _make_markers(density, pixel_mm)
    if not (markers == _BONE).any():
        bone = density >= threshold_otsu(density)  # The bone is narrower than the band, so there is no marker.
    else:
        bone = watershed(gradient_magnitude(log_signal, _GRADIENT_SD_MM / pixel_mm), markers) == _BONE
    return _remove_small_pieces(bone, _MIN_BONE_FRACTION * int(bone.sum()))


def _make_markers(density: Array, pixel_mm: float) -> NDArray[np.int32]:
    """Mark definite soft tissue with 1, definite bone with 2, and the pixels between them with 0."""
    dense = density >= threshold_otsu(density)
    deep = _distance_to_outside_px(dense) > _BAND_MM / pixel_mm
    near_joint = np.abs(np.arange(density.shape[0]) - density.shape[0] // 2)[:, None] < _JOINT_REACH_MM / pixel_mm
    dip, wide_dip = (
        _compute_black_top_hat(density, height_mm / pixel_mm) for height_mm in (_MAX_SURE_SPACE_MM, _MAX_SPACE_MM)
    )
    about_joint = dip[deep & near_joint]
    least = max(_MIN_DIP, threshold_otsu(about_joint)) if about_joint.size and np.ptp(about_joint) > 0 else np.inf
    space = dense & near_joint & (dip > least)
    space = _remove_small_pieces(space, _MIN_SPACE_FRACTION * density.size)
    markers = np.zeros(density.shape, np.int32)
    seam = _SEAM_MM / pixel_mm
    markers[space | (~dense & (_distance_to_outside_px(~dense) > seam))] = _SOFT
    may_be_space = near_joint & (wide_dip > least)
    markers[deep & (dip < least / 2) & ~may_be_space & (_distance_to_outside_px(~space) > seam)] = _BONE
    return markers


def _compute_black_top_hat(density: Array, height_px: float) -> Array:
    """Compute the black top-hat along columns: the depth of each pixel below its surroundings within a height."""
    return np.asarray(grey_closing(density, size=(2 * int(height_px / 2) + 1, 1)) - density)


def _distance_to_outside_px(inside: NDArray[np.bool_]) -> Array:
    """Compute the distance of each pixel from the nearest one outside, in pixels; infinite if there is none."""
    return np.full(inside.shape, np.inf) if inside.all() else np.asarray(distance_transform_edt(inside))


def _remove_small_pieces(mask: NDArray[np.bool_], least_px: float) -> NDArray[np.bool_]:
    """Remove connected pieces of fewer pixels than a limit."""
    pieces, _ = label(mask)
    return mask & (np.bincount(pieces.ravel()) >= least_px)[pieces]
