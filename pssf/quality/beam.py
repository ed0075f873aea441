"""The beam: half-value layers, mean energy, air kerma, photons; by xraylib alone, apart from SpekPy's own figures."""

import numpy as np
import xraylib
from scipy.optimize import brentq

from ..core.checks import Array
from ..geometry.view import magnification, view_of
from ..model.protocol import Protocol
from ..xray.materials import Material
from ..xray.spectrum import beam_of, tube_spectrum
from ..xray.technique import Technique

_JOULE_PER_KEV = 1.602176634e-16
_ELECTRON_KEV = 510.99895


def energy_transfer_cm2_per_g(air: Material, energies_kev: Array) -> Array:
    """(energies,)  mass energy-transfer coefficient of air: photoelectric, and Compton by Klein and Nishina's mean

    Fluorescence and bremsstrahlung, which air of this energy hardly makes, count as absorbed; xraylib's own energy-
    absorption coefficients are interpolated too coarsely (20 keV: a third too low).
    energies_kev  (energies,)
    """
    photo, compton = (
        np.array([sum(share * one(z, float(energy)) for z, share in air.elements) for energy in energies_kev])
        for one in (xraylib.CS_Photo, xraylib.CS_Compt)
    )
    return np.asarray(photo + compton * _transferred(energies_kev))


def _transferred(energies_kev: Array) -> Array:
    """(energies,)  mean share of a photon's energy that a free electron takes (Klein and Nishina 1929)"""
    cosine, weight = np.polynomial.legendre.leggauss(64)
    left = 1 / (1 + energies_kev[:, None] / _ELECTRON_KEV * (1 - cosine))
    section = left**2 * (left + 1 / left - 1 + cosine**2) * weight
    return np.asarray((section * (1 - left)).sum(axis=1) / section.sum(axis=1))


def air_kerma_ugy(air: Material, energies_kev: Array, photons_per_mm2: Array) -> float:
    """Air kerma of a fluence, uGy: photons x energy x mass energy transfer to dry air.

    energies_kev, photons_per_mm2  (energies,)
    """
    per_g = energy_transfer_cm2_per_g(air, energies_kev)
    # keV/mm2 x cm2/g = 100 keV/g = 1e5 keV/kg; a gray is a joule a kilogram.
    return float((photons_per_mm2 * energies_kev * per_g).sum() * 1e5 * _JOULE_PER_KEV * 1e6)


def half_value_layers_mm_al(air: Material, energies_kev: Array, photons_per_mm2: Array) -> tuple[float, float]:
    """First and second half-value layer in aluminium of the air kerma, narrow beam.

    energies_kev, photons_per_mm2  (energies,)
    """
    mu = np.array([xraylib.CS_Total(13, float(energy)) * 2.699 / 10 for energy in energies_kev])
    whole = air_kerma_ugy(air, energies_kev, photons_per_mm2)

    def excess(depth_mm: float, share: float) -> float:
        return air_kerma_ugy(air, energies_kev, photons_per_mm2 * np.exp(-mu * depth_mm)) / whole - share

    def layer(share: float) -> float:
        return float(brentq(excess, 0.0, 100.0, args=(share,), xtol=1e-12))

    first = layer(0.5)
    return first, layer(0.25) - first


def beam_quantities(technique: Technique) -> dict[str, float]:
    """Figures of a protocol's open beam; distances are in vacuum, 1 m of air takes 4 % of the kerma (SpekPy, 70 kV)."""
    protocol, air = technique.protocol, technique.material("air")
    if protocol.mono_kev is not None:
        beam = beam_of(technique)
        energies, photons = beam.energies_kev, beam.photons_per_mm2 / max(protocol.mas, 1e-12)
    else:
        energies, photons = tube_spectrum(protocol.tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
    first, second = half_value_layers_mm_al(air, energies, photons)
    kerma = air_kerma_ugy(air, energies, photons)
    at_detector = (1000.0 / protocol.sdd_mm) ** 2
    return {
        "hvl1_mm_al": first,
        "hvl2_mm_al": second,
        "mean_kev": float((energies * photons).sum() / photons.sum()),
        "photons_per_mm2_mas_1m": float(photons.sum()),
        "air_kerma_ugy_mas_1m": kerma,
        "photons_per_mm2_detector": float(photons.sum() * protocol.mas * at_detector),
        "air_kerma_ugy_detector": kerma * protocol.mas * at_detector,
        "entrance_kerma_ugy": _at_skin_ugy(kerma, protocol),
        "magnification": magnification(view_of(protocol)),
        "penumbra_mm": protocol.focal_spot_mm * (magnification(view_of(protocol)) - 1),
        "nyquist_per_mm": 0.5 / protocol.pixel_mm,
    }


def entrance_kerma_ugy(technique: Technique) -> float:
    """Air kerma of a protocol's open beam where it enters the limb, without what is scattered back; uGy."""
    beam, air = beam_of(technique.taken(mas=1.0)), technique.material("air")
    return _at_skin_ugy(air_kerma_ugy(air, beam.energies_kev, beam.photons_per_mm2), technique.protocol)


def _at_skin_ugy(air_kerma_ugy_mas_1m: float, protocol: Protocol) -> float:
    skin_mm = protocol.sod_mm - 60.0
    return air_kerma_ugy_mas_1m * protocol.mas * (1000.0 / skin_mm) ** 2
