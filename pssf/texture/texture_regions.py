"""Regions of the tibia for texture measures, from the landmarks of a frontal radiograph."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_choice, require_in_range
from ..core.label_names import TIBIAL_LANDMARKS
from ..reader.knee_frame import fit_frame

# Landmarks of each compartment, from its edge to its spine.
_COMPARTMENTS = {"lateral": TIBIAL_LANDMARKS[:4], "medial": TIBIAL_LANDMARKS[:-5:-1]}
# Distance from the landmarks on the plateau to the lower border of the subchondral bone plate, in mm (assumed).
_PLATE_MM = 2.0
# Height of the subchondral and of the subarticular region, in mm, and their width as a fraction of the compartment
# (Kraus 2009; Buckland-Wright 2004).
_SUBCHONDRAL_MM = 6.0
_COMPARTMENT_FRACTION = 0.75
# Rows and columns of the grid of square patches (Janvier 2017; Almhdie-Imjabbar 2022), and the part of the plateau
# width that it covers (assumed).
_GRID_ROWS, _GRID_COLUMNS = 2, 8
_GRID_FRACTION = 0.9
# Depth below the plateau line and part of the plateau width of the regions of the epiphysis and the metaphysis
# (assumed): the physis is 15 to 20 mm below the joint.
_EPIPHYSIS_MM = (4.0, 15.0)
_METAPHYSIS_MM = (22.0, 34.0)
_BONE_FRACTION = 0.7
# Height of the shape-adaptive region, and edge length of its superpixels, in mm (assumed).
_ADAPTIVE_MM = 10.0
_SUPERPIXEL_MM = 4.0
# Compactness of superpixels for grey values with a standard deviation of 1 (assumed).
_COMPACTNESS = 0.5

PATCHES = tuple(f"patch_{row}{column}" for row in range(1, _GRID_ROWS + 1) for column in range(1, _GRID_COLUMNS + 1))
TEXTURE_REGIONS = (
    *(f"{compartment}_{zone}" for zone in ("subchondral", "subarticular", "adaptive") for compartment in _COMPARTMENTS),
    "epiphysis",
    "metaphysis",
    *PATCHES,
)


class RegionOutsideImageError(InputError):
    """A region of the tibia extends beyond the image."""


def make_texture_region(
    name: str,
    landmarks_px: Mapping[str, tuple[float, float]],
    image: NDArray[np.generic],
    *,
    side: str,
    pixel_mm: float,
) -> NDArray[np.bool_]:
    """Make the mask of a region of the tibia.

    The axes of a region follow the line through the edges of the plateau. Subchondral regions and patches start 2 mm
    below the lowest landmark, so that they exclude the subchondral bone plate.

    Parameters
    ----------
    name : str
        One of TEXTURE_REGIONS: `medial_subchondral` and `lateral_subchondral` (6 mm high, 3/4 of the compartment
        wide; Kraus 2009), `..._subarticular` (the same size below; Buckland-Wright 2004), `..._adaptive` (superpixels
        in 10 mm below the subchondral bone plate; Bayramoglu 2020), `epiphysis`, `metaphysis`, and `patch_11` to
        `patch_28` (two rows of eight squares from lateral to medial; Janvier 2017).
    landmarks_px : dict of str to (row, column) tuple
        Tibial landmarks, in pixels.
    image : (rows, cols) array, grey
        Radiograph. Only the adaptive regions use its grey values.
    side : {"right", "left"}
        Side of the knee. The lateral side of a right knee is on the viewer's left.
    pixel_mm : float
        Pixel size, in mm. With the pixel size of the detector, sizes are those of the projection on the detector.

    Returns
    -------
    (rows, cols) bool array
        Mask.

    Raises
    ------
    InputError
        The name or the side is unknown, a landmark is missing, or scikit-image is not installed (adaptive regions).
    RegionOutsideImageError
        A corner of the region is outside the image.
    """
    require_choice("name", name, TEXTURE_REGIONS)
    require_choice("side", side, ("right", "left"))
    require_in_range("pixel_mm", pixel_mm, 1e-3, 10.0, "mm")
    missing = [landmark for landmark in TIBIAL_LANDMARKS if landmark not in landmarks_px]
    if missing:
        raise InputError(f"landmarks_px must contain all tibial landmarks, got none of {', '.join(missing)}")
    places = np.array([landmarks_px[landmark] for landmark in TIBIAL_LANDMARKS])
    frame = fit_frame(places[[0, -1]], side)
    width_mm = frame.width_px * pixel_mm
    of_landmark = dict(zip(TIBIAL_LANDMARKS, frame.map_to_crop(places, width_mm, 1), strict=True))
    (top, bottom), (first, last) = box = _find_box(name, of_landmark, width_mm)
    corners = frame.map_to_image(np.array([(depth, across) for depth in box[0] for across in box[1]]), width_mm, 1)
    if (corners < -0.5).any() or (corners > np.array(image.shape) - 0.5).any():
        farthest = max(float(-corners.min()), float((corners - image.shape).max()))
        raise RegionOutsideImageError(
            f"image must contain the region {name}, got a corner {farthest * pixel_mm:.1f} mm outside"
        )
    near = _find_surroundings(corners, image.shape, pixel_mm)
    grid = np.moveaxis(np.mgrid[near].astype(np.float64), 0, -1)
    depth_mm, across_mm = np.moveaxis(frame.map_to_crop(grid, width_mm, 1), -1, 0)
    mask = np.zeros(image.shape, np.bool_)
    mask[near] = (depth_mm >= top) & (depth_mm < bottom) & (across_mm >= first) & (across_mm < last)
    if name.endswith("_adaptive"):
        mask = _adapt_to_texture(np.asarray(image, np.float64), mask, pixel_mm)
        # No superpixel may reach into the subchondral bone plate.
        mask[near] &= depth_mm >= top
    return mask


def _find_surroundings(corners: Array, shape: tuple[int, ...], pixel_mm: float) -> tuple[slice, slice]:
    """Find the part of the image with a region of the given corners (4, 2) and the superpixels across its border."""
    margin = np.ceil(2 * _SUPERPIXEL_MM / pixel_mm) + 2
    low = np.maximum(np.floor(corners.min(axis=0)) - margin, 0).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0)) + margin + 1, shape).astype(int)
    return np.s_[low[0] : high[0], low[1] : high[1]]


def _find_box(
    name: str, places_mm: Mapping[str, Array], width_mm: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Find the limits of a region in depth and from lateral to medial, in mm in the frame of the plateau."""
    compartment, _, zone = name.partition("_")
    if compartment in _COMPARTMENTS:
        return _find_compartment_box(compartment, zone, places_mm)
    floor = max(float(place[0]) for place in places_mm.values()) + _PLATE_MM
    if compartment == "patch":
        size = _GRID_FRACTION * width_mm / _GRID_COLUMNS
        row, column = int(zone[0]) - 1, int(zone[1]) - 1
        left = -_GRID_FRACTION * width_mm / 2 + column * size
        return (floor + row * size, floor + (row + 1) * size), (left, left + size)
    half = _BONE_FRACTION * width_mm / 2
    top, bottom = _EPIPHYSIS_MM if name == "epiphysis" else _METAPHYSIS_MM
    return (max(top, floor), bottom), (-half, half)


def _find_compartment_box(
    compartment: str, zone: str, places_mm: Mapping[str, Array]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Find the limits of a region of one compartment; it is centred between the edge and the spine."""
    edge, *_, spine = (float(places_mm[name][1]) for name in _COMPARTMENTS[compartment])
    middle, half = (edge + spine) / 2, _COMPARTMENT_FRACTION * abs(spine - edge) / 2
    top = max(float(places_mm[name][0]) for name in _COMPARTMENTS[compartment][:-1]) + _PLATE_MM
    if zone == "subarticular":
        top += _SUBCHONDRAL_MM
    height = _ADAPTIVE_MM if zone == "adaptive" else _SUBCHONDRAL_MM
    return (top, top + height), (middle - half, middle + half)


def _adapt_to_texture(image: Array, mask: NDArray[np.bool_], pixel_mm: float) -> NDArray[np.bool_]:
    """Replace a region by the superpixels whose centres it contains."""
    try:
        from skimage.segmentation import slic
    except ModuleNotFoundError as error:
        raise InputError(f"adaptive regions need {error.name}: pip install 'pssf[study]'") from error
    margin = int(np.ceil(2 * _SUPERPIXEL_MM / pixel_mm))
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    box = np.s_[max(rows[0] - margin, 0) : rows[-1] + margin + 1, max(cols[0] - margin, 0) : cols[-1] + margin + 1]
    part = image[box]
    spread = part.std()
    grey = (part - part.mean()) / (spread if spread > 0 else 1.0)
    count = max(1, round(part.size * pixel_mm**2 / _SUPERPIXEL_MM**2))
    labels = slic(grey, n_segments=count, compactness=_COMPACTNESS, sigma=1.0, channel_axis=None, start_label=0)
    at_row, at_col = np.indices(part.shape)
    size = np.bincount(labels.ravel())
    centre_row = np.rint(np.bincount(labels.ravel(), at_row.ravel()) / size).astype(int)
    centre_col = np.rint(np.bincount(labels.ravel(), at_col.ravel()) / size).astype(int)
    adapted = np.zeros_like(mask)
    adapted[box] = mask[box][centre_row, centre_col][labels]
    return adapted
