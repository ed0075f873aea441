"""Test the texture measures against direct computations, closed forms and invariants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from pssf.core.checks import InputError
from pssf.texture import (
    TEXTURE_FAMILIES,
    fractal_signature,
    hurst_orientation_transform,
    local_binary_patterns,
    measure_texture_features,
    mirror_texture_features,
    spectral_slope,
    variance_orientation_transform,
)
from pssf.texture.directional_variogram import measure_variogram
from pssf.texture.rod_ranges import measure_rod_ranges
from pssf.texture.rose_ellipse import fit_ellipse
from pssf.texture.scaling_laws import fit_local_slopes, fit_parabola, fit_slope
from pssf.texture.texture_scales import prepare_region
from pssf.validation.study_methods.fractional_surface import make_anisotropic_surface, make_fractional_surface

MM = 0.2
LINEAR_MEASURES = ("fsa", "vot", "hot", "spectrum")


def make_noise(seed: int, shape=(60, 70)):
    return ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.0)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_variogram_equals_the_mean_over_all_pairs_of_the_mask(seed):
    image = make_noise(seed)
    mask = np.random.default_rng(seed).random(image.shape) < 0.8
    region = prepare_region(image, 1.0, mask, (2.0, 3.0, 4.0))
    measured = measure_variogram(region, np.array([0.0, 90.0]))
    for scale, (across, down) in zip((2, 3, 4), measured.T, strict=True):
        pairs = region.mask[:, scale:] & region.mask[:, :-scale]
        squares = (region.values[:, scale:] - region.values[:, :-scale]) ** 2
        assert across == pytest.approx(squares[pairs].mean(), rel=1e-6)
        pairs = region.mask[scale:] & region.mask[:-scale]
        assert down == pytest.approx(((region.values[scale:] - region.values[:-scale]) ** 2)[pairs].mean(), rel=1e-6)


@pytest.mark.parametrize(("direction", "shape"), [(0.0, (1, 7)), (90.0, (7, 1))])
def test_the_range_along_rods_equals_dilation_minus_erosion(direction, shape):
    image = make_noise(1)
    lengths, ranges = measure_rod_ranges(prepare_region(image, 1.0, None, (2.0, 3.0, 4.0)), direction)
    reach = int(lengths[-1])
    spread = ndimage.grey_dilation(image, size=shape) - ndimage.grey_erosion(image, size=shape)
    inner = np.s_[:, reach:-reach] if direction == 0.0 else np.s_[reach:-reach]
    assert ranges[lengths == 3][0] == pytest.approx(spread[inner].mean(), rel=1e-12)


def test_power_laws_give_their_exponent_at_every_scale():
    scales = np.geomspace(0.4, 1.6, 7)
    assert fit_slope(scales, 3.0 * scales**0.7) == pytest.approx(0.7)
    by_scale = fit_local_slopes(scales, np.stack((scales**0.7, scales**-0.2)))
    np.testing.assert_allclose(by_scale, np.repeat([[0.7], [-0.2]], 5, axis=1))
    assert fit_parabola(scales, 2.0 + 0.5 * (scales - scales.mean()) ** 2) == pytest.approx((2.0, 0.0, 0.5))


def test_an_exponent_that_changes_with_scale_is_found_at_each_scale():
    # log v = 0.8 log s + 0.3 (log s)^2 has the exponent 0.8 + 0.6 log s.
    scales = np.geomspace(0.4, 1.6, 7)
    values = np.exp(0.8 * np.log(scales) + 0.3 * np.log(scales) ** 2)
    np.testing.assert_allclose(fit_local_slopes(scales, values), 0.8 + 0.6 * np.log(scales[1:-1]))


def test_noise_without_an_ellipse_has_an_aspect_ratio():
    for seed in range(50):
        ellipse = fit_ellipse(np.arange(0.0, 180.0, 10.0), np.random.default_rng(seed).normal(0.0, 0.05, 18))
        assert 0.0 <= ellipse.aspect_ratio <= 1.0
        assert 0.0 <= ellipse.orientation_deg <= 180.0


@settings(max_examples=20, deadline=None)
@given(ratio=st.floats(0.1, 0.99), angle=st.floats(1.0, 179.0))
def test_an_ellipse_is_found_again_from_its_rose_plot(ratio, angle):
    directions = np.arange(0.0, 180.0, 10.0)
    turned = np.deg2rad(directions - angle)
    ellipse = fit_ellipse(directions, 1 / np.hypot(np.cos(turned), np.sin(turned) / ratio))
    assert ellipse.aspect_ratio == pytest.approx(ratio, rel=1e-6)
    assert ellipse.orientation_deg == pytest.approx(angle, abs=1e-4)


@pytest.mark.parametrize("dimension", [2.2, 2.5, 2.8])
def test_the_surfaces_have_the_mean_square_of_their_dimension(dimension):
    squares = np.zeros((20, 2))
    for seed in range(20):
        surface = make_fractional_surface(dimension, 128, seed)
        squares[seed] = [np.square(surface[:, lag:] - surface[:, :-lag]).mean() for lag in (1, 16)]
    exponent = np.log(squares.mean(axis=0)[1] / squares.mean(axis=0)[0]) / np.log(16) / 2
    # Four standard errors of the mean of 20 surfaces, estimated from 200: 0.03.
    assert 3.0 - exponent == pytest.approx(dimension, abs=0.04)


@pytest.mark.parametrize("dimension", [2.3, 2.6, 2.9])
def test_fractional_surfaces_have_their_dimension(dimension):
    surfaces = [make_fractional_surface(dimension, 128, seed) for seed in range(8)]
    of_variance = [variance_orientation_transform(one, pixel_mm=MM).mean_dimension for one in surfaces]
    assert np.mean(of_variance) == pytest.approx(dimension, abs=0.03)
    signatures = [fractal_signature(one, pixel_mm=MM) for one in surfaces]
    both = [(one.horizontal_dimension + one.vertical_dimension) / 2 for one in signatures]
    assert np.mean(both) == pytest.approx(dimension, abs=0.06)
    # The samples of a rod miss the extremes of a rough surface.
    of_range = np.mean([hurst_orientation_transform(one, pixel_mm=MM).mean_dimension for one in surfaces])
    assert dimension - 0.32 < of_range < dimension + 0.02


def test_smooth_surfaces_have_the_exponent_of_their_spectrum():
    exponents = [spectral_slope(make_fractional_surface(2.3, 128, seed), pixel_mm=MM)["all"] for seed in range(8)]
    assert 4 - np.mean(exponents) / 2 == pytest.approx(2.3, abs=0.08)


@pytest.mark.parametrize("direction", [20.0, 75.0, 130.0])
def test_the_orientation_is_across_the_roughest_frequencies(direction):
    vectors, ratios = [], []
    for seed in range(10):
        surface, _ = make_anisotropic_surface(2.2, 2.8, direction, 128, seed)
        for transform in (variance_orientation_transform, hurst_orientation_transform):
            texture = transform(surface, pixel_mm=MM)
            vectors.append(np.exp(2j * np.deg2rad(texture.orientation_deg)))
            ratios.append(texture.aspect_ratio)
    assert np.mean(ratios) < 0.92
    mean_deg = np.rad2deg(np.angle(np.mean(vectors))) / 2
    # The orientation of one surface has a standard deviation of about 12 degrees.
    assert abs((mean_deg - direction) % 180.0 - 90.0) < 12.0


@settings(max_examples=10, deadline=None)
@given(gain=st.floats(0.01, 1e4), offset=st.floats(-1e4, 1e4))
def test_gain_and_offset_change_no_texture_feature(gain, offset):
    image = make_noise(3)
    before = measure_texture_features(image, pixel_mm=MM)
    after = measure_texture_features(gain * image + offset, pixel_mm=MM)
    for name, value in before.items():
        # Patterns of equal grey values depend on rounding errors.
        assert after[name] == pytest.approx(value, rel=1e-4, abs=1e-3), name


def test_an_increasing_tone_curve_changes_no_binary_pattern():
    image = make_noise(4)
    before = local_binary_patterns(image, pixel_mm=MM)
    assert np.array_equal(local_binary_patterns(np.exp(3 * image), pixel_mm=MM), before)
    assert before.sum() == pytest.approx(1.0)
    assert not np.array_equal(local_binary_patterns(-image, pixel_mm=MM), before)


def test_transposing_an_image_swaps_its_directions():
    image = ndimage.gaussian_filter(np.random.default_rng(5).normal(size=(80, 80)), (0.5, 2.0))
    of_image, of_transposed = (fractal_signature(one, pixel_mm=MM) for one in (image, image.T))
    assert of_image.horizontal == pytest.approx(of_transposed.vertical)
    assert of_image.horizontal_parabola == pytest.approx(of_transposed.vertical_parabola)
    first, second = (spectral_slope(one, pixel_mm=MM) for one in (image, image.T))
    assert first["horizontal"] == pytest.approx(second["vertical"])
    for transform in (variance_orientation_transform, hurst_orientation_transform):
        before, after = (transform(one, pixel_mm=MM) for one in (image, image.T))
        assert before.horizontal_dimension == pytest.approx(after.vertical_dimension)
        assert before.aspect_ratio == pytest.approx(after.aspect_ratio, rel=1e-3)
        assert before.orientation_deg == pytest.approx((90.0 - after.orientation_deg) % 180.0, abs=0.1)


def test_scales_in_mm_make_dimensions_independent_of_the_pixel_size():
    # The field is resolved by both pixel sizes, so that both see the same texture.
    fine = ndimage.zoom(ndimage.gaussian_filter(np.random.default_rng(6).normal(size=(128, 128)), 1.5), 2, order=5)
    coarse = fine[::2, ::2]
    for of in (
        lambda image, size: variance_orientation_transform(image, pixel_mm=size).mean_dimension,
        lambda image, size: hurst_orientation_transform(image, pixel_mm=size).mean_dimension,
        lambda image, size: fractal_signature(image, pixel_mm=size).horizontal_dimension,
    ):
        assert of(fine, MM / 2) == pytest.approx(of(coarse, MM), abs=0.03)
    assert local_binary_patterns(fine, pixel_mm=MM / 2) == pytest.approx(
        local_binary_patterns(coarse, pixel_mm=MM), abs=0.02
    )


@pytest.mark.parametrize("pixel_mm", [0.1, 0.15, 0.2])
def test_pixels_outside_the_mask_have_no_effect(pixel_mm):
    image = make_noise(7, (120, 120))
    mask = np.abs(np.mgrid[-60:60, -60:60]).sum(axis=0) < 55
    other = np.where(mask, image, np.nan)
    first = measure_texture_features(image, pixel_mm=pixel_mm, mask=mask)
    assert first == pytest.approx(measure_texture_features(other, pixel_mm=pixel_mm, mask=mask))
    # Patterns are measured in ranks; a pixel outside must not become one of them, nor be read by the interpolation.
    for radius in (0.4, 0.8):
        patterns = [
            local_binary_patterns(one, pixel_mm=pixel_mm, radius_mm=radius, mask=mask) for one in (image, image + 9)
        ]
        assert np.array_equal(*patterns)


def test_a_mirrored_image_changes_only_the_sign_of_sines():
    image = ndimage.gaussian_filter(np.random.default_rng(5).normal(size=(80, 90)), (0.5, 2.0))
    before, after = (measure_texture_features(one, pixel_mm=MM) for one in (image, image[:, ::-1]))
    assert mirror_texture_features(after) == pytest.approx(before, abs=1e-6)
    changed = {name for name, value in before.items() if mirror_texture_features(before)[name] != value}
    assert changed == {"vot_OrientationSine", "hot_OrientationSine"}


def test_a_thin_strip_has_a_variogram():
    region = prepare_region(make_noise(3, (6, 90)), 0.2, None, (0.4, 0.44, 0.48))
    assert (measure_variogram(region, np.array([0.0])) > 0).all()


def test_every_family_names_its_features():
    names = list(measure_texture_features(make_noise(8), pixel_mm=MM))
    assert {name.split("_")[0] for name in names} == set(TEXTURE_FAMILIES)
    assert len(names) == len(set(names)) == 2 * (4 + 5) + 2 * (7 + 4 * 5) + 20 + 3
    assert {"fsa_HorizontalDimension", "vot_AspectRatio_0.50mm", "lbp_Uniform3_0.8mm", "spectrum_Vertical"} <= set(
        names
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": np.zeros((60, 70))}, "image must vary in the mask, got 0 everywhere"),
        ({"image": np.zeros((3, 60, 70))}, "image must have two dimensions"),
        ({"image": np.full((60, 70), np.nan)}, "image must be finite in the mask"),
        ({"mask": np.ones((60, 71), bool)}, "mask must have the shape of the image"),
        ({"mask": np.zeros((60, 70), bool)}, "mask must have at least 100 pixels, got 0"),
        ({"pixel_mm": 0.3}, "scales_mm must be at least 2 pixels of 0.3 mm, got 0.4 mm"),
        ({"pixel_mm": 0.02}, "scales_mm must be below half of the region of 1.2 mm, got 1.6 mm"),
        ({"pixel_mm": 0.0}, "pixel_mm must be between"),
        ({"families": ["vott"]}, "family must be one of"),
        ({"image": np.tile(make_noise(1)[:, :1], 70)}, "must vary"),
    ],
)
def test_images_that_cannot_be_measured_raise_an_error(changes, message):
    arguments = {"image": make_noise(9), "pixel_mm": MM, "mask": None} | changes
    image = arguments.pop("image")
    with pytest.raises(InputError, match=message):
        measure_texture_features(image, **arguments)
