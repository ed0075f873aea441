"""Check measures of grey values, margins and contours on synthetic films with known geometry and grey values."""

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
# Shape and joint gap of the normalised film, in pixels.
SHAPE, GAP = (168, 201), 10
SOFT, BONE, SPACE, PLATE, CORTEX, CANAL = 0.2, 0.6, 0.3, 0.95, 0.8, 0.4


def make_outline(gap_px=GAP, flank_mm=HALF_MM, femur_mm=HALF_MM):
    """Make the outline of two blocks with specified half widths of the femur and the lower part of the tibia."""
    heights = np.arange(3.0, 24.0, PITCH_MM)
    tibia_mm = np.where(heights < 9, HALF_MM, flank_mm)
    columns = COL + np.arange(-78.0, 79.0)
    femur, tibia = (np.full(len(columns), ROW + sign * gap_px / 2) for sign in (-1, 1))
    both = np.array([-1.0, 1.0]) / PITCH_MM
    return Outline(
        columns=columns, femur=femur, tibia=tibia,
        tibia_rows=tibia[0] + heights / PITCH_MM, tibia_sides=COL + tibia_mm[:, None] * both,
        femur_rows=femur[0] - heights / PITCH_MM, femur_sides=COL + np.full((len(heights), 1), femur_mm) * both,
    )  # fmt: skip


def render_film(pixel_mm=0.2, rows=700, side="right"):
    """Render two blocks of bone, the lower one with a subchondral plate and a shaft; return film and joint position."""
    joint = JointPosition(row=230.0, col=259.5, side=side, pitch_mm=pixel_mm)
    y, x = (np.arange(rows) - joint.row)[:, None] * pixel_mm, (np.arange(520) - joint.col) * pixel_mm
    x, gap_mm = (x if side == "right" else -x), GAP * PITCH_MM
    film = np.full((rows, 520), SOFT)
    film[(np.abs(y) < 45) & (np.abs(x) < HALF_MM)] = BONE
    film[(np.abs(y) < gap_mm / 2) & (np.abs(x) < HALF_MM)] = SPACE
    film[(y > gap_mm / 2 + 1) & (y < gap_mm / 2 + 3) & (x > 0) & (x < HALF_MM)] = PLATE
    film[(y > 50) & (np.abs(x) < 14)] = CORTEX
    film[(y > 50) & (np.abs(x) < 9)] = CANAL
    return film, joint


@pytest.mark.parametrize("side", ["right", "left"])
def test_tone_features_equal_the_ratios_of_the_rendered_grey_values(side):
    film, joint = render_film(side=side)
    values = measure_tone(film, resample_joint_field(film, joint), make_outline(), joint)
    assert values["bone_to_soft_tissue_ratio"] == pytest.approx(BONE / SOFT)
    assert values["joint_space"] == pytest.approx((BONE - SPACE) / (BONE + SPACE))
    tones = {"metaphysis": BONE, "medial_condyle": BONE, "canal": CANAL, "medial_subchondral_plate": PLATE}
    for name, grey in tones.items():
        assert values[f"{name}_tone"] == pytest.approx((grey - SOFT) / (CORTEX - SOFT)), name


def make_joint_field(cortex=0.5, wide_mm=3.0, seed=3):
    """Make a normalised film: blocks of bone with a cortical layer at their sides, texture and soft tissue."""
    x = np.abs(np.arange(SHAPE[1]) - COL) * PITCH_MM
    row = np.where(x > 36.0, SOFT, np.where(x > 36.0 - wide_mm, SOFT + cortex * (BONE - SOFT), BONE))
    return row + np.random.default_rng(seed).normal(0.0, 0.004, SHAPE)


def test_brightness_across_bone_edges_equals_that_of_the_cortex():
    for cortex in (0.7, 1.4):
        values = measure_edges(make_joint_field(cortex))
        sides = [name.removesuffix("_2.1_mm") for name in values if name.endswith("_2.1_mm")]
        assert len(sides) == 5
        for side in sides:
            assert values[f"{side}_1.2_mm"] == pytest.approx(cortex, abs=0.05)
            assert values[f"{side}_2.1_mm"] == pytest.approx(cortex, abs=0.05)
            assert 0.2 < values[f"{side}_0_mm"] / cortex < 0.8


def test_edge_brightness_does_not_depend_on_contrast_and_needs_an_edge():
    field = make_joint_field()
    assert measure_edges(3 * field + 0.2) == pytest.approx(measure_edges(field))
    assert not any(name.endswith("_mm") for name in measure_edges(np.random.default_rng(4).normal(SOFT, 0.01, SHAPE)))


@pytest.mark.parametrize(("bone", "above_mm"), [("femur", 25.0), ("tibia", -18.0)])
@pytest.mark.parametrize(("side", "sign"), [("medial", 1), ("lateral", -1)])
def test_a_bright_line_is_detected_in_its_compartment_and_bone(bone, above_mm, side, sign):
    field, plain = make_joint_field(), measure_edges(make_joint_field())
    row, cols = ROW - round(above_mm / PITCH_MM), COL + sign * (np.arange(12) + round(18.0 / PITCH_MM))
    field[row : row + 2, cols] += 0.05
    values = measure_edges(field)
    assert values[f"{side}_{bone}_line"] > 3 * plain[f"{side}_{bone}_line"]
    others = [name for name in values if name.endswith("_line") and name != f"{side}_{bone}_line"]
    assert len(others) == 3
    assert all(values[name] < 1.2 * plain[name] for name in others)


def test_tone_features_do_not_depend_on_contrast_and_brightness():
    film, joint = render_film()
    values, brighter = (
        measure_tone(one, resample_joint_field(one, joint), make_outline(), joint) for one in (film, 2 * film + 0.1)
    )
    assert {name for name in values if name.endswith("_tone")} == {
        *(f"{name}_tone" for name in (*PATCHES, "canal", "medial_subchondral_plate"))
    }
    for name in values:
        if name.endswith("_tone"):
            assert brighter[name] == pytest.approx(values[name])
    assert brighter["bone_to_soft_tissue_ratio"] == pytest.approx((2 * BONE + 0.1) / (2 * SOFT + 0.1))


def test_a_film_without_the_shaft_has_no_tone_features_but_contrasts():
    film, joint = render_film(rows=500)
    values = measure_tone(film, resample_joint_field(film, joint), make_outline(), joint)
    assert set(values) == {"bone_to_soft_tissue_ratio", "joint_space"}
    assert values["bone_to_soft_tissue_ratio"] == pytest.approx(BONE / SOFT)


def make_waves(pixel_mm, per_mm, height=0.1):
    """Make a film of vertical lines; return it and the joint position."""
    side = round(100 / pixel_mm)
    across = np.arange(side) * pixel_mm
    film = np.tile(0.5 + height * np.sin(2 * np.pi * per_mm * across), (side, 1))
    return film, JointPosition(row=(side - 1) / 2, col=(side - 1) / 2, side="right", pitch_mm=pixel_mm)


@pytest.mark.parametrize("transposed", [False, True])
def test_fine_texture_of_a_wave_has_the_moments_and_direction_of_a_sine(transposed):
    film, joint = make_waves(0.1, 8 / PATCH_MM)
    values = measure_fine_texture(film.T if transposed else film, make_outline(), joint, 0.1)
    for name in PATCHES:
        # With 8 waves per patch, detrending removes 1 % of the variance, and interpolation 1 % of the amplitude.
        assert values[f"{name}_sd_over_mean"] == pytest.approx(0.1 / np.sqrt(2) / 0.5, rel=0.02)
        assert values[f"{name}_skewness"] == pytest.approx(0.0, abs=0.05)
        assert values[f"{name}_excess_kurtosis"] == pytest.approx(-1.5, abs=0.05)
        lines = values[f"{name}_vertical_over_horizontal"]
        assert (1 / lines if transposed else lines) > 1000


def test_the_slope_of_a_power_law_spectrum_is_its_exponent():
    pixel_mm, side = 0.1, 1000
    radius = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(side, pixel_mm)]))
    noise = np.fft.fft2(np.random.default_rng(2).standard_normal((side, side)))
    film = np.fft.ifft2(noise / np.maximum(radius, 0.02) ** 1.5).real
    joint = JointPosition(row=499.5, col=499.5, side="right", pitch_mm=pixel_mm)
    values = measure_fine_texture(10 + film / film.std(), make_outline(), joint, pixel_mm)
    # Low frequencies have few samples: the SD of the slope is 0.13 for one patch and 0.08 for the mean of three.
    assert np.mean([values[f"{name}_slope_0.2_2"] for name in PATCHES]) == pytest.approx(-3.0, abs=0.25)


@pytest.mark.parametrize(("pixel_mm", "measured"), [(0.25, True), (0.26, False)])
def test_fine_texture_needs_a_pitch_of_at_most_0_25_mm(pixel_mm, measured):
    film, joint = make_waves(pixel_mm, 0.5)
    values = measure_fine_texture(film, make_outline(), joint, pixel_mm)
    assert bool(values) is measured
    assert measured or values == {}


def test_a_patch_beyond_the_film_border_is_omitted():
    film, joint = make_waves(0.2, 0.5)
    cut = film[: round(joint.row + 20 / 0.2)]
    regions = {
        name.split("_sd_over")[0] for name in measure_fine_texture(cut, make_outline(), joint, 0.2) if "_sd_" in name
    }
    # Only the patch of the femur is above the cut.
    assert regions == {"medial_condyle"}


def test_brightness_depth_and_width_of_a_subchondral_band_are_measured():
    form, outline = np.full(SHAPE, 100.0), make_outline()
    tibia, femur = int(outline.tibia[0]), int(outline.femur[0])
    form[tibia + 3 : tibia + 7, COL:] = 150.0
    form[femur - 5 : femur + 1, :COL] = 120.0
    values = measure_grey_features(form, outline)["subchondral plate"]
    expected = {"brightness": 0.5, "depth": 3 * PITCH_MM, "width": 4 * PITCH_MM, "edge": 0.5}
    expected_femur = {"brightness": 0.2, "depth": 0.0, "width": 6 * PITCH_MM, "edge": 0.0}
    absent = dict.fromkeys(expected, 0.0)
    for joint, known in {
        "medial_tibia": expected, "lateral_tibia": absent, "lateral_femur": expected_femur, "medial_femur": absent,
    }.items():  # fmt: skip
        for name, value in known.items():
            assert values[f"{joint}_{name}"] == pytest.approx(value), (joint, name)


def test_first_order_features_cover_the_whole_film_and_each_patch():
    form, outline = np.full(SHAPE, 50.0), make_outline()
    form[SHAPE[0] // 2 :] = 150.0
    values = measure_grey_features(form, outline)["first order"]
    assert [values[f"p{at}"] for at in (5, 25, 75, 95)] == [50.0, 50.0, 150.0, 150.0]
    assert (values["mean"], values["sd"], values["skewness"]) == (100.0, 50.0, pytest.approx(0.0, abs=1e-12))
    assert (values["medial_condyle_mean"], values["medial_condyle_sd"]) == (50.0, 0.0)
    for name in ("medial_subchondral", "metaphysis"):
        assert (values[f"{name}_mean"], values[f"{name}_sd"]) == (150.0, 0.0)


def test_co_occurrence_features_of_lines_do_not_depend_on_grey_scale():
    form = np.where(np.arange(SHAPE[1]) % 2, 100.0, 40.0) * np.ones((SHAPE[0], 1))
    values, darker = (measure_grey_features(one, make_outline())["texture"] for one in (form, np.sqrt(form)))
    for name in PATCHES:
        for distance in (1, 3):
            # The correlation is -1 across and +1 along the lines; two matrix cells each contain half of the pairs.
            assert values[f"{name}_correlation_{distance}"] == pytest.approx(0.0, abs=1e-9)
            assert values[f"{name}_energy_{distance}"] == pytest.approx(np.sqrt(0.5), abs=1e-3)
        assert values[f"{name}_contrast_1"] == values[f"{name}_contrast_3"] > 0
        for key in ("contrast", "homogeneity", "correlation", "energy"):
            assert darker[f"{name}_{key}_1"] == values[f"{name}_{key}_1"]


def test_margins_measure_distances_of_bone_sides_from_the_plateau_edge():
    margins = measure_shape_features(make_outline(flank_mm=HALF_MM - 3, femur_mm=HALF_MM + 1.5))["margins"]
    for side in ("medial", "lateral"):
        for height, out_mm in ((4, 0.0), (8, 0.0), (12, -3.0), (18, -3.0)):
            assert margins[f"{side}_tibia_{height}mm"] * PLATEAU_MM == pytest.approx(out_mm, abs=1e-9)
            assert margins[f"{side}_femur_{height}mm"] * PLATEAU_MM == pytest.approx(1.5, abs=1e-9)
        assert margins[f"{side}_tibia_lip"] * PLATEAU_MM == pytest.approx(3.0, abs=1e-9)
        assert margins[f"{side}_femur_lip"] == pytest.approx(0.0, abs=1e-12)


def test_a_medial_osteophyte_changes_only_the_medial_margin():
    outline = make_outline()
    sides = outline.tibia_sides.copy()
    sides[(outline.tibia_rows - outline.tibia_rows[0]) * PITCH_MM < 1.5, 1] += 2 / PITCH_MM
    margins = measure_shape_features(dataclasses.replace(outline, tibia_sides=sides))["margins"]
    assert margins["medial_tibia_4mm"] * PLATEAU_MM == pytest.approx(2.0, abs=1e-9)
    assert margins["medial_tibia_lip"] * PLATEAU_MM == pytest.approx(2.0, abs=1e-9)
    assert margins["lateral_tibia_lip"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rise", [0.0, 0.05])
def test_contour_heights_do_not_depend_on_the_tilt_of_the_plateau(rise):
    outline = make_outline()
    fraction = (outline.columns - COL) * PITCH_MM / PLATEAU_MM
    dish_px = 2 / PITCH_MM * np.clip(1 - np.abs(fraction - 0.24) / 0.1, 0, None)
    tilt_px = rise * (outline.columns - COL)
    tilted = dataclasses.replace(outline, tibia=outline.tibia + dish_px + tilt_px, femur=outline.femur + tilt_px)
    contour = measure_shape_features(tilted)["contour"]
    gap_mm = GAP * PITCH_MM
    for at, tibia_mm in ((-0.42, 0.0), (-0.24, 0.0), (0.0, 0.0), (0.24, -2.0), (0.42, 0.0)):
        assert contour[f"tibia_{at:+.2f}"] * PLATEAU_MM == pytest.approx(tibia_mm, abs=0.05)
        assert contour[f"femur_{at:+.2f}"] * PLATEAU_MM == pytest.approx(gap_mm, abs=0.05)


def test_a_femur_without_a_notch_has_notch_depth_and_width_zero():
    shape = measure_shape_features(make_outline())["shape"]
    assert (shape["notch_depth"], shape["notch_width"]) == (0.0, 0.0)
