"""Detectors, spectra, filters and focal spots of the user: closed forms, files and error messages."""

import dataclasses

import numpy as np
import pytest
import xraylib
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pssf
from pssf.detector import detector_blur
from pssf.detector.panel_readout import linearise_pixels, sample_pixel_gains, simulate_readout
from pssf.geometry.view import SIGMA_PER_FWHM, make_focal_spot_views, resolve_view
from pssf.model.detector import load_detectors
from pssf.model.protocol import protocol_from_dict, protocol_to_dict
from pssf.xray.materials import attenuation_per_mm, parse_compound
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.scintillator_response import compute_interacting_fraction
from pssf.xray.spectrum import compute_beam, tube_spectrum

CSI = load_detectors()["csi"]
SMALL = dataclasses.replace(
    pssf.load_protocol("reference").resample(32),
    focal_spot_mm=0.0, scatter="none", noise="none", detector_blur="none", mas=0.5,
)  # fmt: skip
OPEN = pssf.Scene([])


def take(**changes):
    """Simulate an open beam with changed fields of the protocol."""
    return pssf.simulate(OPEN, dataclasses.replace(SMALL, **changes), engine="scanline").pixels


def change_csi(**changes):
    """Return the detector csi with changed fields."""
    return dataclasses.replace(CSI, name="changed", **changes)


def test_an_ideal_detector_absorbs_the_entire_energy():
    detector = load_detectors()["ideal"]
    protocol = dataclasses.replace(SMALL, detector="ideal", mono_kev=60.0, rows=1, cols=1)
    pixel = int(take(detector="ideal", mono_kev=60.0, rows=1, cols=1)[0, 0])
    energy_kev = 60.0 * 1e6 * protocol.mas * (1000.0 / protocol.sdd_mm) ** 2 * protocol.pixel_mm**2
    per_dn = detector.electrons_per_dn_mm2 * protocol.pixel_mm**2 / detector.electrons_per_kev
    assert abs(pixel - (detector.offset_dn + energy_kev / per_dn)) <= 1.0
    assert_array_equal(detector_blur.compute_transfer(detector, np.linspace(0, 10, 50)), 1.0)


@pytest.mark.parametrize("kev", [20.0, 45.0, 100.0, 400.0])
def test_a_cover_attenuates_by_the_beer_lambert_law(kev):
    energies, layers = np.array([kev]), (("C@1.8", 2.0), ("Al@2.7", 0.3))
    bare, covered = (compute_interacting_fraction(change_csi(cover=cover), energies)[0] for cover in ((), layers))
    depth = sum(mm * attenuation_per_mm(parse_compound(name), energies)[0] for name, mm in layers)
    assert_allclose(covered / bare, np.exp(-depth), rtol=1e-12)


def test_filters_attenuate_each_bin_of_the_spectrum():
    plain, filtered = (
        compute_beam(resolve_technique(dataclasses.replace(SMALL, filters=filters)))
        for filters in ((), (("Cu@8.96", 0.1), ("Be@1.85", 1.0)))
    )
    assert_array_equal(plain.energies_kev, filtered.energies_kev)
    depth = 0.1 * attenuation_per_mm(parse_compound("Cu@8.96"), plain.energies_kev)
    depth += attenuation_per_mm(parse_compound("Be@1.85"), plain.energies_kev)
    assert_allclose(filtered.photons_per_mm2, plain.photons_per_mm2 * np.exp(-depth), rtol=1e-12)


def test_bins_end_at_the_k_edge_of_a_filter():
    beam = compute_beam(resolve_technique(dataclasses.replace(SMALL, filters=(("Gd@7.9", 0.1),))))
    energies = beam.energies_kev[beam.energies_kev > 20.0]
    assert np.diff(energies).max() < 0.11
    edge = np.searchsorted(energies, xraylib.EdgeEnergy(64, xraylib.K_SHELL))
    assert energies[edge] - energies[edge - 1] < 0.0999  # one bin is split at the edge


def test_aluminium_as_a_filter_equals_more_filtration():
    by_filter, by_field = (
        compute_beam(resolve_technique(dataclasses.replace(SMALL, **changes)))
        for changes in ({"filters": (("Al@2.699", 1.0),)}, {"filtration_mm_al": SMALL.filtration_mm_al + 1.0})
    )
    # SpekPy and xraylib have different cross sections.
    assert_allclose(
        (by_filter.photons_per_mm2 * by_filter.signal_kev).sum(),
        (by_field.photons_per_mm2 * by_field.signal_kev).sum(),
        rtol=0.01,
    )


def test_the_computed_spectrum_given_as_an_own_spectrum_yields_the_same_pixels(tmp_path):
    bins = list(zip(*tube_spectrum(70.0, 12.0, 3.0), strict=True))
    (tmp_path / "bins.csv").write_text("kev,photons\n" + "\n".join(f"{e!r},{n!r}" for e, n in np.array(bins).tolist()))
    file = tmp_path / "mine.toml"
    file.write_text('base = "reference"\nname = "mine"\nspectrum = "bins.csv"\n')
    assert_array_equal(take(spectrum=bins), take())
    assert pssf.load_protocol(file).spectrum == tuple(map(tuple, np.array(bins).tolist()))


def test_a_gaussian_focal_spot_has_its_full_width_at_half_maximum():
    protocol = dataclasses.replace(SMALL, focal_spot_mm=1.2, focal_spot_shape="gaussian")
    views, centre = make_focal_spot_views(protocol), resolve_view(protocol).source_mm
    weights = np.array([weight for _, weight in views])
    off = np.array([view.source_mm for view, _ in views]) - centre
    assert_allclose(weights.sum(), 1.0, rtol=1e-12)
    sigma = 1.2 * SIGMA_PER_FWHM
    assert_allclose(weights @ off**2, [sigma**2, 0.0, sigma**2], rtol=1e-9, atol=1e-12)
    assert_allclose(weights @ off[:, 0] ** 4, 3 * sigma**4, rtol=1e-9)


@pytest.mark.parametrize("shape", ["square", "gaussian"])
def test_focal_spot_blur_has_the_variance_of_the_focal_spot(shape):
    image, width = np.zeros((129, 129), np.float32), 6.0
    image[64, 64] = 1.0
    values = detector_blur.transform_to_frequency(image)
    detector_blur.apply_focal_spot_blur(values, image.shape, width, shape)
    spread = detector_blur.transform_to_image(values, image.shape).astype(np.float64)
    place = np.arange(129) - 64.0
    variance = (spread.sum(axis=0) * place**2).sum() / spread.sum()
    # The image has no frequencies above the Nyquist frequency, which widens the sides of the square.
    assert_allclose(variance, {"square": width**2 / 12, "gaussian": (width * SIGMA_PER_FWHM) ** 2}[shape], rtol=0.06)


def test_a_table_of_the_mtf_equals_the_equation():
    per_mm = np.linspace(0, 8, 1601)
    law = detector_blur.compute_transfer(CSI, per_mm)
    table = tuple(zip(per_mm.tolist(), law.tolist(), strict=True))
    image = np.random.default_rng(0).random((64, 48), np.float32)
    blurred = []
    for detector in (CSI, change_csi(mtf=table)):
        values = detector_blur.transform_to_frequency(image)
        detector_blur.apply_panel_blur(values, image.shape, 0.15, detector)
        blurred.append(detector_blur.transform_to_image(values, image.shape))
    assert_allclose(blurred[1], blurred[0], atol=1e-5)


@given(fraction=st.floats(0.01, 0.5), length_mm=st.floats(1.0, 100.0))
def test_glare_lowers_the_mtf_by_its_fraction(fraction, length_mm):
    detector = change_csi(glare_fraction=fraction, glare_mm=length_mm)
    per_mm = np.array([0.0, 5.0])
    expected = np.array([1.0, 1 - fraction]) * detector_blur.compute_transfer(CSI, per_mm)
    assert_allclose(detector_blur.compute_transfer(detector, per_mm), expected, rtol=2e-3)


@settings(deadline=None)
@given(
    steps=st.lists(st.tuples(st.floats(10, 5000), st.floats(10, 2000)), min_size=1, max_size=8),
    kev=st.floats(0, 3e4),
)
def test_pixels_with_a_response_curve_can_be_made_linear_again(steps, kev):
    curve = np.vstack(([0.0, 0.0], np.cumsum(steps, axis=0)))
    technique = resolve_technique(dataclasses.replace(SMALL, detector=change_csi(response=curve.tolist())))
    straight = resolve_technique(dataclasses.replace(SMALL, detector=change_csi()))
    energy = np.full((2, 2), kev, np.float32)
    expected = linearise_pixels(simulate_readout(energy, straight, None), CSI)
    pixels = simulate_readout(energy, technique, None)
    if expected[0, 0] >= curve[-1, 0] or pixels.max() >= 65535:
        return  # the curve is flat, or the detector is saturated
    # Rounding to whole DN is a change of half a DN, divided by the slope of the curve.
    tolerance = 0.5 + 0.51 * max(over / up for over, up in steps)
    assert_allclose(linearise_pixels(pixels, technique.detector), expected, atol=tolerance)


def test_a_detector_saturates_at_its_largest_value():
    assert take(detector=change_csi(saturation_dn=4095), mas=50.0).max() == 4095


def test_gains_of_pixels_are_the_same_in_each_exposure_and_have_the_given_spread():
    detector = change_csi(gain_variation=0.03)
    technique = resolve_technique(dataclasses.replace(SMALL, detector=detector, rows=400, cols=400))
    gains = sample_pixel_gains(technique)
    # Bounds of five standard errors of mean and standard deviation.
    assert abs(gains.mean() - 1) < 5 * 0.03 / 400
    assert abs(gains.std() - 0.03) < 5 * 0.03 / np.sqrt(2 * 400**2)
    assert_array_equal(gains, sample_pixel_gains(technique))
    assert_array_equal(take(detector=detector), take(detector=detector))
    varied = take(detector=detector) - 100.0
    assert abs((varied / (take(detector=change_csi()) - 100.0)).std() - 0.03) < 5 * 0.03 / np.sqrt(2 * 32**2)


def test_a_detector_file_inherits_from_its_base_and_lies_beside_the_protocol(tmp_path):
    (tmp_path / "base.toml").write_text('base = "gos"\nname = "mine"\nthickness_mm = 0.2\ncover = [["C@1.8", 1]]\n')
    (tmp_path / "panel.toml").write_text('base = "base.toml"\nreadout_electrons = 900\n')
    (tmp_path / "protocol.toml").write_text('base = "reference"\nname = "own"\ndetector = "panel.toml"\n')
    detector = pssf.load_protocol(tmp_path / "protocol.toml").detector
    gos = load_detectors()["gos"]
    assert detector == dataclasses.replace(
        gos, name="panel", thickness_mm=0.2, cover=(("C@1.8", 1.0),), readout_electrons=900.0
    )
    protocol = dataclasses.replace(SMALL, detector=detector)
    assert protocol_from_dict(protocol_to_dict(protocol), "test") == protocol
    assert dataclasses.replace(SMALL, detector=tmp_path / "panel.toml") == protocol


@pytest.mark.parametrize("suffix", [".tif", ".dcm"])
def test_a_radiograph_file_contains_the_entire_detector_and_spectrum(tmp_path, suffix):
    protocol = dataclasses.replace(
        SMALL, detector=change_csi(mtf=[[0, 1], [5, 0.2]]), spectrum=[[30, 1e5], [60, 2e5]], filters=[["Cu@8.96", 0.1]]
    )
    made = pssf.simulate(pssf.Knee(), protocol, engine="scanline")
    pssf.save(made, tmp_path / f"image{suffix}")
    assert pssf.load(tmp_path / f"image{suffix}").protocol == protocol


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"detector": "cis"}, r"detector must be .*csi.*'cis' \(did you mean 'csi'\?\)"),
        ({"detector": 3}, "detector must be a name, the path of a .toml file or a Detector, got 3"),
        ({"detector": "missing.toml"}, "missing.toml"),
        ({"filters": [["Cu@8.96"]]}, "filters must be pairs of a material and a thickness"),
        ({"filters": [["Cu@8.96", -1]]}, "thickness of Cu@8.96 in filters"),
        ({"filters": [["Cu@8.96", 1]], "mono_kev": 60.0}, "filters must be empty with mono_kev"),
        ({"spectrum": [[30, 1.0], [30, 1.0]]}, "first column of spectrum must ascend"),
        ({"spectrum": [[30, 0.0], [40, 0.0]]}, "spectrum must have photons"),
        ({"spectrum": [[30, 1.0], [40, 1.0]], "mono_kev": 60.0}, "mono_kev must be None"),
        ({"spectrum": [[30, 1.0], [40, 1.0]], "heel": "anode_distal"}, "heel must be 'none'"),
        ({"spectrum": 5}, "spectrum must be 2 to 2000 pairs"),
    ],
)  # fmt: skip
def test_an_invalid_beam_or_detector_is_refused(changes, message):
    with pytest.raises(pssf.InputError, match=message):
        dataclasses.replace(SMALL, **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mtf": [[0.1, 1], [1, 0.5]]}, "mtf must begin with frequency 0 and value 1"),
        ({"response": [[0, 0], [10, 5], [20, 4]]}, "values of response must not fall"),
        ({"response": [[0, 5], [10, 6]]}, "response must begin with"),
        ({"offset_dn": 5000, "saturation_dn": 4095}, "offset_dn must be less than saturation_dn = 4095, got 5000"),
        ({"swank": 1.5}, "swank must be"),
        ({"cover": "C"}, "cover must be pairs"),
    ],
)
def test_an_invalid_detector_is_refused(changes, message):
    with pytest.raises(pssf.InputError, match=message):
        change_csi(**changes)


@pytest.mark.parametrize(
    "changes", [{"filters": [["Unobtainium", 1.0]]}, {"detector": change_csi(formula="Xx")}], ids=["filter", "formula"]
)
def test_an_unknown_material_is_refused_before_the_simulation(changes):
    with pytest.raises(pssf.InputError, match="material"):
        take(**changes)


def test_circular_detector_files_are_refused(tmp_path):
    (tmp_path / "a.toml").write_text('base = "b.toml"\n')
    (tmp_path / "b.toml").write_text('base = "a.toml"\n')
    with pytest.raises(pssf.InputError, match=r"bases of detector a\.toml must not be circular"):
        pssf.load_detector(tmp_path / "a.toml")
