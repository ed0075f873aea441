"""Radiomic features of one region by pyradiomics 3.0.1 (van Griethuysen 2017), as IBSI "2D, averaged" aggregation.

Departures of pyradiomics from IBSI to keep in mind: kurtosis is not excess (IBSI + 3); shape2D, TotalEnergy, MCC and
StandardDeviation are not IBSI features; NGTDM counts pixels without neighbours.
"""

import logging
from collections.abc import Collection
from typing import Any

import numpy as np
import SimpleITK as sitk  # noqa: N813 (the library's own short name)
from numpy.typing import NDArray
from radiomics import firstorder, glcm, gldm, glrlm, glszm, ngtdm, shape2D

from ..core.checks import Array, InputError, require_choice
from .bone import bone_mask
from .families import FAMILIES

TEXTURES = {
    "glcm": glcm.RadiomicsGLCM,
    "glrlm": glrlm.RadiomicsGLRLM,
    "glszm": glszm.RadiomicsGLSZM,
    "ngtdm": ngtdm.RadiomicsNGTDM,
    "gldm": gldm.RadiomicsGLDM,
}
# A shift and scale of the grey values leaves these as they are, so on the z-scored image they would be named twice; and
# Entropy and Uniformity would moreover hang on the last bit of the z-score, where a grey value meets the edge of a bin.
_AFFINE_INVARIANT = ("Entropy", "Uniformity", "Skewness", "Kurtosis")


def extract(
    region: NDArray[np.generic], pixel_mm: float, bins: int = 64, families: Collection[str] = FAMILIES
) -> dict[str, float]:
    """The features of a region, by names such as `glcm_Contrast`; see `families`.

    First order is taken twice: of the linear signal (`firstorder_linear_*`) and of its z-score over the region
    (`firstorder_z_*`). Shape is that of the bone in the region. Texture is of the raw integers in `bins` equal bins
    from their minimum to their maximum, which no gain or offset changes.

    region   (size, size) whole numbers, linear, DN
    bins     a power of two keeps the edges of the bins exact
    families of FAMILIES; one that is not asked for costs nothing
    raises   InputError for grey values that are not integers, or an unknown family
    """
    if not np.issubdtype(region.dtype, np.integer):
        raise InputError(f"region of {region.dtype}; allowed: integers, since bins of floats hang on their last bit")
    for name in families:
        require_choice("family", name, FAMILIES)
    square = np.ones(region.shape, dtype=np.uint8)
    values: dict[str, float] = {}
    if "firstorder" in families:
        values |= measure(firstorder.RadiomicsFirstOrder, region, square, pixel_mm, "firstorder_linear", binCount=bins)
        z = measure(firstorder.RadiomicsFirstOrder, _z_score(region), square, pixel_mm, "firstorder_z", binCount=bins)
        values |= {name: value for name, value in z.items() if name.rsplit("_", 1)[1] not in _AFFINE_INVARIANT}
    if "shape2D" in families:
        bone = bone_mask(region).astype(np.uint8)
        values |= measure(shape2D.RadiomicsShape2D, region, bone, pixel_mm, "shape2D", binCount=bins)
    for name, kind in TEXTURES.items():
        if name in families:
            values |= measure(kind, region, square, pixel_mm, name, binCount=bins)
    return values


def measure(
    kind: Any, values: NDArray[np.generic], mask: NDArray[np.uint8], pixel_mm: float, prefix: str, **discretisation: Any
) -> dict[str, float]:
    """All features of one family of pyradiomics, of one slice: `<prefix>_<name>`.

    kind    class of the family, such as `radiomics.glcm.RadiomicsGLCM`
    values  (rows, cols) any unit
    mask    (rows, cols) 1 where the region is
    """
    logging.getLogger("radiomics").setLevel(logging.CRITICAL)  # it reports each family on stderr
    image, of = _image(values, pixel_mm, None), _image(mask, pixel_mm, 0)
    # A single slice of three dimensions, taken in its plane: a true 2D image with these settings is silently wrong.
    features = kind(image, of, force2D=True, force2Ddimension=0, **discretisation)
    features.enableAllFeatures()
    return {f"{prefix}_{name}": float(value) for name, value in features.execute().items()}


def _image(values: NDArray[np.generic], pixel_mm: float, outside: int | None) -> sitk.Image:
    """One slice with a border of one pixel; pyradiomics 3.0.1 refuses a mask without any zero.

    outside  value of the border, or None to repeat the edge
    """
    padded = np.pad(values, 1, mode="edge") if outside is None else np.pad(values, 1, constant_values=outside)
    image = sitk.GetImageFromArray(padded[None])
    image.SetSpacing((pixel_mm, pixel_mm, 1.0))
    return image


def _z_score(region: NDArray[np.generic]) -> Array:
    """(size, size) with mean 0 and standard deviation 1; zeros for a region of one grey value."""
    values = region.astype(np.float64)
    spread = values.std()
    return (values - values.mean()) / spread if spread > 0 else np.zeros(region.shape)
