"""Detector and display: blur, noise, readout, and grey levels for presentation.

detector_blur       blur by focal spot and panel, in frequency space
quantum_noise       quantum (Poisson) noise
panel_readout       gain, readout noise, offset and 16-bit numbers
side_marker         side marker of lead, or drawn
laplacian_pyramid   decomposition of an image into details by size
display_processing  grey levels: log, processed, film
display_rendering   image for presentation with 8 to 16 bits
"""

from .display_rendering import (
    DISPLAY_PROCESSING,
    format_processing,
    render_for_display,
    resolve_processing,
)

__all__ = ["DISPLAY_PROCESSING", "format_processing", "render_for_display", "resolve_processing"]
