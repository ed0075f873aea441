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
from pssf.data.imaging.detector_table import load_detectors
from pssf.data.imaging.display_table import load_display_processing
from pssf.detector import display_rendering
from pssf.detector.display_processing import render_film, render_processed
from pssf.detector.laplacian_pyramid import join_pyramid, split_pyramid
from pssf.model.sampling.display_sampling import sample_processing_from_table

PLAIN = msgspec.structs.replace(load_display_processing().processed, power=1.0, edge_gain=1.0, latitude_gain=1.0)
SIDE = 256


def changed(**values):
    return msgspec.structs.replace(PLAIN, **values)


def limb(log_detail=0.0):
    """(256, 256)  signal of a band of limb between strips of air"""
    density = np.full((SIDE, SIDE), 2.5) + log_detail
    density[:, :32] = density[:, -32:] = 0.0
    return (2e4 * np.exp(-density)).astype(np.float32)


def waves(amplitude, period_px):
    rows = np.arange(SIDE)[:, None] * np.ones(SIDE)
    return amplitude * np.sin(2 * np.pi * rows / period_px)


@given(
    st.integers(9, 90), st.integers(9, 90), st.integers(0, 5), st.floats(-3, 3, width=32), st.floats(0, 100, width=32)
)
def test_a_pyramid_that_is_not_changed_gives_the_image_back(rows, cols, seed, mean, contrast):
    image = np.random.default_rng(seed).normal(mean, contrast, (rows, cols)).astype(np.float32)
    assert_allclose(join_pyramid(*split_pyramid(image)), image, atol=1e-5 * max(1.0, contrast))


@given(st.integers(8, 90), st.integers(8, 90), st.integers(0, 5))
def test_a_layer_is_the_binomial_convolved_and_every_second_pixel_of_it(rows, cols, seed):
    image = np.random.default_rng(seed).normal(0, 1, (rows, cols)).astype(np.float32)
    binomial = np.outer(*[np.array([1, 4, 6, 4, 1]) / 16] * 2)
    details, coarser = split_pyramid(image, 1)
    assert_allclose(coarser, ndimage.convolve(image, binomial, mode="mirror")[::2, ::2], atol=1e-6)
    apart = np.zeros_like(image)
    apart[::2, ::2] = 4 * coarser
    assert_allclose(details[0], image - ndimage.convolve(apart, binomial, mode="mirror"), atol=2e-6)


def test_an_even_image_has_no_details():
    details, rest = split_pyramid(np.full((70, 41), 3.0, np.float32))
    assert len(details) == 3
    assert max(np.abs(layer).max() for layer in details) < 1e-5
    assert_allclose(rest, 3.0, rtol=1e-6)


def test_without_factors_the_grey_is_a_rising_curve_of_the_logarithm():
    rng = np.random.default_rng(0)
    signal = limb(rng.normal(0, 0.4, (SIDE, SIDE)))
    grey = render_processed(signal, 0.15, PLAIN)
    order = np.argsort(signal, axis=None)[::-1]
    assert np.diff(grey.ravel()[order]).min() > -1e-5
    assert grey.min() >= 0
    assert grey.max() <= 1
    shown = render_processed(signal, 0.15, changed(bend=1e-3))[:, 32:-32]
    assert_allclose([(shown < 1e-3).mean(), (shown > 1 - 1e-3).mean()], [PLAIN.dark, 1 - PLAIN.bright], atol=0.02)


def test_a_power_below_one_makes_small_details_larger_beside_great_ones():
    small, great = (waves(size, 16.0) for size in (0.03, 0.3))
    fixed = dict(dark=0.0, bright=1.0, bend=1e-3)

    def ratio(power):
        # Both in one image, left and right, so that both have one curve to grey.
        both = np.where(np.arange(SIDE) < SIDE // 2, small, great)
        grey = render_processed(limb(both), 0.15, changed(power=power, **fixed))
        return np.ptp(grey[64:-64, 60:90]) / np.ptp(grey[64:-64, -90:-60])

    assert_allclose(ratio(1.0), 0.1, rtol=0.05)
    # Vuylsteke and Schoeters 1994: (x / bound)^power.
    assert_allclose(ratio(0.7), 0.1**0.7, rtol=0.12)


def test_latitude_takes_contrast_from_large_structures_alone():
    both = waves(0.3, 256.0) + waves(0.3, 8.0)

    def slow_over_fine(gain):
        processing = changed(latitude_gain=gain, latitude_mm=20.0, dark=0.0, bright=1.0, bend=1e-3)
        power = np.abs(np.fft.rfft(render_processed(limb(both), 0.5, processing)[:, 96:-96].mean(axis=1)))
        return power[1] / power[32]

    assert_allclose(slow_over_fine(1.0), 1.0, rtol=0.05)
    assert 0.3 < slow_over_fine(0.3) < 0.6


def test_air_and_the_collimator_are_black():
    signal = limb()
    signal[:20] = 1.0
    grey = render_processed(signal, 0.15, load_display_processing().processed)
    assert grey[:20].max() == 0
    assert grey[30:, :20].max() < 0.05


def test_a_limb_too_thick_for_the_beam_is_white_and_not_black():
    signal = limb()
    signal[-30:, 32:-32] = 1.0
    grey = render_processed(signal, 0.15, load_display_processing().processed)
    assert grey[-15:, 64:-64].min() > 0.9


def test_a_film_has_the_density_of_its_table_at_the_median_and_darkens_with_dose():
    processing = load_display_processing().film
    signal = limb(np.random.default_rng(1).normal(0, 0.3, (SIDE, SIDE)))
    grey = render_film(signal, processing)
    density = processing.base + (1 - grey) * (processing.max_density - processing.base)
    assert_allclose(np.median(density[:, 32:-32]), processing.middle, atol=0.01)
    order = np.argsort(signal, axis=None)
    assert np.diff(density.ravel()[order]).min() >= -1e-6


def test_each_look_shows_bone_brighter_than_muscle_brighter_than_air():
    strips = np.repeat([16000.0, 2500.0, 1800.0, 1200.0], 64)
    pixels = (np.ones((256, 1)) * strips + 50).astype(np.uint16)
    for processing in ("log", "processed", "film"):
        shown = pssf.render_for_display(pixels, processing=processing, pixel_mm=0.5)[128, 32::64].astype(int)
        assert (np.diff(shown) > 0).all(), processing


@pytest.mark.parametrize("processing", display_rendering.DISPLAY_PROCESSING)
def test_what_is_read_without_light_is_taken_off_as_the_radiographs_own_detector_has_it(monkeypatch, processing):
    known = load_detectors()
    brighter = {**known, "gos": msgspec.structs.replace(known["gos"], offset_dn=known["csi"].offset_dn + 500)}
    monkeypatch.setattr(display_rendering, "load_detectors", lambda: brighter)
    pixels = limb().astype(np.uint16)
    shown = pssf.render_for_display(pixels, detector="csi", processing=processing, pixel_mm=0.2)
    assert_array_equal(
        pssf.render_for_display(pixels + 500, detector="gos", processing=processing, pixel_mm=0.2), shown
    )
    protocol = dataclasses.replace(pssf.load_protocol("reference"), detector="gos", pixel_mm=0.2)
    radiograph = pssf.Radiograph(pixels=pixels + 500, protocol=protocol, seed=0)
    assert_array_equal(pssf.render_for_display(radiograph, processing=processing), shown)


def test_an_even_field_is_shown():
    for processing in ("processed", "film"):
        assert np.isfinite(pssf.render_for_display(np.full((64, 64), 3000, np.uint16), processing=processing)).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"processing": "soft"}, "processing must be one of log, processed, film, got 'soft'"),
        ({"processing": 3}, "processing must be log, processed, film, a FlatPanelProcessing or a ScreenFilm, got 3"),
        ({"pixel_mm": 0.0}, "pixel_mm must be .*, got 0.0 mm"),
    ],
)
def test_what_is_no_look_is_refused(wrong, said):
    with pytest.raises(InputError, match=said):
        pssf.render_for_display(np.ones((8, 8), np.uint16), **wrong)


@pytest.mark.parametrize("processing", ["log", "processed", "film"])
def test_what_scatters_behind_the_leaves_is_black_and_changes_no_grey_within_the_field(processing):
    open_field = np.zeros((SIDE, SIDE), np.uint16)
    open_field[40:-40, 60:-60] = limb(waves(0.2, 40))[40:-40, 60:-60]
    scattered = np.where(open_field > 0, open_field, 700).astype(np.uint16)
    field_mm = ((SIDE - 120) * 0.2, (SIDE - 80) * 0.2)
    shown = [
        pssf.render_for_display(image, processing=processing, pixel_mm=0.2, field_mm=field_mm)
        for image in (open_field, scattered)
    ]
    np.testing.assert_array_equal(*shown)
    assert not shown[1][:40].any()
    assert not shown[1][:, -60:].any()
    inside = pssf.render_for_display(
        np.ascontiguousarray(scattered[40:-40, 60:-60]), processing=processing, pixel_mm=0.2
    )
    np.testing.assert_array_equal(shown[1][40:-40, 60:-60], inside)


@pytest.mark.parametrize(("field_mm", "what"), [((-1.0, 0.0), "width of field_mm"), ((0.0, 0.1), "height of field_mm")])
def test_a_field_of_no_pixel_is_refused(field_mm, what):
    with pytest.raises(InputError, match=what):
        pssf.render_for_display(limb().astype(np.uint16), pixel_mm=0.2, field_mm=field_mm)


@pytest.mark.parametrize(("share", "kind"), [(0.0, ""), (1.0, "plain_")])
def test_drawn_looks_vary_as_the_table_says_and_the_same_chance_gives_the_same_look(share, kind):
    spread = msgspec.structs.replace(load_display_processing().spread, weakly_processed_fraction=share)
    known = msgspec.structs.replace(load_display_processing(), spread=spread)
    drawn = [sample_processing_from_table(known, rng=np.random.default_rng(seed)) for seed in range(400)]
    assert drawn[7] == sample_processing_from_table(known, rng=np.random.default_rng(7))
    for name in ("latitude_gain", "edge_gain", "dark", "bright", "bend"):
        law = getattr(spread, kind + name if name.endswith("gain") else name)
        values = np.array([getattr(processing, name) for processing in drawn])
        values = np.log(values) if name == "edge_gain" else values
        assert law.low - 1e-3 <= values.min()
        assert values.max() <= law.high + 1e-3
        # Standard error of the mean of 400, three times; holding at the ends moves it by less than a fifth of the SD.
        assert abs(values.mean() - law.mean) < (3 / np.sqrt(400) + 0.2) * law.sd
        assert 0.5 * law.sd < values.std() < 1.1 * law.sd
    assert all(processing.power == load_display_processing().processed.power for processing in drawn)


def test_so_large_a_share_of_drawn_looks_is_plain():
    known = load_display_processing()
    rare = msgspec.structs.replace(known.spread.plain_latitude_gain, mean=9.0, sd=0.0, low=9.0, high=9.0)
    known = msgspec.structs.replace(known, spread=msgspec.structs.replace(known.spread, plain_latitude_gain=rare))
    plain = [
        sample_processing_from_table(known, rng=np.random.default_rng(seed)).latitude_gain == 9.0 for seed in range(600)
    ]
    share = known.spread.weakly_processed_fraction
    assert abs(np.mean(plain) - share) < 4 * np.sqrt(share * (1 - share) / 600)


def test_every_drawn_look_shows_a_limb_from_dark_to_bright():
    pixels = limb(waves(0.3, 64)).astype(np.uint16)
    for seed in range(20):
        shown = pssf.render_for_display(
            pixels, processing=pssf.sample_display_processing(rng=np.random.default_rng(seed)), pixel_mm=0.15
        )
        assert np.ptp(shown) > 60
        assert shown[:, :24].max() <= shown[:, 64:192].min() + 60


def test_display_processing_is_sampled_by_a_seed_or_a_generator():
    assert pssf.sample_display_processing(rng=7) == pssf.sample_display_processing(rng=np.random.default_rng(7))
    with pytest.raises(InputError, match="rng must be a whole number from 0"):
        pssf.sample_display_processing(rng="7")


@pytest.mark.parametrize("processing", ["log", "processed"])
def test_a_radiograph_is_shown_by_its_own_detector_pitch_and_field(processing):
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
    told = {"detector": "gos", "pixel_mm": 1.2, "field_mm": (120.0, 180.0), "shadow_mm": shadow_mm}
    shown = pssf.render_for_display(radiograph, processing=processing)
    assert_array_equal(shown, pssf.render_for_display(radiograph.pixels, processing=processing, **told))
    assert (shown[:, :20] == 0).all()
    assert (pssf.render_for_display(radiograph.pixels, processing=processing) != shown).any()


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
def test_what_is_no_picture_is_refused(pixels, given):
    with pytest.raises(InputError) as refused:
        pssf.render_for_display(pixels)
    assert str(refused.value) == f"pixels must be a (rows, cols) array of numbers or a Radiograph, got {given}"


def test_pixels_that_are_not_finite_are_counted():
    pixels = limb()
    pixels[3, :4] = np.nan, np.inf, -np.inf, 1.0
    with pytest.raises(InputError, match="pixels must be finite, got 3 of 65536 that are not"):
        pssf.render_for_display(pixels)


def slab(**changes):
    """A plate of muscle, larger than any field, with a rod of bone in it."""
    plate, rod = trimesh.creation.box((400.0, 80.0, 400.0)), trimesh.creation.cylinder(20.0, 390.0)
    surfaces = [pssf.Surface(plate, "muscle", "air"), pssf.Surface(rod, "cortical_bone", "muscle", name="rod")]
    scene = pssf.Scene(surfaces)
    base = dataclasses.replace(pssf.load_protocol("reference"), rows=440, cols=400, noise="none", heel="none")
    return pssf.simulate(scene, dataclasses.replace(base, pixel_mm=0.4, **changes), engine="scanline")


@pytest.mark.parametrize("processing", ["log", "processed", "film"])
@pytest.mark.parametrize(("focal_spot_mm", "sdd_mm", "detector"), [(0.6, 1150.0, "csi"), (1.2, 1800.0, "gos")])
def test_no_bright_line_runs_along_the_edge_of_a_collimated_field(processing, focal_spot_mm, sdd_mm, detector):
    changes = {"focal_spot_mm": focal_spot_mm, "sdd_mm": sdd_mm, "detector": detector}
    radiograph = slab(field_width_mm=100.0, field_height_mm=120.0, **changes)
    shown = pssf.render_for_display(radiograph, processing=processing).astype(int)
    shadow_mm = focal_spot_mm * (sdd_mm / 300 - 1) / 2 + 0.5
    high, wide = (int((whole - 2 * shadow_mm) / 0.4) // 2 for whole in (120.0, 100.0))
    field = shown[220 - high : 220 + high, 200 - wide : 200 + wide]
    outside = shown.copy()
    outside[220 - high : 220 + high, 200 - wide : 200 + wide] = 0
    assert not outside.any()
    edges = (field[0], field[-1], field[:, 0], field[:, -1])
    inner = (field[12], field[-13], field[:, 12], field[:, -13])
    for edge, line in zip(edges, inner, strict=True):
        assert np.median(edge) <= np.median(line) + 6


def letters(shown):
    """Number of white letters in a picture, away from its middle, where bone is."""
    white = shown >= 200
    white[:, shown.shape[1] // 2 - 80 : shown.shape[1] // 2 + 80] = False
    return ndimage.label(ndimage.binary_dilation(white, iterations=3))[1]


@pytest.mark.parametrize("field", [{}, {"field_width_mm": 110.0, "field_height_mm": 130.0}])
def test_a_marked_radiograph_bears_one_side_marker(field):
    taken = {marker: slab(marker=marker, **field) for marker in ("none", "R")}
    processing = load_display_processing().film
    assert letters(pssf.render_for_display(taken["none"], processing=processing)) == 0
    for radiograph in taken.values():
        assert letters(pssf.render_for_display(radiograph, processing=processing, side="right")) == 1
    of_lead, marked = (
        pssf.render_for_display(taken["R"], processing=processing, side=side) for side in (None, "right")
    )
    assert (marked <= of_lead).all()


def test_a_drawn_marker_is_within_a_collimated_field():
    radiograph = slab(field_width_mm=110.0, field_height_mm=130.0)
    plain, marked = (pssf.render_for_display(radiograph, processing="film", side=side) for side in (None, "right"))
    assert (marked != plain).any()
    assert not (marked != plain)[plain == 0].any()
