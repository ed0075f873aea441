"""The beam: photons a square millimetre and mAs, at one metre, by energy (SpekPy), and their weight in the detector."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.interpolate import CubicSpline

from ..core.checks import Array
from ..data.detectors import Detector
from ..data.store import Arrays, Origin, kept
from .materials import Material, absorbed_fraction, attenuation_per_mm, edges_kev
from .quadrature import TOLERANCE, spectrum_quadrature
from .technique import Technique

_ORIGIN = Origin(sources=("xray/spectrum.py",), libraries=("spekpy", "numpy"))
_ROUND_MM = 20.0
# Width of the bins of a spectrum, and of one in which the scene has an absorption edge, in keV.
_BIN_KEV, _FINE_KEV = 0.5, 0.1
_MONO_PHOTONS_PER_MM2_MAS = 1e6
# Places along the anode-cathode axis between which the heel effect is interpolated.
_HEEL_POINTS = 9
# Beyond this part of the anode's cut-off the intensity falls too steeply for evenly spaced places: 0.14 % off there,
# 2.5 % at 0.9, where places that crowd towards the cut-off are 0.02 % off, and 0.06 % at 0.95 (6 and 12 deg, 70 kV).
_NEAR_CUT_OFF, _HEEL_POINTS_NEAR = 0.7, 13


@dataclass(frozen=True)
class Beam:
    """Energies and photons of a beam at 1 m without an object, and what the detector makes of a photon.

    energies_kev     (nodes,)
    photons_per_mm2  (nodes,)  for the protocol's mAs
    signal_kev       (nodes,)  energy absorbed a photon: interaction probability times energy
    square_kev2      (nodes,)  its second moment: interaction probability times energy squared
    """

    energies_kev: Array
    photons_per_mm2: Array
    signal_kev: Array
    square_kev2: Array


def beam_of(technique: Technique, materials: Iterable[Material] = ()) -> Beam:
    """Compute the beam of a technique in bins of 0.5 keV, or in one bin when it is monochromatic.

    materials  where one of their K or L edges lies in the spectrum, bins are 0.1 keV wide and end at each edge: a bin
               is attenuated as at its middle. The signal of the open beam stays that of bins of 0.5 keV
    """
    protocol = technique.protocol
    if protocol.mono_kev is not None:
        energies, photons = np.array([protocol.mono_kev]), np.array([_MONO_PHOTONS_PER_MM2_MAS])
        return Beam(energies, photons * protocol.mas, *_response(energies, technique.detector))
    tube = (protocol.tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
    energies, photons = tube_spectrum(*tube)
    response = _response(energies, technique.detector)
    edges = [edge for edge in edges_kev(materials) if energies[0] < edge < energies[-1]]
    if edges:
        signal = (photons * response[0]).sum()
        energies, photons = _split_bins(*tube_spectrum(*tube, bin_kev=_FINE_KEV), edges, _FINE_KEV)
        response = _response(energies, technique.detector)
        photons = photons * (signal / (photons * response[0]).sum())
    return Beam(energies, photons * protocol.mas, *response)


def beam_for(technique: Technique, most_mm: Mapping[str, float], tolerance: float = TOLERANCE) -> Beam:
    """The beam of a technique, folded to the few energies that a scene needs.

    most_mm    material -> longest path through it, mm
    tolerance  largest relative error of the signal behind any mixture up to there, against bins of 0.5 keV
    """
    # In steps, so that like scenes share a fit.
    rounded = {name: float(_ROUND_MM * np.ceil(most / _ROUND_MM)) for name, most in most_mm.items() if most > 0}
    same = replace(technique, protocol=replace(technique.protocol, name="beam", mas=1.0))
    beam = _folded(same, tuple(sorted(rounded.items())), tolerance)
    return replace(beam, photons_per_mm2=beam.photons_per_mm2 * technique.protocol.mas)


@lru_cache(maxsize=64)
def _folded(technique: Technique, most_mm: tuple[tuple[str, float], ...], tolerance: float) -> Beam:
    beam = beam_of(technique, [technique.material(name) for name, _ in most_mm])
    photons, signal, square = beam.photons_per_mm2, beam.signal_kev, beam.square_kev2
    mu = np.array([attenuation_per_mm(technique.material(name), beam.energies_kev) for name, _ in most_mm])
    mu = mu.reshape(-1, len(photons))
    most = np.array([most for _, most in most_mm])
    bins, first, second, _ = spectrum_quadrature(photons * signal, photons * square, mu, most, tolerance)
    return Beam(beam.energies_kev[bins], first / signal[bins], signal[bins], second / first * signal[bins])


def heel_factor(technique: Technique) -> Array:
    """(rows,)  signal of the open beam over that on the central ray, less inverse square: self-absorption in the anode

    Of the intensity, with the detector's response; that the beam is some 0.5 keV harder towards the anode is left out.
    """
    protocol = technique.protocol
    row = (np.arange(protocol.rows) - (protocol.rows - 1) / 2) * protocol.pixel_mm / protocol.sdd_mm
    sign = 1.0 if protocol.heel == "anode_proximal" else -1.0
    slopes = np.linspace(row[0], row[-1], _HEEL_POINTS)
    cut_off = np.tan(np.deg2rad(protocol.anode_angle_deg))
    if -row[0] > _NEAR_CUT_OFF * cut_off:
        # Rows that the collimator covers have the value of the outermost row that it does not.
        lit = min(-float(row[0]), protocol.heel_slope)
        row = np.clip(row, -lit, lit)
        slopes = np.sort(sign * _slopes_near_cut_off(lit, float(cut_off)))
    signals = []
    for slope in (*slopes, 0.0):
        beam = (protocol.tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
        energies, photons = tube_spectrum(*beam, off_axis=round(sign * float(slope), 9))
        signals.append((photons * _response(energies, technique.detector)[0]).sum() * (1 + slope**2))
    return np.asarray(CubicSpline(slopes, signals[:-1])(row) / signals[-1])


def _slopes_near_cut_off(lit: float, cut_off: float) -> Array:
    """Place interpolation nodes the denser, the nearer they are to the anode's cut-off.

    lit      tangent of the greatest angle from the central ray
    cut_off  tangent of the anode's angle; greater than `lit`
    returns  (13,)  tangents from -lit, towards the anode, to lit
    """
    return np.asarray(np.geomspace(cut_off - lit, cut_off + lit, _HEEL_POINTS_NEAR) - cut_off)


def _split_bins(energies_kev: Array, photons: Array, edges_kev: Sequence[float], bin_kev: float) -> tuple[Array, Array]:
    """Split bins at edges into parts with their share of the photons, each at its own middle.

    energies_kev, photons  (bins,)  middles of bins of `bin_kev`, and photons of any unit in them
    returns                (parts,)  keV and (parts,)  photons of the same unit
    """
    low = energies_kev - bin_kev / 2
    ends = low + bin_kev
    parts = [(start, end, count) for start, end, count in zip(low, ends, photons / bin_kev, strict=True)]
    for edge in edges_kev:
        parts = [
            (*bounds, density)
            for start, end, density in parts
            for bounds in ([(start, edge), (edge, end)] if start < edge < end else [(start, end)])
        ]
    start, end, density = np.array(parts).T
    return (start + end) / 2, density * (end - start)


@lru_cache(maxsize=64)
def tube_spectrum(
    tube_kv: float,
    anode_angle_deg: float,
    filtration_mm_al: float,
    off_axis: float = 0.0,
    bin_kev: float = _BIN_KEV,
) -> tuple[Array, Array]:
    """(bins,) keV and (bins,) photons/mm2/mAs at 1 m: tungsten behind aluminium, no air (SpekPy 2, "casim").

    off_axis  tangent of the angle from the central ray, positive away from the anode
    bin_kev   width of a bin
    """
    beam = (float(tube_kv), float(anode_angle_deg), float(filtration_mm_al), float(off_axis))
    name = "spectrum-" + "-".join(map(repr, beam if bin_kev == _BIN_KEV else (*beam, bin_kev)))
    # Loading SpekPy takes a second, and a monochromatic protocol does without.
    arrays = kept(name, _ORIGIN, partial(_computed, *beam, bin_kev))
    return arrays["energies_kev"], arrays["photons"]


def _computed(
    tube_kv: float, anode_angle_deg: float, filtration_mm_al: float, off_axis: float, bin_kev: float
) -> Arrays:
    from spekpy import Spek

    source = Spek(kvp=tube_kv, th=anode_angle_deg, dk=bin_kev, mas=1.0, x=100.0 * off_axis, z=100.0)
    source.filter("Al", filtration_mm_al)
    energies, per_kev_cm2 = source.get_spectrum(edges=False)
    keep = per_kev_cm2 > per_kev_cm2.max() * 1e-9
    return {"energies_kev": energies[keep], "photons": per_kev_cm2[keep] * bin_kev / 100.0}


def _response(energies_kev: Array, detector: Detector) -> tuple[Array, Array]:
    fraction = absorbed_fraction(detector.formula, detector.mg_per_cm2, energies_kev)
    return fraction * energies_kev, fraction * energies_kev**2
