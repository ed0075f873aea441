"""A view for eyes, bone bright; with the collimator's edge and a side marker where they are wanted."""

import math
import reprlib

import numpy as np
from msgspec.structs import asdict
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import InputError, require, require_choice, require_whole
from ..core.keywords import keywords
from ..data.detectors import detectors
from ..data.looks import Film, Looks, Processed, looks
from ..model.exposure import MARKERS
from ..model.radiograph import Radiograph
from ..xray.collimator import penumbra_mm
from .looks import film, linear, processed
from .marker import drawn_letter

LOOKS = ("linear", "processed", "film")
# Width of the shadow of the collimator's leaves, and of its penumbra; height of a marker and its distance from that
# shadow. Shares of the smaller side of the image.
_LEAF, _PENUMBRA, _MARKER, _APART = 0.025, 0.002, 0.055, 0.02
# By so much a panel blurs the edge of the field further inwards than the half-shadow goes (judgement).
_BLURRED_MM = 0.5


@keywords()
def present(
    pixels: NDArray[np.uint16] | Radiograph,
    *,
    bits: int = 8,
    side: str | None = None,
    detector: str = "csi",
    look: str | Processed | Film = "linear",
    pixel_mm: float = 0.15,
    field_mm: tuple[float, float] = (0.0, 0.0),
    shadow_mm: float = 0.0,
) -> NDArray[np.uint8 | np.uint16]:
    """(rows, cols)  for eyes, bone bright

    pixels    (rows, cols) linear in the energy absorbed; or a Radiograph, which knows its detector, pitch, field, the
              shadow of its leaves and whether a marker of lead is on it
    bits      8 (uint8), or up to 16 (uint16)
    side      "right" or "left" draws the edge of the collimator where the beam has none, and the marker R or L, on the
              lateral side of the knee, where the radiograph has none of lead
    detector  that they were read by, whose offset is taken off
    look      "linear": log signal, large structures evened out, edges a little sharper; "processed": multi-scale
              contrast and a curve to grey, as a flat panel's software has them; "film": a screen and film; or one of
              these two with parameters of one's own (data.looks)
    pixel_mm  pitch, for "processed", whose structures have sizes, and for the field
    field_mm  width and height of the collimator's field about the middle, beyond which all is black; 0: no leaves there
    shadow_mm how far into the field the leaves shade it; that is black too, or it would be shown as a bright line
    raises    InputError for another number of bits, another side, an unknown detector or look, a pitch or a field out
              of range, and for what is no picture of finite numbers
    """
    require_whole("bits", bits, 8, 16, "")
    if isinstance(pixels, Radiograph):
        protocol = pixels.protocol
        detector, pixel_mm = protocol.detector, protocol.pixel_mm
        field_mm, pixels = (protocol.field_width_mm, protocol.field_height_mm), pixels.pixels
        shadow_mm, lead = penumbra_mm(protocol) / 2 + _BLURRED_MM, protocol.marker != "none"
    else:
        lead = False
    _require_pixels(pixels)
    panels = detectors()
    require_choice("detector", detector, tuple(panels))
    shown_as = look_of(look, looks())
    require("pixel_mm", pixel_mm, 1e-3, 50, "mm")
    require("shadow_mm", shadow_mm, 0, 100, "mm")
    signal = np.maximum(pixels.astype(np.float32) - np.float32(panels[detector].offset_dn), 1.0)
    within = _within(signal.shape, field_mm, pixel_mm, shadow_mm)
    shown = np.zeros_like(signal)
    # What scatters behind the leaves is no part of the limb, from which greys are chosen.
    shown[within] = _shown(np.ascontiguousarray(signal[within]), shown_as, pixel_mm)
    if side is not None:
        shown[within] = _marked(shown[within], side, tuple(wide > 0 for wide in reversed(field_mm)), lead)
    most = 2**bits - 1
    return np.clip(np.rint(most * shown), 0, most).astype(np.uint8 if bits == 8 else np.uint16)


def _require_pixels(pixels: object) -> None:
    numbers = isinstance(pixels, np.ndarray) and pixels.ndim == 2 and pixels.size and pixels.dtype.kind in "iuf"
    if not numbers:
        given = f"an array {pixels.shape} of {pixels.dtype}" if isinstance(pixels, np.ndarray) else reprlib.repr(pixels)
        raise InputError(f"pixels = {given}; allowed: (rows, cols) of numbers, or a Radiograph")
    assert isinstance(pixels, np.ndarray)
    wrong = np.count_nonzero(~np.isfinite(pixels))
    if wrong:
        raise InputError(f"pixels: {wrong} of {pixels.size} are not finite; allowed: finite numbers")


def named_look(look: Processed | Film | None) -> str:
    """A look in words, as `look_of` gives it: its name, and its parameters where it has any."""
    if look is None:
        return "linear"
    values = ", ".join(f"{name} {value:g}" for name, value in asdict(look).items())
    return f"{type(look).__name__.lower()} ({values})"


def _within(
    shape: tuple[int, ...], field_mm: tuple[float, float], pixel_mm: float, shadow_mm: float
) -> tuple[slice, slice]:
    """Rows and columns of the collimator's field without the shadow of its leaves, of which a field is never all."""
    slices = []
    for name, count, wide_mm in zip(("height", "width"), shape, reversed(field_mm), strict=True):
        require(f"{name} of field_mm", wide_mm, 0, 2e4, "mm")
        beyond, shaded = (
            max(0, math.ceil((count - clear_mm / pixel_mm) / 2)) if wide_mm > 0 else 0
            for clear_mm in (wide_mm, wide_mm - 2 * shadow_mm)
        )
        if 2 * beyond >= count:
            raise InputError(f"{name} of field_mm = {wide_mm:g} mm; allowed: a pixel or more, of {pixel_mm:g} mm")
        out = shaded if 2 * shaded < count else beyond
        slices.append(slice(out, count - out))
    return slices[0], slices[1]


def look_of(look: str | Processed | Film, known: Looks) -> Processed | Film | None:
    """The parameters that a name stands for; None for "linear", which has none.

    raises  InputError for what is no look
    """
    if isinstance(look, str):
        require_choice("look", look, LOOKS)
        return {"linear": None, "processed": known.processed, "film": known.film}[look]
    if not isinstance(look, Processed | Film):
        raise InputError(f"look = {look!r}; allowed: {', '.join(LOOKS)}, a Processed or a Film")
    return look


def _shown(signal: NDArray[np.float32], look: Processed | Film | None, pixel_mm: float) -> NDArray[np.float32]:
    """(rows, cols)  greys from 0 to 1"""
    if look is None:
        return linear(signal)
    return processed(signal, pixel_mm, look) if isinstance(look, Processed) else film(signal, look)


def _marked(shown: NDArray[np.float32], side: str, collimated: tuple[bool, ...], lead: bool) -> NDArray[np.float32]:
    """A field (rows, cols), 0 to 1, within the collimator's shadow, with a side marker in its upper lateral corner.

    collimated  whether the field's rows and columns end at leaves that were in the beam
    lead        whether a marker was in the beam
    """
    require_choice("side", side, tuple(MARKERS))
    rows, cols = shown.shape
    smaller = min(rows, cols)
    leaf = max(1, round(_LEAF * smaller))
    high, wide = (0 if real else leaf for real in collimated)
    field = np.zeros_like(shown)
    field[high : rows - high, wide : cols - wide] = 1.0
    field = ndimage.gaussian_filter(field, _PENUMBRA * smaller)
    if lead:
        return shown * field
    # In a view from the front a right knee has its lateral side at the left.
    inset = leaf + _APART * smaller
    place, anchor = ((inset, inset), "la") if side == "right" else ((cols - inset, inset), "ra")
    return np.maximum(shown * field, drawn_letter((rows, cols), MARKERS[side], _MARKER * smaller, place, anchor))
