"""A view for eyes: log signal, bone bright; with the collimator's edge and a side marker where they are wanted."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.blocks import block_mean, enlarge
from ..core.checks import require_choice, require_whole
from ..data.detectors import detectors

# Width of the shadow of the collimator's leaves, and of its penumbra; height of a marker and its distance from that
# shadow. Shares of the smaller side of the image.
_LEAF, _PENUMBRA, _MARKER, _APART = 0.025, 0.002, 0.055, 0.02
_MARKERS = {"right": "R", "left": "L"}


def present(
    pixels: NDArray[np.uint16], *, bits: int = 8, side: str | None = None, detector: str = "csi"
) -> NDArray[np.uint8 | np.uint16]:
    """(rows, cols)  for eyes: log signal, bone bright, large structures evened out, edges a little sharper

    pixels    (rows, cols) linear in the energy absorbed
    bits      8 (uint8), or up to 16 (uint16)
    side      "right" or "left" draws the edge of the collimator and the marker R or L, on the lateral side of the knee
    detector  that they were read by, whose offset is taken off
    raises    InputError for another number of bits, another side, an unknown detector
    """
    require_whole("bits", bits, 8, 16, "")
    require_choice("detector", detector, tuple(detectors()))
    signal = np.maximum(pixels.astype(np.float32) - np.float32(detectors()[detector].offset_dn), 1.0)
    density = -np.log(signal)
    step = max(1, max(pixels.shape) // 128)
    coarse = enlarge(ndimage.gaussian_filter(block_mean(density, step), 4.0), step, pixels.shape)
    # Part of what is larger than a few centimetres is taken away, so that thigh, knee and calf share one window.
    even = density - 0.45 * coarse + 0.6 * (density - ndimage.gaussian_filter(density, 3.0))
    low, high = np.percentile(even[::4, ::4], [0.5, 99.8])
    scaled = np.clip((even - low) / max(float(high - low), 1e-6), 0, 1.12)
    shown = 225.0 / 255.0 * scaled**2.2
    if side is not None:
        shown = _marked(shown, side)
    most = 2**bits - 1
    return np.clip(np.rint(most * shown), 0, most).astype(np.uint8 if bits == 8 else np.uint16)


def _marked(shown: NDArray[np.float32], side: str) -> NDArray[np.float32]:
    """A view (rows, cols), 0 to 1, within the collimator's shadow, with a side marker in its upper lateral corner."""
    from PIL import Image, ImageDraw, ImageFont  # only where a marker is drawn

    require_choice("side", side, tuple(_MARKERS))
    rows, cols = shown.shape
    smaller = min(rows, cols)
    leaf = max(1, round(_LEAF * smaller))
    field = np.zeros_like(shown)
    field[leaf:-leaf, leaf:-leaf] = 1.0
    field = ndimage.gaussian_filter(field, _PENUMBRA * smaller)
    sheet = Image.new("L", (cols, rows))
    # In a view from the front a right knee has its lateral side at the left.
    inset = leaf + _APART * smaller
    place, anchor = ((inset, inset), "la") if side == "right" else ((cols - inset, inset), "ra")
    ImageDraw.Draw(sheet).text(
        place, _MARKERS[side], fill=255, font=ImageFont.load_default(_MARKER * smaller), anchor=anchor
    )
    return np.maximum(shown * field, np.asarray(sheet, np.float32) / 255.0)
