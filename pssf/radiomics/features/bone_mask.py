"""Bone mask: segmentation of the bone in a region, for shape features of the bone."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, grey_closing, label
from scipy.ndimage import gaussian_gradient_magnitude as gradient_magnitude
from skimage.filters import threshold_otsu
from skimage.segmentation import watershed

from ...core.checks import Array

# Standard deviation of the Gaussian filter before thresholding, in mm; larger than noise and trabeculae.
_DENSITY_SD_MM = 0.8
# Standard deviation of the Gaussian filter before the gradient, in mm; a smaller value makes the outline follow noise.
_GRADIENT_SD_MM = 0.8
# Maximum height of a density dip that is certainly joint space, in mm; assumed.
_MAX_SURE_SPACE_MM = 10.0
# Maximum height of the joint space near the intercondylar notch, projected on the detector, in mm; assumed.
_MAX_SPACE_MM = 16.0
# Minimum depth of bone markers inside the Otsu outline, in mm; in this band, the gradient locates the bone outline.
_BAND_MM = 8.0
# Gap between the markers and the joint space or the Otsu outline, in mm; the gradient locates the outline in this gap.
_SEAM_MM = 2.0
# Maximum vertical distance of the joint space and the notch from the middle row of the region, in mm.
_JOINT_REACH_MM = 16.0
# Minimum difference of ln(signal) between joint space and adjacent bone, about 4 % of the signal; above the noise.
_MIN_DIP = 0.04
# Minimum area of a joint-space component, as a fraction of the region area; smaller components are trabecular gaps.
_MIN_SPACE_FRACTION = 0.002
# Minimum area of a connected component of bone, as a fraction of the bone area; smaller components are noise.
_MIN_BONE_FRACTION = 0.05
# Watershed marker of soft tissue.
_SOFT = 1
# Watershed marker of bone.
_BONE = 2


def segment_bone(region: NDArray[np.generic], pixel_mm: float) -> NDArray[np.bool_]:
    """Segment the bone by a marker-based watershed of the gradient (Meyer and Beucher 1990, J Vis Commun Image R 1).

    Parameters
    ----------
    region : (rows, cols) array, DN
        Linear signal, or any signal whose logarithm decreases with attenuation. The joint line is in the middle row.
    pixel_mm : float
        Pixel size, in mm.

    Returns
    -------
    (rows, cols) bool array
        True inside bone; True everywhere for a constant region.

    Notes
    -----
    Otsu's threshold (Otsu 1979) of the log signal separates dense from less dense pixels. Bone markers are deep inside
    the dense region. Soft-tissue markers are outside the dense region and in the joint space. A black top-hat (Serra
    1982) detects the joint space, where the signal is higher than above and below. The bone outline is the strongest
    gradient between the markers, even where soft tissue is superimposed.
    """
    log_signal = np.log(np.maximum(region.astype(np.float64), 1.0))
    density = -gaussian_filter(log_signal, _DENSITY_SD_MM / pixel_mm)
    if np.ptp(density) == 0:
        return np.ones(region.shape, dtype=bool)
    markers = _make_markers(density, pixel_mm)
    if not (markers == _BONE).any():
        bone = density >= threshold_otsu(density)  # Bone narrower than the band has no marker.
    else:
        bone = watershed(gradient_magnitude(log_signal, _GRADIENT_SD_MM / pixel_mm), markers) == _BONE
    return _remove_small_pieces(bone, _MIN_BONE_FRACTION * int(bone.sum()))


def _make_markers(density: Array, pixel_mm: float) -> NDArray[np.int32]:
    """Make the watershed markers: 1 for definite soft tissue, 2 for definite bone, 0 for undecided pixels."""
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
    """Compute the black top-hat along columns, with a structuring element of `height_px` rows."""
    return np.asarray(grey_closing(density, size=(2 * int(height_px / 2) + 1, 1)) - density)


def _distance_to_outside_px(inside: NDArray[np.bool_]) -> Array:
    """Compute the distance from each mask pixel to the nearest outside pixel, in pixels; infinite for a full mask."""
    return np.full(inside.shape, np.inf) if inside.all() else np.asarray(distance_transform_edt(inside))


def _remove_small_pieces(mask: NDArray[np.bool_], least_px: float) -> NDArray[np.bool_]:
    """Remove connected components with fewer pixels than `least_px`."""
    pieces, _ = label(mask)
    return mask & (np.bincount(pieces.ravel()) >= least_px)[pieces]
