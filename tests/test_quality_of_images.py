"""MTF, noise power spectrum, DQE and exposure index of images: closed forms, statistics and refusals."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.special import erf

import pssf
from pssf.detector.detector_blur import compute_transfer
from pssf.model.detector import load_detectors
from pssf.quality import measure_edge_mtf, measure_flat_nnps, measure_image_dqe, measure_image_exposure_index


def make_edge(angle_deg, sigma_px, shape=(200, 220), shift_px=0.0):
    """Make the image of an edge with Gaussian blur, sampled at the pixel centres."""
    rows, cols = np.mgrid[: shape[0], : shape[1]] - np.array(shape)[:, None, None] / 2
    across = cols * np.cos(np.deg2rad(angle_deg)) + rows * np.sin(np.deg2rad(angle_deg)) - shift_px
    return 1000.0 + 400.0 * erf(across / (sigma_px * np.sqrt(2)))


@settings(max_examples=15, deadline=None)
@given(
    angle_deg=st.one_of(st.floats(1.0, 15.0), st.floats(-15.0, -1.0)), sigma_px=st.floats(0.5, 1.5),
    turned=st.booleans(), falling=st.booleans(), shift_px=st.floats(-20.0, 20.0),
)  # fmt: skip
def test_the_mtf_of_a_gaussian_edge_is_gaussian(angle_deg, sigma_px, turned, falling, shift_px):
    image = make_edge(angle_deg, sigma_px, shift_px=shift_px)
    image = image.T if turned else image
    image = 3000.0 - image if falling else image
    frequency, mtf = measure_edge_mtf(image, 0.2)
    expected = np.exp(-2 * (np.pi * sigma_px * frequency * 0.2) ** 2)
    assert_allclose(mtf, expected, atol=0.015)


def test_noise_changes_the_mtf_by_less_than_its_statistical_error():
    noise = np.random.default_rng(3).normal(0.0, 4.0, (400, 400))
    image = make_edge(2.5, 0.8, shape=(400, 400)) + noise
    frequency, mtf = measure_edge_mtf(image, 0.1)
    expected = np.exp(-2 * (np.pi * 0.8 * frequency * 0.1) ** 2)
    # Each bin holds 50 pixels; the noise of the 1,536 differences adds to a standard error of 0.03.
    assert np.abs(mtf - expected)[frequency < 4.0].max() < 0.1
    assert np.abs(mtf - expected)[frequency < 4.0].mean() < 0.03


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((200, 200)), "straight edge"),
        (make_edge(0.0, 1.0), "angle of the edge"),
        (make_edge(30.0, 1.0), "angle of the edge|from the border"),
        (make_edge(3.0, 1.0, shift_px=104.0), "from the border"),
        (np.random.default_rng(0).random((200, 200)), "straight edge|angle|from the border"),
        (np.zeros((200, 200, 3)), "two-dimensional"),
        (np.full((200, 200), np.nan), "finite"),
        (np.zeros((8, 8)), "at least 32 pixels"),
    ],
)
def test_an_image_without_a_usable_edge_is_refused(image, message):
    with pytest.raises(pssf.InputError, match=message):
        measure_edge_mtf(image, 0.1)


def test_white_noise_has_a_flat_noise_power_spectrum():
    mean, sigma, pixel_mm = 1000.0, 20.0, 0.15
    flats = np.random.default_rng(1).normal(mean, sigma, (6, 512, 512))
    frequency, nnps = measure_flat_nnps(flats, pixel_mm)
    expected = (sigma / mean) ** 2 * pixel_mm**2
    # Five independent fields of sixteen regions; a ring of the lowest frequencies has at least 8 values.
    assert_allclose(nnps, expected, rtol=6 / np.sqrt(5 * 16 * 8))
    assert_allclose(nnps[len(nnps) // 2 :].mean(), expected, rtol=0.01)
    assert frequency.max() < 0.5 / pixel_mm


def test_a_photon_counter_has_a_dqe_of_one():
    photons, pixel_mm = 400.0, 0.2
    flats = np.random.default_rng(2).poisson(photons, (6, 256, 256))
    nnps = measure_flat_nnps(flats, pixel_mm)
    kerma_ugy = photons / pixel_mm**2 / 30174.0
    _, dqe = measure_image_dqe((np.array([0.0, 10.0]), np.ones(2)), nnps, kerma_ugy)
    assert abs(dqe.mean() - 1) < 0.03


def test_the_exposure_index_is_a_hundred_times_the_kerma_of_the_median():
    assert measure_image_exposure_index(np.array([1.0, 5.0, 100.0]), 2.0) == 250.0


@pytest.mark.parametrize(
    ("flats", "message"),
    [
        ([np.ones((200, 200))], "at least two images"),
        ([np.ones((200, 200)), np.ones((200, 201))], "same shape"),
        ([np.ones((100, 200))] * 2, "128 x 128"),
        ([-np.ones((200, 200))] * 2, "mean of the flats"),
    ],
)
def test_unusable_flat_fields_are_refused(flats, message):
    with pytest.raises(pssf.InputError, match=message):
        measure_flat_nnps(flats, 0.1)


def test_a_simulated_edge_image_yields_the_mtf_of_the_detector():
    plate = trimesh.creation.box((60, 1.0, 200))
    plate.apply_translation((30, 0, 0))
    plate.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(2.5), (0, 1, 0)))
    scene = pssf.Scene([pssf.Surface(plate, "W@19.25", "air", "plate")])
    protocol = dataclasses.replace(
        pssf.load_protocol("reference"), rows=320, cols=320, pixel_mm=0.15, sod_mm=1149.0, focal_spot_mm=0.0,
        scatter="none", noise="none", subpixels=4, mas=1.0,
    )  # fmt: skip
    pixels = pssf.simulate(scene, protocol, engine="scanline").pixels.astype(float)
    frequency, mtf = measure_edge_mtf(pixels, 0.15)
    expected = compute_transfer(load_detectors()["csi"], frequency)
    used = frequency < 0.8 * 0.5 / 0.15
    assert_allclose(mtf[used], expected[used], atol=0.02)
