"""Feature extraction: a backend measures the radiomic features of a region, which are named as in pyradiomics."""

from collections.abc import Collection
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array, InputError, require_choice
from ...texture import TEXTURE_FAMILIES, measure_texture_features
from .bone_mask import segment_bone
from .feature_backends import default_backend, require_backend
from .feature_families import ALL_FAMILIES, FAMILIES, TEXTURES
from .ibsi_tags import IbsiTags

# First-order features that do not change if grey values are shifted and scaled. They are omitted for the z-score, where
# they would be duplicates. Rounding errors at bin edges would also affect Entropy and Uniformity of the z-score.
_AFFINE_INVARIANT = ("Entropy", "Uniformity", "Skewness", "Kurtosis")


class FeatureExtractor(Protocol):
    """Interface that every feature backend implements."""

    def first_order(
        self,
        values: NDArray[np.generic],
        pixel_mm: float,
        bins: int,
        leave_out: Collection[str] = (),
        mask: NDArray[np.bool_] | None = None,
    ) -> dict[str, float]:
        """Measure first-order features.

        Parameters
        ----------
        values : (rows, cols) array, any unit
            Grey values.
        pixel_mm : float
            Pixel size, in mm.
        bins : int
            Number of grey-level bins.
        leave_out : collection of str
            Names of features to omit.
        mask : (rows, cols) bool array or None
            True for the pixels to measure; None measures all pixels.

        Returns
        -------
        dict of str to float
            Value of each feature, keyed by name without family.
        """

    def shape(self, mask: NDArray[np.bool_], pixel_mm: float) -> dict[str, float]:
        """Measure the shape of a mask in the image plane.

        Parameters
        ----------
        mask : (rows, cols) bool array
            True inside the measured object.
        pixel_mm : float
            Pixel size, in mm.

        Returns
        -------
        dict of str to float
            Value of each feature, keyed by name without family; lengths in mm and areas in mm2.
        """

    def textures(
        self,
        values: NDArray[np.generic],
        pixel_mm: float,
        bins: int,
        families: Collection[str],
        mask: NDArray[np.bool_] | None = None,
    ) -> dict[str, dict[str, float]]:
        """Measure texture features.

        Parameters
        ----------
        values : (rows, cols) array, any unit
            Grey values, which are divided into bins of equal width from minimum to maximum.
        pixel_mm : float
            Pixel size, in mm.
        bins : int
            Number of grey-level bins.
        families : collection of str
            Texture feature families to measure.
        mask : (rows, cols) bool array or None
            True for the pixels to measure; None measures all pixels.

        Returns
        -------
        dict of str to dict of str to float
            Value of each feature, keyed by family and then by name without family.
        """


def extract_features(
    region: NDArray[np.generic],
    pixel_mm: float,
    tags: IbsiTags,
    bins: int = 64,
    families: Collection[str] = FAMILIES,
    backend: str | None = None,
    mask: NDArray[np.bool_] | None = None,
    *,
    bones: NDArray[np.bool_] | None = None,
) -> dict[str, float]:
    """Measure the features of a region, with names such as `glcm_Contrast`.

    First-order features are measured twice: from the linear signal (`firstorder_linear_*`) and from its z-score over
    the region (`firstorder_z_*`). Shape features describe the segmented bone in the region. Texture features are
    measured after binning from minimum to maximum, so gain and offset do not affect them. The families of
    `texture.TEXTURE_FAMILIES` are measured without binning.

    Parameters
    ----------
    region : (size, size) integer array, DN
        Linear signal.
    pixel_mm : float
        Pixel size, in mm.
    tags : dict of str to dict of str to str
        IBSI tag of each feature, keyed by family and then by feature name; see `load_ibsi_tags`. MIRP features are
        identified by these tags.
    bins : int
        Number of grey-level bins. With a power of two, bin edges are free of rounding errors.
    families : collection of str
        Feature families to measure, from ALL_FAMILIES.
    backend : {"pyradiomics", "mirp"} or None
        Feature library; None for pyradiomics if it is installed, else MIRP.
    mask : (size, size) bool array or None
        True for the pixels to measure; shape features then describe the mask. If None, all pixels are measured and
        shape features describe the bones.
    bones : (size, size) bool array or None
        Mask of the bones for shape features; None: the bones are segmented. A `mask` has priority.

    Returns
    -------
    dict of str to float
        Value of each feature, keyed by feature name.

    Raises
    ------
    InputError
        The grey values are not integers, a family is unknown, or the backend is not installed; or the region
        is too small or its pixels too large for a texture measure (`texture.texture_scales.prepare_region`).
    """
    if not np.issubdtype(region.dtype, np.integer):
        raise InputError(
            f"region must have an integer type, got {region.dtype}: rounding errors would affect grey-level bins"
        )
    for name in families:
        require_choice("family", name, ALL_FAMILIES)
    by = load_extractor(default_backend() if backend is None else backend, tags)
    values: dict[str, float] = {}
    if "firstorder" in families:
        values |= _prefix_names("firstorder_linear", by.first_order(region, pixel_mm, bins, mask=mask))
        values |= _prefix_names(
            "firstorder_z", by.first_order(_compute_z_score(region, mask), pixel_mm, bins, _AFFINE_INVARIANT, mask)
        )
    if "shape2D" in families:
        outline = bones if mask is None else mask
        values |= _prefix_names(
            "shape2D", by.shape(segment_bone(region, pixel_mm) if outline is None else outline, pixel_mm)
        )
    of_texture = [name for name in TEXTURES if name in families]
    for name, of_family in by.textures(region, pixel_mm, bins, of_texture, mask).items():
        values |= _prefix_names(name, of_family)
    of_bone = [name for name in TEXTURE_FAMILIES if name in families]
    if of_bone:
        values |= measure_texture_features(region, pixel_mm=pixel_mm, mask=mask, families=of_bone)
    return values


def load_extractor(backend: str, tags: IbsiTags) -> FeatureExtractor:
    """Load the extractor of a backend.

    Parameters
    ----------
    backend : str
        Name of the backend, one of BACKENDS.
    tags : dict of str to dict of str to str
        IBSI tag of each feature, keyed by family and then by feature name; see `load_ibsi_tags`.

    Returns
    -------
    FeatureExtractor
        Extractor of the backend.

    Raises
    ------
    InputError
        The backend is unknown or not installed.
    """
    require_backend(backend)
    if backend == "mirp":
        from .mirp_backend import MirpExtractor

        return MirpExtractor(tags)
    from . import pyradiomics_backend

    return pyradiomics_backend


def _prefix_names(prefix: str, values: dict[str, float]) -> dict[str, float]:
    """Add a prefix to feature names."""
    return {f"{prefix}_{name}": value for name, value in values.items()}


def _compute_z_score(region: NDArray[np.generic], mask: NDArray[np.bool_] | None) -> Array:
    """Scale grey values to mean 0 and standard deviation 1 over the mask; return zeros for a constant region."""
    values = region.astype(np.float64)
    measured = values if mask is None else values[mask]
    spread = measured.std()
    return (values - measured.mean()) / spread if spread > 0 else np.zeros(region.shape)
