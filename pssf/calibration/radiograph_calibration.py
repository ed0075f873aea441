"""Estimate the gain and the NTF of a detector from radiographs of patients, without a phantom."""

from dataclasses import replace

import numpy as np

from .calibration_state import CalibrationState, describe_open_beam, describe_readout, set_readout
from .estimate import Estimate, hold_value, make_estimate
from .noise_spectrum import FlatSpectra
from .radiograph_noise import RadiographNoise, measure_radiograph_noise


def calibrate_radiographs(work: CalibrationState, readout_dn: Estimate | None) -> tuple[FlatSpectra, float]:
    """Estimate NTF, gain and mAs from radiographs.

    Parameters
    ----------
    work : CalibrationState
        Radiographs, protocol and values so far; the estimates are added.
    readout_dn : Estimate or None
        Readout noise of dark images, in DN.

    Returns
    -------
    spectra : FlatSpectra
        Noise power spectra of homogeneous regions.
    noise_per_signal_dn : float
        Variance of a pixel divided by its signal at frequency 0 in the open beam, in DN.
    """
    work.hold("images contain no electrons, only DN", "electrons_per_kev")
    work.hold("radiographs determine only the product of gain and 1 / swank", "swank")
    work.hold("radiographs do not separate it from anatomy", "gain_variation")
    start = work.technique.detector
    noise = measure_radiograph_noise(
        work.images.radiographs,
        replace(work.technique, detector=work.detector),
        describe_readout(readout_dn),
        (start.ntf_f0_per_mm, start.ntf_power),
    )
    fit, errors = noise.fit, np.sqrt(np.diag(noise.fit.covariance))
    where = f"{noise.regions} homogeneous regions"
    work.changes["ntf"] = None
    work.set("ntf_f0_per_mm", make_estimate(fit.ntf_f0_per_mm, fit.ntf_f0_per_mm * float(errors[1]), note=where))
    work.set("ntf_power", make_estimate(fit.ntf_power, fit.ntf_power * float(errors[2]), note=where))
    signal_kev, quantum_kev, _ = describe_open_beam(work, None)
    gain = start.swank * fit.noise_per_signal_dn / quantum_kev
    per_dn_mm2 = start.electrons_per_kev / (gain * work.images.pixel_mm**2)
    note = "for the Swank factor and the beam of the protocol"
    work.set("electrons_per_dn_mm2", make_estimate(per_dn_mm2, per_dn_mm2 * float(errors[0]), note=note))
    set_readout(work, fit.readout_dn, float(errors[3]), float(errors[0]))
    _set_exposure(work, noise, gain * signal_kev, float(errors[0]))
    return noise.spectra, fit.noise_per_signal_dn


def _set_exposure(work: CalibrationState, noise: RadiographNoise, signal_per_mas: float, error: float) -> None:
    """Set the saturation, and the mAs from the signal of the open beam and its relative error, if it is visible."""
    if noise.saturation_dn is not None:
        top = noise.saturation_dn
        work.set("saturation_dn", Estimate(value=top, low=top, high=top))
    if noise.open_dn is None:
        reason = "the open beam is saturated or not visible"
        work.estimates["mas"] = hold_value(work.technique.protocol.mas, reason)
    else:
        mas = noise.open_dn / signal_per_mas
        note = "for the tube output and the scintillator of the protocol; brightest regions taken for the open beam"
        work.estimates["mas"] = make_estimate(mas, mas * error, note=note)
