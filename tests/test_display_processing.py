"""Display processing: log, flat-panel and screen-film rendering, pyramids, collimation and side markers."""

import dataclasses

import msgspec
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

import pssf
from pssf import InputError
from pssf.data.imaging.display_table import load_display_processing
from pssf.detector import display_rendering
from pssf.detector.display_processing import render_film, render_processed
from pssf.detector.laplacian_pyramid import join_pyramid, split_pyramid
from pssf.model.detector import load_detectors
from pssf.model.sampling.display_sampling import sample_processing_from_table

PLAIN = msgspec.structs.replace(load_display_processing().processed, power=1.0, edge_gain=1.0, latitude_gain=1.0)
SIDE = 256


def change_plain(**values):
    return msgspec.structs.replace(PLAIN, **values)


def render_limb(log_detail=0.0):
    """Render the signal (256, 256) of a vertical band of limb between strips of air."""
    density = np.full((SIDE, SIDE), 2.5) + log_detail
    density[:, :32] = density[:, -32:] = 0.0
    return (2e4 * np.exp(-density)).astype(np.float32)


def make_waves(amplitude, period_px):
    rows = np.arange(SIDE)[:, None] * np.ones(SIDE)
    return amplitude * np.sin(2 * np.pi * rows / period_px)


@given(
    st.integers(9, 90), st.integers(9, 90), st.integers(0, 5), st.floats(-3, 3, width=32), st.floats(0, 100, width=32)
)
def test_joining_an_unchanged_pyramid_restores_the_image(rows, cols, seed, mean, contrast):
    image = np.random.default_rng(seed).normal(mean, contrast, (rows, cols)).astype(np.float32)
    assert_allclose(join_pyramid(*split_pyramid(image)), image, atol=1e-5 * max(1.0, contrast))


@given(st.integers(8, 90), st.integers(8, 90), st.integers(0, 5))
def test_a_pyramid_layer_is_binomially_filtered_and_subsampled_by_two(rows, cols, seed):
    image = np.random.default_rng(seed).normal(0, 1, (rows, cols)).astype(np.float32)
    binomial = np.outer(*[np.array([1, 4, 6, 4, 1]) / 16] * 2)
    details, coarser = split_pyramid(image, 1)
    assert_allclose(coarser, ndimage.convolve(image, binomial, mode="mirror")[::2, ::2], atol=1e-6)
    upsampled = np.zeros_like(image)
    upsampled[::2, ::2] = 4 * coarser
    assert_allclose(details[0], image - ndimage.convolve(upsampled, binomial, mode="mirror"), atol=2e-6)


def test_a_constant_image_has_no_details():
    details, rest = split_pyramid(np.full((70, 41), 3.0, np.float32))
    assert len(details) == 3
    assert max(np.abs(layer).max() for layer in details) < 1e-5
    assert_allclose(rest, 3.0, rtol=1e-6)


def test_without_gains_grey_is_a_monotonic_function_of_the_log_signal():
    rng = np.random.default_rng(0)
    signal = render_limb(rng.normal(0, 0.4, (SIDE, SIDE)))
    grey = render_processed(signal, 0.15, PLAIN)
    order = np.argsort(signal, axis=None)[::-1]
    assert np.diff(grey.ravel()[order]).min() > -1e-5
    assert grey.min() >= 0
    assert grey.max() <= 1
    displayed = render_processed(signal, 0.15, change_plain(bend=1e-3))[:, 32:-32]
    assert_allclose(
        [(displayed < 1e-3).mean(), (displayed > 1 - 1e-3).mean()], [PLAIN.dark, 1 - PLAIN.bright], atol=0.02
    )


def test_a_power_below_one_enhances_small_details_over_large_ones():
    small, large = (make_waves(size, 16.0) for size in (0.03, 0.3))
    fixed = dict(dark=0.0, bright=1.0, bend=1e-3)

    def measure_ratio(power):
        # The two amplitudes are in the left and right half of one image, so the same grey curve applies to both.
        both = np.where(np.arange(SIDE) < SIDE // 2, small, large)
        grey = render_processed(render_limb(both), 0.15, change_plain(power=power, **fixed))
        return np.ptp(grey[64:-64, 60:90]) / np.ptp(grey[64:-64, -90:-60])

    assert_allclose(measure_ratio(1.0), 0.1, rtol=0.05)
    # Vuylsteke and Schoeters 1994: (x / bound)^power.
    assert_allclose(measure_ratio(0.7), 0.1**0.7, rtol=0.12)


def test_latitude_gain_reduces_the_contrast_of_large_structures_only():
    both = make_waves(0.3, 256.0) + make_waves(0.3, 8.0)

    def measure_slow_over_fine(gain):
        processing = change_plain(latitude_gain=gain, latitude_mm=20.0, dark=0.0, bright=1.0, bend=1e-3)
        power = np.abs(np.fft.rfft(render_processed(render_limb(both), 0.5, processing)[:, 96:-96].mean(axis=1)))
        return power[1] / power[32]

    assert_allclose(measure_slow_over_fine(1.0), 1.0, rtol=0.05)
    assert 0.3 < measure_slow_over_fine(0.3) < 0.6


def test_air_and_the_collimated_border_are_black():
    signal = render_limb()
    signal[:20] = 1.0
    grey = render_processed(signal, 0.15, load_display_processing().processed)
    assert grey[:20].max() == 0
    assert grey[30:, :20].max() < 0.05


def test_a_limb_without_transmission_is_white_and_not_black():
    signal = render_limb()
    signal[-30:, 32:-32] = 1.0
    grey = render_processed(signal, 0.15, load_display_processing().processed)
    assert grey[-15:, 64:-64].min() > 0.9


def test_screen_film_has_the_tabulated_density_and_darkens_with_dose():
    processing = load_display_processing().film
    signal = render_limb(np.random.default_rng(1).normal(0, 0.3, (SIDE, SIDE)))
    grey = render_film(signal, processing)
    density = processing.base + (1 - grey) * (processing.max_density - processing.base)
    assert_allclose(np.median(density[:, 32:-32]), processing.middle, atol=0.01)
    order = np.argsort(signal, axis=None)
    assert np.diff(density.ravel()[order]).min() >= -1e-6


def test_bone_is_brighter_than_muscle_and_muscle_brighter_than_air():
    strips = np.repeat([16000.0, 2500.0, 1800.0, 1200.0], 64)
    pixels = (np.ones((256, 1)) * strips + 50).astype(np.uint16)
    for processing in ("log", "processed", "film"):
        displayed = pssf.render_for_display(pixels, processing=processing, pixel_mm=0.5)[128, 32::64].astype(int)
        assert (np.diff(displayed) > 0).all(), processing


@pytest.mark.parametrize("processing", display_rendering.DISPLAY_PROCESSING)
def test_the_dark_offset_of_the_detector_is_subtracted(processing):
    known = load_detectors()
    brighter = dataclasses.replace(known["gos"], name="brighter", offset_dn=known["csi"].offset_dn + 500)
    pixels = render_limb().astype(np.uint16)
    displayed = pssf.render_for_display(pixels, detector="csi", processing=processing, pixel_mm=0.2)
    assert_array_equal(
        pssf.render_for_display(pixels + 500, detector=brighter, processing=processing, pixel_mm=0.2), displayed
    )
    protocol = dataclasses.replace(pssf.load_protocol("reference"), detector=brighter, pixel_mm=0.2)
    radiograph = pssf.Radiograph(pixels=pixels + 500, protocol=protocol, seed=0)
    assert_array_equal(pssf.render_for_display(radiograph, processing=processing), displayed)


def test_a_constant_image_is_rendered():
    for processing in ("processed", "film"):
        assert np.isfinite(pssf.render_for_display(np.full((64, 64), 3000, np.uint16), processing=processing)).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"processing": "soft"}, "processing must be one of log, processed, film, got 'soft'"),
        ({"processing": 3}, "processing must be log, processed, film, a FlatPanelProcessing or a ScreenFilm, got 3"),
        ({"pixel_mm": 0.0}, "pixel_mm must be .*, got 0.0 mm"),
    ],
)
def test_invalid_display_processing_raises_an_error(wrong, message):
    with pytest.raises(InputError, match=message):
        pssf.render_for_display(np.ones((8, 8), np.uint16), **wrong)


@pytest.mark.parametrize("processing", ["log", "processed", "film"])
def test_scatter_outside_the_collimated_field_is_black_and_has_no_effect(processing):
    open_field = np.zeros((SIDE, SIDE), np.uint16)
    open_field[40:-40, 60:-60] = render_limb(make_waves(0.2, 40))[40:-40, 60:-60]
    scattered = np.where(open_field > 0, open_field, 700).astype(np.uint16)
    field_mm = ((SIDE - 120) * 0.2, (SIDE - 80) * 0.2)
    displayed = [
        pssf.render_for_display(image, processing=processing, pixel_mm=0.2, field_mm=field_mm)
        for image in (open_field, scattered)
    ]
    np.testing.assert_array_equal(*displayed)
    assert not displayed[1][:40].any()
    assert not displayed[1][:, -60:].any()
    inside = pssf.render_for_display(
        np.ascontiguousarray(scattered[40:-40, 60:-60]), processing=processing, pixel_mm=0.2
    )
    np.testing.assert_array_equal(displayed[1][40:-40, 60:-60], inside)


@pytest.mark.parametrize(("field_mm", "what"), [((-1.0, 0.0), "width of field_mm"), ((0.0, 0.1), "height of field_mm")])
def test_a_field_smaller_than_one_pixel_raises_an_error(field_mm, what):
    with pytest.raises(InputError, match=what):
        pssf.render_for_display(render_limb().astype(np.uint16), pixel_mm=0.2, field_mm=field_mm)


@pytest.mark.parametrize(("fraction", "kind"), [(0.0, ""), (1.0, "plain_")])
def test_sampled_display_processing_follows_the_table_and_its_seed(fraction, kind):
    spread = msgspec.structs.replace(load_display_processing().spread, weakly_processed_fraction=fraction)
    known = msgspec.structs.replace(load_display_processing(), spread=spread)
    sampled = [sample_processing_from_table(known, rng=np.random.default_rng(seed)) for seed in range(400)]
    assert sampled[7] == sample_processing_from_table(known, rng=np.random.default_rng(7))
    for name in ("latitude_gain", "edge_gain", "dark", "bright", "bend"):
        law = getattr(spread, kind + name if name.endswith("gain") else name)
        values = np.array([getattr(processing, name) for processing in sampled])
        values = np.log(values) if name == "edge_gain" else values
        assert law.low - 1e-3 <= values.min()
        assert values.max() <= law.high + 1e-3
        # The tolerance is three standard errors of 400 values plus 0.2 SD for the shift by clipping.
        assert abs(values.mean() - law.mean) < (3 / np.sqrt(400) + 0.2) * law.sd
        assert 0.5 * law.sd < values.std() < 1.1 * law.sd
    assert all(processing.power == load_display_processing().processed.power for processing in sampled)


def test_the_tabulated_fraction_of_sampled_processing_is_weak():
    known = load_display_processing()
    rare = msgspec.structs.replace(known.spread.plain_latitude_gain, mean=9.0, sd=0.0, low=9.0, high=9.0)
    known = msgspec.structs.replace(known, spread=msgspec.structs.replace(known.spread, plain_latitude_gain=rare))
    plain = [
        sample_processing_from_table(known, rng=np.random.default_rng(seed)).latitude_gain == 9.0 for seed in range(600)
    ]
    fraction = known.spread.weakly_processed_fraction
    assert abs(np.mean(plain) - fraction) < 4 * np.sqrt(fraction * (1 - fraction) / 600)


def test_every_sampled_processing_renders_a_limb_with_full_contrast():
    pixels = render_limb(make_waves(0.3, 64)).astype(np.uint16)
    for seed in range(20):
        displayed = pssf.render_for_display(
            pixels, processing=pssf.sample_display_processing(rng=np.random.default_rng(seed)), pixel_mm=0.15
        )
        assert np.ptp(displayed) > 60
        assert displayed[:, :24].max() <= displayed[:, 64:192].min() + 60


def test_display_processing_is_sampled_from_a_seed_or_a_generator():
    assert pssf.sample_display_processing(rng=7) == pssf.sample_display_processing(rng=np.random.default_rng(7))
    with pytest.raises(InputError, match="rng must be a whole number from 0"):
        pssf.sample_display_processing(rng="7")


@pytest.mark.parametrize("processing", ["log", "processed"])
def test_a_radiograph_is_rendered_with_its_detector_pitch_and_field(processing):
    protocol = dataclasses.replace(
        pssf.load_protocol("reference"),
        **{
            "rows": 200,
            "cols": 160,
            "pixel_mm": 1.2,
            "detector": "gos",
            "field_width_mm": 120.0,
            "field_height_mm": 180.0,
        },
    )
    radiograph = pssf.simulate(pssf.Knee(), protocol)
    shadow_mm = protocol.focal_spot_mm * (protocol.sdd_mm / 300 - 1) / 2 + 0.5
    given = {"detector": "gos", "pixel_mm": 1.2, "field_mm": (120.0, 180.0), "shadow_mm": shadow_mm}
    displayed = pssf.render_for_display(radiograph, processing=processing)
    assert_array_equal(displayed, pssf.render_for_display(radiograph.pixels, processing=processing, **given))
    assert (displayed[:, :20] == 0).all()
    assert (pssf.render_for_display(radiograph.pixels, processing=processing) != displayed).any()


@pytest.mark.parametrize(
    ("pixels", "given"),
    [
        (None, "None"),
        ([[1, 2], [3, 4]], "[[1, 2], [3, 4]]"),
        ("x", "'x'"),
        (np.zeros((5, 5, 3), np.uint16), "an array (5, 5, 3) of uint16"),
        (np.zeros((0, 5), np.uint16), "an array (0, 5) of uint16"),
        (np.full((5, 5), "a"), "an array (5, 5) of <U1"),
    ],
)
def test_invalid_pixels_raise_an_error_that_describes_them(pixels, given):
    with pytest.raises(InputError) as raised:
        pssf.render_for_display(pixels)
    assert str(raised.value) == f"pixels must be a (rows, cols) array of numbers or a Radiograph, got {given}"


def test_the_error_counts_pixels_that_are_not_finite():
    pixels = render_limb()
    pixels[3, :4] = np.nan, np.inf, -np.inf, 1.0
    with pytest.raises(InputError, match="pixels must be finite, got 3 of 65536 pixels that are not finite"):
        pssf.render_for_display(pixels)


def simulate_slab(**changes):
    """Simulate a slab of muscle, larger than any field, with a rod of bone in it."""
    plate, rod = trimesh.creation.box((400.0, 80.0, 400.0)), trimesh.creation.cylinder(20.0, 390.0)
    surfaces = [pssf.Surface(plate, "muscle", "air"), pssf.Surface(rod, "cortical_bone", "muscle", name="rod")]
    scene = pssf.Scene(surfaces)
    base = dataclasses.replace(pssf.load_protocol("reference"), rows=440, cols=400, noise="none", heel="none")
    return pssf.simulate(scene, dataclasses.replace(base, pixel_mm=0.4, **changes), engine="scanline")


@pytest.mark.parametrize("processing", ["log", "processed", "film"])
@pytest.mark.parametrize(("focal_spot_mm", "sdd_mm", "detector"), [(0.6, 1150.0, "csi"), (1.2, 1800.0, "gos")])
def test_a_collimated_field_has_no_bright_line_along_its_edge(processing, focal_spot_mm, sdd_mm, detector):
    changes = {"focal_spot_mm": focal_spot_mm, "sdd_mm": sdd_mm, "detector": detector}
    radiograph = simulate_slab(field_width_mm=100.0, field_height_mm=120.0, **changes)
    displayed = pssf.render_for_display(radiograph, processing=processing).astype(int)
    shadow_mm = focal_spot_mm * (sdd_mm / 300 - 1) / 2 + 0.5
    high, wide = (int((whole - 2 * shadow_mm) / 0.4) // 2 for whole in (120.0, 100.0))
    field = displayed[220 - high : 220 + high, 200 - wide : 200 + wide]
    outside = displayed.copy()
    outside[220 - high : 220 + high, 200 - wide : 200 + wide] = 0
    assert not outside.any()
    edges = (field[0], field[-1], field[:, 0], field[:, -1])
    inner = (field[12], field[-13], field[:, 12], field[:, -13])
    for edge, line in zip(edges, inner, strict=True):
        assert np.median(edge) <= np.median(line) + 6


def count_letters(displayed):
    """Count the white letters in an image, excluding the middle, which contains bone."""
    white = displayed >= 200
    white[:, displayed.shape[1] // 2 - 80 : displayed.shape[1] // 2 + 80] = False
    return ndimage.label(ndimage.binary_dilation(white, iterations=3))[1]


@pytest.mark.parametrize("field", [{}, {"field_width_mm": 110.0, "field_height_mm": 130.0}])
def test_a_radiograph_with_a_lead_marker_shows_one_side_marker(field):
    radiographs = {marker: simulate_slab(marker=marker, **field) for marker in ("none", "R")}
    processing = load_display_processing().film
    assert count_letters(pssf.render_for_display(radiographs["none"], processing=processing)) == 0
    for radiograph in radiographs.values():
        assert count_letters(pssf.render_for_display(radiograph, processing=processing, side="right")) == 1
    of_lead, marked = (
        pssf.render_for_display(radiographs["R"], processing=processing, side=side) for side in (None, "right")
    )
    assert (marked <= of_lead).all()


def test_a_rendered_marker_is_within_the_collimated_field():
    radiograph = simulate_slab(field_width_mm=110.0, field_height_mm=130.0)
    plain, marked = (pssf.render_for_display(radiograph, processing="film", side=side) for side in (None, "right"))
    assert (marked != plain).any()
    assert not (marked != plain)[plain == 0].any()
