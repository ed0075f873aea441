"""Estimate the properties of a detector and of its beam from images of flat fields, edges and wedges."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..detector.detector_blur import apply_panel_blur, transform_to_frequency, transform_to_image
from ..detector.panel_readout import linearise_pixels
from ..model.detector import Detector
from ..model.protocol import Protocol
from ..xray.primary_beam import compute_primary
from ..xray.resolved_technique import Technique, resolve_technique
from ..xray.response_of_mass import set_mass_per_area
from .beam_fit import PARAMETERS, BeamFit, WedgeSignals, fit_beam, measure_wedge
from .calibration_images import CalibrationImages
from .calibration_state import CalibrationState, describe_open_beam, describe_readout, set_readout
from .dark_noise import estimate_dark_noise
from .edge_blur import EdgeMtf, fit_mtf, make_mtf_table, measure_edge
from .estimate import Estimate, hold_value, make_estimate
from .noise_spectrum import FlatSpectra, fit_noise, measure_flat_spectra
from .radiograph_calibration import calibrate_radiographs
from .signal_response import SignalResponse, measure_signal_response

# Largest deviation of the MTF from its equation, absolute and in standard errors, above which a table replaces it.
_MTF_DEVIATION, _MTF_DEVIATION_ERRORS = 0.01, 5.0


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Result of a calibration.

    Attributes
    ----------
    detector : Detector
        Detector with the measured properties.
    protocol : Protocol
        Protocol with the measured tube voltage and filtration, the pixel pitch of the images, and the detector.
    estimates : mapping of str to Estimate
        Measured and held values with their intervals, keyed by field of `Detector` or `Protocol`.
    response : SignalResponse or None
        Signal of the flat fields.
    spectra : FlatSpectra or None
        Noise power spectra of the flat fields, or of homogeneous regions of radiographs.
    noise_per_signal_dn : float
        Variance of a pixel divided by its signal at frequency 0 in the open beam, in DN; 0 if it was not measured.
    edge : EdgeMtf or None
        Measured MTF.
    wedges : tuple of WedgeSignals
        Signals behind the wedge.
    beam : BeamFit or None
        Beam that reproduces the signals behind the wedge.
    """

    detector: Detector
    protocol: Protocol
    estimates: Mapping[str, Estimate]
    response: SignalResponse | None = None
    spectra: FlatSpectra | None = None
    noise_per_signal_dn: float = 0.0
    edge: EdgeMtf | None = None
    wedges: tuple[WedgeSignals, ...] = ()
    beam: BeamFit | None = None


def calibrate_detector(images: CalibrationImages, protocol: Protocol, name: str = "calibrated") -> Calibration:
    """Estimate the properties of a detector and of its beam from images.

    Parameters
    ----------
    images : CalibrationImages
        Dark images, flat fields, edge and wedge; any of them can be missing.
    protocol : Protocol
        Geometry, nominal tube voltage and filtration of the flat fields, and starting detector. What the images do not
        determine is held at the values of this protocol and detector.
    name : str, default "calibrated"
        Name of the detector.

    Returns
    -------
    Calibration
        Detector, protocol, and estimates with 95 % intervals.

    Raises
    ------
    InputError
        If an image does not show what it should, for example no straight edge.

    Notes
    -----
    Images contain electrons only as numbers of DN, so `electrons_per_kev` is held; it sets the scale of the other
    constants in electrons. Without a wedge, the mass of scintillator, tube voltage and filtration are held. The Swank
    factor follows from the noise and from the output of the tube, which is that of the spectrum model.

    Radiographs of patients determine the NTF and the noise per signal, and with the Swank factor of the starting
    detector the gain and the mAs.
    """
    work = CalibrationState(images, resolve_technique(replace(protocol, pixel_mm=images.pixel_mm)))
    readout_dn = _calibrate_dark(work)
    response = _calibrate_signal(work)
    spectra = _measure_spectra(work, response)
    edge = _calibrate_edge(work)
    wedges, beam = _calibrate_beam(work)
    if images.radiographs:
        spectra, noise_per_signal = calibrate_radiographs(work, readout_dn)
    else:
        noise_per_signal = _calibrate_gain(work, readout_dn, response, spectra, beam)
    detector = replace(work.detector, name=name)
    tube_kv, filtration = (work.estimates[key].value for key in ("tube_kv", "filtration_mm_al"))
    mas = work.estimates["mas"].value if images.radiographs else protocol.mas
    return Calibration(
        detector=detector,
        protocol=replace(
            protocol,
            pixel_mm=images.pixel_mm,
            detector=detector,
            tube_kv=tube_kv,
            filtration_mm_al=filtration,
            mas=mas,
        ),
        estimates=work.estimates,
        response=response,
        spectra=spectra,
        noise_per_signal_dn=noise_per_signal,
        edge=edge,
        wedges=wedges,
        beam=beam,
    )


def _calibrate_dark(work: CalibrationState) -> Estimate | None:
    """Estimate the offset; return the readout noise in DN, which becomes electrons when the gain is known."""
    if not work.images.darks:
        work.hold("no dark images", "offset_dn")
        return None
    dark = estimate_dark_noise(work.images.darks)
    work.set("offset_dn", dark.offset_dn)
    return dark.noise_dn


def _calibrate_signal(work: CalibrationState) -> SignalResponse | None:
    """Measure signal per mAs, response curve and saturation."""
    images = work.images
    if not images.flats:
        return None
    beam = _relative_open_beam(work, images.flats[0].shape)
    response = measure_signal_response(images.flats, images.flat_mas, work.detector.offset_dn, beam)
    work.changes["response"] = response.response
    if not all(response.used):
        work.set(
            "saturation_dn",
            Estimate(value=response.saturation_dn, low=response.saturation_dn, high=response.saturation_dn),
        )
    return response


def _measure_spectra(work: CalibrationState, response: SignalResponse | None) -> FlatSpectra | None:
    """Measure the noise power spectra of the flat fields below saturation."""
    if response is None:
        return None
    flats = [
        linearise_pixels(flat, work.detector).astype(np.float64)
        for flat, used in zip(work.images.flats, response.used, strict=True)
        if used
    ]
    return measure_flat_spectra(flats, work.images.pixel_mm)


def _calibrate_edge(work: CalibrationState) -> EdgeMtf | None:
    """Estimate the MTF: the equation, or a table if the equation does not fit."""
    images = work.images
    if images.edge is None:
        work.hold("no image of an edge", "mtf_f0_per_mm", "mtf_power")
        return None
    signal = linearise_pixels(images.edge, work.detector) / _relative_open_beam(work, images.edge.shape)
    edge = measure_edge(signal.astype(np.float64), images.pixel_mm)
    start = work.technique.detector
    fit = fit_mtf(edge, (start.mtf_f0_per_mm, start.mtf_power))
    errors = np.sqrt(np.diag(fit.covariance))
    work.changes.update(mtf=None, glare_fraction=0.0)
    work.set("mtf_f0_per_mm", make_estimate(fit.f0_per_mm, fit.f0_per_mm * float(errors[0])))
    work.set("mtf_power", make_estimate(fit.power, fit.power * float(errors[1])))
    if fit.deviation > _MTF_DEVIATION and fit.deviation_errors > _MTF_DEVIATION_ERRORS:
        work.changes["mtf"] = make_mtf_table(edge)
    return edge


def _calibrate_beam(work: CalibrationState) -> tuple[tuple[WedgeSignals, ...], BeamFit | None]:
    """Estimate tube voltage, filtration and mass of scintillator."""
    images, protocol = work.images, work.technique.protocol
    if not images.wedges:
        work.hold("no images of a wedge", "thickness_mm")
        for name in ("tube_kv", "filtration_mm_al"):
            work.estimates[name] = hold_value(getattr(protocol, name), "no images of a wedge")
        return (), None
    wedges = []
    for wedge in images.wedges:
        signal = _remove_blur(linearise_pixels(wedge.image, work.detector), work)
        view = _resize(work.technique, wedge.image.shape).view
        beam = _relative_open_beam(work, wedge.image.shape)
        wedges.append(measure_wedge(signal, beam, images.steps, view, wedge.tube_kv))
    fit = fit_beam(wedges, work.technique, images.step_material)
    errors = np.sqrt(np.diag(fit.covariance))
    nominal = (protocol.tube_kv, 1.0, 1.0)
    values = (fit.kv_scale, fit.filtration_mm_al, fit.mg_per_cm2)
    for name, unit, value, error in zip(PARAMETERS, nominal, values, errors, strict=True):
        if name in fit.held:
            known = hold_value(value * unit, "not determined by the wedge images")
        else:
            known = make_estimate(value * unit, value * unit * float(error))
        if name == "mg_per_cm2":
            thickness = set_mass_per_area(work.technique.detector, 1.0).thickness_mm
            work.set("thickness_mm", known.scale(thickness))
        else:
            work.estimates[name] = known
    return tuple(wedges), fit


def _remove_blur(signal: NDArray[np.float32], work: CalibrationState) -> Array:
    """Remove most of the light that the detector spreads from bright to dark steps (rows, cols), in DN.

    The difference between the image and the image blurred once more is added (van Cittert 1931, one iteration). The
    mean over a region then contains the spread light only in second order. Noise of high frequencies has no effect on
    the mean.
    """
    values = transform_to_frequency(signal)
    apply_panel_blur(values, signal.shape, work.images.pixel_mm, work.detector)
    return np.asarray(2.0 * signal - transform_to_image(values, signal.shape), np.float64)


def _calibrate_gain(
    work: CalibrationState,
    readout_dn: Estimate | None,
    response: SignalResponse | None,
    spectra: FlatSpectra | None,
    beam: BeamFit | None,
) -> float:
    """Estimate gain, noise and Swank factor, for which the beam must be known; return the noise per signal in DN."""
    work.hold("images contain no electrons, only DN", "electrons_per_kev")
    if response is None or spectra is None:
        work.hold("no flat fields", "electrons_per_dn_mm2", "swank", "ntf_f0_per_mm", "ntf_power", "gain_variation")
        work.hold("no flat fields" if work.images.darks else "no dark images", "readout_electrons")
        return 0.0
    start = work.technique.detector
    fit = fit_noise(spectra, describe_readout(readout_dn), (start.ntf_f0_per_mm, start.ntf_power))
    errors = np.sqrt(np.diag(fit.covariance))
    work.changes["ntf"] = None
    work.set("ntf_f0_per_mm", make_estimate(fit.ntf_f0_per_mm, fit.ntf_f0_per_mm * float(errors[1])))
    work.set("ntf_power", make_estimate(fit.ntf_power, fit.ntf_power * float(errors[2])))
    work.changes["gain_variation"] = fit.gain_variation
    covariance = np.zeros((3, 3)) if beam is None else beam.covariance
    signal_kev, quantum_kev, slopes = describe_open_beam(work, beam)
    slope_error = response.signal_per_mas.relative_error
    gain_error = float(np.sqrt(slope_error**2 + slopes[0] @ covariance @ slopes[0]))
    gain = response.signal_per_mas.value / signal_kev
    note = "" if beam is not None else "for the beam of the protocol"
    per_dn_mm2 = start.electrons_per_kev / (gain * work.images.pixel_mm**2)
    work.set("electrons_per_dn_mm2", make_estimate(per_dn_mm2, per_dn_mm2 * gain_error, note=note))
    set_readout(work, fit.readout_dn, float(errors[3]), gain_error)
    swank = gain * quantum_kev / fit.noise_per_signal_dn
    towards = slopes[1] - slopes[0]
    swank_error = float(np.sqrt(slope_error**2 + errors[0] ** 2 + towards @ covariance @ towards))
    _set_swank(work, swank, swank_error)
    return fit.noise_per_signal_dn


def _set_swank(work: CalibrationState, swank: float, error: float) -> None:
    """Set the Swank factor, or limit it to 1 if the noise is less than that of the photons of the spectrum model."""
    if swank > 1.0:
        note = f"the noise gives {swank:.3f}: the tube has a greater output than the spectrum model"
        work.estimates["swank"] = hold_value(1.0, note)
        work.changes["swank"] = 1.0
    else:
        work.set("swank", make_estimate(swank, swank * error, note="for the tube output of the spectrum model"))


def _relative_open_beam(work: CalibrationState, shape: tuple[int, int]) -> Array:
    """Compute the signal of the open beam relative to the centre of the detector (rows, cols)."""
    bare = _resize(work.technique, shape).replace_protocol(
        focal_spot_mm=0.0, subpixels=1, field_width_mm=0.0, field_height_mm=0.0
    )
    kev = compute_primary({}, bare).kev
    return np.asarray(kev / float(kev[shape[0] // 2, shape[1] // 2]), np.float64)


def _resize(technique: Technique, shape: tuple[int, int]) -> Technique:
    """Make a technique whose detector has the number of rows and columns of an image."""
    return technique.replace_protocol(rows=shape[0], cols=shape[1])
