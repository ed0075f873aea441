"""Compute beam quality with xraylib, independently of SpekPy: half-value layers, mean energy, air kerma and fluence."""

import numpy as np
import xraylib
from scipy.optimize import brentq

from ..core.checks import Array
from ..geometry.view import magnification, resolve_view
from ..model.protocol import Protocol
from ..xray.materials import Material, sum_cross_sections
from ..xray.resolved_technique import Technique
from ..xray.spectrum import compute_beam, compute_source_spectrum

# Joule per keV (CODATA 2018, exact).
_JOULE_PER_KEV = 1.602176634e-16
# Rest energy of the electron, in keV (CODATA 2018).
_ELECTRON_REST_KEV = 510.99895


def energy_transfer_cm2_per_g(air: Material, energies_kev: Array) -> Array:
    """Compute the mass energy-transfer coefficient of air from photoelectric absorption and Compton scattering.

    Parameters
    ----------
    air : Material
        Elements and mass fractions of dry air.
    energies_kev : (energies,) array
        Photon energies, in keV.

    Returns
    -------
    (energies,) array
        Mass energy-transfer coefficient, in cm2/g.

    Notes
    -----
    The Compton part is the mean energy transfer of Klein and Nishina (1929). Fluorescence and bremsstrahlung are
    negligible in air at diagnostic energies, so their energy is regarded as absorbed. The energy-absorption
    coefficients of xraylib are not used, because their interpolation is too coarse (a third too low at 20 keV).
    """
    photo, compton = (
        sum(share * sum_cross_sections((one,), z, energies_kev) for z, share in air.elements)
        for one in (xraylib.CS_Photo, xraylib.CS_Compt)
    )
    return np.asarray(photo + compton * _compton_transfer_fraction(energies_kev))


def _compton_transfer_fraction(energies_kev: Array) -> Array:
    """Compute the mean fraction of photon energy transferred to a free electron (Klein and Nishina 1929).

    Argument and result have shape (energies,).
    """
    cosine, weight = np.polynomial.legendre.leggauss(64)
    left = 1 / (1 + energies_kev[:, None] / _ELECTRON_REST_KEV * (1 - cosine))
    section = left**2 * (left + 1 / left - 1 + cosine**2) * weight
    return np.asarray((section * (1 - left)).sum(axis=1) / section.sum(axis=1))


def air_kerma_ugy(air: Material, energies_kev: Array, photons_per_mm2: Array) -> float:
    """Compute the air kerma of a fluence: fluence times energy times mass energy-transfer coefficient of dry air.

    Parameters
    ----------
    air : Material
        Elements and mass fractions of dry air.
    energies_kev : (energies,) array
        Photon energies, in keV.
    photons_per_mm2 : (energies,) array
        Fluence at each energy, in photons per mm2.

    Returns
    -------
    float
        Air kerma, in uGy.
    """
    per_g = energy_transfer_cm2_per_g(air, energies_kev)
    # keV/mm2 times cm2/g is 100 keV/g, or 1e5 keV/kg; one gray is one joule per kg.
    return float((photons_per_mm2 * energies_kev * per_g).sum() * 1e5 * _JOULE_PER_KEV * 1e6)


def half_value_layers_mm_al(air: Material, energies_kev: Array, photons_per_mm2: Array) -> tuple[float, float]:
    """Compute the first and second half-value layers in aluminium from the air kerma, in narrow-beam geometry.

    Parameters
    ----------
    air : Material
        Elements and mass fractions of dry air.
    energies_kev : (energies,) array
        Photon energies, in keV.
    photons_per_mm2 : (energies,) array
        Fluence at each energy, in photons per mm2.

    Returns
    -------
    first : float
        First half-value layer, in mm of aluminium.
    second : float
        Second half-value layer, in mm of aluminium.
    """
    mu = sum_cross_sections((xraylib.CS_Total,), 13, energies_kev) * 2.699 / 10
    whole = air_kerma_ugy(air, energies_kev, photons_per_mm2)

    def excess(depth_mm: float, share: float) -> float:
        """Compute the fraction of the air kerma that aluminium transmits, minus the fraction `share`."""
        return air_kerma_ugy(air, energies_kev, photons_per_mm2 * np.exp(-mu * depth_mm)) / whole - share

    def layer(share: float) -> float:
        """Find the aluminium thickness in mm that transmits the fraction `share` of the air kerma."""
        return float(brentq(excess, 0.0, 100.0, args=(share,), xtol=1e-12))

    first = layer(0.5)
    return first, layer(0.25) - first


def compute_beam_quantities(technique: Technique) -> dict[str, float]:
    """Compute the quality of the open beam of a protocol.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    dict of str to float
        Values keyed by quantity name; each name ends with the unit.

    Notes
    -----
    Attenuation in air is neglected; one metre of air would reduce the air kerma by 4 % (SpekPy, 70 kV).
    """
    protocol, air = technique.protocol, technique.material("air")
    if protocol.mono_kev is not None:
        beam = compute_beam(technique)
        energies, photons = beam.energies_kev, beam.photons_per_mm2 / max(protocol.mas, 1e-12)
    else:
        energies, photons = compute_source_spectrum(technique)
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
        "entrance_kerma_ugy": _kerma_at_skin_ugy(kerma, protocol),
        "magnification": magnification(resolve_view(protocol)),
        "penumbra_mm": protocol.focal_spot_mm * (magnification(resolve_view(protocol)) - 1),
        "nyquist_per_mm": 0.5 / protocol.pixel_mm,
    }


def entrance_kerma_ugy(technique: Technique) -> float:
    """Compute the incident air kerma at the entrance surface of the limb, without backscatter.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    float
        Air kerma, in uGy.
    """
    beam, air = compute_beam(technique.replace_protocol(mas=1.0)), technique.material("air")
    return _kerma_at_skin_ugy(air_kerma_ugy(air, beam.energies_kev, beam.photons_per_mm2), technique.protocol)


def _kerma_at_skin_ugy(air_kerma_ugy_mas_1m: float, protocol: Protocol) -> float:
    """Scale the air kerma per mAs at 1 m to the skin (60 mm in front of the joint) and to the mAs of the protocol."""
    skin_mm = protocol.sod_mm - 60.0
    return air_kerma_ugy_mas_1m * protocol.mas * (1000.0 / skin_mm) ** 2
