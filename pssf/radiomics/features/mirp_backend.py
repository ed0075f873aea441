"""MIRP backend: features are measured by MIRP (Zwanenburg 2024), which follows the IBSI, and named as in pyradiomics.

MIRP features are identified by their IBSI tag. MIRP has no 2D shape features, so `shape2d` measures them. The MCC
feature is omitted, because MIRP and pyradiomics define MCC differently.
"""

import logging
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ibsi_tags import IbsiTags
from .shape2d import measure_shape

# MIRP names of each feature family, and the ending of MIRP feature names after the IBSI tag: distance, aggregation or
# binning.
_FAMILIES = {
    "firstorder": (("statistics", "intensity_histogram"), "_fbn"),
    "glcm": (("glcm",), "_d1_"),
    "glrlm": (("glrlm",), "_2d"),
    "glszm": (("glszm",), "_2d"),
    "ngtdm": (("ngtdm",), "_2d"),
    "gldm": (("ngldm",), "_d1_"),
}
# MIRP settings that give the same results as pyradiomics.
_SETTINGS = {
    "by_slice": True,
    "ibsi_compliant": False,
    "stack_images": "no",
    "stack_masks": "no",
    "base_discretisation_method": "fixed_bin_number",
    "glcm_distance": 1.0,
    "glcm_spatial_method": "2d_average",
    "glrlm_spatial_method": "2d_average",
    "glszm_spatial_method": "2d",
    "ngtdm_spatial_method": "2d",
    "ngldm_spatial_method": "2d",
    "ngldm_distance": 1.0,
    "ngldm_difference_level": 0.0,
}


@dataclass(frozen=True)
class MirpExtractor:
    """Feature extractor that uses MIRP.

    Attributes
    ----------
    tags : dict of str to dict of str to str
        IBSI tag of each feature, keyed by family and then by feature name; see `load_ibsi_tags`.
    """

    tags: IbsiTags

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
        known = self._select_tagged("firstorder", measure_with_mirp(values, bins, ("firstorder",), mask))
        known["Kurtosis"] += 3  # MIRP returns excess kurtosis, pyradiomics returns kurtosis.
        known["TotalEnergy"] = known["Energy"] * pixel_mm**2
        return _sort_like_pyradiomics({name: value for name, value in known.items() if name not in leave_out})

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
        return measure_shape(mask, pixel_mm)

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
        theirs = measure_with_mirp(values, bins, families, mask) if families else {}
        return {name: _sort_like_pyradiomics(self._select_tagged(name, theirs)) for name in families}

    def list_unused_tags(self, family: str, values: NDArray[np.generic], bins: int) -> list[str]:
        """List the IBSI tags of all features in a family that MIRP measures but this package does not use.

        Parameters
        ----------
        family : str
            Feature family.
        values : (rows, cols) array, any unit
            Grey values of any image; MIRP measures features of the image to list their names.
        bins : int
            Number of grey-level bins.

        Returns
        -------
        list of str
            IBSI tags of unused features.
        """
        end = _FAMILIES[family][1]
        names = [name for name in measure_with_mirp(values, bins, (family,)) if not name.startswith("image_")]
        taken = {*self.tags[family].values(), "stat_total_energy"}
        return [tag for tag in (name.split(end)[0] for name in names) if tag not in taken]

    def _select_tagged(self, family: str, theirs: dict[str, float]) -> dict[str, float]:
        """Select the features of a family by IBSI tag, and rename them to pyradiomics names."""
        end = _FAMILIES[family][1]
        values: dict[str, float] = {}
        for name, tag in self.tags[family].items():
            (values[name],) = (value for key, value in theirs.items() if key == tag or key.startswith(tag + end))
        return values


def measure_with_mirp(
    values: NDArray[np.generic], bins: int, families: Collection[str], mask: NDArray[np.bool_] | None = None
) -> dict[str, float]:
    """Measure all MIRP features of the specified families, with MIRP names.

    Parameters
    ----------
    values : (rows, cols) array, any unit
        Grey values.
    bins : int
        Number of grey-level bins.
    families : collection of str
        Feature families to measure.
    mask : (rows, cols) bool array or None
        True for the pixels to measure; None measures all pixels.

    Returns
    -------
    dict of str to float
        Value of each feature, keyed by MIRP name.
    """
    import mirp  # Importing MIRP takes seconds, so the import is deferred.

    with warnings.catch_warnings(), _silence_mirp_log():
        warnings.simplefilter("ignore")
        (table,) = mirp.extract_features(
            image=values[None].astype(np.float64),
            mask=(np.ones(values.shape, np.uint8) if mask is None else mask.astype(np.uint8))[None],
            base_feature_families=[theirs for name in families for theirs in _FAMILIES[name][0]],
            base_discretisation_n_bins=bins,
            **_SETTINGS,
        )
    return {name: float(table[name].iloc[0]) for name in table.columns if table[name].dtype.kind in "fi"}


def _sort_like_pyradiomics(values: dict[str, float]) -> dict[str, float]:
    """Sort features in the order of the pyradiomics method names.

    The order matters, because feature selection removes the second of two correlated features.
    """
    return {name: values[name] for name in sorted(values, key=lambda name: f"get{name}FeatureValue")}


@contextmanager
def _silence_mirp_log() -> Iterator[None]:
    """Prevent MIRP from adding a log handler that prints one line per image to stdout."""
    root, silent = logging.getLogger(), logging.NullHandler()
    root.addHandler(silent)
    try:
        yield
    finally:
        root.removeHandler(silent)
