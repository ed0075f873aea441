"""Read a radiograph from an array or a file, and show the result."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.checks import Array, InputError, require_in_range
from ..io.dataset_files import encode_png
from ..io.patients.patient_list import PIXEL_MM_RANGE
from ..io.patients.patient_radiographs import read_film
from .film_overlay import draw_overlay
from .knee_reading import KneeReading, Reader, load_reader, read_knees
from .reading_rows import make_rows

# Least number of rows and columns of a radiograph.
_LEAST_PX = 64


class FilmReading(tuple[KneeReading, ...]):
    """Knees of one radiograph, from the viewer's left to the viewer's right; empty if it shows no frontal knee.

    In a notebook, the radiograph is shown with landmarks and masks.

    Attributes
    ----------
    file : str
        File of the radiograph; empty for an array.
    pixels : (rows, cols) array
        Grey values.
    """

    file: str
    pixels: Array

    def __new__(cls, knees: Iterable[KneeReading], file: str, pixels: Array) -> Self:
        """Make the result for knees, a file and grey values (rows, cols)."""
        made = super().__new__(cls, tuple(knees))
        made.file, made.pixels = file, pixels
        return made

    def __getnewargs__(self) -> tuple[tuple[KneeReading, ...], str, Array]:
        return tuple(self), self.file, self.pixels

    def rows(self) -> list[dict[str, Any]]:
        """Make table rows.

        Returns
        -------
        list of dict
            One row per knee, or one row with the status "no knee".
        """
        return make_rows(self.file, self)

    def draw(self) -> NDArray[np.uint8]:
        """Draw landmarks and masks over the radiograph.

        Returns
        -------
        (rows, cols, 3) uint8 array
            Picture; refused knees have red landmarks.
        """
        return draw_overlay(self.pixels, self)

    def _repr_png_(self) -> bytes:
        """Encode the drawn radiograph as PNG for notebooks."""
        return encode_png(self.draw())


def read(image: ArrayLike | str | Path, *, pixel_mm: float | None = None, reader: Reader | None = None) -> FilmReading:
    """Read the knees on a frontal radiograph.

    Parameters
    ----------
    image : (rows, cols) array, or str or Path
        Grey values of a radiograph or a crop, of any range and polarity, or a PNG, JPEG, TIFF or DICOM file. Both knees
        may be visible.
    pixel_mm : float, optional
        Pixel size, 0.01 to 5 mm; None: the pixel size of the file. If it is unknown, lengths are given as fractions of
        the plateau width.
    reader : Reader, optional
        Result of `load_reader`; None: the networks of the package.

    Returns
    -------
    FilmReading
        Tuple of knees, from the viewer's left to the viewer's right; empty if the image shows no frontal knee.

    Raises
    ------
    InputError
        The file cannot be read, the image is not an array of at least 64 x 64 finite grey values, `pixel_mm` is outside
        its range, or ONNX Runtime is not installed.
    """
    file = ""
    if isinstance(image, (str, Path)):
        file = str(image)
        film = read_film(image)
        image, pixel_mm = film.pixels, pixel_mm or film.pixel_mm
    grey = np.asarray(image)
    if grey.ndim != 2 or min(grey.shape) < _LEAST_PX:
        raise InputError(
            f"image must be an array of at least {_LEAST_PX} x {_LEAST_PX} grey values, got shape {grey.shape}"
        )
    if not np.isfinite(grey).all():
        raise InputError(f"image must have finite grey values, got {np.sum(~np.isfinite(grey))} infinite or NaN")
    if pixel_mm is not None:
        require_in_range("pixel_mm", pixel_mm, *PIXEL_MM_RANGE, "mm")
    used = load_reader() if reader is None else reader
    return FilmReading(read_knees(grey.astype(np.float32), pixel_mm, used), file, grey)
