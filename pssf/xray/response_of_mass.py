"""Response of a scintillator for any mass per area, interpolated between simulated layers.

The simulation of a response takes half a minute, which is too slow for a fit of the mass per area.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from ..core.checks import Array, InputError
from ..model.detector import Detector
from .scintillator_response import ScintillatorResponse, load_scintillator_response

# Mass per area of the simulated layers, in mg/cm2. Between them, a cubic spline of the logarithm deviates from the
# simulation by at most 0.22 % (15 to 150 keV, CsI at 193 and Gd2O2S at 117 mg/cm2).
NODES_MG_PER_CM2 = (30.0, 60.0, 120.0, 240.0, 480.0)


def set_mass_per_area(detector: Detector, mg_per_cm2: float) -> Detector:
    """Make a copy of a detector with another mass of scintillator per area.

    Parameters
    ----------
    detector : Detector
        Detector whose density and packing are kept.
    mg_per_cm2 : float
        Mass per area, in mg/cm2.

    Returns
    -------
    Detector
        Copy with another thickness.
    """
    thickness_mm = mg_per_cm2 / (100.0 * detector.density_g_per_cm3 * detector.packing)
    return replace(detector, thickness_mm=float(f"{thickness_mm:.12g}"))


def make_node_detectors(detector: Detector) -> tuple[Detector, ...]:
    """Make the detectors whose responses are interpolated.

    Parameters
    ----------
    detector : Detector
        Detector with the material of the scintillator.

    Returns
    -------
    tuple of Detector
        Detectors that differ only in the mass of scintillator per area, in increasing order.
    """
    solid = replace(detector, density_g_per_cm3=1.0, packing=1.0, cover=(), absorption="layer", escape="simulated")
    return tuple(replace(solid, thickness_mm=mass / 100.0) for mass in NODES_MG_PER_CM2)


def interpolate_response(detector: Detector, anchor: Detector | None = None) -> ScintillatorResponse:
    """Interpolate the response of the scintillator of a detector between simulated layers of other masses.

    Parameters
    ----------
    detector : Detector
        Detector with the material and mass per area of its scintillator.
    anchor : Detector, optional
        Detector of a similar mass, whose response is simulated. The interpolated responses are multiplied by the ratio
        of its simulated to its interpolated response.

    Returns
    -------
    ScintillatorResponse
        Response at the energies of the simulation.

    Raises
    ------
    InputError
        If the mass per area is not between 30 and 480 mg/cm2.
    """
    if detector.escape == "none" or detector.absorption == "all":
        return load_scintillator_response(detector)
    mass, (least, most) = detector.mg_per_cm2, (NODES_MG_PER_CM2[0], NODES_MG_PER_CM2[-1])
    if not least * 0.999 <= mass <= most * 1.001:
        raise InputError(f"mass per area must be between {least:g} and {most:g} mg/cm2, got {mass:g} mg/cm2")
    energies, spline = _fit_splines(make_node_detectors(detector))
    mean, square = spline(np.log(mass))
    if anchor is not None:
        exact, near = load_scintillator_response(anchor), spline(np.log(anchor.mg_per_cm2))
        mean, square = mean * exact.mean / near[0], square * exact.square / near[1]
    return ScintillatorResponse(energies, mean, square)


@lru_cache(maxsize=8)
def _fit_splines(nodes: tuple[Detector, ...]) -> tuple[Array, CubicSpline]:
    """Fit splines of the logarithm of the mass per area to the responses (nodes, 2, energies) of a material."""
    layers = [load_scintillator_response(node) for node in nodes]
    values = np.array([(layer.mean, layer.square) for layer in layers])
    return layers[0].energies_kev, CubicSpline(np.log(NODES_MG_PER_CM2), values)
