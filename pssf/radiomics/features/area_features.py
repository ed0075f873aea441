"""Features of the square around the medial joint line, and of regions of the tibia that follow from landmarks."""

from collections.abc import Collection
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...core.checks import Array, InputError
from ...texture import (
    SCALES_MM,
    TEXTURE_FAMILIES,
    RegionOutsideImageError,
    UnmeasurableTextureError,
    make_texture_region,
    mirror_texture_features,
)
from ...texture.texture_scales import MIN_SCALE_PX, is_resolved
from ..localisation.joint_localisation import JointLocation
from .feature_extraction import extract_features
from .feature_families import SQUARE, name_in_area
from .ibsi_tags import IbsiTags

# Distance around the middle of the landmarks that is resampled, as a fraction of the distance of the plateau edges. It
# contains all regions of the tibia.
_REACH = 0.75
# Status of a radiograph of which an area extends beyond the image, whose grey values have no measurable texture, or
# whose pixels are too large for the texture measures.
OUTSIDE, UNMEASURABLE, COARSE = "leaves image", "no texture", "coarse pixels"


class AreaSettings(Protocol):
    """Settings for the measurement of areas: `ExtractionSettings` or `DisplayExtractionSettings`."""

    @property
    def bins(self) -> int:
        """Number of grey-level bins."""

    @property
    def families(self) -> tuple[str, ...]:
        """Feature families to measure."""

    @property
    def backend(self) -> str:
        """Feature library."""

    @property
    def areas(self) -> tuple[str, ...]:
        """Areas to measure."""


def resolves_texture(pixel_mm: float, families: Collection[str]) -> bool:
    """Report whether pixels are small enough for the families of texture measures.

    Parameters
    ----------
    pixel_mm : float
        Pixel size, in mm.
    families : collection of str
        Feature families to measure.

    Returns
    -------
    bool
        True if the smallest scale has at least two pixels, or if no family measures texture by scale.
    """
    return not set(families) & set(TEXTURE_FAMILIES) or is_resolved(SCALES_MM[0], pixel_mm)


def require_resolved_texture(pixel_mm: float, families: Collection[str]) -> None:
    """Require that pixels are small enough for the families of texture measures.

    Parameters
    ----------
    pixel_mm : float
        Largest pixel size, in mm.
    families : collection of str
        Feature families to measure.

    Raises
    ------
    InputError
        The smallest scale has fewer than two pixels.
    """
    if not resolves_texture(pixel_mm, families):
        measured = [name for name in TEXTURE_FAMILIES if name in families]
        raise InputError(
            f"pixel_mm must be at most {SCALES_MM[0] / MIN_SCALE_PX:g} mm for the families {', '.join(measured)}, "
            f"got {pixel_mm:g} mm"
        )


def measure_areas(
    pixels: NDArray[np.generic],
    square: NDArray[np.generic] | None,
    joint: JointLocation,
    pixel_mm: float,
    tags: IbsiTags,
    *,
    settings: AreaSettings,
    bones: NDArray[np.bool_] | None,
) -> dict[str, Any]:
    """Measure the features of every area: of the regions of the tibia, and of the square around the medial joint line.

    Shape features of regions are omitted, because they would describe the region.

    Parameters
    ----------
    pixels : (rows, cols) integer array, DN
        Radiograph, or the part of it with the regions of the tibia.
    square : (size, size) integer array, DN, or None
        Square; None if it is not measured.
    joint : JointLocation
        Location of the joint, with landmarks in pixels of `pixels`.
    pixel_mm : float
        Pixel size, in mm.
    tags : dict of str to dict of str to str
        IBSI tags; see `load_ibsi_tags`.
    settings : ExtractionSettings or DisplayExtractionSettings
        Areas and features.
    bones : (size, size) bool array or None
        Mask of the bones in the square for shape features; None: the bones are segmented.

    Returns
    -------
    dict of str to float or str
        Value of each feature, with names such as `glcm_Contrast@medial_subchondral`; or only the column "status", if an
        area extends beyond the image or its texture cannot be measured.

    Raises
    ------
    InputError
        The location has no landmarks, or a library is not installed.
    """
    regions = [area for area in settings.areas if area != SQUARE]
    if regions and joint.landmarks_px is None:
        raise InputError(f"areas other than {SQUARE} need landmarks, got regions without landmarks for {regions[0]}")
    to_right = mirror_texture_features if joint.side == "left" else dict
    values: dict[str, Any] = {}
    families = [family for family in settings.families if family != "shape2D"]
    try:
        for area in regions:
            assert joint.landmarks_px is not None
            mask = make_texture_region(area, joint.landmarks_px, pixels, side=joint.side, pixel_mm=pixel_mm)
            box = ndimage.find_objects(mask.astype(np.uint8))[0]
            measured = extract_features(
                pixels[box], pixel_mm, tags, settings.bins, families, settings.backend, mask[box]
            )
            values |= {name_in_area(name, area): value for name, value in to_right(measured).items()}
        if SQUARE in settings.areas:
            assert square is not None
            measured = extract_features(
                square, pixel_mm, tags, settings.bins, settings.families, settings.backend, bones=bones
            )
            values |= to_right(measured)
    except RegionOutsideImageError:
        return {"status": OUTSIDE}
    except UnmeasurableTextureError:
        return {"status": UNMEASURABLE}
    return values


def resample_around_plateau(
    pixels: NDArray[np.generic], joint: JointLocation, pixel_mm: float
) -> tuple[Array, JointLocation]:
    """Resample the surroundings of the tibial plateau to another pixel size, without aliasing.

    A Gaussian filter removes detail that the new pixel size cannot represent. Cubic splines interpolate between pixels.

    Parameters
    ----------
    pixels : (rows, cols) array, any unit
        Radiograph with square pixels.
    joint : JointLocation
        Location of the joint, with landmarks.
    pixel_mm : float
        New pixel size, in mm.

    Returns
    -------
    resampled : (rows, cols) array, any unit
        Surroundings that are inside the image.
    joint : JointLocation
        Location whose landmarks are in pixels of the resampled image.
    """
    assert joint.landmarks_px is not None
    places = np.array(list(joint.landmarks_px.values()))
    reach = _REACH * np.ptp(places, axis=0).max()
    middle = places.mean(axis=0)
    first = np.maximum(0, np.floor(middle - reach)).astype(int)
    last = np.minimum(pixels.shape, np.ceil(middle + reach + 1)).astype(int)
    part = np.asarray(pixels[first[0] : last[0], first[1] : last[1]], np.float64)
    ratio = pixel_mm / joint.pixel_mm
    if ratio > 1.0:
        part = ndimage.gaussian_filter(part, 0.5 * np.sqrt(ratio**2 - 1.0), mode="nearest")
    rows, cols = (np.arange(int((length - 1) / ratio) + 1) * ratio for length in part.shape)
    resampled = ndimage.map_coordinates(part, np.meshgrid(rows, cols, indexing="ij"), order=3, mode="nearest")
    moved = {name: tuple((np.array(at) - first) / ratio) for name, at in joint.landmarks_px.items()}
    return np.asarray(resampled), replace(joint, landmarks_px=moved)
