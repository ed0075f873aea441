"""Detector and display: blur, noise, readout, and grey levels for presentation.

detector_blur       blur by focal spot and detector, in the frequency domain
quantum_noise       quantum (Poisson) noise
panel_readout       gain, readout noise, offset and conversion to 16-bit pixel values
side_marker         lead side marker, or side marker drawn into the image
laplacian_pyramid   decomposition of an image into detail layers by size
display_processing  conversion of the signal to grey levels: log, processed, film
display_rendering   images for presentation with 8 to 16 bits
"""

from .display_rendering import (
    DISPLAY_PROCESSING,
    format_processing,
    render_for_display,
    resolve_processing,
)

__all__ = ["DISPLAY_PROCESSING", "format_processing", "render_for_display", "resolve_processing"]
