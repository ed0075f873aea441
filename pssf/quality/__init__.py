"""Measure the image quality of a protocol: beam, detector and exposure, with reference values.

measure_quality  Protocol       -> table of quantities with reference values, and measured curves
write_quality    QualityResult  -> CSV files, and a figure (``study`` extra)

beam_quality         half-value layers, air kerma, photons
detector_quality     MTF, NPS, DQE, photon transfer
exposure_index       exposure index, scatter, dynamic range, noise
quality_measurement  all image quality quantities of a protocol, with reference values
quality_figure       figure of measured and model curves
quality_files        output files with tables and figure
"""

from .quality_files import write_quality
from .quality_measurement import QualityResult, measure_quality

__all__ = ["QualityResult", "measure_quality", "write_quality"]
