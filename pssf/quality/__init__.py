"""Measure the image quality of a protocol or of images: beam, detector and exposure, with reference values.

measure_quality               Protocol       -> table of quantities with reference values, and measured curves
write_quality                 QualityResult  -> CSV files, and a figure (``study`` extra)
measure_edge_mtf              image of an edge             -> MTF
measure_flat_nnps             flat fields                  -> normalised noise power spectrum
measure_image_dqe             MTF, NNPS and air kerma      -> DQE
measure_image_exposure_index  pixels and signal per kerma  -> exposure index

beam_quality         half-value layers, air kerma, photons
image_quality        MTF, NNPS, DQE and exposure index of images
detector_quality     MTF, NPS, DQE, photon transfer
exposure_index       exposure index, scatter, dynamic range, noise
quality_measurement  all image quality quantities of a protocol, with reference values
quality_figure       figure of measured and model curves
quality_files        output files with tables and figure
"""

from .image_quality import (
    measure_edge_mtf,
    measure_flat_nnps,
    measure_image_dqe,
    measure_image_exposure_index,
)
from .quality_files import write_quality
from .quality_measurement import QualityResult, measure_quality

__all__ = [
    "QualityResult",
    "measure_edge_mtf",
    "measure_flat_nnps",
    "measure_image_dqe",
    "measure_image_exposure_index",
    "measure_quality",
    "write_quality",
]
