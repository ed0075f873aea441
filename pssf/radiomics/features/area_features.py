"""Features of regions of the tibia that follow from landmarks."""

from collections.abc import Collection
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...core.checks import Array, InputError
from ...texture import TEXTURE_FAMILIES, make_texture_region
from ...texture.texture_scales import MIN_SCALE_PX, SCALES_MM
from ..localisation.joint_localisation import JointLocation
from .feature_extraction import extract_features
from .feature_families import SQUARE, name_in_area
from .ibsi_tags import IbsiTags

# Distance around the middle of the landmarks that is resampled, as a fraction of the distance of the plateau edges. It
# contains all regions of the tibia.
_REACH = 0.75


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
    measured = [name for name in TEXTURE_FAMILIES if name in families]
    if measured and pixel_mm * MIN_SCALE_PX > SCALES_MM[0] + 1e-6:
        raise InputError(
            f"pixel_mm must be at most {SCALES_MM[0] / MIN_SCALE_PX:g} mm for the families {', '.join(measured)}, "
            f"got {pixel_mm:g} mm"
        )


def measure_areas(
    pixels: NDArray[np.integer], joint: JointLocation, pixel_mm: float, settings: AreaSettings, tags: IbsiTags
) -> dict[str, float] | None:
    """Measure the features of every area except the square.

    Parameters
    ----------
    pixels : (rows, cols) integer array, DN
        Radiograph.
    joint : JointLocation
        Location of the joint, with landmarks.
    pixel_mm : float
        Pixel size, in mm.
    settings : AreaSettings
        Areas and features. Shape features are omitted, because they would describe the area.
    tags : dict of str to dict of str to str
        IBSI tags; see `load_ibsi_tags`.

    Returns
    -------
    dict of str to float, or None
        Value of each feature, with names such as `glcm_Contrast@medial_subchondral`; None if an area extends beyond the
        image.

    Raises
    ------
    InputError
        The location has no landmarks, or the pixels are too large for a texture measure.
    """
    areas = [area for area in settings.areas if area != SQUARE]
    if not areas:
        return {}
    if joint.landmarks_px is None:
        raise InputError(f"areas other than {SQUARE} need landmarks, got regions without landmarks for {areas[0]}")
    require_resolved_texture(pixel_mm, settings.families)
    try:
        masks = [
            make_texture_region(area, joint.landmarks_px, pixels, side=joint.side, pixel_mm=pixel_mm) for area in areas
        ]
    except InputError:
        return None
    families = [family for family in settings.families if family != "shape2D"]
    values: dict[str, float] = {}
    for area, mask in zip(areas, masks, strict=True):
        box = ndimage.find_objects(mask.astype(np.uint8))[0]
        measured = extract_features(pixels[box], pixel_mm, tags, settings.bins, families, settings.backend, mask[box])
        values |= {name_in_area(name, area): value for name, value in measured.items()}
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
