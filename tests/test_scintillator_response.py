"""Energy deposited in a scintillator: closed forms, bounds and K edges."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
import xraylib
from numpy.testing import assert_allclose

from pssf.data.array_cache import compute_cache_digest
from pssf.data.code_hash import PACKAGE_ROOT
from pssf.model.detector import load_detectors
from pssf.xray.materials import absorbed_fraction, parse_compound
from pssf.xray.scintillator_response import (
    compute_deposited_energy,
    load_scintillator_response,
    make_layer_tables,
    response_name,
    response_origin,
    simulate_deposited_energy,
)

DETECTORS = {
    name: dataclasses.replace(detector, escape="simulated")
    for name, detector in load_detectors().items()
    if name != "ideal"
}
ENERGIES = np.linspace(15.0, 150.0, 136)


@pytest.mark.parametrize("name", DETECTORS)
def test_the_package_contains_the_current_response(name):
    detector = DETECTORS[name]
    digest = compute_cache_digest(replace(response_origin(detector), libraries=()))[:16]
    assert (PACKAGE_ROOT / "data" / "kept" / f"{response_name(detector)}-{digest}.npz").is_file()


@pytest.mark.parametrize("name", DETECTORS)
def test_deposited_energy_is_between_zero_and_the_photon_energy(name):
    mean, square = compute_deposited_energy(DETECTORS[name], ENERGIES)
    chance = absorbed_fraction(DETECTORS[name].formula, DETECTORS[name].mg_per_cm2, ENERGIES)
    # Coherent scattering lengthens the path in the layer and so raises the absorption by up to 3 %.
    assert np.all(mean < 1.03 * chance * ENERGIES)
    assert np.all(mean > 0.5 * chance * ENERGIES)
    # Jensen's inequality for the interacting photons, whose number can be 3 % larger than without coherent scattering.
    assert np.all(square >= mean**2 / (1.03 * chance))
    assert np.all(square <= mean * ENERGIES * (1 + 1e-9))


@pytest.mark.parametrize(("formula", "kev"), [("CsI", 45.0), ("CsI", 80.0), ("Gd2O2S", 65.0), ("CaWO4", 90.0)])
def test_a_very_thin_layer_loses_each_fluorescence_and_each_scattered_photon(formula, kev):
    """In a layer of 1 nm, no secondary photon is absorbed, so cross sections and fluorescence yields give the mean."""
    material = parse_compound(f"{formula}@5.0")
    tables, shells, _ = make_layer_tables(material)
    thin_mm, photons = 1e-6, 400_000
    mean, square = simulate_deposited_energy(kev, thin_mm, tables, shells, photons)
    expected, expected_square = 0.0, 0.0
    for z, weight in material.elements:
        photo, compton = xraylib.CS_Photo(z, kev), xraylib.CS_Compt(z, kev)
        edge = xraylib.EdgeEnergy(z, xraylib.K_SHELL)
        fraction = (
            xraylib.CS_Photo_Partial(z, xraylib.K_SHELL, kev) / xraylib.CS_Photo_Total(z, kev) if kev > edge else 0
        )
        escaping = fraction * xraylib.FluorYield(z, xraylib.K_SHELL) if edge > 12.0 else 0.0
        lines = [
            xraylib.KL3_LINE,
            xraylib.KL2_LINE,
            xraylib.KM3_LINE,
            xraylib.KM2_LINE,
            xraylib.KN3_LINE,
            xraylib.KN2_LINE,
        ]
        rates = np.array([xraylib.RadRate(z, line) for line in lines]) if escaping else np.ones(1)
        left = kev - np.array([xraylib.LineEnergy(z, line) for line in lines]) if escaping else np.zeros(1)
        rates = rates / rates.sum()
        expected += weight * photo * ((1 - escaping) * kev + escaping * (rates * left).sum())
        expected_square += weight * photo * ((1 - escaping) * kev**2 + escaping * (rates * left**2).sum())
        recoil = compton * kev * (1 - _mean_scattered_share(z, kev))
        expected += weight * recoil
    factor = 0.1 * 5.0 * thin_mm  # from cm2/g to a number of interactions
    # The statistical error of the simulated mean is below 0.3 %. The incoherent scattering function, which the closed
    # form of the recoil energy includes by numerical integration, is interpolated.
    assert_allclose(mean, expected * factor, rtol=5e-3)
    assert_allclose(square, expected_square * factor, rtol=1e-2)


def _mean_scattered_share(z, kev):
    """Integrate the energy of Compton-scattered photons, relative to `kev`, over all angles."""
    cosines = np.linspace(-1, 1, 2001)
    share = 1 / (1 + kev / 510.99895 * (1 - cosines))
    density = share**2 * (share + 1 / share - 1 + cosines**2)
    x = kev / 12.398419843 * np.sqrt((1 - cosines) / 2)
    density = density * np.array([xraylib.SF_Compt(z, float(v)) if v > 0 else 0.0 for v in x])
    return np.trapezoid(density * share, cosines) / np.trapezoid(density, cosines)


def test_an_opaque_layer_keeps_more_energy_than_a_thin_one():
    tables, shells, _ = make_layer_tables(parse_compound("CsI@3.5"))
    kept = []
    for thickness_mm in (0.05, 0.2, 0.8, 5.0):
        chance = absorbed_fraction("CsI", 350.0 * thickness_mm, np.array([60.0]))[0]
        kept.append(simulate_deposited_energy(60.0, thickness_mm, tables, shells, 100_000)[0] / (60.0 * chance))
    assert np.all(np.diff(kept) > 0)
    assert 0.9 < kept[-1] < 1.0  # fluorescence and scattered photons leave only backwards


@pytest.mark.parametrize(("name", "edge_kev"), [("csi", 33.17), ("csi", 35.98), ("gos", 50.24)])
def test_the_deposited_share_falls_at_each_k_edge(name, edge_kev):
    detector = DETECTORS[name]
    below, above = (compute_deposited_energy(detector, np.array([edge_kev + way]))[0][0] for way in (-0.3, 0.3))
    chance = [
        absorbed_fraction(detector.formula, detector.mg_per_cm2, np.array([edge_kev + w]))[0] for w in (-0.3, 0.3)
    ]
    shares = below / chance[0] / (edge_kev - 0.3), above / chance[1] / (edge_kev + 0.3)
    assert shares[0] - shares[1] > 0.03


def test_below_the_k_edges_almost_all_energy_is_deposited():
    for name, kev in (("csi", 30.0), ("gos", 40.0)):
        response = load_scintillator_response(DETECTORS[name])
        assert_allclose(np.interp(kev, response.energies_kev, response.mean), 1.0, atol=0.01)


def test_without_escape_each_interacting_photon_deposits_its_energy():
    for detector in DETECTORS.values():
        plain = detector.without_escape()
        chance = absorbed_fraction(detector.formula, detector.mg_per_cm2, ENERGIES)
        mean, square = compute_deposited_energy(plain, ENERGIES)
        assert_allclose(mean, chance * ENERGIES, rtol=1e-12)
        assert_allclose(square, chance * ENERGIES**2, rtol=1e-12)
