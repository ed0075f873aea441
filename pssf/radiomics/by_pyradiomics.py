"""Features by pyradiomics 3.0.1 (van Griethuysen 2017), as IBSI "2D, averaged" aggregation.

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

TEXTURES = {
    "glcm": glcm.RadiomicsGLCM,
    "glrlm": glrlm.RadiomicsGLRLM,
    "glszm": glszm.RadiomicsGLSZM,
    "ngtdm": ngtdm.RadiomicsNGTDM,
    "gldm": gldm.RadiomicsGLDM,
}


_OF_BINS = {"Entropy", "Uniformity"}


class _FirstOrder(firstorder.RadiomicsFirstOrder):  # type: ignore[misc]
    """With each central moment taken once, and none that is left out: they took a quarter of the time of all features.

    Products instead of powers would be faster still, and differ in the last bit.
    """

    __module__ = firstorder.__name__  # by which the library names a log
    left_out: Collection[str] = ()

    def _applyBinning(self, matrix: Any) -> Any:  # noqa: N802 (the library's own name)
        return np.zeros(matrix.shape, int) if set(self.left_out) >= _OF_BINS else super()._applyBinning(matrix)

    def _initCalculation(self, voxelCoordinates: Any = None) -> None:  # noqa: N802
        super()._initCalculation(voxelCoordinates)
        self._moments: dict[int, Any] = {}
        for name in self.left_out:
            self.enableFeatureByName(name, False)

    def _moment(self, a: Any, moment: int = 1) -> Any:
        """(1,) of the region's pixels (1, pixels), which `a` always is."""
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
    """Name -> value, first order of all pixels, or of those of a mask.

    values     (rows, cols) any unit
    leave_out  names that are not measured
    mask       (rows, cols) True where it is
    """
    kind = type("FirstOrder", (_FirstOrder,), {"left_out": tuple(leave_out), "__module__": firstorder.__name__})
    return measure(kind, values, _inside(values, mask), pixel_mm, binCount=bins)


def shape(mask: NDArray[np.bool_], pixel_mm: float) -> dict[str, float]:
    """Name -> value, of a mask's outline and of the ellipse of its pixels.

    mask  (rows, cols) True where it is
    """
    return measure(shape2D.RadiomicsShape2D, mask.astype(np.uint8), mask.astype(np.uint8), pixel_mm)


def textures(
    values: NDArray[np.generic],
    pixel_mm: float,
    bins: int,
    families: Collection[str],
    mask: NDArray[np.bool_] | None = None,
) -> dict[str, dict[str, float]]:
    """Family -> name -> value, of all pixels, or of those of a mask.

    values    (rows, cols) any unit, in equal bins from their minimum to their maximum
    families  of TEXTURES
    mask      (rows, cols) True where it is
    """
    square = _inside(values, mask)
    kinds = {name: kind for name, kind in TEXTURES.items() if name in families}
    binned: dict[str, Any] = {}
    return {
        name: measure(_binned_once(kind, binned), values, square, pixel_mm, binCount=bins)
        for name, kind in kinds.items()
    }


def _binned_once(kind: Any, held: dict[str, Any]) -> Any:
    """A family that takes the bins which another one has made of the same pixels.

    held  where they are kept; empty before the first
    """

    def apply(self: Any, matrix: Any) -> Any:
        if not held:
            held["matrix"] = kind._applyBinning(self, matrix)
            held["of"] = {name: self.coefficients[name] for name in ("grayLevels", "Ng")}
        self.coefficients |= held["of"]
        return held["matrix"].copy()

    return type(kind.__name__, (kind,), {"_applyBinning": apply, "__module__": kind.__module__})


def measure(
    kind: Any, values: NDArray[np.generic], mask: NDArray[np.uint8], pixel_mm: float, **discretisation: Any
) -> dict[str, float]:
    """All features of one family of pyradiomics, of one slice, by their names there.

    kind    class of the family, such as `radiomics.glcm.RadiomicsGLCM`
    values  (rows, cols) any unit
    mask    (rows, cols) 1 where the region is
    """
    logging.getLogger("radiomics").setLevel(logging.CRITICAL)  # it reports each family on stderr
    image, of = _image(values, pixel_mm, None), _image(mask, pixel_mm, 0)
    # A single slice of three dimensions, taken in its plane: a true 2D image with these settings is silently wrong.
    features = kind(image, of, force2D=True, force2Ddimension=0, **discretisation)
    features.enableAllFeatures()
    return {name: float(value) for name, value in features.execute().items()}


def _inside(values: NDArray[np.generic], mask: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    return np.ones(values.shape, dtype=np.uint8) if mask is None else mask.astype(np.uint8)


def _image(values: NDArray[np.generic], pixel_mm: float, outside: int | None) -> sitk.Image:
    """One slice with a border of one pixel; pyradiomics 3.0.1 refuses a mask without any zero.

    outside  value of the border, or None to repeat the edge
    """
    padded = np.pad(values, 1, mode="edge") if outside is None else np.pad(values, 1, constant_values=outside)
    image = sitk.GetImageFromArray(padded[None])
    image.SetSpacing((pixel_mm, pixel_mm, 1.0))
    return image
