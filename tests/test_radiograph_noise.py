"""Estimate the noise of a detector from radiographs with structure: muscle of several thicknesses with bone spheres."""

import dataclasses

import numpy as np
import pytest
import tifffile
import trimesh
from numpy.testing import assert_allclose

import pssf
from pssf.calibration import CalibrationImages, calibrate_detector
from pssf.calibration.noise_spectrum import fit_noise
from pssf.calibration.radiograph_noise import measure_radiograph_noise
from pssf.cli import main
from pssf.core.checks import InputError
from pssf.xray.resolved_technique import resolve_technique

PIXEL_MM = 0.15
# Muscle, in mm, in each quarter of the field beside the open beam.
THICKNESSES_MM = (40.0, 80.0, 120.0)


def make_scene(spheres):
    """Make three slabs of muscle beside the open beam, with bone spheres in front of two of them."""
    surfaces = []
    for number, mm in enumerate(THICKNESSES_MM):
        slab = trimesh.creation.box((24.0, mm, 200.0)).apply_translation((-12.0 + 25.0 * number, 0.0, 0.0))
        surfaces.append(pssf.Surface(slab, "muscle", "air", f"slab_{number}"))
    rng = np.random.default_rng(5)
    for number in range(spheres):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=float(rng.uniform(1.0, 4.0)))
        ball.apply_translation((rng.uniform(-20.0, 45.0), -80.0, 9.0 * (number - spheres / 2)))
        surfaces.append(pssf.Surface(ball, "cortical_bone", "air", f"ball_{number}"))
    return pssf.Scene(surfaces)


@pytest.fixture(scope="module")
def protocol():
    """Return a protocol with grid whose detector differs from csi in NTF and gain."""
    known = resolve_technique(pssf.load_protocol("reference")).detector
    detector = dataclasses.replace(known, ntf_f0_per_mm=1.5, ntf_power=1.7, electrons_per_dn_mm2=40000.0)
    return dataclasses.replace(
        pssf.load_protocol("reference"), rows=1024, cols=1024, pixel_mm=PIXEL_MM, sdd_mm=1500.0, sod_mm=1350.0,
        detector=detector, mas=5.0, scatter="none", grid_ratio=8.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def radiographs(protocol):
    """Return two radiographs with structure."""
    return tuple(pssf.simulate(make_scene(14), protocol, rng=seed, engine="scanline").pixels for seed in (1, 2))


@pytest.fixture(scope="module")
def start(protocol):
    """Return the protocol with the detector from which a calibration starts."""
    known = resolve_technique(pssf.load_protocol("reference")).detector
    return dataclasses.replace(protocol, detector=known, mas=1.0)


def test_radiographs_give_ntf_gain_and_mas(protocol, radiographs, start):
    result = calibrate_detector(CalibrationImages(pixel_mm=PIXEL_MM, radiographs=radiographs), start)
    truth = {"ntf_f0_per_mm": 1.5, "ntf_power": 1.7, "electrons_per_dn_mm2": 40000.0, "mas": 5.0}
    for name, value in truth.items():
        one = result.estimates[name]
        # Four standard errors of statistics, and 3 % for what remains of the structure.
        assert abs(np.log(one.value / value)) < 4 * one.relative_error + 0.03
        assert one.relative_error < 0.05
    assert result.protocol.mas == result.estimates["mas"].value
    held = {name for name, one in result.estimates.items() if one.source == "held"}
    assert held >= {"mtf_f0_per_mm", "thickness_mm", "tube_kv", "filtration_mm_al", "swank", "electrons_per_kev"}
    assert all(result.estimates[name].note for name in held)


def test_the_simulated_noise_equals_that_of_the_radiographs(radiographs, start):
    result = calibrate_detector(CalibrationImages(pixel_mm=PIXEL_MM, radiographs=radiographs), start)
    again = pssf.simulate(make_scene(0), result.protocol, rng=3, engine="scanline").pixels
    real = pssf.simulate(make_scene(0), dataclasses.replace(result.protocol, noise="none"), engine="scanline").pixels
    for columns in (slice(100, 300), slice(370, 480), slice(720, 830)):
        region = (slice(400, 800), columns)
        noise = (again[region].astype(float) - real[region]).std()
        assert noise > 0
        # Differences of neighbouring pixels contain hardly any structure.
        steps = [np.median(np.abs(np.diff(image[region].astype(float), axis=0))) for image in (radiographs[0], again)]
        assert_allclose(steps[0], steps[1], rtol=0.06)


def test_hardening_behind_a_patient_is_not_readout_noise(radiographs, start):
    technique = resolve_technique(dataclasses.replace(start, pixel_mm=PIXEL_MM))
    noise = measure_radiograph_noise(radiographs, technique, None, (1.3, 2.0))
    assert np.all(np.diff(noise.spectra.hardening[np.argsort(noise.spectra.mean_dn)]) <= 1e-9)
    assert 1.08 < noise.spectra.hardening.max() < 1.35
    ignored = fit_noise(noise.spectra._replace(hardening=np.ones(len(noise.spectra.mean_dn))), None, (1.3, 2.0))
    assert ignored.readout_dn > noise.fit.readout_dn


def test_a_saturated_open_beam_gives_no_mas(radiographs, start):
    clipped = tuple(np.minimum(image, np.uint16(np.quantile(image, 0.9))) for image in radiographs)
    result = calibrate_detector(CalibrationImages(pixel_mm=PIXEL_MM, radiographs=clipped), start)
    assert result.estimates["mas"].source == "held"
    assert result.detector.saturation_dn == clipped[0].max()
    assert_allclose(result.detector.ntf_f0_per_mm, 1.5, rtol=0.15)


def test_radiographs_without_homogeneous_regions_are_refused(start):
    rng = np.random.default_rng(0)
    smooth = np.repeat(np.repeat(rng.integers(1000, 30000, (100, 100)), 10, axis=0), 10, axis=1).astype(np.uint16)
    with pytest.raises(InputError, match="at least 40 homogeneous regions"):
        calibrate_detector(CalibrationImages(pixel_mm=PIXEL_MM, radiographs=(smooth,)), start)
    with pytest.raises(InputError, match="at least 40 regions"):
        calibrate_detector(CalibrationImages(pixel_mm=PIXEL_MM, radiographs=(smooth[:200, :200],)), start)


def test_the_command_calibrates_from_radiographs(radiographs, tmp_path, monkeypatch, capsys):
    for number, image in enumerate(radiographs):
        tifffile.imwrite(tmp_path / f"knee_{number}.tif", image)
    monkeypatch.chdir(tmp_path)
    arguments = ["calibrate", "--radiographs", "knee_*.tif", "--pixel", str(PIXEL_MM), "--out", "mine.toml"]
    monkeypatch.setattr("sys.argv", ["pssf", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    assert "no image of an edge" in capsys.readouterr().out
    assert_allclose(pssf.load_detector("mine.toml").ntf_f0_per_mm, 1.5, rtol=0.1)
    assert pssf.load_protocol("mine_protocol.toml").mas > 1.0
    assert "homogeneous regions" in (tmp_path / "mine_page.html").read_text()


def test_radiographs_beside_flat_fields_are_refused():
    flat = np.full((256, 256), 1000, np.uint16)
    with pytest.raises(InputError, match="without flat fields, got 1 flat fields"):
        CalibrationImages(pixel_mm=PIXEL_MM, flats=(flat,), flat_mas=(1.0,), radiographs=(flat,))
