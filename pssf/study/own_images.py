"""Radiomic features of a user's own images and masks, without a model."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError, require, require_choice, require_whole
from ..data.ibsi import ibsi_tags
from ..io.image_kind import is_dicom
from ..io.images import load
from ..io.masks import load_masks
from ..io.stored_pixels import read_values
from ..model.radiograph import Radiograph
from ..radiomics.backends import require_backend
from ..radiomics.families import FAMILIES
from ..radiomics.features import extract
from . import require_extra

# pyradiomics has no shape of fewer, and no texture.
_LEAST_PX = 4
_PITCH_MM = (0.001, 50.0)


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

    No joint is looked for and grey values are taken as they are. The names are those of a study's features.csv:
    pyradiomics' own without ``original_``, but for first-order features, which are measured of the grey values
    (``firstorder_linear_Mean``) and of their z-score inside the mask (``firstorder_z_Mean``).

    Parameters
    ----------
    image : (rows, cols) integer array, Radiograph, str or Path
        Grey values; a float array of whole numbers will do. A file may be PNG, JPEG, TIFF or DICOM of 8 to 16 bit; its
        stored values are measured, of a DICOM after its rescale.
    mask : (rows, cols) array of any unit, str or Path, optional
        Pixels to measure: those that are not zero. A file may be a picture, or the masks of one bone that
        `save_masks` wrote. By default the whole image is measured, as pyradiomics does with a mask of ones, and shape
        features are those of its rectangle.
    pixel_mm : float, optional
        Side of a pixel, in mm. Needed where the image does not say it; a `Radiograph`, a file of this package and most
        DICOM do.
    bins : int, default 64
        Grey-level bins of textures, equal from the least to the greatest value inside the mask.
    families : collection of str, optional
        Of firstorder, shape2D, glcm, glrlm, glszm, ngtdm, gldm; all by default.
    backend : str, optional
        pyradiomics or mirp; the first that is installed by default.

    Returns
    -------
    dict of str to float
        Value of each feature by its name; lengths in mm, areas in mm2.

    Raises
    ------
    InputError
        An image or mask that cannot be read or used, masks of another shape, fewer than four pixels inside, an unknown
        pitch, or a family, backend or number of bins out of range.

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
    require_whole("bins", bins, 8, 256, "grey values")
    if isinstance(families, str):
        families = (families,)
    for name in families:
        require_choice("family", name, FAMILIES)
    if backend is not None:
        require_backend(backend)
    values, known_mm = _values(image)
    pitch_mm = known_mm if pixel_mm is None else pixel_mm
    if pitch_mm is None:
        raise InputError("pixel_mm = None; allowed: the side of a pixel in mm, which this image does not say")
    require("pixel_mm", pitch_mm, *_PITCH_MM, "mm")
    inside = np.ones(values.shape, np.bool_) if mask is None else _mask(mask, values.shape)
    return extract(values, float(pitch_mm), ibsi_tags(), bins, tuple(families), backend, inside)


def read_image(path: Path) -> tuple[NDArray[Any], float | None]:
    """Read the grey values of a file, and its pitch in mm where it says so.

    Raises
    ------
    InputError
        As `read_values`.
    """
    try:
        radiograph = load(path)
        return radiograph.pixels, radiograph.protocol.pixel_mm
    except InputError:
        stored = read_values(path)
        return stored.pixels, stored.pixel_mm


def read_masks(path: Path) -> dict[str, NDArray[np.bool_]]:
    """Read masks by their names: those that `save_masks` wrote, or one picture, whose mask is called "mask".

    Raises
    ------
    InputError
        As `read_values`.
    """
    try:
        return load_masks(path)
    except InputError:
        if is_dicom(path):
            raise
        return {"mask": read_values(path).pixels != 0}


def _values(image: Any) -> tuple[NDArray[Any], float | None]:
    """Whole numbers (rows, cols), and the pitch in mm where it is known."""
    known_mm = None
    if isinstance(image, Radiograph):
        image, known_mm = image.pixels, image.protocol.pixel_mm
    elif isinstance(image, str | Path):
        image, known_mm = read_image(Path(image))
    values = np.asarray(image)
    if values.ndim != 2 or not values.size or values.dtype.kind not in "iuf":
        raise InputError(f"image must be (rows, cols) of numbers, a Radiograph or a path, got {_kind(values)}")
    if values.dtype.kind == "f":
        if not np.isfinite(values).all() or not (values == np.rint(values)).all():
            raise InputError(
                f"image must hold whole numbers, got {_fraction(values)}: bins depend on the last bit; round"
            )
        values = values.astype(np.int64)
    return values, known_mm


def _mask(mask: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if isinstance(mask, str | Path):
        masks = read_masks(Path(mask))
        if len(masks) != 1:
            raise InputError(
                f"mask must be one mask, got {len(masks)} ({', '.join(masks)}) in {mask}: take one of load_masks"
            )
        (mask,) = masks.values()
    values = np.asarray(mask)
    if (
        values.shape != shape
        or values.dtype.kind not in "biuf"
        or (values.dtype.kind == "f" and np.isnan(values).any())
    ):
        raise InputError(f"mask must be {shape} of numbers, as the image is, got {_kind(values)}")
    inside = values != 0
    if inside.sum() < _LEAST_PX:
        raise InputError(f"mask must have {_LEAST_PX} pixels or more that are not zero, got {int(inside.sum())}")
    return np.asarray(inside)


def _fraction(values: NDArray[Any]) -> float:
    """The first value that is no whole number."""
    return float(values[~np.isfinite(values) | (values != np.rint(values))][0])


def _kind(values: NDArray[Any]) -> str:
    return f"{values.shape} of {values.dtype}"
