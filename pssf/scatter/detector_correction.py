"""Correction of the scatter kernel for detectors other than that of the kernel fit.

Scattered photons have less energy than primary photons, and reach the detector obliquely. A detector whose absorption
depends differently on energy and direction than that of the fit records another ratio of scatter to open beam.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..data.imaging.scatter_table import FittedDetector
from ..model.detector import Detector
from ..xray.materials import attenuation_per_mm
from ..xray.resolved_technique import Technique
from ..xray.scintillator_response import compute_deposited_energy
from ..xray.spectrum import compute_beam

# Rest energy of an electron, in keV.
_ELECTRON_KEV = 510.99895
# Thicknesses of muscle for which the transmission is tabulated, in mm; the largest is beyond the fit of the kernel.
_MUSCLE_MM = np.concatenate((np.arange(0.0, 400.0, 5.0), np.geomspace(400.0, 4000.0, 20)))


def convert_to_fitted_detector(transmission: Array, technique: Technique) -> Array:
    """Convert the transmission that a detector measures to that which the detector of the kernel fit would measure.

    Parameters
    ----------
    transmission : (rows, cols) float64 array, dimensionless
        Primary signal divided by the open-beam signal, from 0 (exclusive) to 1.
    technique : Technique
        Resolved protocol.

    Returns
    -------
    (rows, cols) float64 array
        Transmission for the detector of the fit. Both detectors see the same thickness of muscle.
    """
    fitted = make_fitted_detector(technique)
    if _responds_as(technique.detector, fitted):
        return transmission
    own, other = (_log_transmissions(detector, technique) for detector in (technique.detector, fitted))
    # The logarithms decrease with thickness, and `numpy.interp` needs increasing values.
    return np.asarray(np.exp(np.interp(np.log(transmission), own[::-1], other[::-1])))


def compute_detector_factor(log_transmission: float, gap_mm: float, technique: Technique) -> float:
    """Compute the ratio of scatter to open beam, relative to that of the detector of the kernel fit.

    Parameters
    ----------
    log_transmission : float
        Mean natural logarithm of the primary transmission for the detector of the fit.
    gap_mm : float
        Distance from the exit surface of the object to the detector, in mm.
    technique : Technique
        Resolved protocol.

    Returns
    -------
    float
        Factor for the scatter of the kernel; 1 for the detector of the fit.

    Notes
    -----
    The spectrum of the scatter is that of the primary behind a part of the object, after one Compton scattering by a
    fixed angle. Its photons pass the scintillator on a path that is longer than its thickness, the less so the larger
    the gap. The constants are in ``data/scatter.toml``, with their error.
    """
    constants, fitted = technique.kernel.fitted_detector, make_fitted_detector(technique)
    if _responds_as(technique.detector, fitted):
        return 1.0
    beam = compute_beam(technique)
    thickness_mm = np.interp(-log_transmission, -_log_transmissions(fitted, technique), _MUSCLE_MM)
    muscle_per_mm = attenuation_per_mm(technique.material("muscle"), beam.energies_kev)
    photons = beam.photons_per_mm2 * np.exp(-muscle_per_mm * thickness_mm * constants.muscle_share)
    kev = beam.energies_kev / (1 + beam.energies_kev / _ELECTRON_KEV * constants.one_minus_cosine)
    secant = 1 + constants.oblique_excess * np.exp(-gap_mm / constants.oblique_gap_mm)
    own, other = (
        (photons @ compute_deposited_energy(detector, kev, secant)[0])
        / (beam.photons_per_mm2 @ compute_deposited_energy(detector, beam.energies_kev)[0])
        for detector in (technique.detector, fitted)
    )
    return float(own / other)


def make_fitted_detector(technique: Technique) -> Detector:
    """Make the detector for which the kernel was fitted.

    Parameters
    ----------
    technique : Technique
        Resolved protocol, whose kernel names the detector.

    Returns
    -------
    Detector
        Detector of the protocol with the scintillator of the fit, which absorbs the entire energy of each photon that
        interacts.
    """
    fitted: FittedDetector = technique.kernel.fitted_detector
    return replace(
        technique.detector,
        absorption="layer",
        formula=fitted.formula,
        density_g_per_cm3=fitted.density_g_per_cm3,
        packing=fitted.packing,
        thickness_mm=fitted.thickness_mm,
        cover=(),
        escape="none",
    )


def use_fitted_detector(technique: Technique) -> Technique:
    """Replace the detector of a technique by that of the kernel fit.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    Technique
        Technique with the detector of `make_fitted_detector`.
    """
    return replace(technique, detector=make_fitted_detector(technique))


def _responds_as(detector: Detector, fitted: Detector) -> bool:
    """Return whether a detector absorbs the same energy as the detector of the fit."""
    first, second = ((one.absorption, one.formula, one.mg_per_cm2, one.cover, one.escape) for one in (detector, fitted))
    return first == second


def _log_transmissions(detector: Detector, technique: Technique) -> NDArray[np.float64]:
    """Compute the logarithm of the transmission (thicknesses,) of muscle for a detector."""
    beam = compute_beam(replace(technique, detector=detector))
    mu = attenuation_per_mm(technique.material("muscle"), beam.energies_kev)
    signal = beam.photons_per_mm2 * beam.signal_kev
    # The lowest attenuation is factored out, so that the logarithm stays finite behind metres of muscle.
    least = float(mu[signal > 0].min())
    passed = np.exp(-(mu - least) * _MUSCLE_MM[:, None]) @ signal / signal.sum()
    return np.asarray(np.log(passed) - least * _MUSCLE_MM)
