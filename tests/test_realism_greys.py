"""Greys, margins and contours of pictures whose geometry and greys are drawn as known values."""

import dataclasses

import numpy as np
import pytest

from pssf.patient_comparison.films.edge_features import measure_edges
from pssf.patient_comparison.films.film_normalisation import (
    PITCH_MM,
    PLATEAU_MM,
    JointPosition,
    joint_centre_px,
    resample_joint_field,
)
from pssf.patient_comparison.films.film_outline import Outline
from pssf.patient_comparison.films.grey_features import PATCH_MM, PATCHES, measure_grey_features
from pssf.patient_comparison.films.outline_features import measure_shape_features
from pssf.patient_comparison.films.tone_features import measure_fine_texture, measure_tone

HALF_MM = PLATEAU_MM / 2
ROW, COL = joint_centre_px()
# Of the standard form, in pixels.
SHAPE, GAP = (168, 201), 10
SOFT, BONE, SPACE, PLATE, CORTEX, CANAL = 0.2, 0.6, 0.3, 0.95, 0.8, 0.4


def drawn_outline(gap_px=GAP, flank_mm=HALF_MM, femur_mm=HALF_MM):
    """The outline of two blocks: the plateau as wide as it is, the tibia's flank and the femur as told."""
    heights = np.arange(3.0, 24.0, PITCH_MM)
    tibia_mm = np.where(heights < 9, HALF_MM, flank_mm)
    columns = COL + np.arange(-78.0, 79.0)
    femur, tibia = (np.full(len(columns), ROW + way * gap_px / 2) for way in (-1, 1))
    both = np.array([-1.0, 1.0]) / PITCH_MM
    return Outline(
        columns=columns, femur=femur, tibia=tibia,
        tibia_rows=tibia[0] + heights / PITCH_MM, tibia_sides=COL + tibia_mm[:, None] * both,
        femur_rows=femur[0] - heights / PITCH_MM, femur_sides=COL + np.full((len(heights), 1), femur_mm) * both,
    )  # fmt: skip


def drawn_film(pixel_mm=0.2, rows=700, side="right"):
    """Two blocks of bone, the lower with a bright plate and, farther down, a shaft of cortex and canal; the place."""
    place = JointPosition(row=230.0, col=259.5, side=side, pitch_mm=pixel_mm)
    y, x = (np.arange(rows) - place.row)[:, None] * pixel_mm, (np.arange(520) - place.col) * pixel_mm
    x, gap_mm = (x if side == "right" else -x), GAP * PITCH_MM
    film = np.full((rows, 520), SOFT)
    film[(np.abs(y) < 45) & (np.abs(x) < HALF_MM)] = BONE
    film[(np.abs(y) < gap_mm / 2) & (np.abs(x) < HALF_MM)] = SPACE
    film[(y > gap_mm / 2 + 1) & (y < gap_mm / 2 + 3) & (x > 0) & (x < HALF_MM)] = PLATE
    film[(y > 50) & (np.abs(x) < 14)] = CORTEX
    film[(y > 50) & (np.abs(x) < 9)] = CANAL
    return film, place


@pytest.mark.parametrize("side", ["right", "left"])
def test_tones_are_the_ratios_of_the_greys_that_are_drawn(side):
    film, place = drawn_film(side=side)
    values = measure_tone(film, resample_joint_field(film, place), drawn_outline(), place)
    assert values["bone_over_soft"] == pytest.approx(BONE / SOFT)
    assert values["joint_space"] == pytest.approx((BONE - SPACE) / (BONE + SPACE))
    tones = {"metaphysis": BONE, "medial_condyle": BONE, "canal": CANAL, "medial_plate": PLATE}
    for name, grey in tones.items():
        assert values[f"{name}_tone"] == pytest.approx((grey - SOFT) / (CORTEX - SOFT)), name


def drawn_field(cortex=0.5, wide_mm=3.0, seed=3):
    """The standard form: blocks of bone with a layer at their sides, and a texture; outside is soft tissue."""
    x = np.abs(np.arange(SHAPE[1]) - COL) * PITCH_MM
    row = np.where(x > 36.0, SOFT, np.where(x > 36.0 - wide_mm, SOFT + cortex * (BONE - SOFT), BONE))
    return row + np.random.default_rng(seed).normal(0.0, 0.004, SHAPE)


def test_brightness_across_the_sides_is_that_of_the_layers_that_are_drawn():
    for cortex in (0.7, 1.4):
        values = measure_edges(drawn_field(cortex))
        sides = [name.removesuffix("_2.1_mm") for name in values if name.endswith("_2.1_mm")]
        assert len(sides) == 5
        for side in sides:
            assert values[f"{side}_1.2_mm"] == pytest.approx(cortex, abs=0.05)
            assert values[f"{side}_2.1_mm"] == pytest.approx(cortex, abs=0.05)
            assert 0.2 < values[f"{side}_0_mm"] / cortex < 0.8


def test_brightness_across_the_sides_is_the_same_for_other_contrast_and_told_of_no_side_that_is_not_there():
    field = drawn_field()
    assert measure_edges(3 * field + 0.2) == pytest.approx(measure_edges(field))
    assert not any(name.endswith("_mm") for name in measure_edges(np.random.default_rng(4).normal(SOFT, 0.01, SHAPE)))


@pytest.mark.parametrize(("bone", "above_mm"), [("femur", 25.0), ("tibia", -18.0)])
@pytest.mark.parametrize(("side", "way"), [("medial", 1), ("lateral", -1)])
def test_a_line_is_told_on_its_side_of_its_bone(bone, above_mm, side, way):
    field, plain = drawn_field(), measure_edges(drawn_field())
    row, cols = ROW - round(above_mm / PITCH_MM), COL + way * (np.arange(12) + round(18.0 / PITCH_MM))
    field[row : row + 2, cols] += 0.05
    values = measure_edges(field)
    assert values[f"{side}_{bone}_line"] > 3 * plain[f"{side}_{bone}_line"]
    others = [name for name in values if name.endswith("_line") and name != f"{side}_{bone}_line"]
    assert len(others) == 3
    assert all(values[name] < 1.2 * plain[name] for name in others)


def test_tones_are_the_same_for_other_contrast_and_brightness_and_ratios_are_not():
    film, place = drawn_film()
    values, brighter = (
        measure_tone(one, resample_joint_field(one, place), drawn_outline(), place) for one in (film, 2 * film + 0.1)
    )
    assert {name for name in values if name.endswith("_tone")} == {
        *(f"{name}_tone" for name in (*PATCHES, "canal", "medial_plate"))
    }
    for name in values:
        if name.endswith("_tone"):
            assert brighter[name] == pytest.approx(values[name])
    assert brighter["bone_over_soft"] == pytest.approx((2 * BONE + 0.1) / (2 * SOFT + 0.1))


def test_a_film_that_ends_before_the_shaft_has_contrasts_alone():
    film, place = drawn_film(rows=500)
    values = measure_tone(film, resample_joint_field(film, place), drawn_outline(), place)
    assert set(values) == {"bone_over_soft", "joint_space"}
    assert values["bone_over_soft"] == pytest.approx(BONE / SOFT)


def waves(pixel_mm, per_mm, height=0.1):
    """A film of vertical lines, and where its joint is."""
    side = round(100 / pixel_mm)
    across = np.arange(side) * pixel_mm
    film = np.tile(0.5 + height * np.sin(2 * np.pi * per_mm * across), (side, 1))
    return film, JointPosition(row=(side - 1) / 2, col=(side - 1) / 2, side="right", pitch_mm=pixel_mm)


@pytest.mark.parametrize("turned", [False, True])
def test_a_wave_has_the_spread_and_the_moments_of_a_sine_and_lies_along_its_lines(turned):
    film, place = waves(0.1, 8 / PATCH_MM)
    values = measure_fine_texture(film.T if turned else film, drawn_outline(), place, 0.1)
    for name in PATCHES:
        # Of 8 waves the trend takes 1 % of the variance, and interpolation as much of the height.
        assert values[f"{name}_sd_over_mean"] == pytest.approx(0.1 / np.sqrt(2) / 0.5, rel=0.02)
        assert values[f"{name}_skewness"] == pytest.approx(0.0, abs=0.05)
        assert values[f"{name}_excess_kurtosis"] == pytest.approx(-1.5, abs=0.05)
        lines = values[f"{name}_vertical_over_horizontal"]
        assert (1 / lines if turned else lines) > 1000


def test_a_spectrum_that_falls_with_a_power_of_the_frequency_has_it_as_its_slope():
    pixel_mm, side = 0.1, 1000
    radius = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(side, pixel_mm)]))
    noise = np.fft.fft2(np.random.default_rng(2).standard_normal((side, side)))
    film = np.fft.ifft2(noise / np.maximum(radius, 0.02) ** 1.5).real
    place = JointPosition(row=499.5, col=499.5, side="right", pitch_mm=pixel_mm)
    values = measure_fine_texture(10 + film / film.std(), drawn_outline(), place, pixel_mm)
    # Inner rings have few waves: that of a patch scatters by 0.13 (36 patches), the mean of three by 0.08.
    assert np.mean([values[f"{name}_slope_0.2_2"] for name in PATCHES]) == pytest.approx(-3.0, abs=0.25)


@pytest.mark.parametrize(("pixel_mm", "told"), [(0.25, True), (0.26, False)])
def test_a_pitch_above_a_quarter_of_a_millimetre_tells_no_fine_texture(pixel_mm, told):
    film, place = waves(pixel_mm, 0.5)
    values = measure_fine_texture(film, drawn_outline(), place, pixel_mm)
    assert bool(values) is told
    assert told or values == {}


def test_a_patch_that_leaves_the_film_is_left_out():
    film, place = waves(0.2, 0.5)
    cut = film[: round(place.row + 20 / 0.2)]
    regions = {
        name.split("_sd_over")[0] for name in measure_fine_texture(cut, drawn_outline(), place, 0.2) if "_sd_" in name
    }
    # Only that of the femur is above the cut.
    assert regions == {"medial_condyle"}


def test_a_band_under_a_contour_has_its_brightness_depth_width_and_edge():
    form, outline = np.full(SHAPE, 100.0), drawn_outline()
    tibia, femur = int(outline.tibia[0]), int(outline.femur[0])
    form[tibia + 3 : tibia + 7, COL:] = 150.0
    form[femur - 5 : femur + 1, :COL] = 120.0
    values = measure_grey_features(form, outline)["plate"]
    expected = {"brightness": 0.5, "depth": 3 * PITCH_MM, "width": 4 * PITCH_MM, "edge": 0.5}
    expected_femur = {"brightness": 0.2, "depth": 0.0, "width": 6 * PITCH_MM, "edge": 0.0}
    nothing = dict.fromkeys(expected, 0.0)
    for place, known in {
        "medial_tibia": expected, "lateral_tibia": nothing, "lateral_femur": expected_femur, "medial_femur": nothing,
    }.items():  # fmt: skip
        for name, value in known.items():
            assert values[f"{place}_{name}"] == pytest.approx(value), (place, name)


def test_first_order_is_of_the_whole_form_and_of_each_patch():
    form, outline = np.full(SHAPE, 50.0), drawn_outline()
    form[SHAPE[0] // 2 :] = 150.0
    values = measure_grey_features(form, outline)["first order"]
    assert [values[f"p{at}"] for at in (5, 25, 75, 95)] == [50.0, 50.0, 150.0, 150.0]
    assert (values["mean"], values["sd"], values["skewness"]) == (100.0, 50.0, pytest.approx(0.0, abs=1e-12))
    assert (values["medial_condyle_mean"], values["medial_condyle_sd"]) == (50.0, 0.0)
    for name in ("medial_subchondral", "metaphysis"):
        assert (values[f"{name}_mean"], values[f"{name}_sd"]) == (150.0, 0.0)


def test_lines_a_pixel_wide_are_opposite_across_and_alike_along_whatever_their_tone():
    form = np.where(np.arange(SHAPE[1]) % 2, 100.0, 40.0) * np.ones((SHAPE[0], 1))
    values, darker = (measure_grey_features(one, drawn_outline())["texture"] for one in (form, np.sqrt(form)))
    for name in PATCHES:
        for distance in (1, 3):
            # Across the lines -1 and along them +1; two cells of the matrix, half of the pairs in each.
            assert values[f"{name}_correlation_{distance}"] == pytest.approx(0.0, abs=1e-9)
            assert values[f"{name}_energy_{distance}"] == pytest.approx(np.sqrt(0.5), abs=1e-3)
        assert values[f"{name}_contrast_1"] == values[f"{name}_contrast_3"] > 0
        for key in ("contrast", "homogeneity", "correlation", "energy"):
            assert darker[f"{name}_{key}_1"] == values[f"{name}_{key}_1"]


def test_margins_are_how_far_the_sides_stand_out_beside_the_edges_of_the_plateau():
    margins = measure_shape_features(drawn_outline(flank_mm=HALF_MM - 3, femur_mm=HALF_MM + 1.5))["margins"]
    for side in ("medial", "lateral"):
        for height, out_mm in ((4, 0.0), (8, 0.0), (12, -3.0), (18, -3.0)):
            assert margins[f"{side}_tibia_{height}mm"] * PLATEAU_MM == pytest.approx(out_mm, abs=1e-9)
            assert margins[f"{side}_femur_{height}mm"] * PLATEAU_MM == pytest.approx(1.5, abs=1e-9)
        assert margins[f"{side}_tibia_lip"] * PLATEAU_MM == pytest.approx(3.0, abs=1e-9)
        assert margins[f"{side}_femur_lip"] == pytest.approx(0.0, abs=1e-12)


def test_a_lip_on_one_side_stands_out_there_alone():
    outline = drawn_outline()
    sides = outline.tibia_sides.copy()
    sides[(outline.tibia_rows - outline.tibia_rows[0]) * PITCH_MM < 1.5, 1] += 2 / PITCH_MM
    margins = measure_shape_features(dataclasses.replace(outline, tibia_sides=sides))["margins"]
    assert margins["medial_tibia_4mm"] * PLATEAU_MM == pytest.approx(2.0, abs=1e-9)
    assert margins["medial_tibia_lip"] * PLATEAU_MM == pytest.approx(2.0, abs=1e-9)
    assert margins["lateral_tibia_lip"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rise", [0.0, 0.05])
def test_contours_are_heights_over_the_plateau_whatever_its_tilt(rise):
    outline = drawn_outline()
    share = (outline.columns - COL) * PITCH_MM / PLATEAU_MM
    dish_px = 2 / PITCH_MM * np.clip(1 - np.abs(share - 0.24) / 0.1, 0, None)
    tilt_px = rise * (outline.columns - COL)
    tilted = dataclasses.replace(outline, tibia=outline.tibia + dish_px + tilt_px, femur=outline.femur + tilt_px)
    contour = measure_shape_features(tilted)["contour"]
    gap_mm = GAP * PITCH_MM
    for at, tibia_mm in ((-0.42, 0.0), (-0.24, 0.0), (0.0, 0.0), (0.24, -2.0), (0.42, 0.0)):
        assert contour[f"tibia_{at:+.2f}"] * PLATEAU_MM == pytest.approx(tibia_mm, abs=0.05)
        assert contour[f"femur_{at:+.2f}"] * PLATEAU_MM == pytest.approx(gap_mm, abs=0.05)


def test_a_femur_without_a_notch_has_none_of_any_width():
    shape = measure_shape_features(drawn_outline())["shape"]
    assert (shape["notch_depth"], shape["notch_width"]) == (0.0, 0.0)
