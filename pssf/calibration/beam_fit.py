"""Estimate tube voltage, filtration and scintillator mass from images of a step wedge at one or more tube voltages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import OptimizeResult, least_squares

from ..core.checks import Array, InputError
from ..geometry.view import View
from ..model.detector import Detector
from ..scatter.antiscatter_grid import compute_primary_transmission, make_grid
from ..xray.materials import Material, attenuation_per_mm, parse_compound
from ..xray.resolved_technique import Technique
from ..xray.response_of_mass import NODES_MG_PER_CM2, interpolate_response, set_mass_per_area
from ..xray.scintillator_response import compute_deposited_energy
from ..xray.spectrum import compute_filter_transmission, compute_tube_spectrum, split_at_detector_edges
from .calibration_images import Step
from .estimate import compute_covariance

# Side length of the blocks of a region whose scatter gives its standard error, in pixels.
_BLOCK_PX = 8
# Relative error of a modelled signal, from the simulated response of the scintillator and the energy quadrature.
_MODEL_ERROR = 2e-4
# Largest relative standard error at which a parameter counts as measured. With a larger one it is held.
_LARGEST_ERRORS = {"tube_kv": 0.03, "filtration_mm_al": 0.3, "mg_per_cm2": 0.3}
# Parameters of the fit, in this order.
PARAMETERS = tuple(_LARGEST_ERRORS)
# Index of the mass of scintillator among the parameters.
_MASS = PARAMETERS.index("mg_per_cm2")
# Relative differences of mass and tube voltage from the nodes of a model up to which interpolation adds no error.
_NEAR_MASS = 0.1
_NEAR_KV = 0.01
# Range of the fitted relative tube voltage.
_KV_SCALE = (0.85, 1.15)
# Range of the fitted filtration, in mm aluminium.
_FILTRATION_MM_AL = (0.3, 40.0)
# Relative step of the numerical derivatives.
_STEP = 0.005
# Relative tube voltages at which spectra are computed for the first fit (Chebyshev nodes of the range).
_FIRST_NODES = np.mean(_KV_SCALE) - np.ptp(_KV_SCALE) / 2 * np.cos(np.pi * (np.arange(7) + 0.5) / 7)
# Material of the filtration.
_ALUMINIUM = parse_compound("Al@2.70")


@dataclass(frozen=True, kw_only=True)
class WedgeSignals:
    """Signals behind the steps of a wedge at one tube voltage.

    Attributes
    ----------
    tube_kv : float
        Nominal tube voltage, in kV.
    path_mm : (steps,) array
        Path length of the rays in each step, in mm.
    log_signal : (steps,) array
        Natural logarithm of the signal behind each step, relative to the open beam at the same place plus an unknown
        constant.
    error : (steps,) array
        Standard error of `log_signal`.
    """

    tube_kv: float
    path_mm: Array
    log_signal: Array
    error: Array


@dataclass(frozen=True, kw_only=True)
class BeamFit:
    """Beam and scintillator that reproduce the signals behind a wedge.

    Attributes
    ----------
    kv_scale : float
        Tube voltage divided by its nominal value.
    filtration_mm_al : float
        Total filtration, in mm aluminium.
    mg_per_cm2 : float
        Mass of scintillator per area, in mg/cm2.
    held : tuple of str
        Names in `PARAMETERS` that the wedge does not determine, and that are held.
    covariance : (3, 3) array
        Covariance of the logarithms of the parameters; 0 for parameters that are held.
    residuals : (wedges, steps) array
        Measured minus fitted logarithm of the signal.
    errors : (wedges, steps) array
        Standard errors of the residuals.
    reduced_chi2 : float
        Mean squared residual divided by its expected value.
    """

    kv_scale: float
    filtration_mm_al: float
    mg_per_cm2: float
    held: tuple[str, ...]
    covariance: Array
    residuals: Array
    errors: Array
    reduced_chi2: float


class _Beam(NamedTuple):
    """Beam of a wedge image at one tube voltage.

    `energies_kev` (bins,) are in keV, `photons` (bins,) and `aluminium_per_mm` (bins,) are those behind the filtration
    of the technique and the attenuation of the filter in 1/mm, and `passed` (steps, bins) is the transmission.
    """

    energies_kev: Array
    photons: Array
    aluminium_per_mm: Array
    passed: Array


class _Model(NamedTuple):
    """Beams from which the signals are interpolated.

    `kv_nodes` (nodes,) are relative tube voltages, `filtration_mm_al` is the filtration of the spectra, and `beams` are
    the beams of each wedge image at the nodes. `anchor` is a detector with a similar mass of scintillator, whose
    response is simulated.
    """

    kv_nodes: Array
    filtration_mm_al: float
    beams: list[list[_Beam]]
    anchor: Detector | None


def measure_wedge(signal: Array, open_beam: Array, steps: Sequence[Step], view: View, tube_kv: float) -> WedgeSignals:
    """Measure the signals behind the steps of a wedge.

    Parameters
    ----------
    signal : (rows, cols) float64 array, DN
        Linear image of the wedge without offset.
    open_beam : (rows, cols) array, any unit
        Relative signal of the open beam.
    steps : sequence of Step
        Steps and their regions.
    view : View
        Source and detector, for the obliquity of the rays.
    tube_kv : float
        Nominal tube voltage, in kV.

    Returns
    -------
    WedgeSignals
        Mean signals, with standard errors from the scatter of blocks of 8 x 8 pixels.

    Raises
    ------
    InputError
        If the mean signal of a region is not positive.
    """
    first = np.asarray(view.first_pixel_mm)
    rows = []
    for step in steps:
        values = step.cut(signal) / step.cut(open_beam)
        mean, error = _mean_of_blocks(values)
        if not mean > 0:
            raise InputError(f"signal behind the step of {step.thickness_mm:g} mm must be above 0, got {mean:g} DN")
        row, col = (step.top + step.bottom - 1) / 2, (step.left + step.right - 1) / 2
        ray = first + np.array([col * view.pixel_mm, 0.0, -row * view.pixel_mm]) - np.asarray(view.source_mm)
        relative = np.hypot(error / mean, _MODEL_ERROR)
        rows.append((step.thickness_mm * float(np.linalg.norm(ray) / ray[1]), np.log(mean), relative))
    path, log_signal, error = np.array(rows).T
    return WedgeSignals(tube_kv=tube_kv, path_mm=path, log_signal=log_signal, error=error)


def _mean_of_blocks(values: Array) -> tuple[float, float]:
    """Compute the mean of a region and its standard error, which includes the correlation of neighbouring pixels."""
    rows, cols = (max(1, side // _BLOCK_PX) for side in values.shape)
    parts = [part.mean() for band in np.array_split(values, rows) for part in np.array_split(band, cols, axis=1)]
    if len(parts) < 4:
        return float(values.mean()), float(values.std() / np.sqrt(values.size) * _BLOCK_PX / 2)
    return float(values.mean()), float(np.std(parts, ddof=1) / np.sqrt(len(parts)))


def fit_beam(wedges: Sequence[WedgeSignals], technique: Technique, material: str) -> BeamFit:
    """Fit tube voltage, filtration and scintillator mass to the signals behind a wedge.

    Parameters
    ----------
    wedges : sequence of WedgeSignals
        Signals at one or more tube voltages. All tube voltages have the same relative error.
    technique : Technique
        Technique with the starting values, and the formula and cover of the scintillator.
    material : str
        Material of the wedge.

    Returns
    -------
    BeamFit
        Fitted values. A parameter whose standard error would be too large is held at its starting value.
    """
    start = np.log([1.0, technique.protocol.filtration_mm_al, technique.detector.mg_per_cm2])
    free, known = list(range(len(PARAMETERS))), technique.material(material)
    if technique.detector.absorption == "all":
        free.remove(_MASS)
    beams = [_make_beams(wedge, technique, known, _FIRST_NODES) for wedge in wedges]
    model = _Model(_FIRST_NODES, technique.protocol.filtration_mm_al, beams, None)
    while True:
        optimum, covariance = _fit_free(wedges, model, technique, start, free)
        errors = {i: float(np.sqrt(covariance[n, n])) / _LARGEST_ERRORS[PARAMETERS[i]] for n, i in enumerate(free)}
        worst = max(errors, key=lambda i: errors[i], default=-1)
        values = _merge_values(start, optimum.x, free)
        if free and errors[worst] > 1.0:
            free.remove(worst)
        elif _is_near(np.exp(values), model):
            break
        else:
            model = _refine_model(np.exp(values), wedges, technique, known)
    return _describe_fit(wedges, optimum, covariance, values, free)


def _merge_values(start: Array, logs: Array, free: Sequence[int]) -> Array:
    """Return the logarithms of all parameters (3,): fitted ones where they are free, and starting values elsewhere."""
    values = start.copy()
    values[list(free)] = logs[: len(free)]
    return values


def _is_near(values: Array, model: _Model) -> bool:
    """Return whether fitted values are so near to the nodes of a model that interpolation adds no error."""
    if np.ptp(model.kv_nodes) > 2.01 * _NEAR_KV:
        return False
    is_inside = abs(values[0] - model.kv_nodes.mean()) <= _NEAR_KV
    return is_inside and (model.anchor is None or abs(values[_MASS] / model.anchor.mg_per_cm2 - 1) < _NEAR_MASS)


def _refine_model(values: Array, wedges: Sequence[WedgeSignals], technique: Technique, material: Material) -> _Model:
    """Make a model with spectra and a simulated response near fitted values."""
    nodes = float(values[0]) + _NEAR_KV * np.linspace(-1, 1, 4)
    technique = technique.replace_protocol(filtration_mm_al=float(values[1]))
    detector = technique.detector
    anchor = None if detector.absorption == "all" else set_mass_per_area(detector, float(values[_MASS]))
    beams = [_make_beams(wedge, technique, material, nodes) for wedge in wedges]
    return _Model(nodes, technique.protocol.filtration_mm_al, beams, anchor)


def _fit_free(
    wedges: Sequence[WedgeSignals],
    model: _Model,
    technique: Technique,
    start: Array,
    free: Sequence[int],
) -> tuple[OptimizeResult, Array]:
    """Fit the free parameters; return the result and the covariance (free, free) of their logarithms."""

    def residuals(logs: Array) -> Array:
        values = _merge_values(start, logs, free)
        parts = []
        for number, wedge in enumerate(wedges):
            expected = _predict_log_signals(np.exp(values), number, technique, model)
            parts.append((wedge.log_signal - logs[len(free) + number] - expected) / wedge.error)
        return np.concatenate(parts)

    bounds = np.log([_KV_SCALE, _FILTRATION_MM_AL, (NODES_MG_PER_CM2[0], NODES_MG_PER_CM2[-1])])
    begin = [np.clip(start[i], bounds[i, 0] + 0.01, bounds[i, 1] - 0.01) for i in free]
    begin += [float(wedge.log_signal[wedge.path_mm.argmin()]) for wedge in wedges]
    low = [*(bounds[i, 0] for i in free), *(np.full(len(wedges), -np.inf))]
    high = [*(bounds[i, 1] for i in free), *(np.full(len(wedges), np.inf))]
    optimum = least_squares(residuals, begin, bounds=(low, high), x_scale="jac", diff_step=_STEP)
    return optimum, compute_covariance(optimum.jac)[: len(free), : len(free)]


def _describe_fit(
    wedges: Sequence[WedgeSignals], optimum: OptimizeResult, covariance: Array, values: Array, free: Sequence[int]
) -> BeamFit:
    """Collect the values, covariance and residuals of a fit."""
    whole = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    whole[np.ix_(free, free)] = covariance
    errors = np.array([wedge.error for wedge in wedges])
    scaled = optimum.fun.reshape(errors.shape)
    chi2 = float((scaled**2).sum() / max(1, scaled.size - len(optimum.x)))
    # Deviations beyond the statistical error, for example by scatter, increase the errors of the parameters.
    whole *= max(1.0, chi2)
    kv_scale, filtration, mass = (float(value) for value in np.exp(values))
    return BeamFit(
        kv_scale=kv_scale,
        filtration_mm_al=filtration,
        mg_per_cm2=mass,
        held=tuple(name for i, name in enumerate(PARAMETERS) if i not in free),
        covariance=whole,
        residuals=scaled * errors,
        errors=errors,
        reduced_chi2=chi2,
    )


def _make_beams(wedge: WedgeSignals, technique: Technique, material: Material, kv_nodes: Array) -> list[_Beam]:
    """Compute the beams of a wedge image at relative tube voltages (nodes,)."""
    beams = []
    for scale in kv_nodes:
        energies, photons = filtered_spectrum(
            wedge.tube_kv * float(scale), technique.protocol.filtration_mm_al, technique
        )
        passed = np.exp(-np.outer(wedge.path_mm, attenuation_per_mm(material, energies)))
        beams.append(_Beam(energies, photons, attenuation_per_mm(_ALUMINIUM, energies), passed))
    return beams


def _predict_log_signals(values: Array, wedge: int, technique: Technique, model: _Model) -> Array:
    """Predict the logarithms of the signals behind the steps (steps,), relative to the open beam.

    `values` are the relative tube voltage, the filtration in mm aluminium, and the mass of scintillator in mg/cm2. The
    logarithms are interpolated between the nodes of the tube voltage.
    """
    kv_scale, filtration, mass = (float(value) for value in values)
    detector = technique.detector
    if detector.absorption != "all":
        detector = set_mass_per_area(detector, mass)
    logs = []
    for beam in model.beams[wedge]:
        added_mm = filtration - model.filtration_mm_al
        signal = beam.photons * np.exp(-beam.aluminium_per_mm * added_mm)
        signal *= deposit_energy(detector, beam.energies_kev, model.anchor)[0]
        logs.append(np.log(beam.passed @ signal / signal.sum()))
    return np.asarray(BarycentricInterpolator(model.kv_nodes, np.array(logs))(kv_scale))


def deposit_energy(detector: Detector, energies_kev: Array, anchor: Detector | None = None) -> tuple[Array, Array]:
    """Compute the deposited energy with the interpolated response of a scintillator.

    Parameters
    ----------
    detector : Detector
        Detector with any mass of scintillator.
    energies_kev : (bins,) array, keV
        Photon energies.
    anchor : Detector, optional
        Detector with a similar mass of scintillator, whose response is simulated, see
        `xray.response_of_mass.interpolate_response`.

    Returns
    -------
    mean_kev : (bins,) float64 array
        Mean deposited energy per incident photon, in keV.
    square_kev2 : (bins,) float64 array
        Mean squared deposited energy per incident photon, in keV2.
    """
    return compute_deposited_energy(detector, energies_kev, response=interpolate_response(detector, anchor))


def filtered_spectrum(tube_kv: float, filtration_mm_al: float, technique: Technique) -> tuple[Array, Array]:
    """Compute the spectrum behind any filtration and the grid, from that behind the filtration of the technique.

    Parameters
    ----------
    tube_kv : float
        Tube voltage, in kV.
    filtration_mm_al : float
        Total filtration, in mm aluminium.
    technique : Technique
        Anode angle, filtration of the starting spectrum, other filters, and anti-scatter grid.

    Returns
    -------
    energies_kev : (bins,) float64 array
        Centres of the bins, in keV.
    photons : (bins,) float64 array
        Photons per mm2 and mAs at 1 m.
    """
    protocol = technique.protocol
    known = _tube_spectrum(tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
    energies, photons = split_at_detector_edges(known["energies_kev"], known["photons"], technique.detector)
    depth = attenuation_per_mm(_ALUMINIUM, energies) * (filtration_mm_al - protocol.filtration_mm_al)
    photons = photons * np.exp(-depth) * compute_filter_transmission(technique, energies)
    if protocol.grid_ratio > 0:
        photons = photons * compute_primary_transmission(make_grid(protocol), energies)
    return energies, photons


@lru_cache(maxsize=256)
def _tube_spectrum(tube_kv: float, anode_angle_deg: float, filtration_mm_al: float) -> Mapping[str, Array]:
    """Compute a tube spectrum without writing it to the cache folder."""
    return compute_tube_spectrum(tube_kv, anode_angle_deg, filtration_mm_al)
