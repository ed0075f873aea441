"""Films of any source: the pixels of one film as they are displayed; `film_list` says which a folder holds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from ..core.checks import Array, InputError, require_choice, require_whole
from ..data.looks import Processed
from ..detector import present
from .film_list import PIXEL_MM, SIDES, Film, list_films, require_film, subject_and_side
from .film_tiff import read_packed
from .image_kind import SUFFIXES, is_dicom
from .images import load, load_parameters, reading

__all__ = ["SIDES", "SUFFIXES", "Film", "FilmImage", "list_films", "read_film", "subject_and_side"]

# Least side of a film, pixels: a joint of 100 mm is resolved to some 1.5 mm.
LEAST_PX = 64
# Mode of Pillow -> grey values.
_GREY = {"L": 2**8, "I;16": 2**16, "I;16L": 2**16, "I;16B": 2**16, "I;16N": 2**16}
_COLOUR = ("P", "PA", "LA", "RGB", "RGBA")
# Channels of a grey picture differ by what a JPEG's colour transform rounds.
_GREY_SPREAD = 8 / 255
_WHITE_IS_ZERO, _PHOTOMETRIC = 0, 262


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmImage:
    """A film as it is displayed.

    pixels    (rows, cols) 0 to 1 over the range of its bits; bone bright, unless it is inverted and does not say so
    pixel_mm  pitch at the film or detector, where the file says so: DICOM, and what this package wrote. Resolutions in
              other files are for print, and not believed
    side      right | left, where the file says so
    """

    pixels: Array
    pixel_mm: float | None = None
    side: str | None = None


def read_film(path: str | Path, look: Processed | None = None) -> FilmImage:
    """A film as it is displayed; linear pixels, and others' logarithms of them, are rendered for eyes first.

    look    that they are rendered with; None: "processed"
    path    PNG, JPEG, TIFF or DICOM of 8 to 16 bit; of colour only what is grey in truth
    raises  InputError naming a file that is missing, empty, damaged, of another kind, of several frames, coloured, of
            one grey value or too small; one whose pixels are not square; a DICOM For Processing that does not say how
            its pixels hang on the beam
    """
    path = Path(path)
    require_film(path)
    with reading(path, "a readable film of 8 to 16 bit", "damaged"):
        if path.stat().st_size == 0:
            raise InputError(f"file {path}: size = 0 bytes; allowed: a film")
        if is_dicom(path):
            from . import film_dicom  # pydicom is not imported before a DICOM is wanted

            ours = film_dicom.is_linear_by_pssf(path)
            film = _rendered(path, look) if ours else FilmImage(**film_dicom.read(path, PIXEL_MM, look))
        else:
            packed = read_packed(path) if path.suffix.lower() in (".tif", ".tiff") else None
            film = _picture(path, look) if packed is None else FilmImage(pixels=packed)
    for name, length in zip(("rows", "columns"), film.pixels.shape, strict=True):
        require_whole(f"file {path}: {name}", length, LEAST_PX, 2**16, "pixels")
    least, most = float(film.pixels.min()), float(film.pixels.max())
    if not most > least:
        raise InputError(f"file {path}: pixels = {least:g} throughout; allowed: more than one grey value")
    return film


def _rendered(path: Path, look: Processed | None) -> FilmImage:
    """Linear pixels of this package, for eyes."""
    radiograph = load(path)
    shown = present(radiograph, bits=16, look=look or "processed")
    side = None if radiograph.knee is None else radiograph.knee.side
    return FilmImage(pixels=shown / 65535.0, pixel_mm=radiograph.protocol.pixel_mm, side=side)


def _picture(path: Path, look: Processed | None) -> FilmImage:
    """A PNG, JPEG or TIFF."""
    with _opened(path) as image:
        frames = getattr(image, "n_frames", 1)
        if frames > 1:
            raise InputError(f"file {path}: frames = {frames}; allowed: 1")
        if "pssf" in str(getattr(image, "tag_v2", {}).get(305, "")):
            return _rendered(path, look)
        said: dict[str, Any] = _said_by_pssf(path) if "Description" in image.info else {}
        upright = ImageOps.exif_transpose(image)
        pixels = _grey(np.asarray(_flat(upright, path)), upright.mode, path)
        # Pillow turns white-is-zero round at 8 bit, and leaves it at 16.
        if image.mode != "L" and getattr(image, "tag_v2", {}).get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
            pixels = 1.0 - pixels
    return FilmImage(pixels=pixels, **said)


def _opened(path: Path) -> Image.Image:
    """The picture with its pixels."""
    image = None
    try:
        image = Image.open(path)
        image.load()
        return image
    except OSError as error:  # Pillow's own, as if the disk were at fault, for what is no picture or not whole
        if image is not None:
            image.close()
        if error.errno is not None:
            raise
        raise InputError(f"file {path}: damaged, or no picture; allowed: a readable film of 8 to 16 bit") from None


def _said_by_pssf(path: Path) -> dict[str, Any]:
    """Pitch and side, if the picture is one of this package's."""
    try:
        made = load_parameters(path)
    except InputError:
        return {}
    return {"pixel_mm": made["protocol"].pixel_mm, "side": None if made["knee"] is None else made["knee"].side}


def _flat(image: Image.Image, path: Path) -> Image.Image:
    """The picture without a palette."""
    require_choice(f"file {path}: kind of pixel", image.mode, (*_GREY, *_COLOUR))
    return image.convert("RGBA") if image.mode in _COLOUR else image


def _grey(values: NDArray[Any], mode: str, path: Path) -> Array:
    """(rows, cols) 0 to 1 of grey values, or of the channels of a colour picture that are alike."""
    if mode in _GREY:
        return values.astype(np.float64) / (_GREY[mode] - 1)
    shown = values.astype(np.float64) / 255.0
    if shown[..., 3].min() < 1.0:
        raise InputError(f"file {path}: opacity = {shown[..., 3].min():.2f} somewhere; allowed: 1 throughout")
    spread = float(np.ptp(shown[..., :3], axis=2).max())
    if spread > _GREY_SPREAD:
        raise InputError(f"file {path}: channels differ by = {spread:.2f}; allowed: up to {_GREY_SPREAD:.2f}")
    return np.asarray(shown[..., :3].mean(axis=2))
