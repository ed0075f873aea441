"""pyradiomics backend: features of pyradiomics 3.0.1 (van Griethuysen 2017), IBSI aggregation "2D, averaged".

Differences between pyradiomics and the IBSI: pyradiomics returns kurtosis, and the IBSI defines excess kurtosis
(kurtosis - 3). The IBSI does not define shape2D, TotalEnergy, MCC and StandardDeviation. The pyradiomics NGTDM includes
pixels without neighbours.
"""

import logging
from collections.abc import Collection
from typing import Any

import numpy as np
import SimpleITK as sitk  # noqa: N813 (the library's own short name)
from numpy.typing import NDArray
from radiomics import firstorder, glcm, gldm, glrlm, glszm, ngtdm, shape2D

TEXTURES = {
    "glcm": glcm.RadiomicsGLCM,
    "glrlm": glrlm.RadiomicsGLRLM,
    "glszm": glszm.RadiomicsGLSZM,
    "ngtdm": ngtdm.RadiomicsNGTDM,
    "gldm": gldm.RadiomicsGLDM,
}


_BINNED_FEATURES = {"Entropy", "Uniformity"}


class _FirstOrder(firstorder.RadiomicsFirstOrder):  # type: ignore[misc]
    """First-order features of pyradiomics, with each central moment computed once and omitted features skipped.

    pyradiomics itself computes the moments repeatedly, which takes a quarter of its total run time. Computing powers as
    products would be even faster, but would change the last bit of the results.
    """

    __module__ = firstorder.__name__  # pyradiomics uses the module name as logger name.
    left_out: Collection[str] = ()

    def _applyBinning(self, matrix: Any) -> Any:  # noqa: N802 (name in the library)
        """Bin the grey values only if a feature needs the bins."""
        return np.zeros(matrix.shape, int) if set(self.left_out) >= _BINNED_FEATURES else super()._applyBinning(matrix)

    def _initCalculation(self, voxelCoordinates: Any = None) -> None:  # noqa: N802
        """Prepare the calculation and disable omitted features."""
        super()._initCalculation(voxelCoordinates)
        self._moments: dict[int, Any] = {}
        for name in self.left_out:
            self.enableFeatureByName(name, False)

    def _moment(self, a: Any, moment: int = 1) -> Any:
        """Return a central moment (1,) of the region pixels `a` (1, pixels).

        The moments are cached, because `a` is the same array in every call.
        """
        if moment not in self._moments:
            self._moments[moment] = super()._moment(a, moment)
        return self._moments[moment]


def first_order(
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
    kind = type("FirstOrder", (_FirstOrder,), {"left_out": tuple(leave_out), "__module__": firstorder.__name__})
    return measure_family(kind, values, _make_mask(values, mask), pixel_mm, binCount=bins)


def shape(mask: NDArray[np.bool_], pixel_mm: float) -> dict[str, float]:
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
    return measure_family(shape2D.RadiomicsShape2D, mask.astype(np.uint8), mask.astype(np.uint8), pixel_mm)


def textures(
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
    square = _make_mask(values, mask)
    kinds = {name: kind for name, kind in TEXTURES.items() if name in families}
    binned: dict[str, Any] = {}
    return {
        name: measure_family(_share_binning(kind, binned), values, square, pixel_mm, binCount=bins)
        for name, kind in kinds.items()
    }


def _share_binning(kind: Any, cache: dict[str, Any]) -> Any:
    """Make a subclass of a pyradiomics family class that reuses the binned pixels of another family.

    `cache` stores the binned pixels; it is empty until the first family is measured.
    """

    def apply(self: Any, matrix: Any) -> Any:
        if not cache:
            cache["matrix"] = kind._applyBinning(self, matrix)
            cache["of"] = {name: self.coefficients[name] for name in ("grayLevels", "Ng")}
        self.coefficients |= cache["of"]
        return cache["matrix"].copy()

    return type(kind.__name__, (kind,), {"_applyBinning": apply, "__module__": kind.__module__})


def measure_family(
    kind: Any, values: NDArray[np.generic], mask: NDArray[np.uint8], pixel_mm: float, **discretisation: Any
) -> dict[str, float]:
    """Measure all features of a pyradiomics family in one image.

    Parameters
    ----------
    kind : type
        pyradiomics class of the family, such as `radiomics.glcm.RadiomicsGLCM`.
    values : (rows, cols) array, any unit
        Grey values.
    mask : (rows, cols) uint8 array
        Region mask: 1 inside the region, 0 outside.
    pixel_mm : float
        Pixel size, in mm.
    **discretisation : object
        pyradiomics settings of the discretisation, such as binCount.

    Returns
    -------
    dict of str to float
        Value of each feature, keyed by pyradiomics name.
    """
    logging.getLogger("radiomics").setLevel(logging.CRITICAL)  # By default, pyradiomics logs every family to stderr.
    image, of = _make_image(values, pixel_mm, None), _make_image(mask, pixel_mm, 0)
    # The image is one slice of a 3D image and is measured in the slice plane. With these settings, pyradiomics returns
    # wrong values for a 2D image.
    features = kind(image, of, force2D=True, force2Ddimension=0, **discretisation)
    features.enableAllFeatures()
    return {name: float(value) for name, value in features.execute().items()}


def _make_mask(values: NDArray[np.generic], mask: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """Convert a mask to uint8; return ones everywhere if the mask is None."""
    return np.ones(values.shape, dtype=np.uint8) if mask is None else mask.astype(np.uint8)


def _make_image(values: NDArray[np.generic], pixel_mm: float, outside: int | None) -> sitk.Image:
    """Make a SimpleITK image with one slice and a border of one pixel.

    The border is needed because pyradiomics 3.0.1 rejects a mask without zeros. `outside` is the border value; if it is
    None, the border repeats the edge pixels.
    """
    padded = np.pad(values, 1, mode="edge") if outside is None else np.pad(values, 1, constant_values=outside)
    image = sitk.GetImageFromArray(padded[None])
    image.SetSpacing((pixel_mm, pixel_mm, 1.0))
    return image
