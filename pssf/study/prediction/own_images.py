"""Radiomic features of a user's own images and masks, without a model."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import (
    InputError,
    require_choice,
    require_in_range,
    require_integer,
)
from ...data.analysis.ibsi_table import load_ibsi_tags
from ...io.image_kind import is_dicom
from ...io.mask_files import load_masks
from ...io.patients.stored_pixels import read_stored_pixels
from ...io.radiograph_files import load
from ...model.radiograph import Radiograph
from ...radiomics.features.feature_backends import require_backend
from ...radiomics.features.feature_extraction import extract_features
from ...radiomics.features.feature_families import ALL_FAMILIES, FAMILIES
from .. import require_extra

# Smallest allowed mask, in pixels; pyradiomics computes no shape or texture features of a smaller mask.
_MIN_MASK_PX = 4
# Allowed pixel pitch, in mm.
_PITCH_RANGE_MM = (0.001, 50.0)


def features(
    image: NDArray[np.integer] | Radiograph | str | Path,
    mask: NDArray[np.generic] | str | Path | None = None,
    pixel_mm: float | None = None,
    *,
    bins: int = 64,
    families: Collection[str] = FAMILIES,
    backend: str | None = None,
) -> dict[str, float]:
    """Measure radiomic features of an image inside a mask.

    No joint is located, and grey values are not rescaled. Feature names are those in ``features.csv`` of a study:
    pyradiomics names without the prefix ``original_``. First-order features are computed from the grey values
    (``firstorder_linear_Mean``) and from their z-score inside the mask (``firstorder_z_Mean``).

    Parameters
    ----------
    image : (rows, cols) integer array, Radiograph, str or Path
        Grey values, in any unit; a float array must contain integers. A path may refer to a PNG, JPEG, TIFF or
        DICOM file with 8 to 16 bits per pixel. The stored values are used; those of a DICOM file are first converted
        with its rescale slope and intercept.
    mask : (rows, cols) dimensionless array, str or Path, optional
        Mask whose nonzero pixels are measured. A path may refer to an image file, or to a file with the mask of one
        bone from `save_masks`. None measures the whole image; shape features then describe the image rectangle, as in
        pyradiomics with a mask of ones.
    pixel_mm : float, optional
        Pixel pitch, 0.001 to 50 mm. The pitch is required if the image does not store it. A `Radiograph`, files written
        by this package and most DICOM files store the pitch.
    bins : int, default 64
        Number of grey-level bins of the texture features, 8 to 256. The bins have equal width and span the grey values
        inside the mask.
    families : collection of str
        Feature families to measure: firstorder, shape2D, glcm, glrlm, glszm, ngtdm, gldm (default), and the texture
        measures fsa, vot, hot, lbp and spectrum, which require at least two pixels per 0.4 mm.
    backend : str, optional
        Radiomics backend: "pyradiomics" or "mirp". None uses the first installed backend.

    Returns
    -------
    dict of str to float
        Value of each feature by name; lengths in mm, areas in mm2.

    Raises
    ------
    InputError
        The image or mask cannot be read, the mask has another shape or fewer than four pixels, the pixel pitch
        is unknown, or a family, backend or number of bins is not allowed.

    Examples
    --------
    >>> import numpy as np
    >>> import pssf
    >>> image = np.arange(400).reshape(20, 20)
    >>> mask = np.zeros((20, 20))
    >>> mask[5:15, 5:15] = 1
    >>> measured = pssf.features(image, mask, pixel_mm=0.2, families=["firstorder", "shape2D"])
    >>> round(measured["firstorder_linear_Mean"], 1), round(measured["shape2D_PixelSurface"], 2)
    (199.5, 4.0)
    """
    require_extra()
    require_integer("bins", bins, 8, 256, "grey values")
    if isinstance(families, str):
        families = (families,)
    for name in families:
        require_choice("family", name, ALL_FAMILIES)
    if backend is not None:
        require_backend(backend)
    values, known_mm = _read_grey_values(image)
    pitch_mm = known_mm if pixel_mm is None else pixel_mm
    if pitch_mm is None:
        raise InputError(f"pixel_mm must be the pixel pitch in mm, got {pixel_mm}: the image stores no pixel pitch")
    require_in_range("pixel_mm", pitch_mm, *_PITCH_RANGE_MM, "mm")
    inside = np.ones(values.shape, np.bool_) if mask is None else _read_mask(mask, values.shape)
    return extract_features(values, float(pitch_mm), load_ibsi_tags(), bins, tuple(families), backend, inside)


def read_image(path: Path) -> tuple[NDArray[Any], float | None]:
    """Read the grey values and the pixel pitch of an image file.

    Parameters
    ----------
    path : Path
        PNG, JPEG, TIFF or DICOM file.

    Returns
    -------
    pixels : (rows, cols) integer array
        Grey values.
    pixel_mm : float or None
        Pixel pitch in mm; None if the file does not store it.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        radiograph = load(path)
        return radiograph.pixels, radiograph.protocol.pixel_mm
    except InputError:
        stored = read_stored_pixels(path)
        return stored.pixels, stored.pixel_mm


def read_masks(path: Path) -> dict[str, NDArray[np.bool_]]:
    """Read all masks in a file.

    Parameters
    ----------
    path : Path
        File written by `save_masks`, or an image of one mask.

    Returns
    -------
    dict of str to (rows, cols) bool array
        Masks by name; the mask in an image is called "mask".

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        return load_masks(path)
    except InputError:
        if is_dicom(path):
            raise
        return {"mask": read_stored_pixels(path).pixels != 0}


def _read_grey_values(image: Any) -> tuple[NDArray[Any], float | None]:
    """Read integer grey values (rows, cols), and the pixel pitch in mm or None if the pitch is unknown."""
    known_mm = None
    if isinstance(image, Radiograph):
        image, known_mm = image.pixels, image.protocol.pixel_mm
    elif isinstance(image, str | Path):
        image, known_mm = read_image(Path(image))
    values = np.asarray(image)
    if values.ndim != 2 or not values.size or values.dtype.kind not in "iuf":
        raise InputError(
            f"image must be a (rows, cols) array of numbers, a Radiograph or a path, got {_describe_array(values)}"
        )
    if values.dtype.kind == "f":
        if not np.isfinite(values).all() or not (values == np.rint(values)).all():
            raise InputError(
                f"image must contain integers, got {_find_fraction(values)}: round the values first, because small "
                "floating-point errors can move pixels to another bin"
            )
        values = values.astype(np.int64)
    return values, known_mm


def _read_mask(mask: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Read a mask as a boolean array with the shape of the image."""
    if isinstance(mask, str | Path):
        masks = read_masks(Path(mask))
        if len(masks) != 1:
            raise InputError(
                f"mask must be one mask, got {len(masks)} ({', '.join(masks)}) in {mask}: "
                "load the file with load_masks and pass one mask"
            )
        (mask,) = masks.values()
    values = np.asarray(mask)
    if (
        values.shape != shape
        or values.dtype.kind not in "biuf"
        or (values.dtype.kind == "f" and np.isnan(values).any())
    ):
        raise InputError(f"mask must be an array of numbers of shape {shape}, got {_describe_array(values)}")
    inside = values != 0
    if inside.sum() < _MIN_MASK_PX:
        raise InputError(f"mask must have at least {_MIN_MASK_PX} nonzero pixels, got {int(inside.sum())}")
    return np.asarray(inside)


def _find_fraction(values: NDArray[Any]) -> float:
    """Find the first value that is not an integer."""
    return float(values[~np.isfinite(values) | (values != np.rint(values))][0])


def _describe_array(values: NDArray[Any]) -> str:
    """Describe the shape and type of an array in words."""
    return f"{values.shape} of {values.dtype}"
