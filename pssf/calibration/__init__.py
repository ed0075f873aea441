"""Calibrate a detector: estimate its properties and its beam from dark images, flat fields, an edge and a step wedge.

read_calibration_images  files                -> images of a calibration
calibrate_detector       images and protocol  -> detector, protocol and estimates with intervals
write_calibration        calibration          -> detector file, protocol file, table and page

calibration_images   images, steps and settings
dark_noise           offset and readout noise
signal_response      signal per mAs, response curve and saturation
noise_spectrum       quantum noise, NTF and gain variation
edge_blur            MTF
beam_fit             tube voltage, filtration and mass of scintillator
estimate             value with confidence interval
calibration_run      all steps in order
calibration_reader   reading of images and steps
calibration_files    output files
calibration_page     page with plots
"""

from .calibration_files import write_calibration
from .calibration_images import CalibrationImages, Step, Wedge
from .calibration_reader import read_calibration_images
from .calibration_run import Calibration, calibrate_detector
from .estimate import Estimate

__all__ = [
    "Calibration",
    "CalibrationImages",
    "Estimate",
    "Step",
    "Wedge",
    "calibrate_detector",
    "read_calibration_images",
    "write_calibration",
]
