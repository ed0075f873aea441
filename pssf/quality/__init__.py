"""Image quality of a protocol: measure beam, detector and exposure as a medical physicist would, beside references.

measure_quality  protocol       -> table of quantities with references, and the curves behind them
write_quality    QualityResult  -> CSV files, and a figure (extra ``study``)

beam_quality         half-value layers, air kerma, photons
detector_quality     MTF, NPS, DQE, photon transfer
exposure_index       exposure index, scatter, dynamic range, noise
quality_measurement  all of these, beside references
quality_figure       figure of the curves
quality_files        tables and figure on disk
"""

from .quality_files import write_quality
from .quality_measurement import QualityResult, measure_quality

__all__ = ["QualityResult", "measure_quality", "write_quality"]
