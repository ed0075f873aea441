"""Define the images and settings from which a detector is calibrated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError, require_in_range

# Smallest number of rows and columns of a flat field or dark image, in pixels.
_LEAST_SIDE_PX = 128
# Smallest number of pixels of the region of a step.
_LEAST_STEP_PIXELS = 100


@dataclass(frozen=True, kw_only=True)
class Step:
    """Step of a wedge, and the region of the image in which it is measured.

    Attributes
    ----------
    thickness_mm : float
        Thickness of the step along the beam, in mm; 0 is the open beam beside the wedge.
    top, bottom, left, right : int
        First row, last row plus 1, first column, and last column plus 1 of the region.
    """

    thickness_mm: float
    top: int
    bottom: int
    left: int
    right: int

    def cut(self, image: Array) -> Array:
        """Cut the region of the step out of an image.

        Parameters
        ----------
        image : (rows, cols) array, any unit
            Image of the wedge.

        Returns
        -------
        (bottom - top, right - left) array
            Values of the region.
        """
        return image[self.top : self.bottom, self.left : self.right]


@dataclass(frozen=True, kw_only=True)
class Wedge:
    """Image of a step wedge at one tube voltage.

    Attributes
    ----------
    image : (rows, cols) uint16 array
        Linear pixel values, in DN.
    tube_kv : float
        Nominal tube voltage, in kV.
    """

    image: NDArray[np.uint16]
    tube_kv: float


@dataclass(frozen=True, kw_only=True)
class CalibrationImages:
    """Images of a detector; any of them can be missing.

    Attributes
    ----------
    pixel_mm : float
        Pixel pitch, in mm.
    darks : tuple of (rows, cols) uint16 array
        Images without exposure, in DN.
    flats : tuple of (rows, cols) uint16 array
        Flat fields, in DN.
    flat_mas : tuple of float
        mAs of each flat field.
    edge : (rows, cols) uint16 array, optional
        Image of a slanted edge of an opaque plate on the detector, in DN.
    wedges : tuple of Wedge
        Images of a step wedge, each at another tube voltage.
    steps : tuple of Step
        Steps of the wedge, with one of thickness 0.
    step_material : str
        Material of the wedge.
    radiographs : tuple of (rows, cols) uint16 array
        Linear radiographs of patients instead of flat fields, in DN. Their shapes may differ.

    Raises
    ------
    InputError
        If an image is too small or has another shape than others of its kind, a number is out of range, or numbers and
        images do not belong together.
    """

    pixel_mm: float
    darks: tuple[NDArray[np.uint16], ...] = ()
    flats: tuple[NDArray[np.uint16], ...] = ()
    flat_mas: tuple[float, ...] = ()
    edge: NDArray[np.uint16] | None = None
    wedges: tuple[Wedge, ...] = ()
    steps: tuple[Step, ...] = ()
    step_material: str = "Al@2.70"
    radiographs: tuple[NDArray[np.uint16], ...] = ()

    def __post_init__(self) -> None:
        require_in_range("pixel_mm", self.pixel_mm, 0.001, 50, "mm")
        _require_images("dark image", self.darks)
        _require_images("flat field", self.flats)
        if len(self.flat_mas) != len(self.flats):
            raise InputError(f"mas must be one number per flat field, got {len(self.flat_mas)} for {len(self.flats)}")
        for mas in self.flat_mas:
            require_in_range("mas", mas, 1e-6, 1e6, "mAs")
        for image in self.radiographs:
            _require_images("radiograph", (image,))
        if self.radiographs and self.flats:
            raise InputError(
                f"radiographs must be given without flat fields, got {len(self.flats)} flat fields: these determine "
                "the noise without anatomy"
            )
        if not (self.darks or self.flats or self.edge is not None or self.wedges or self.radiographs):
            raise InputError(
                f"images must include a dark image, flat field, edge, wedge or radiograph, got {self.darks}"
            )
        self._check_wedges()

    def _check_wedges(self) -> None:
        """Raise InputError if the wedge images and steps do not belong together."""
        if not self.wedges:
            return
        kvs = [wedge.tube_kv for wedge in self.wedges]
        for kv in kvs:
            require_in_range("tube voltage of the wedge", kv, 20, 300, "kV")
        if len({step.thickness_mm for step in self.steps}) < 3:
            raise InputError(f"steps must have at least 3 thicknesses, got {len(self.steps)} steps")
        if min(step.thickness_mm for step in self.steps) != 0:
            raise InputError(
                "steps must include thickness 0, the open beam beside the wedge, got a smallest thickness of "
                f"{min(step.thickness_mm for step in self.steps):g} mm"
            )
        for wedge in self.wedges:
            for step in self.steps:
                _require_region(step, wedge.image.shape)


def _require_images(what: str, images: Sequence[NDArray[np.uint16]]) -> None:
    """Raise InputError if images are too small or differ in shape."""
    shapes = {image.shape for image in images}
    if len(shapes) > 1:
        raise InputError(f"each {what} must have the same shape, got {sorted(shapes)}")
    for shape in shapes:
        if min(shape) < _LEAST_SIDE_PX:
            raise InputError(f"{what} must have at least {_LEAST_SIDE_PX} x {_LEAST_SIDE_PX} pixels, got {shape}")


def _require_region(step: Step, shape: tuple[int, ...]) -> None:
    """Raise InputError if the region of a step is too small or not inside the image."""
    where = f"region of the step of {step.thickness_mm:g} mm"
    require_in_range(f"thickness of a step in mm, {where}", step.thickness_mm, 0, 1000, "mm")
    inside = 0 <= step.top < step.bottom <= shape[0] and 0 <= step.left < step.right <= shape[1]
    if not inside or (step.bottom - step.top) * (step.right - step.left) < _LEAST_STEP_PIXELS:
        raise InputError(
            f"{where} must contain at least {_LEAST_STEP_PIXELS} pixels of the image of {shape[0]} x {shape[1]} pixels"
            f", got rows {step.top} to {step.bottom} and columns {step.left} to {step.right}"
        )
