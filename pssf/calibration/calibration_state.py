"""Collect the values of a calibration, and describe the open beam that they belong to."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..core.checks import Array
from ..model.detector import Detector
from ..xray.resolved_technique import Technique
from ..xray.response_of_mass import set_mass_per_area
from .beam_fit import BeamFit, deposit_energy, filtered_spectrum
from .calibration_images import CalibrationImages
from .estimate import Estimate, hold_value, make_estimate

# Smallest relative standard error of the readout noise from dark images.
_LEAST_ERROR = 1e-4
# Largest relative standard error at which the readout noise is determined without dark images.
_READOUT_ERROR = 0.1
# Step of the logarithm of a beam parameter for numerical derivatives.
_STEP = 0.005


@dataclass
class CalibrationState:
    """Values that the steps of a calibration collect.

    Attributes
    ----------
    images : CalibrationImages
        Images of the detector.
    technique : Technique
        Protocol and starting detector.
    estimates : dict of str to Estimate
        Estimated and held values.
    changes : dict of str to value
        Fields of the detector that differ from the starting detector.
    """

    images: CalibrationImages
    technique: Technique
    estimates: dict[str, Estimate] = field(default_factory=dict)
    changes: dict[str, Any] = field(default_factory=dict)

    @property
    def detector(self) -> Detector:
        """Starting detector with the values that are known so far."""
        return replace(self.technique.detector, **self.changes)

    def set(self, name: str, estimate: Estimate) -> None:
        """Store the estimate of a field of the detector and use its value.

        Parameters
        ----------
        name : str
            Field of the detector.
        estimate : Estimate
            Estimated or held value.
        """
        self.estimates[name] = estimate
        if estimate.source == "measured":
            self.changes[name] = estimate.value

    def hold(self, note: str, *names: str) -> None:
        """Hold fields of the detector at their starting values.

        Parameters
        ----------
        note : str
            Reason.
        *names : str
            Fields of the detector.
        """
        for name in names:
            self.set(name, hold_value(getattr(self.technique.detector, name), note))


def describe_readout(readout_dn: Estimate | None) -> tuple[float, float] | None:
    """Describe the readout noise of dark images for a fit of noise power.

    Parameters
    ----------
    readout_dn : Estimate or None
        Readout noise, in DN; None without dark images.

    Returns
    -------
    (float, float) or None
        Readout noise in DN and its relative standard error.
    """
    return None if readout_dn is None else (readout_dn.value, max(readout_dn.relative_error, _LEAST_ERROR))


def set_readout(work: CalibrationState, readout_dn: float, error: float, gain_error: float) -> None:
    """Set the readout noise in electrons, or hold it if exposed images alone do not determine it.

    Parameters
    ----------
    work : CalibrationState
        Values so far, with the gain.
    readout_dn : float
        Readout noise, in DN.
    error : float
        Relative standard error of the readout noise.
    gain_error : float
        Relative standard error of the gain.
    """
    if not work.images.darks and error > _READOUT_ERROR:
        work.hold("no dark images, and too small in the other images", "readout_electrons")
        return
    electrons = readout_dn * work.changes["electrons_per_dn_mm2"] * work.images.pixel_mm**2
    work.set("readout_electrons", make_estimate(electrons, electrons * float(np.hypot(error, gain_error))))


def describe_open_beam(work: CalibrationState, beam: BeamFit | None) -> tuple[float, float, Array]:
    """Describe the open beam at the centre of the detector, behind the grid of the protocol.

    Parameters
    ----------
    work : CalibrationState
        Protocol, and detector so far.
    beam : BeamFit or None
        Measured beam; None for that of the protocol.

    Returns
    -------
    signal_kev : float
        Absorbed energy per pixel and mAs, in keV.
    quantum_kev : float
        Variance of the absorbed energy divided by its mean, in keV.
    slopes : (2, 3) float64 array
        Derivatives of the logarithms of both with respect to the logarithms of the beam parameters.
    """
    protocol, detector = work.technique.protocol, work.detector
    values, technique = np.log([1.0, protocol.filtration_mm_al, detector.mg_per_cm2]), work.technique
    if beam is not None:
        technique = technique.replace_protocol(filtration_mm_al=beam.filtration_mm_al)
        values = np.log([beam.kv_scale, beam.filtration_mm_al, beam.mg_per_cm2])
    area = protocol.pixel_mm**2 * (1000.0 / protocol.sdd_mm) ** 2

    def describe(logs: Array) -> Array:
        kv_scale, filtration, mass = (float(value) for value in np.exp(logs))
        energies, photons = filtered_spectrum(protocol.tube_kv * kv_scale, filtration, technique)
        layer = detector if detector.absorption == "all" else set_mass_per_area(detector, mass)
        first, second = deposit_energy(layer, energies, None if detector.absorption == "all" else detector)
        return np.log([photons @ first * area, (photons @ second) / (photons @ first)])

    middle = describe(values)
    slopes = [(describe(values + _STEP * step) - describe(values - _STEP * step)) / (2 * _STEP) for step in np.eye(3)]
    return float(np.exp(middle[0])), float(np.exp(middle[1])), np.array(slopes).T
