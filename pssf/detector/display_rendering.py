"""Images for presentation with bright bone, and optionally with a drawn collimator edge and side marker."""

import math
import reprlib
import warnings

import numpy as np
from msgspec.structs import asdict
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import (
    InputError,
    require_choice,
    require_in_range,
    require_integer,
)
from ..core.keyword_arguments import check_keywords
from ..data.imaging.display_table import (
    DisplayProcessing,
    FlatPanelProcessing,
    ScreenFilm,
    load_display_processing,
)
from ..model.detector import Detector, resolve_detector
from ..model.radiograph import Radiograph
from ..model.sampling.acquisition import SIDE_MARKERS
from ..xray.collimator import penumbra_mm
from .display_processing import render_film, render_log, render_processed
from .panel_readout import linearise_pixels
from .side_marker import draw_letter

# Names of the display processing methods.
DISPLAY_PROCESSING = ("log", "processed", "film")
# Width of the drawn collimator shadow, as a fraction of the smaller side of the image.
_LEAF = 0.025
# Width of the penumbra of the drawn collimator shadow, as a fraction of the smaller side of the image.
_PENUMBRA = 0.002
# Height of the drawn side marker, as a fraction of the smaller side of the image.
_MARKER = 0.055
# Distance of the drawn side marker from the collimator shadow, as a fraction of the smaller side of the image.
_APART = 0.02
# Width by which detector blur extends the penumbra into the field, in mm (assumed).
_PANEL_BLUR_MM = 0.5


@check_keywords(look="processing")
def render_for_display(
    pixels: NDArray[np.uint16] | Radiograph,
    *,
    bits: int = 8,
    side: str | None = None,
    detector: str | Detector = "csi",
    processing: str | FlatPanelProcessing | ScreenFilm = "log",
    pixel_mm: float = 0.15,
    field_mm: tuple[float, float] = (0.0, 0.0),
    shadow_mm: float = 0.0,
) -> NDArray[np.uint8 | np.uint16]:
    """Render a radiograph for presentation, with bright bone.

    Parameters
    ----------
    pixels : (rows, cols) array, DN, or Radiograph
        Image that is linear in the absorbed energy. For a Radiograph, the parameters `detector`, `pixel_mm`, `field_mm`
        and `shadow_mm` are ignored, and the values of its protocol are used.
    bits : int, default 8
        Bits per pixel of the rendered image, from 8 (uint8) to 16 (uint16).
    side : {"right", "left"}, optional
        Right or left knee. If specified, a collimator edge is drawn in each direction in which the beam is not
        collimated. The marker R or L is drawn on the lateral side, unless the radiograph shows a lead marker.
    detector : str or Detector, default "csi"
        Detector whose offset and response curve are removed.
    processing : {"log", "processed", "film"}, FlatPanelProcessing or ScreenFilm, default "log"
        Display processing. ``"log"`` is the logarithm of the signal with attenuated large structures and slightly
        sharpened edges. ``"processed"`` is multi-scale contrast processing with a grey-level curve, as in flat-panel
        software. ``"film"`` simulates a screen-film system. A FlatPanelProcessing replaces the default parameters of
        ``"processed"``, and a ScreenFilm those of ``"film"``.
    pixel_mm : float, default 0.15
        Pixel size, from 0.001 to 50 mm. It is used for ``"processed"`` and to convert the field size to pixels.
    field_mm : tuple of float, default (0, 0)
        Width and height of the collimated field, centred on the image, in mm. Pixels outside the field are black. A
        value of 0 means that the beam is not collimated in this direction.
    shadow_mm : float, default 0
        Width of the penumbra inside the field, from 0 to 100 mm. The penumbra is also black; otherwise, it would appear
        as a bright line.

    Returns
    -------
    (rows, cols) uint8 or uint16 array
        Image for presentation.

    Raises
    ------
    InputError
        If `bits`, `side`, `detector`, `processing`, `pixel_mm`, `field_mm` or `shadow_mm` has a value that is not
        allowed, or if `pixels` is not a two-dimensional array of finite numbers.

    Examples
    --------
    >>> import numpy as np, pssf
    >>> pixels = np.full((64, 64), 20_000, np.uint16)
    >>> pixels[:, 24:40] = 2_000  # a bone
    >>> image = pssf.render_for_display(pixels, side="right")
    >>> image.shape, image.dtype
    ((64, 64), dtype('uint8'))
    >>> bool(image[32, 32] > image[32, 10])
    True
    """
    require_integer("bits", bits, 8, 16, "")
    if isinstance(pixels, Radiograph):
        protocol = pixels.protocol
        detector, pixel_mm = protocol.detector, protocol.pixel_mm
        field_mm, pixels = (protocol.field_width_mm, protocol.field_height_mm), pixels.pixels
        shadow_mm, lead = penumbra_mm(protocol) / 2 + _PANEL_BLUR_MM, protocol.marker != "none"
    else:
        lead = False
    _require_pixels(pixels)
    panel = resolve_detector(detector)
    shown_as = resolve_processing(processing, load_display_processing())
    require_in_range("pixel_mm", pixel_mm, 1e-3, 50, "mm")
    require_in_range("shadow_mm", shadow_mm, 0, 100, "mm")
    signal = np.maximum(linearise_pixels(pixels, panel), 1.0)
    within = _find_field_slices(signal.shape, field_mm, pixel_mm, shadow_mm)
    shown = np.zeros_like(signal)
    # Only the field is rendered, because scatter behind the collimator leaves must not affect the grey levels of the
    # limb.
    shown[within] = _render_grey(np.ascontiguousarray(signal[within]), shown_as, pixel_mm)
    if side is not None:
        shown[within] = _add_drawn_marker(shown[within], side, tuple(wide > 0 for wide in reversed(field_mm)), lead)
    most = 2**bits - 1
    return np.clip(np.rint(most * shown), 0, most).astype(np.uint8 if bits == 8 else np.uint16)


def _require_pixels(pixels: object) -> None:
    """Raise InputError if `pixels` is not a (rows, cols) array of finite numbers."""
    numbers = isinstance(pixels, np.ndarray) and pixels.ndim == 2 and pixels.size and pixels.dtype.kind in "iuf"
    if not numbers:
        given = f"an array {pixels.shape} of {pixels.dtype}" if isinstance(pixels, np.ndarray) else reprlib.repr(pixels)
        raise InputError(f"pixels must be a (rows, cols) array of numbers or a Radiograph, got {given}")
    assert isinstance(pixels, np.ndarray)
    wrong = np.count_nonzero(~np.isfinite(pixels))
    if wrong:
        raise InputError(f"pixels must be finite, got {wrong} of {pixels.size} pixels that are not finite")


def format_processing(processing: FlatPanelProcessing | ScreenFilm | None) -> str:
    """Describe a display processing method as text.

    Parameters
    ----------
    processing : FlatPanelProcessing, ScreenFilm or None
        Processing parameters from `resolve_processing`; None for ``"log"``.

    Returns
    -------
    str
        Name of the display processing method, followed by its parameters.
    """
    if processing is None:
        return "log"
    values = ", ".join(f"{key} {value:g}" for key, value in asdict(processing).items())
    name = "processed" if isinstance(processing, FlatPanelProcessing) else "film"
    return f"{name} ({values})"


def _find_field_slices(
    shape: tuple[int, ...], field_mm: tuple[float, float], pixel_mm: float, shadow_mm: float
) -> tuple[slice, slice]:
    """Find the rows and columns of the collimated field, without its penumbra.

    If the entire field is penumbra, the penumbra is included.
    """
    slices = []
    for name, count, wide_mm in zip(("height", "width"), shape, reversed(field_mm), strict=True):
        require_in_range(f"{name} of field_mm", wide_mm, 0, 2e4, "mm")
        beyond, shaded = (
            max(0, math.ceil((count - clear_mm / pixel_mm) / 2)) if wide_mm > 0 else 0
            for clear_mm in (wide_mm, wide_mm - 2 * shadow_mm)
        )
        if 2 * beyond >= count:
            raise InputError(f"{name} of field_mm must be at least one pixel, {pixel_mm:g} mm, got {wide_mm:g} mm")
        out = shaded if 2 * shaded < count else beyond
        slices.append(slice(out, count - out))
    return slices[0], slices[1]


def resolve_processing(
    processing: str | FlatPanelProcessing | ScreenFilm, presets: DisplayProcessing
) -> FlatPanelProcessing | ScreenFilm | None:
    """Return the parameters of a display processing method.

    Parameters
    ----------
    processing : {"log", "processed", "film"}, FlatPanelProcessing or ScreenFilm
        Name of the method, or its parameters, which are returned unchanged.
    presets : DisplayProcessing
        Default parameters of the display processing methods.

    Returns
    -------
    FlatPanelProcessing, ScreenFilm or None
        Processing parameters; None for ``"log"``, which has no parameters.

    Raises
    ------
    InputError
        If `processing` is neither a known name nor a FlatPanelProcessing or ScreenFilm object.

    Warns
    -----
    DeprecationWarning
        If `processing` is ``"linear"``, the deprecated name of ``"log"``.
    """
    if isinstance(processing, str):
        if processing == "linear":
            warnings.warn(
                'processing = "linear" is now "log", but the former name will be removed; use "log"',
                DeprecationWarning,
                stacklevel=3,
            )
            processing = "log"
        require_choice("processing", processing, DISPLAY_PROCESSING)
        return {"log": None, "processed": presets.processed, "film": presets.film}[processing]
    if not isinstance(processing, FlatPanelProcessing | ScreenFilm):
        raise InputError(
            f"processing must be {', '.join(DISPLAY_PROCESSING)}, a FlatPanelProcessing or a ScreenFilm, "
            f"got {processing!r}"
        )
    return processing


def _render_grey(
    signal: NDArray[np.float32], processing: FlatPanelProcessing | ScreenFilm | None, pixel_mm: float
) -> NDArray[np.float32]:
    """Render a signal as grey levels (rows, cols) from 0 to 1."""
    if processing is None:
        return render_log(signal)
    return (
        render_processed(signal, pixel_mm, processing)
        if isinstance(processing, FlatPanelProcessing)
        else render_film(signal, processing)
    )


def _add_drawn_marker(
    shown: NDArray[np.float32], side: str, has_leaves: tuple[bool, ...], has_lead_marker: bool
) -> NDArray[np.float32]:
    """Draw the collimator shadow and the side marker into an image (rows, cols) of grey levels from 0 to 1.

    `has_leaves` indicates, for height and width, whether the image already shows a collimated beam. `has_lead_marker`
    indicates whether the image already shows a lead marker. The drawn marker is in the upper corner on the lateral
    side.
    """
    require_choice("side", side, tuple(SIDE_MARKERS))
    rows, cols = shown.shape
    smaller = min(rows, cols)
    leaf = max(1, round(_LEAF * smaller))
    high, wide = (0 if real else leaf for real in has_leaves)
    field = np.zeros_like(shown)
    field[high : rows - high, wide : cols - wide] = 1.0
    field = ndimage.gaussian_filter(field, _PENUMBRA * smaller)
    if has_lead_marker:
        return shown * field
    # The marker is drawn on the lateral side, which is the left side of the image for a right knee in frontal view.
    inset = leaf + _APART * smaller
    place, anchor = ((inset, inset), "la") if side == "right" else ((cols - inset, inset), "ra")
    return np.maximum(shown * field, draw_letter((rows, cols), SIDE_MARKERS[side], _MARKER * smaller, place, anchor))
