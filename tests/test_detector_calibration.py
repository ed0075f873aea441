"""Check the calibration of detectors: each estimate on its own, a whole calibration, and its files."""

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import pssf
from pssf.calibration import CalibrationImages, Step, calibrate_detector, write_calibration
from pssf.calibration.beam_fit import WedgeSignals, filtered_spectrum, fit_beam
from pssf.calibration.calibration_reader import natural_key, read_calibration_images, read_steps
from pssf.calibration.dark_noise import estimate_dark_noise
from pssf.calibration.edge_blur import EdgeMtf, fit_mtf
from pssf.calibration.noise_spectrum import fit_noise, measure_flat_spectra
from pssf.calibration.signal_response import measure_signal_response
from pssf.cli import main
from pssf.core.checks import InputError
from pssf.validation.imaging.calibration_recovery import (
    compare_calibration,
    draw_blind_detector,
    simulate_calibration_images,
)
from pssf.xray.materials import attenuation_per_mm
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.scintillator_response import compute_deposited_energy

PIXEL_MM = 0.15


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 300.0), st.floats(0.6, 20.0), st.integers(0, 10**6))
def test_offset_and_readout_noise_are_those_before_rounding(offset, noise, seed):
    sample = np.random.default_rng(seed).normal(offset, noise, (300, 300))
    dark = estimate_dark_noise([np.clip(np.rint(sample), 0, 65535).astype(np.uint16)])
    # Five standard errors of 90,000 values. Rounding and values below 0, of which half may be lost, increase them.
    factor = (1.0 + 0.3 / noise) * (4.0 if offset < 3 * noise else 1.0)
    assert abs(dark.offset_dn.value - offset) < 5 * noise / 300 * factor
    assert abs(dark.noise_dn.value / noise - 1) < 5 / (300 * np.sqrt(2)) * factor


@pytest.mark.parametrize("value", [0, 100])
def test_dark_images_without_visible_noise_have_a_wide_interval(value):
    dark = estimate_dark_noise([np.full((128, 128), value, np.uint16)])
    assert dark.offset_dn.low <= value <= dark.offset_dn.high
    assert dark.noise_dn.value < 0.3
    assert dark.noise_dn.high > 2 * dark.noise_dn.value


def test_defective_pixels_do_not_change_the_readout_noise():
    dark = np.rint(np.random.default_rng(1).normal(100.0, 4.0, (256, 256)))
    dark[::16, ::16] = 4000
    assert_allclose(estimate_dark_noise([dark.astype(np.uint16)]).noise_dn.value, 4.0, rtol=0.02)


def test_different_offsets_of_pixels_are_not_readout_noise():
    rng = np.random.default_rng(2)
    pattern = rng.normal(200.0, 10.0, (256, 256))
    darks = [np.rint(pattern + rng.normal(0.0, 3.0, pattern.shape)).astype(np.uint16) for _ in range(2)]
    assert_allclose(estimate_dark_noise(darks).noise_dn.value, 3.0, rtol=0.02)


def make_flats(levels, *, per_signal=1.4, f0=1.7, power=1.9, readout=4.0, pattern=0.0, seed=0):
    """Make flat fields with filtered quantum noise, readout noise and gains of the pixels."""
    rng, side = np.random.default_rng(seed), 512
    f = np.fft.fftfreq(side, PIXEL_MM)
    transfer = 1 / (1 + (np.hypot(*np.meshgrid(f, f)) / f0) ** power)
    gains = 1 + pattern * rng.standard_normal((side, side))
    flats = []
    for level in levels:
        white = rng.normal(0.0, np.sqrt(per_signal * level), (side, side))
        quantum = np.fft.ifft2(np.fft.fft2(white) * transfer).real
        flats.append(np.rint((level + quantum) * gains + rng.normal(0.0, readout, (side, side))))
    return flats


@pytest.mark.parametrize("pattern", [0.0, 0.01])
def test_quantum_noise_ntf_and_gain_variation_are_recovered(pattern):
    spectra = measure_flat_spectra(make_flats((500, 2000, 8000, 30000), pattern=pattern), PIXEL_MM)
    fit = fit_noise(spectra, (4.0, 1e-3), (1.3, 2.1))
    errors = np.sqrt(np.diag(fit.covariance))
    for value, truth, error in zip(fit[:3], (1.4, 1.7, 1.9), errors[:3], strict=True):
        assert abs(np.log(value / truth)) < 4 * error
        assert error < 0.05
    assert_allclose(fit.gain_variation, pattern, atol=5e-4)


def test_readout_noise_follows_from_flat_fields_if_there_are_no_dark_images():
    spectra = measure_flat_spectra(make_flats((50, 500, 5000), readout=20.0), PIXEL_MM)
    assert_allclose(fit_noise(spectra, None, (1.3, 2.1)).readout_dn, 20.0, rtol=0.02)


def expose_flats(mas, curve=lambda signal: signal, top=65535):
    rng = np.random.default_rng(3)
    images = [curve(4000.0 * one) + rng.normal(0, 5, (128, 128)) + 100 for one in mas]
    return [np.clip(np.rint(image), 0, top).astype(np.uint16) for image in images]


def test_signal_per_mas_ignores_saturated_flat_fields():
    mas = (1.0, 2.0, 4.0, 8.0)
    response = measure_signal_response(expose_flats(mas, top=20000), mas, 100.0, np.ones((128, 128)))
    assert_allclose(response.signal_per_mas.value, 4000.0, rtol=1e-3)
    assert response.used == (True, True, True, False)
    assert response.saturation_dn == 20000
    assert response.response is None


def test_a_curved_response_is_recorded_as_a_curve():
    mas = (0.5, 1.0, 2.0, 4.0, 8.0)
    curve = lambda signal: signal * (1 - signal / 200_000)  # noqa: E731
    response = measure_signal_response(expose_flats(mas, curve), mas, 100.0, np.ones((128, 128)))
    linear, recorded = np.array(response.response).T
    for level in mas:
        assert_allclose(
            np.interp(level * response.signal_per_mas.value, linear, recorded), curve(4000 * level), rtol=1e-3
        )


def test_flat_fields_in_the_wrong_order_are_refused():
    mas = (1.0, 2.0, 4.0)
    with pytest.raises(InputError, match="must increase with the mAs"):
        measure_signal_response(expose_flats(mas)[::-1], mas, 100.0, np.ones((128, 128)))


def test_the_equation_of_an_mtf_is_recovered_in_spite_of_a_wrong_value_at_frequency_zero():
    frequency = np.linspace(0, 3.3, 200)
    error = np.full(200, 0.002)
    mtf = 0.99 / (1 + (frequency / 1.3) ** 2.1) + np.random.default_rng(4).normal(0, 0.002, 200)
    fit = fit_mtf(EdgeMtf(frequency, mtf, error), (1.0, 1.7))
    for value, truth, sd in zip(fit[:2], (1.3, 2.1), np.sqrt(np.diag(fit.covariance)), strict=True):
        assert abs(np.log(value / truth)) < 4 * sd


def make_wedge(technique, kv, kv_scale, filtration, noise=1e-5):
    steps = np.array([0.0, 1.0, 2.0, 4.0, 8.0, 12.0, 18.0, 25.0])
    energies, photons = filtered_spectrum(kv * kv_scale, filtration, technique)
    signal = photons * compute_deposited_energy(technique.detector, energies)[0]
    passed = np.exp(-np.outer(steps, attenuation_per_mm(technique.material("Al@2.70"), energies)))
    values = np.log(passed @ signal) + np.random.default_rng(int(kv)).normal(0, noise, len(steps))
    return WedgeSignals(tube_kv=kv, path_mm=steps, log_signal=values, error=np.full(len(steps), 1e-4))


def resolve_with_mass(thickness_mm):
    detector = dataclasses.replace(pssf.load_detector("csi"), escape="none", thickness_mm=thickness_mm)
    return resolve_technique(dataclasses.replace(pssf.load_protocol("reference"), detector=detector))


@pytest.mark.slow
def test_a_wedge_at_two_tube_voltages_gives_voltage_filtration_and_thickness():
    true, start = resolve_with_mass(0.4), resolve_with_mass(0.55)
    fit = fit_beam([make_wedge(true, kv, 1.02, 3.6) for kv in (50.0, 80.0)], start, "Al@2.70")
    assert fit.held == ()
    assert_allclose(fit.kv_scale, 1.02, rtol=5e-4)
    assert_allclose(fit.filtration_mm_al, 3.6, rtol=5e-3)
    assert_allclose(fit.mg_per_cm2, true.detector.mg_per_cm2, rtol=0.02)


def test_what_one_tube_voltage_with_few_steps_does_not_determine_is_held():
    true = resolve_with_mass(0.55)
    wedge = make_wedge(true, 70.0, 1.0, 3.0)
    coarse = dataclasses.replace(wedge, error=np.full(len(wedge.path_mm), 2e-3))
    fit = fit_beam([coarse], true, "Al@2.70")
    assert "mg_per_cm2" in fit.held
    assert fit.mg_per_cm2 == pytest.approx(true.detector.mg_per_cm2)


@pytest.fixture(scope="module")
def blind():
    """Detector without escape, whose response needs no simulation."""
    drawn = draw_blind_detector(1)
    return drawn._replace(
        protocol=dataclasses.replace(drawn.protocol, detector=drawn.protocol.detector.without_escape()),
        nominal=dataclasses.replace(drawn.nominal, detector=drawn.nominal.detector.without_escape()),
    )


@pytest.fixture(scope="module")
def images(blind):
    return simulate_calibration_images(blind, 1)


@pytest.fixture(scope="module")
def calibration(blind, images):
    return calibrate_detector(images, blind.nominal)


def test_a_simulated_detector_is_recovered(calibration, blind):
    row = compare_calibration(calibration, blind)
    assert row["mtf_percent"] < 2.0
    assert row["nnps_percent"] < 3.0
    assert abs(row["electrons_per_dn_mm2_percent"]) < 1.0
    assert abs(row["readout_electrons_percent"]) < 1.0
    assert abs(row["thickness_mm_percent"]) < 5.0
    assert abs(row["contrast_percent"]) < 1.4


def test_without_a_wedge_the_beam_is_held(images, blind):
    few = dataclasses.replace(images, wedges=(), steps=())
    estimates = calibrate_detector(few, blind.nominal).estimates
    for name in ("tube_kv", "filtration_mm_al", "thickness_mm"):
        assert estimates[name].source == "held"
    assert estimates["mtf_f0_per_mm"].source == "measured"


@pytest.mark.slow
def test_flat_fields_may_be_smaller_than_the_wedge_images(images, blind, calibration):
    small = tuple(flat[384:640, 384:640] for flat in images.flats)
    result = calibrate_detector(dataclasses.replace(images, flats=small, darks=images.darks), blind.nominal)
    for name in ("tube_kv", "filtration_mm_al", "thickness_mm"):
        one, other = result.estimates[name], calibration.estimates[name]
        assert_allclose(one.value, other.value, rtol=1e-4)


def test_each_kind_of_image_alone_is_enough(images, blind):
    for kept in ("darks", "edge"):
        alone = CalibrationImages(pixel_mm=PIXEL_MM, **{kept: getattr(images, kept)})
        result = calibrate_detector(alone, blind.nominal)
        sources = {name: one.source for name, one in result.estimates.items()}
        assert "measured" in sources.values()
        assert sources["electrons_per_dn_mm2"] == "held"
        assert result.detector.electrons_per_dn_mm2 == blind.nominal.detector.electrons_per_dn_mm2


def test_written_files_are_read_by_simulate(calibration, tmp_path):
    paths = write_calibration(calibration, tmp_path / "mine.toml")
    assert [path.name for path in paths[:3]] == ["mine.toml", "mine_protocol.toml", "mine_estimates.csv"]
    detector = pssf.load_detector(paths[0])
    assert_allclose(detector.thickness_mm, calibration.detector.thickness_mm, rtol=1e-6)
    protocol = pssf.load_protocol(paths[1])
    assert_allclose(protocol.tube_kv, calibration.protocol.tube_kv, rtol=1e-6)
    assert protocol.detector == detector
    assert "Noise power" in paths[3].read_text()


def write_inputs(images, folder: Path):
    for number, flat in enumerate(images.flats, start=1):
        tifffile.imwrite(folder / f"flat_{number * 4}.tif", flat)
    tifffile.imwrite(folder / "dark.tif", images.darks[0])
    for wedge in images.wedges:
        tifffile.imwrite(folder / f"wedge_{wedge.tube_kv:.0f}.tif", wedge.image)
    with (folder / "steps.csv").open("w", newline="") as file:
        rows = csv.DictWriter(file, ["thickness_mm", "top", "bottom", "left", "right"])
        rows.writeheader()
        rows.writerows(dataclasses.asdict(step) for step in images.steps)


def test_files_are_read_in_the_order_of_their_numbers(images, tmp_path):
    write_inputs(images, tmp_path)
    read = read_calibration_images(
        darks=[tmp_path / "dark.tif"],
        flats=sorted(tmp_path.glob("flat_*.tif")),
        flat_mas=images.flat_mas,
        wedges=[tmp_path / "wedge_50.tif", tmp_path / "wedge_100.tif"],
        steps=tmp_path / "steps.csv",
    )
    means = [flat.mean() for flat in read.flats]
    assert means == sorted(means)
    assert [wedge.tube_kv for wedge in read.wedges] == [50.0, 100.0]
    assert read.steps == images.steps
    assert natural_key(Path("flat_2.tif")) < natural_key(Path("flat_10.tif"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--flats", "flat_4.tif"], "mas must be one number per flat field, got 0 for 1"),
        (["--flats", "flat_4.tif", "--mas", "a"], "mas must be numbers separated by commas"),
        (["--flats", "none_*.tif"], "no file matches"),
        (["--wedge", "wedge_50.tif"], "steps must be a CSV file"),
        ([], "images must include"),
        (["--edge", "dark.tif"], "edge"),
    ],
)
def test_wrong_input_gives_one_line_and_exit_code_2(arguments, message, images, tmp_path, monkeypatch, capsys):
    write_inputs(images, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["pssf", "calibrate", *arguments, "--out", "mine.toml"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert not Path("mine.toml").exists()


def test_a_table_of_steps_with_a_wrong_value_is_refused(tmp_path):
    path = tmp_path / "steps.csv"
    path.write_text("thickness_mm,top,bottom,left,right\n0,1,2,3,x\n")
    with pytest.raises(InputError, match="line 2"):
        read_steps(path)


def test_regions_outside_the_image_are_refused(images):
    wrong = (*images.steps[:-1], Step(thickness_mm=25.0, top=0, bottom=50, left=1000, right=1100))
    with pytest.raises(InputError, match="region of the step of 25 mm"):
        dataclasses.replace(images, steps=wrong)
