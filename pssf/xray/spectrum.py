"""X-ray beam: photons per energy, per mm2 and mAs at 1 m (SpekPy), and the detector response."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.interpolate import CubicSpline

from ..core.checks import Array
from ..data.array_cache import Arrays, CacheKey, load_or_make_arrays
from ..model.detector import Detector
from ..model.protocol import Protocol
from .materials import (
    Material,
    absorption_edges_kev,
    attenuation_per_mm,
    parse_compound,
)
from .resolved_technique import Technique
from .scintillator_response import compute_deposited_energy
from .spectrum_quadrature import RELATIVE_TOLERANCE, fit_spectrum_quadrature

# Source file and libraries whose changes invalidate cached spectra.
_CACHE_ORIGIN = CacheKey(sources=("xray/spectrum.py",), libraries=("spekpy", "numpy"))
# Step, in mm, to which maximum path lengths are rounded up, so that similar scenes use the same reduced beam.
_PATH_STEP_MM = 20.0
# Width of the energy bins of a spectrum, in keV.
_BIN_KEV = 0.5
# Width of the energy bins if the scene has an absorption edge within the spectrum, in keV.
_FINE_KEV = 0.1
# Width of bins, in keV, up to which the bins of a spectrum of the user are split at edges of the scintillator.
_LARGEST_BIN_KEV = 1.0
# Photons per mm2 and mAs of a monochromatic beam at 1 m.
_MONO_PHOTONS_PER_MM2_MAS = 1e6
# Number of evenly spaced interpolation nodes of the heel effect along the anode-cathode axis.
_HEEL_POINTS = 9
# Tangent of the field edge, as a fraction of the tangent of the anode angle (the cut-off), above which denser nodes
# near the cut-off replace evenly spaced nodes. The error of evenly spaced nodes is 0.14 % at a fraction of 0.7 and 2.5
# % at 0.9, because the intensity falls steeply. The error of denser nodes is 0.02 % at 0.9 and 0.06 % at 0.95 (6 and 12
# deg, 70 kV).
_NEAR_CUT_OFF = 0.7
# Number of interpolation nodes if they are denser near the cut-off.
_HEEL_POINTS_NEAR = 13


@dataclass(frozen=True)
class Beam:
    """Beam at 1 m without an object, and the detector response to one photon.

    Attributes
    ----------
    energies_kev : (nodes,) float64 array
        Photon energies, in keV.
    photons_per_mm2 : (nodes,) float64 array
        Photons per mm2 for the mAs of the protocol.
    signal_kev : (nodes,) float64 array
        Mean energy deposited in the scintillator per photon, in keV.
    square_kev2 : (nodes,) float64 array
        Second moment of the energy deposited per photon, in keV2.
    """

    energies_kev: Array
    photons_per_mm2: Array
    signal_kev: Array
    square_kev2: Array


def compute_beam(technique: Technique, materials: Iterable[Material] = ()) -> Beam:
    """Compute the beam of a technique in bins of 0.5 keV, or in one bin for a monochromatic beam.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    materials : iterable of Material, optional
        Materials of the scene. If a K or L edge of a material is within the spectrum, bins are 0.1 keV wide and end at
        each edge, because the attenuation is evaluated at bin centres. The open-beam signal does not change.

    Returns
    -------
    Beam
        Energies, photons and detector response.
    """
    protocol = technique.protocol
    if protocol.mono_kev is not None:
        energies, photons = np.array([protocol.mono_kev]), np.array([_MONO_PHOTONS_PER_MM2_MAS])
        return Beam(energies, photons * protocol.mas, *compute_deposited_energy(technique.detector, energies))
    energies, photons = compute_source_spectrum(technique)
    response = compute_deposited_energy(technique.detector, energies)
    filters = [technique.material(name) for name, _ in protocol.filters]
    edges = [edge for edge in absorption_edges_kev([*materials, *filters]) if energies[0] < edge < energies[-1]]
    if edges and protocol.spectrum is None:
        signal = (photons * response[0]).sum()
        edges += _detector_edges_kev(technique.detector)
        energies, photons = _split_bins(*_tube_spectrum(protocol, bin_kev=_FINE_KEV), edges, _FINE_KEV)
        photons = photons * compute_filter_transmission(technique, energies)
        response = compute_deposited_energy(technique.detector, energies)
        photons = photons * (signal / (photons * response[0]).sum())
    return Beam(energies, photons * protocol.mas, *response)


def split_at_detector_edges(energies_kev: Array, photons: Array, detector: Detector) -> tuple[Array, Array]:
    """Split the bins of a spectrum that contain an absorption edge of a scintillator.

    Parameters
    ----------
    energies_kev : (bins,) array, keV
        Centres of the bins. Lines or bins of unequal or large width are not split.
    photons : (bins,) array, any unit
        Photons per bin.
    detector : Detector
        Detector with the scintillator.

    Returns
    -------
    energies_kev : (parts,) float64 array
        Centres of the new bins, in keV.
    photons : (parts,) float64 array
        Photons per bin, in the unit of `photons`.
    """
    steps, edges = np.diff(energies_kev), _detector_edges_kev(detector)
    if not edges or len(steps) < 2 or steps.max() > min(_LARGEST_BIN_KEV, 1.001 * steps.min()):
        return energies_kev, photons
    return _split_bins(energies_kev, photons, edges, float(steps.mean()))


def _detector_edges_kev(detector: Detector) -> list[float]:
    """List the absorption edges of the scintillator of a detector, in keV."""
    if detector.absorption == "all":
        return []
    return list(absorption_edges_kev([parse_compound(f"{detector.formula}@1.0")]))


def compute_reduced_beam(
    technique: Technique, max_path_mm: Mapping[str, float], tolerance: float = RELATIVE_TOLERANCE
) -> Beam:
    """Compute the beam of a technique with only as many energies as a scene needs.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    max_path_mm : mapping of str to float
        Maximum path length in each material, in mm.
    tolerance : float, default 1e-4
        Largest relative error of the signal behind any combination of path lengths up to `max_path_mm`, compared with
        bins of 0.5 keV.

    Returns
    -------
    Beam
        Energies, photons and detector response.
    """
    # Maximum path lengths are rounded up in steps, so that similar scenes use the same fit.
    rounded = {
        name: float(_PATH_STEP_MM * np.ceil(most / _PATH_STEP_MM)) for name, most in max_path_mm.items() if most > 0
    }
    same = replace(technique, protocol=replace(technique.protocol, name="beam", mas=1.0))
    beam = _reduce_beam(same, tuple(sorted(rounded.items())), tolerance)
    return replace(beam, photons_per_mm2=beam.photons_per_mm2 * technique.protocol.mas)


@lru_cache(maxsize=64)
def _reduce_beam(technique: Technique, max_path_mm: tuple[tuple[str, float], ...], tolerance: float) -> Beam:
    """Reduce the beam to few energies for given maximum path lengths in mm per material; results are cached."""
    beam = compute_beam(technique, [technique.material(name) for name, _ in max_path_mm])
    photons, signal, square = beam.photons_per_mm2, beam.signal_kev, beam.square_kev2
    mu = np.array([attenuation_per_mm(technique.material(name), beam.energies_kev) for name, _ in max_path_mm])
    mu = mu.reshape(-1, len(photons))
    most = np.array([most for _, most in max_path_mm])
    bins, first, second, _ = fit_spectrum_quadrature(photons * signal, photons * square, mu, most, tolerance)
    return Beam(beam.energies_kev[bins], first / signal[bins], signal[bins], second / first * signal[bins])


def heel_factor(technique: Technique) -> Array:
    """Compute the heel effect: the open-beam signal in each row relative to the central ray.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    (rows,) float64 array
        Factor by which self-absorption in the anode changes the signal of each row, excluding the inverse-square law.

    Notes
    -----
    The factor applies to the detector signal. The beam is also about 0.5 keV harder towards the anode, which is
    neglected.
    """
    protocol = technique.protocol
    below_mm = (np.arange(protocol.rows) - (protocol.rows - 1) / 2) * protocol.pixel_mm - protocol.detector_offset_z_mm
    row = below_mm / protocol.sdd_mm
    sign = 1.0 if protocol.heel == "anode_proximal" else -1.0
    slopes = np.linspace(row[0], row[-1], _HEEL_POINTS)
    cut_off = np.tan(np.deg2rad(protocol.anode_angle_deg))
    farthest = max(-float(row[0]), float(row[-1]))
    if farthest > _NEAR_CUT_OFF * cut_off:
        # Rows outside the collimated field have the factor of the outermost row in the field.
        lit = min(farthest, protocol.field_edge_tangent)
        row = np.clip(row, -lit, lit)
        slopes = np.sort(sign * _slopes_near_cut_off(lit, float(cut_off)))
    signals = []
    for slope in (*slopes, 0.0):
        energies, photons = compute_source_spectrum(technique, off_axis=round(sign * float(slope), 9))
        signals.append((photons * compute_deposited_energy(technique.detector, energies)[0]).sum() * (1 + slope**2))
    return np.asarray(CubicSpline(slopes, signals[:-1])(row) / signals[-1])


def compute_source_spectrum(
    technique: Technique, off_axis: float = 0.0, bin_kev: float = _BIN_KEV
) -> tuple[Array, Array]:
    """Compute the spectrum behind all filters, or take the spectrum of the protocol.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    off_axis : float, default 0
        Tangent of the angle from the central ray, positive away from the anode.
    bin_kev : float, default 0.5
        Width of the bins, in keV. A spectrum of the user keeps its bins.

    Returns
    -------
    energies_kev : (bins,) float64 array
        Centres of the bins, in keV.
    photons : (bins,) float64 array
        Photons per mm2 and mAs at 1 m.
    """
    protocol = technique.protocol
    if protocol.spectrum is not None:
        energies, photons = np.array(protocol.spectrum).T
    else:
        energies, photons = _tube_spectrum(protocol, off_axis, bin_kev)
    energies, photons = split_at_detector_edges(energies, photons, technique.detector)
    return energies, photons * compute_filter_transmission(technique, energies)


def _tube_spectrum(protocol: Protocol, off_axis: float = 0.0, bin_kev: float = _BIN_KEV) -> tuple[Array, Array]:
    """Compute the spectrum of a protocol behind its aluminium: energies (bins,) in keV, photons per mm2 and mAs."""
    tube = (protocol.tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
    return tube_spectrum(*tube, off_axis=off_axis, bin_kev=bin_kev)


def compute_filter_transmission(technique: Technique, energies_kev: Array) -> Array:
    """Compute the transmission of the added filters of a protocol, which rays cross at normal incidence.

    Parameters
    ----------
    technique : Technique
        Resolved protocol with the filters.
    energies_kev : (bins,) array, keV
        Photon energies.

    Returns
    -------
    (bins,) float64 array
        Transmission from 0 to 1, without the total filtration in aluminium.
    """
    depth = np.zeros(len(energies_kev))
    for name, mm in technique.protocol.filters:
        depth += mm * attenuation_per_mm(technique.material(name), energies_kev)
    return np.exp(-depth)


def _slopes_near_cut_off(max_slope: float, cut_off_slope: float) -> Array:
    """Place interpolation nodes that are denser towards the cut-off of the anode.

    `max_slope` is the tangent of the angle from the central ray to the field edge. `cut_off_slope` is the tangent of
    the anode angle, which is greater. Return the tangents of the nodes (13,), from -max_slope on the anode side to
    max_slope.
    """
    return np.asarray(
        np.geomspace(cut_off_slope - max_slope, cut_off_slope + max_slope, _HEEL_POINTS_NEAR) - cut_off_slope
    )


def _split_bins(energies_kev: Array, photons: Array, edges_kev: Sequence[float], bin_kev: float) -> tuple[Array, Array]:
    """Split energy bins at absorption edges; return the centres and the photons of the new bins (parts,).

    `energies_kev` (bins,) are the bin centres in keV. `photons` (bins,) may have any unit.
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
    """Compute the spectrum of a tungsten anode behind aluminium, neglecting air (SpekPy 2, model "casim").

    Parameters
    ----------
    tube_kv : float
        Tube voltage, in kV.
    anode_angle_deg : float
        Anode angle, in degrees.
    filtration_mm_al : float
        Total filtration, in mm aluminium.
    off_axis : float, default 0
        Tangent of the angle from the central ray, positive away from the anode.
    bin_kev : float, default 0.5
        Width of the bins, in keV.

    Returns
    -------
    energies_kev : (bins,) float64 array
        Centres of the bins, in keV.
    photons : (bins,) float64 array
        Photons per mm2 and mAs at 1 m.
    """
    beam = (float(tube_kv), float(anode_angle_deg), float(filtration_mm_al), float(off_axis))
    name = "spectrum-" + "-".join(map(repr, beam if bin_kev == _BIN_KEV else (*beam, bin_kev)))
    # SpekPy, which takes a second to import, is imported only when a spectrum is not in the cache.
    arrays = load_or_make_arrays(name, _CACHE_ORIGIN, partial(compute_tube_spectrum, *beam, bin_kev))
    return arrays["energies_kev"], arrays["photons"]


def compute_tube_spectrum(
    tube_kv: float,
    anode_angle_deg: float,
    filtration_mm_al: float,
    off_axis: float = 0.0,
    bin_kev: float = _BIN_KEV,
) -> Arrays:
    """Compute a tube spectrum with SpekPy, without a cache.

    Parameters
    ----------
    tube_kv, anode_angle_deg, filtration_mm_al, off_axis, bin_kev : float
        As in `tube_spectrum`.

    Returns
    -------
    mapping of str to array
        ``energies_kev``, the centres of the bins in keV, and ``photons``, per mm2 and mAs at 1 m.
    """
    from spekpy import Spek

    source = Spek(kvp=tube_kv, th=anode_angle_deg, dk=bin_kev, mas=1.0, x=100.0 * off_axis, z=100.0)
    source.filter("Al", filtration_mm_al)
    energies, per_kev_cm2 = source.get_spectrum(edges=False)
    keep = per_kev_cm2 > per_kev_cm2.max() * 1e-9
    return {"energies_kev": energies[keep], "photons": per_kev_cm2[keep] * bin_kev / 100.0}
