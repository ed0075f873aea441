"""Check the imaging chain: materials, spectrum, attenuation, noise, blur and display."""

import dataclasses
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from tissue_materials import compute_attenuation, find_material

import pssf
from pssf.core.resample import downsample_by_blocks, upsample_linear
from pssf.data.analysis.reference_table import load_reference_tables
from pssf.detector import detector_blur, panel_readout, quantum_noise
from pssf.geometry.view import resolve_view
from pssf.model.detector import load_detectors
from pssf.stages import LatentImage, StageContext, run_stages
from pssf.xray.primary_beam import compute_primary, transmit
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.scintillator_response import compute_deposited_energy
from pssf.xray.spectrum import (
    Beam,
    compute_beam,
    compute_reduced_beam,
    heel_factor,
    tube_spectrum,
)

SEED = np.random.SeedSequence(1)
CSI = load_detectors()["csi"]


def run_imaging_chain(path_mm, protocol, gap_mm=0.0, seed=1, keep=()):
    image = LatentImage(path_mm=path_mm, air_gaps_mm=gap_mm)
    seconds = run_stages(image, StageContext(technique=resolve_technique(protocol), seed=seed, keep=frozenset(keep)))
    return image.pixels, image.kept, seconds


def test_a_compound_with_a_density_is_a_material():
    fifty = np.array([50.0])
    # The tissue "water" has ICRU's rounded composition.
    assert_allclose(compute_attenuation("H2O@1.0", fifty), compute_attenuation("water", fifty), rtol=1e-3)
    assert find_material("Ti@4.51").density_g_per_cm3 == 4.51


def test_a_nist_compound_is_found_by_its_name():
    fifty = np.array([50.0])
    assert_allclose(compute_attenuation("Water, Liquid", fifty), compute_attenuation("H2O@1.0", fifty), rtol=1e-3)
    assert find_material("Gypsum, Plaster of Paris").density_g_per_cm3 == 2.32
    assert find_material("Polyethylene@0.97").density_g_per_cm3 == 0.97
    with pytest.raises(pssf.InputError, match="density of Polyethylene"):
        find_material("Polyethylene@-1")


def test_implant_metals_attenuate_as_tabulated_by_nist():
    sixty = np.array([60.0])
    # Mass attenuation coefficients at 60 keV with coherent scattering, in cm2/g (NIST XCOM).
    for name, density, tabulated in (("Ti@4.51", 4.51, 0.7661), ("Al@2.70", 2.70, 0.2778)):
        assert_allclose(compute_attenuation(name, sixty), tabulated * density / 10, rtol=0.005)
    parts = 0.9 * 0.7661 + 0.06 * 0.2778
    vanadium = compute_attenuation("V@1.0", sixty) * 10 * 0.04
    assert_allclose(compute_attenuation("titanium_alloy", sixty), (parts + vanadium) * 0.443, rtol=0.005)
    metals = ("polyethylene", "titanium_alloy", "stainless_steel", "cobalt_chromium")
    per_mm = [compute_attenuation(name, sixty)[0] for name in metals]
    assert per_mm == sorted(per_mm)


@pytest.mark.parametrize("name", ["bone", "Xx@2.0", "Ti@heavy", "Ti@-1", "Ti@nan", "Ti"])
def test_an_unknown_material_is_named_in_the_error(name):
    with pytest.raises(pssf.InputError, match=name.split("@")[0]):
        compute_attenuation(name, np.array([50.0]))


@given(fraction=st.lists(st.floats(0, 1), min_size=4, max_size=4))
@settings(max_examples=50)
def test_the_reduced_spectrum_changes_signals_by_less_than_0_1_percent(fraction):
    protocol = pssf.load_protocol("reference")
    most = {"muscle": 150.0, "cortical_bone": 30.0, "trabecular_bone": 80.0, "Ti@4.51": 10.0}
    whole, few = compute_beam(resolve_technique(protocol)), compute_reduced_beam(resolve_technique(protocol), most)
    assert len(few.energies_kev) <= 16 < len(whole.energies_kev)
    for second, within in ((False, 1e-3), (True, 1e-2)):
        signals = []
        for beam in (whole, few):
            path = sum(
                compute_attenuation(m, beam.energies_kev) * s * t
                for (m, t), s in zip(most.items(), fraction, strict=True)
            )
            weight = beam.square_kev2 if second else beam.signal_kev
            signals.append((beam.photons_per_mm2 * weight * np.exp(-path)).sum())
        assert_allclose(signals[1], signals[0], rtol=within)


def test_lead_or_zero_mas_gives_an_image_of_offset_and_noise(small):
    paths = {"Pb@11.35": np.full((8, 8), 1000.0, np.float32), "muscle": np.full((8, 8), 50.0, np.float32)}
    tiny = dataclasses.replace(small, rows=8, cols=8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path_mm, protocol in ((paths, tiny), ({}, dataclasses.replace(tiny, mas=0.0))):
            pixels, kept, _ = run_imaging_chain(path_mm, protocol, gap_mm=50.0, keep=("primary", "scatter"))
            assert (kept["primary"] == 0).all()
            assert np.isfinite(kept["scatter"]).all()
            assert abs(pixels.astype(float) - 100).max() < 30


def test_the_heel_effect_falls_towards_the_anode(small):
    rows = heel_factor(resolve_technique(dataclasses.replace(small, heel="anode_proximal")))
    assert_allclose(
        rows[::-1], heel_factor(resolve_technique(dataclasses.replace(small, heel="anode_distal"))), rtol=1e-6
    )
    # At the cathode end, the longer oblique path through the filter reduces the signal slightly.
    assert (np.diff(rows[: len(rows) // 2]) > 0).all()
    assert 0.85 < rows[0] < 0.99 < rows[len(rows) // 2] < 1.01
    assert rows[-1] > 1
    bare = dataclasses.replace(small, noise="none", scatter="none", detector_blur="none", focal_spot_mm=0.0)
    one, other = (
        compute_primary({}, resolve_technique(dataclasses.replace(bare, heel=heel)))
        for heel in ("none", "anode_proximal")
    )
    assert_allclose(other.kev, one.kev * rows[:, None], rtol=1e-5)


def test_dead_pixels_are_zero_and_have_the_same_locations_for_any_seed(small):
    broken = dataclasses.replace(small, dead_pixels=0.01)
    dead = panel_readout.sample_dead_pixels(resolve_technique(broken))
    assert abs(dead.sum() - 0.01 * dead.size) < 5 * np.sqrt(0.01 * dead.size)
    for seed in (1, 2):
        pixels, _, _ = run_imaging_chain({}, broken, gap_mm=50.0, seed=seed)
        assert ((pixels == 0) == dead).all()


def test_a_resolved_technique_can_change_values_but_not_the_detector():
    technique = resolve_technique(pssf.load_protocol("reference"))
    other = technique.replace_protocol(tube_kv=80.0, rows=64)
    assert other == resolve_technique(dataclasses.replace(technique.protocol, tube_kv=80.0, rows=64))
    with pytest.raises(pssf.InputError, match=r"detector must be 'csi', got 'gos'"):
        technique.replace_protocol(detector="gos")


@given(a=st.floats(0, 80), b=st.floats(0, 80))
@settings(max_examples=25)
def test_transmission_of_two_slabs_is_the_product_of_both(a, b):
    technique = resolve_technique(dataclasses.replace(pssf.load_protocol("reference"), rows=64, cols=64))
    beam = Beam(np.array([50.0]), np.array([1e6]), np.array([40.0]), np.array([1600.0]))

    def kev(**lengths):
        return float(
            transmit({k: np.full((64, 64), v, np.float32) for k, v in lengths.items()}, beam, technique).kev[0, 0]
        )

    assert_allclose(kev(muscle=a, water=b) * kev(), kev(muscle=a) * kev(water=b), rtol=1e-5)


def test_each_pixel_of_a_wide_row_depends_on_its_path_lengths():
    rng = np.random.default_rng(3)
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=2, cols=700)
    technique = resolve_technique(protocol)
    beam = compute_beam(technique)
    # Some pixels contain no material, some contain only one of the two materials.
    lengths = {name: rng.uniform(0, 60, (2, 700)) * (rng.random((2, 700)) < 0.6) for name in ("muscle", "cartilage")}
    path_mm = {name: length.astype(np.float32) for name, length in lengths.items()}
    signal, empty = transmit(path_mm, beam, technique), transmit({}, beam, technique)
    passed = np.exp(-sum(path_mm[m][..., None] * compute_attenuation(m, beam.energies_kev) for m in path_mm))
    first = (passed * beam.photons_per_mm2 * beam.signal_kev).sum(axis=-1)
    second = (passed * beam.photons_per_mm2 * beam.square_kev2).sum(axis=-1)
    assert_allclose(signal.kev / empty.kev, first / (beam.photons_per_mm2 * beam.signal_kev).sum(), rtol=1e-5)
    assert_allclose(signal.photon_kev, second / first, rtol=1e-5)


def test_the_open_beam_follows_inverse_square_and_obliquity():
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=3, cols=2001, mono_kev=50.0)
    kev = transmit({}, compute_beam(resolve_technique(protocol)), resolve_technique(protocol)).kev[1]
    slant = np.hypot((np.arange(2001) - 1000) * 0.15, 1150.0)
    assert_allclose(kev / kev[1000], (1150.0 / slant) ** 3, rtol=1e-5)


@pytest.mark.parametrize("setting", [{"mas": 0.0}, {"mono_kev": 60.0}, {"tube_kv": 60.0}])
def test_a_metre_of_lead_gives_no_numerical_warning(setting, small):
    lead = {"Pb@11.35": np.full((256, 256), 1000.0, np.float32)}
    with np.errstate(all="raise", under="ignore"):
        pixels, _, _ = run_imaging_chain(lead, dataclasses.replace(small, **setting), gap_mm=100.0)
    assert pixels.max() < 200


def test_disabled_stages_are_not_run(small):
    bare = dataclasses.replace(
        small, focal_spot_mm=0.0, scatter="none", detector_blur="none", noise="none", mono_kev=60.0
    )
    _, _, seconds = run_imaging_chain({}, bare, gap_mm=100.0)
    assert set(seconds) == {"spectrum", "attenuation", "readout"}


def test_quantum_noise_has_the_expected_variance_and_keeps_the_mean():
    kev = np.full((512, 512), 3000.0, np.float32)
    noisy = quantum_noise.sample_quantum_noise(kev, np.full_like(kev, 50.0), CSI.swank, SEED)
    n, variance = kev.size, 3000.0 * 50.0 / CSI.swank
    assert abs(noisy.mean() - 3000.0) < 5 * np.sqrt(variance / n)
    assert abs(noisy.var() / variance - 1) < 5 * np.sqrt(2 / n)


@pytest.mark.parametrize("photons", [0.0, 1e-6, 1.0, 1e9])
def test_any_photon_count_is_sampled_without_overflow_or_negative_signal(photons):
    kev = np.full((64, 64), photons * 50.0, np.float32)
    noisy = quantum_noise.sample_quantum_noise(kev, np.full_like(kev, 50.0), CSI.swank, SEED)
    assert np.isfinite(noisy).all()
    assert (noisy >= 0).all()
    assert abs(noisy.mean() / 50.0 - photons) <= 6 * np.sqrt(photons / CSI.swank / noisy.size) + 1e-2 * (photons < 1e-3)


@pytest.mark.parametrize("quanta", [0.9, 1.1])
def test_moments_of_photon_counts_are_correct_near_the_gaussian_limit(quanta):
    mean = quanta * quantum_noise.GAUSSIAN_MIN_QUANTA
    # The energy of one quantum is 50 keV divided by the Swank factor.
    kev = np.full((1024, 1024), mean * 50.0 / CSI.swank, np.float32)
    counts = (
        quantum_noise.sample_quantum_noise(kev, np.full_like(kev, 50.0), CSI.swank, SEED).astype(np.float64)
        * CSI.swank
        / 50.0
    )
    deviations, n = (counts - mean) / np.sqrt(mean), counts.size
    assert abs(deviations.mean()) < 5 / np.sqrt(n)
    assert abs(deviations.var() - 1) < 5 * np.sqrt(2 / n)
    # The third and fourth sample moments of a normal variable have variances 15 / n and 96 / n.
    assert abs((deviations**3).mean() - 1 / np.sqrt(mean)) < 0.016 + 5 * np.sqrt(15 / n)
    assert abs((deviations**4).mean() - 3) < 5 * np.sqrt(96 / n)


def test_noise_does_not_depend_on_the_number_of_workers():
    kev = np.full((600, 100), 1000.0, np.float32)
    one, four = (quantum_noise.sample_quantum_noise(kev, kev / 20, CSI.swank, SEED, workers) for workers in (1, 4))
    assert (one == four).all()


@pytest.mark.parametrize("name", ["csi", "gos"])
def test_a_sine_wave_passes_the_panel_as_its_mtf_predicts(name):
    n, pixel, panel_ = 512, 0.15, load_detectors()[name]
    x = np.arange(n) - n / 2
    passed = []
    for per_mm in (0.5, 1.0, 2.0):
        wave = 1 + 0.5 * np.cos(2 * np.pi * per_mm * pixel * x)[None, :] * np.ones((64, 1))
        values = detector_blur.transform_to_frequency(wave.astype(np.float32))
        detector_blur.apply_panel_blur(values, wave.shape, pixel, panel_)
        blurred = detector_blur.transform_to_image(values, wave.shape)
        passed.append(np.ptp(blurred[32, 100:400]) / np.ptp(wave[32, 100:400]))
    assert_allclose(passed, detector_blur.compute_transfer(panel_, np.array([0.5, 1.0, 2.0])), rtol=0.02)
    assert 1 > passed[0] > passed[1] > passed[2] > 0


@pytest.mark.parametrize("per_mm", [0.5, 1.0, 2.0])
def test_the_mtf_of_the_caesium_iodide_panel_matches_published_values(per_mm):
    known = load_reference_tables().quality[f"mtf_{per_mm:g}_per_mm"]
    low, high = known.range or (0.97 * known.value, 1.03 * known.value)
    assert low <= detector_blur.compute_transfer(CSI, np.array([per_mm]))[0] <= high


def test_the_dqe_of_the_caesium_iodide_panel_falls_with_frequency_as_published():
    # Between Samei 2003 and Marshall 2011: 0.68 at 0, 0.6 at 0.5, 0.5 at 1 and 0.3 at 2 per mm.
    per_mm = np.array([0.5, 1.0, 2.0])
    mtf, ntf = (detector_blur.compute_transfer(CSI, per_mm, curve) for curve in ("mtf", "ntf"))
    assert_allclose(0.68 * (mtf / ntf) ** 2, [0.6, 0.5, 0.3], atol=0.05)


def test_the_focal_spot_blurs_by_its_magnified_width():
    protocol = dataclasses.replace(pssf.load_protocol("reference"), pixel_mm=0.01)
    edge = np.where(np.arange(400) < 200, 1.0, 0.0).astype(np.float32)[None, :] * np.ones((40, 1), np.float32)
    blurred = detector_blur.blur_image_by_focal_spot(edge, 1.2, resolve_view(protocol))[20]
    width = (blurred[100:300].sum() - 100, -np.diff(blurred[100:300]).min())
    assert width[1] == pytest.approx(0.01 / (1.2 * (1150 / 950 - 1)), rel=0.2)


def test_blurs_conserve_the_signal_of_a_flat_field():
    flat = np.full((100, 130), 7.0, np.float32)
    values = detector_blur.transform_to_frequency(flat)
    for part in ("mtf", "ntf"):
        detector_blur.apply_panel_blur(values, flat.shape, 0.15, CSI, part)
    assert_allclose(detector_blur.transform_to_image(values, flat.shape), 7.0, rtol=1e-5)
    assert_allclose(
        detector_blur.blur_image_by_focal_spot(flat, 1.2, resolve_view(pssf.load_protocol("reference"))), 7.0, rtol=1e-5
    )


def test_downsampling_and_upsampling_reproduce_a_ramp():
    ramp = np.add.outer(np.arange(70.0), 2 * np.arange(45.0)).astype(np.float32)
    coarse = downsample_by_blocks(ramp, 8)
    assert_allclose(upsample_linear(coarse, 8, ramp.shape)[4:60, 4:36], ramp[4:60, 4:36], rtol=1e-5, atol=1e-3)


def test_displayed_bone_is_brighter_than_muscle_and_muscle_than_air():
    pixels = np.full((300, 300), 40000, np.uint16)
    pixels[:, 60:240], pixels[:, 120:180] = 6000, 2200
    displayed = pssf.render_for_display(pixels).astype(int)
    assert displayed[150, 150] > displayed[150, 90] + 30 > displayed[150, 20] + 60


def test_each_data_file_begins_with_a_comment_on_its_sources():
    for path in (Path(pssf.__file__).parent / "data").glob("*.toml"):
        text = path.read_text()
        assert tomllib.loads(text)
        assert text.startswith("#"), path.name


@pytest.mark.parametrize("heel", ["anode_proximal", "anode_distal"])
@pytest.mark.parametrize("angle_deg", [8.1, 9.0])
def test_the_heel_effect_agrees_with_spekpy_up_to_the_field_edge(heel, angle_deg):
    protocol = dataclasses.replace(pssf.load_protocol("reference"), heel=heel, anode_angle_deg=angle_deg)
    technique = resolve_technique(protocol)
    rows = heel_factor(technique)[:: 1 if heel == "anode_proximal" else -1]
    assert (rows > 0).all()
    assert (np.diff(rows[: rows.argmax() + 1]) > 0).all()
    for row in (3, 60, 700):
        slope = (row - (protocol.rows - 1) / 2) * protocol.pixel_mm / protocol.sdd_mm
        signals = []
        for off_axis in (slope, 0.0):
            energies, photons = tube_spectrum(70.0, angle_deg, 3.0, off_axis=off_axis)
            signals.append((photons * compute_deposited_energy(technique.detector, energies)[0]).sum())
        assert_allclose(rows[row], signals[0] * (1 + slope**2) / signals[1], rtol=1e-3)


def test_the_error_for_an_anode_cut_off_in_the_field_states_the_minimum():
    reference = pssf.load_protocol("reference")
    for angle_deg in (6.0, 7.0, 8.0):
        with pytest.raises(pssf.InputError, match=r"anode_angle_deg must be at least 8\.1 deg .*, got"):
            dataclasses.replace(reference, heel="anode_distal", anode_angle_deg=angle_deg)
    # A collimated field that ends before the cut-off is allowed, and rows beyond it have a finite factor.
    narrow = dataclasses.replace(reference, heel="anode_distal", anode_angle_deg=6.0, field_height_mm=150.0)
    rows = heel_factor(resolve_technique(narrow))
    assert rows.min() > 0.3
    assert rows.max() < 1.2
