"""Check spectrum bins that contain an absorption edge of a material in the scene."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from tissue_materials import find_material

import pssf
from pssf.xray import spectrum
from pssf.xray.materials import absorption_edges_kev, attenuation_per_mm
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.scintillator_response import compute_deposited_energy
from pssf.xray.spectrum import compute_beam, tube_spectrum


def resolve_at(tube_kv):
    """Return the reference technique at a tube voltage."""
    return resolve_technique(dataclasses.replace(pssf.load_protocol("reference"), tube_kv=float(tube_kv)))


def compute_transmission(energies_kev, weights, substance, mm):
    """Compute the weighted transmission of a material of a given thickness."""
    return float((weights * np.exp(-attenuation_per_mm(substance, energies_kev) * mm)).sum() / weights.sum())


@pytest.mark.parametrize(
    ("name", "mm", "tube_kv"),
    [("I@4.93", 0.3, 40), ("Gd@7.9", 0.2, 80), ("Ta@16.65", 0.1, 110), ("Ag@10.5", 0.2, 40), ("Ba@3.5", 0.3, 70)],
)
def test_transmission_near_a_k_edge_is_accurate_to_0_2_percent(name, mm, tube_kv):
    technique, of = resolve_at(tube_kv), find_material(name)
    protocol = technique.protocol
    # The expected value uses bins of 0.02 keV that also end at the edges.
    tube = (protocol.tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
    fine = spectrum._split_bins(*tube_spectrum(*tube, bin_kev=0.02), absorption_edges_kev([of]), 0.02)
    response = compute_deposited_energy(technique.detector, fine[0])[0]
    expected = compute_transmission(fine[0], fine[1] * response, of, mm)
    beam = compute_beam(technique, [of])
    assert_allclose(
        compute_transmission(beam.energies_kev, beam.photons_per_mm2 * beam.signal_kev, of, mm), expected, rtol=2e-3
    )


def test_iodine_contrast_equals_that_of_a_finely_binned_spectrum():
    protocol = dataclasses.replace(
        *(pssf.load_protocol("reference"),), rows=9, cols=9, tube_kv=40.0, focal_spot_mm=0.0, scatter="none",
        noise="none", detector_blur="none", detector=pssf.load_detector("csi").without_escape(),
    )  # fmt: skip
    primary = []
    for x in (0.0, 5000.0):
        sheet = trimesh.creation.box((120, 0.3, 120)).apply_translation((x, 0, 0))
        scene = pssf.Scene([pssf.Surface(sheet, "I@4.93", "air")], size_mm=(0, np.inf))
        image = pssf.simulate(scene, protocol, keep=("primary",), engine="scanline")
        primary.append(float(image.kept["primary"][4, 4]))
    # The expected value is from SpekPy with bins of 0.02 keV that end at the edge.
    assert_allclose(primary[0] / primary[1], 0.14102, rtol=2e-3)


def test_tissues_do_not_change_the_spectrum_bins():
    technique = resolve_at(70)
    names = ("cortical_bone", "trabecular_bone", "marrow", "cartilage", "tendon", "muscle", "adipose", "skin", "water")
    one, other = compute_beam(technique), compute_beam(technique, [technique.material(name) for name in names])
    for field in ("energies_kev", "photons_per_mm2", "signal_kev", "square_kev2"):
        assert np.array_equal(getattr(one, field), getattr(other, field))


def test_absorption_edges_do_not_change_the_open_beam_signal():
    technique = resolve_at(70)
    signals = [
        (beam.photons_per_mm2 * beam.signal_kev).sum()
        for beam in (compute_beam(technique), compute_beam(technique, [find_material("I@4.93")]))
    ]
    assert_allclose(*signals, rtol=1e-12)


@given(st.lists(st.floats(9.0, 41.0), max_size=6))
def test_splitting_spectrum_bins_at_edges_preserves_the_photon_number(edges):
    energies = np.arange(10.25, 40.0, 0.5)
    photons = np.linspace(1.0, 2.0, len(energies))
    middles, parts = spectrum._split_bins(energies, photons, edges, 0.5)
    assert_allclose(parts.sum(), photons.sum())
    assert (np.diff(middles) > 0).all()
    for edge in edges:
        below = middles < edge
        # Fraction of each original bin that is below the edge.
        whole = np.clip((edge - (energies - 0.25)) / 0.5, 0.0, 1.0)
        assert_allclose(parts[below].sum(), (photons * whole).sum(), atol=1e-9)
