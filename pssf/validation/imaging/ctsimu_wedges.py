"""Comparison with the CTSimU test suite for radiographic simulators (BAM): step wedges and scintillators."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...core.checks import Array
from ...data.imaging.ctsimu_table import CtsimuTable, WedgeMaterial, WedgeReference, load_ctsimu
from ...model.detector import Detector, load_detectors
from ...model.protocol import Protocol, load_protocol
from ...xray.materials import attenuation_per_mm, parse_compound
from ...xray.resolved_technique import resolve_technique
from ...xray.spectrum import compute_beam

Row = dict[str, Any]
# Formula and density in g/cm3 of each scintillator of the suite.
_SCINTILLATORS = {"csi": ("CsI", 4.51), "gos": ("Gd2O2S", 7.34)}
# Number of steps of a wedge.
STEPS = 9


def compare_with_ctsimu() -> list[Row]:
    """Compare the primary signal behind step wedges with the two Monte Carlo codes of the CTSimU suite.

    Returns
    -------
    list of dict
        One row per wedge, beam and detector. ``steps_within`` counts the steps, including the free beam, whose signal
        is within one standard deviation of the grey values of at least one of the codes. Deviations are relative to the
        mean of the codes, for the step with the largest deviation, in percent. ``without_escape`` marks values for a
        scintillator that neither fluorescence nor scattered photons leave.
    """
    table = load_ctsimu()
    return [_compare_wedge(wedge, table) for wedge in table.wedge]


def compute_wedge_signals(wedge: WedgeReference, table: CtsimuTable, *, escape: bool = True) -> Array:
    """Compute the primary signal behind the steps of a wedge and in the free beam.

    Parameters
    ----------
    wedge : WedgeReference
        Wedge, beam and detector.
    table : CtsimuTable
        Table with the path lengths of the steps and the X-ray tube.
    escape : bool, default True
        Whether fluorescence and scattered photons may leave the scintillator.

    Returns
    -------
    (10,) float64 array
        Signals from the thickest step to the free beam, relative to the free beam.
    """
    known = table.material[wedge.material]
    material = parse_compound(f"{wedge.material}@{known.density_g_per_cm3}")
    path_mm = np.append(list_path_lengths_mm(known), 0.0)
    protocol = make_wedge_protocol(wedge, table, escape=escape)
    beam = compute_beam(resolve_technique(protocol), [material])
    weights = beam.photons_per_mm2 * beam.signal_kev
    passed = np.exp(-np.outer(path_mm, attenuation_per_mm(material, beam.energies_kev)))
    return np.asarray(passed @ weights / weights.sum())


def list_path_lengths_mm(wedge: WedgeMaterial) -> Array:
    """List the path lengths in the steps of a wedge.

    Parameters
    ----------
    wedge : WedgeMaterial
        Material with the thinnest step and the increase per step.

    Returns
    -------
    (9,) float64 array
        Path lengths from the thickest to the thinnest step, in mm.
    """
    return np.asarray(wedge.thinnest_mm + wedge.step_mm * np.arange(STEPS - 1, -1, -1))


def make_wedge_protocol(wedge: WedgeReference, table: CtsimuTable, *, escape: bool = True) -> Protocol:
    """Make a protocol with the beam and the detector of a sub-test.

    Parameters
    ----------
    wedge : WedgeReference
        Wedge, beam and detector.
    table : CtsimuTable
        Table with the X-ray tube.
    escape : bool, default True
        Whether fluorescence and scattered photons may leave the scintillator.

    Returns
    -------
    Protocol
        The protocol ``reference`` with this beam and detector.
    """
    detector = _make_detector(wedge.detector)
    return replace(_make_beam_protocol(wedge.beam, table), detector=detector if escape else detector.without_escape())


def compare_with_codes(signal: Array, codes: Array, spread: Array) -> Row:
    """Compare signals with the grey values of the two codes.

    Parameters
    ----------
    signal : (10,) array, dimensionless
        Signals relative to the free beam.
    codes, spread : (2, 10) array, dimensionless
        Means and standard deviations of the grey values of the codes, relative to the free beam.

    Returns
    -------
    dict
        ``steps_within`` counts the signals within one standard deviation of at least one code. ``deviation_percent`` is
        the largest deviation from the mean of the codes.
    """
    deviation = signal / codes.mean(axis=0) - 1
    return {
        "steps_within": int((np.abs(signal - codes) <= spread).any(axis=0).sum()),
        "deviation_percent": round(100 * float(deviation[np.abs(deviation).argmax()]), 1),
    }


def _make_detector(name: str) -> Detector:
    """Make the detector of a sub-test from its name: ideal, or a scintillator with its thickness in micrometres."""
    known = load_detectors()
    if name == "ideal":
        return known["ideal"]
    scintillator, micrometres = name.split("_")
    formula, density = _SCINTILLATORS[scintillator]
    return replace(
        known["csi"], name=name, formula=formula, density_g_per_cm3=density, packing=1.0, escape="simulated",
        thickness_mm=float(micrometres) / 1000,
    )  # fmt: skip


def _make_beam_protocol(beam: str, table: CtsimuTable) -> Protocol:
    """Make a protocol with the beam of a sub-test, such as "50 keV" or "120 kV"."""
    number, unit = beam.split()
    plain = load_protocol("reference")
    if unit == "keV":
        return replace(plain, mono_kev=float(number))
    return replace(
        plain, tube_kv=float(number), filtration_mm_al=table.window_mm_al, anode_angle_deg=table.anode_angle_deg
    )


def _compare_wedge(wedge: WedgeReference, table: CtsimuTable) -> Row:
    """Make the table row of one wedge."""
    codes = np.array([wedge.rosi, wedge.mcray])
    spread = np.array([wedge.rosi_sd, wedge.mcray_sd]) / codes[:, -1:]
    codes = codes / codes[:, -1:]
    row: Row = {"detector": wedge.detector.replace("_", " "), "wedge": wedge.material, "beam": wedge.beam}
    for label, escape in (("", True), ("_without_escape", False)):
        signal = compute_wedge_signals(wedge, table, escape=escape)
        agreement = compare_with_codes(signal, codes, spread)
        row |= {f"{name}{label}": value for name, value in agreement.items()}
    row["codes_differ_percent"] = round(100 * float(np.abs(codes[0] / codes[1] - 1).max()), 1)
    return row
