"""The same features by MIRP (Zwanenburg 2024), which follows the IBSI, under the names that pyradiomics gives them.

A feature is known by its IBSI tag. MIRP has no shape of a mask in the plane, which `shape2d` measures, and its MCC is
another than that of pyradiomics, so there is none.
"""

import logging
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ibsi import Tags
from .shape2d import shape

# What MIRP calls a family, and how its names go on after a tag: distance, aggregation, bins.
_FAMILIES = {
    "firstorder": (("statistics", "intensity_histogram"), "_fbn"),
    "glcm": (("glcm",), "_d1_"),
    "glrlm": (("glrlm",), "_2d"),
    "glszm": (("glszm",), "_2d"),
    "ngtdm": (("ngtdm",), "_2d"),
    "gldm": (("ngldm",), "_d1_"),
}
# As pyradiomics measures; see the notes of each family there.
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
class Mirp:
    """`features.Measures` by MIRP.

    tags  of `data.ibsi.ibsi_tags`
    """

    tags: Tags

    def first_order(
        self,
        values: NDArray[np.generic],
        pixel_mm: float,
        bins: int,
        leave_out: Collection[str] = (),
        mask: NDArray[np.bool_] | None = None,
    ) -> dict[str, float]:
        """Name -> value, first order of all pixels, or of those of a mask.

        values     (rows, cols) any unit
        leave_out  names that are not given
        mask       (rows, cols) True where it is
        """
        known = self._named("firstorder", measure(values, bins, ("firstorder",), mask))
        known["Kurtosis"] += 3  # not excess in pyradiomics
        known["TotalEnergy"] = known["Energy"] * pixel_mm**2
        return _in_order({name: value for name, value in known.items() if name not in leave_out})

    def shape(self, mask: NDArray[np.bool_], pixel_mm: float) -> dict[str, float]:
        """Name -> value, of a mask's outline and of the ellipse of its pixels.

        mask  (rows, cols) True where it is
        """
        return shape(mask, pixel_mm)

    def textures(
        self,
        values: NDArray[np.generic],
        pixel_mm: float,
        bins: int,
        families: Collection[str],
        mask: NDArray[np.bool_] | None = None,
    ) -> dict[str, dict[str, float]]:
        """Family -> name -> value, of all pixels, or of those of a mask.

        values    (rows, cols) any unit, in equal bins from their minimum to their maximum
        families  of textures
        mask      (rows, cols) True where it is
        """
        theirs = measure(values, bins, families, mask) if families else {}
        return {name: _in_order(self._named(name, theirs)) for name in families}

    def beside(self, family: str, values: NDArray[np.generic], bins: int) -> list[str]:
        """What MIRP measures of a family and `pssf` does not take, by its tags.

        values  (rows, cols) any unit
        """
        end = _FAMILIES[family][1]
        names = [name for name in measure(values, bins, (family,)) if not name.startswith("image_")]
        taken = {*self.tags[family].values(), "stat_total_energy"}
        return [tag for tag in (name.split(end)[0] for name in names) if tag not in taken]

    def _named(self, family: str, theirs: dict[str, float]) -> dict[str, float]:
        """Name -> value of those features of a family that have a tag."""
        end = _FAMILIES[family][1]
        values: dict[str, float] = {}
        for name, tag in self.tags[family].items():
            (values[name],) = (value for key, value in theirs.items() if key == tag or key.startswith(tag + end))
        return values


def measure(
    values: NDArray[np.generic], bins: int, families: Collection[str], mask: NDArray[np.bool_] | None = None
) -> dict[str, float]:
    """All that MIRP measures of these families, by its own names.

    values  (rows, cols) any unit
    mask    (rows, cols) True where it is; None: everywhere
    """
    import mirp  # seconds, which only those wait for who measure by it

    with warnings.catch_warnings(), _without_its_log():
        warnings.simplefilter("ignore")
        (table,) = mirp.extract_features(
            image=values[None].astype(np.float64),
            mask=(np.ones(values.shape, np.uint8) if mask is None else mask.astype(np.uint8))[None],
            base_feature_families=[theirs for name in families for theirs in _FAMILIES[name][0]],
            base_discretisation_n_bins=bins,
            **_SETTINGS,
        )
    return {name: float(table[name].iloc[0]) for name in table.columns if table[name].dtype.kind in "fi"}


def _in_order(values: dict[str, float]) -> dict[str, float]:
    """As pyradiomics has them, since of two that correlate a selection leaves out the later: by its methods' names."""
    return {name: values[name] for name in sorted(values, key=lambda name: f"get{name}FeatureValue")}


@contextmanager
def _without_its_log() -> Iterator[None]:
    """MIRP tells of each image on stdout by a handler of its own, unless there is one."""
    root, silent = logging.getLogger(), logging.NullHandler()
    root.addHandler(silent)
    try:
        yield
    finally:
        root.removeHandler(silent)
