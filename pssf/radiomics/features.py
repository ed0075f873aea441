"""Radiomic features of one region by pyradiomics 3.0.1 (van Griethuysen 2017), as IBSI "2D, averaged" aggregation.

Departures of pyradiomics from IBSI to keep in mind: kurtosis is not excess (IBSI + 3); shape2D, TotalEnergy, MCC and
StandardDeviation are not IBSI features; NGTDM counts pixels without neighbours.
"""

import logging
from typing import Any

import numpy as np
import SimpleITK as sitk  # noqa: N813 (the library's own short name)
from numpy.typing import NDArray
from radiomics import firstorder, glcm, gldm, glrlm, glszm, ngtdm, shape2D

from ..checks import Array, InputError
from .bone import bone_mask

FAMILIES = ("firstorder", "shape2D", "glcm", "glrlm", "glszm", "ngtdm", "gldm")
_TEXTURES = {
    "glcm": glcm.RadiomicsGLCM,
    "glrlm": glrlm.RadiomicsGLRLM,
    "glszm": glszm.RadiomicsGLSZM,
    "ngtdm": ngtdm.RadiomicsNGTDM,
    "gldm": gldm.RadiomicsGLDM,
}
# A shift and scale of the grey values leaves these as they are, so on the z-scored image they would be named twice; and
# Entropy and Uniformity would moreover hang on the last bit of the z-score, where a grey value meets the edge of a bin.
_AFFINE_INVARIANT = ("Entropy", "Uniformity", "Skewness", "Kurtosis")


def extract(region: NDArray[np.generic], pixel_mm: float, bins: int = 64) -> dict[str, float]:
    """All features of a region, by names such as `glcm_Contrast`; see `family`.

    First order is taken twice: of the linear signal (`firstorder_linear_*`) and of its z-score over the region
    (`firstorder_z_*`). Shape is that of the bone in the region. Texture is of the raw integers in `bins` equal bins
    from their minimum to their maximum, which no gain or offset changes.

    region   (size, size) whole numbers, linear
    bins     a power of two keeps the edges of the bins exact
    raises   InputError for grey values that are not integers
    """
    if not np.issubdtype(region.dtype, np.integer):
        raise InputError(f"region of {region.dtype}; allowed: integers, since bins of floats hang on their last bit")
    logging.getLogger("radiomics").setLevel(logging.CRITICAL)  # it reports each family on stderr
    square = _image(np.ones(region.shape, dtype=np.uint8), pixel_mm, 0)
    raw = _image(region, pixel_mm, None)
    z = _image(_z_score(region), pixel_mm, None)
    bone = _image(bone_mask(region).astype(np.uint8), pixel_mm, 0)
    found = _family("firstorder_linear", firstorder.RadiomicsFirstOrder, raw, square, bins)
    standard = _family("firstorder_z", firstorder.RadiomicsFirstOrder, z, square, bins)
    found |= {name: value for name, value in standard.items() if name.rsplit("_", 1)[1] not in _AFFINE_INVARIANT}
    found |= _family("shape2D", shape2D.RadiomicsShape2D, raw, bone, bins)
    for name, kind in _TEXTURES.items():
        found |= _family(name, kind, raw, square, bins)
    return found


def family(name: str) -> str:
    """The family of a feature, one of FAMILIES."""
    return name.split("_", 1)[0]


def _family(prefix: str, kind: Any, image: sitk.Image, mask: sitk.Image, bins: int) -> dict[str, float]:
    # A single slice of three dimensions, taken in its plane: a true 2D image with these settings is silently wrong.
    features = kind(image, mask, binCount=bins, force2D=True, force2Ddimension=0)
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
