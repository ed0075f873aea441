"""Radiomic features of one region, by one of the backends, under the names that pyradiomics gives them."""

from collections.abc import Collection
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_choice
from .backends import default_backend, require_backend
from .bone import bone_mask
from .families import FAMILIES, TEXTURES
from .ibsi import Tags

# A shift and scale of the grey values leaves these as they are, so on the z-scored image they would be named twice; and
# Entropy and Uniformity would moreover hang on the last bit of the z-score, where a grey value meets the edge of a bin.
_AFFINE_INVARIANT = ("Entropy", "Uniformity", "Skewness", "Kurtosis")


class Measures(Protocol):
    """What a backend measures, each name -> value."""

    def first_order(
        self,
        values: NDArray[np.generic],
        pixel_mm: float,
        bins: int,
        leave_out: Collection[str] = (),
        mask: NDArray[np.bool_] | None = None,
    ) -> dict[str, float]:
        """First order of all pixels, or of those of a mask.

        values     (rows, cols) any unit
        leave_out  names that are not wanted
        mask       (rows, cols) True where it is
        """

    def shape(self, mask: NDArray[np.bool_], pixel_mm: float) -> dict[str, float]:
        """Shape of a mask in the plane.

        mask  (rows, cols) True where it is
        """

    def textures(
        self,
        values: NDArray[np.generic],
        pixel_mm: float,
        bins: int,
        families: Collection[str],
        mask: NDArray[np.bool_] | None = None,
    ) -> dict[str, dict[str, float]]:
        """Family -> its features, of all pixels, or of those of a mask.

        values  (rows, cols) any unit, in equal bins from their minimum to their maximum
        mask    (rows, cols) True where it is
        """


def extract(
    region: NDArray[np.generic],
    pixel_mm: float,
    tags: Tags,
    bins: int = 64,
    families: Collection[str] = FAMILIES,
    backend: str | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> dict[str, float]:
    """The features of a region, by names such as `glcm_Contrast`; see `families`.

    First order is taken twice: of the linear signal (`firstorder_linear_*`) and of its z-score over the region
    (`firstorder_z_*`). Shape is that of the bone in the region. Texture is of the raw integers in `bins` equal bins
    from their minimum to their maximum, which no gain or offset changes.

    region   (size, size) whole numbers, linear, DN
    tags     of `data.ibsi.ibsi_tags`, by which MIRP's features are known
    bins     a power of two keeps the edges of the bins exact
    families of FAMILIES; one that is not asked for costs nothing
    backend  of BACKENDS; None: the first that is installed
    mask     (size, size) pixels that are measured, and whose shape is; None: all pixels, and the shape of the bone
    raises   InputError for grey values that are not integers, an unknown family, or a backend that is not there
    """
    if not np.issubdtype(region.dtype, np.integer):
        raise InputError(f"region of {region.dtype}; allowed: integers, since bins of floats hang on their last bit")
    for name in families:
        require_choice("family", name, FAMILIES)
    by = measures(default_backend() if backend is None else backend, tags)
    values: dict[str, float] = {}
    if "firstorder" in families:
        values |= _named("firstorder_linear", by.first_order(region, pixel_mm, bins, mask=mask))
        values |= _named(
            "firstorder_z", by.first_order(_z_score(region, mask), pixel_mm, bins, _AFFINE_INVARIANT, mask)
        )
    if "shape2D" in families:
        values |= _named("shape2D", by.shape(bone_mask(region, pixel_mm) if mask is None else mask, pixel_mm))
    of_texture = [name for name in TEXTURES if name in families]
    for name, of_family in by.textures(region, pixel_mm, bins, of_texture, mask).items():
        values |= _named(name, of_family)
    return values


def measures(backend: str, tags: Tags) -> Measures:
    """What measures, by the name of its backend.

    tags    of `data.ibsi.ibsi_tags`
    raises  InputError for one that is not there
    """
    require_backend(backend)
    if backend == "mirp":
        from .by_mirp import Mirp

        return Mirp(tags)
    from . import by_pyradiomics

    return by_pyradiomics


def _named(prefix: str, values: dict[str, float]) -> dict[str, float]:
    return {f"{prefix}_{name}": value for name, value in values.items()}


def _z_score(region: NDArray[np.generic], mask: NDArray[np.bool_] | None) -> Array:
    """(size, size) with mean 0 and standard deviation 1 over the mask; zeros for a region of one grey value."""
    values = region.astype(np.float64)
    measured = values if mask is None else values[mask]
    spread = measured.std()
    return (values - measured.mean()) / spread if spread > 0 else np.zeros(region.shape)
