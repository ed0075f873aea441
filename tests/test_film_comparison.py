"""Check the comparison of simulated and patient films: outlines, features, domain shift and the page."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

import pssf
from pssf.core.processes.execution import Execution
from pssf.core.resample import downsample_by_area, downsample_by_blocks
from pssf.io.patients.patient_radiographs import Film
from pssf.patient_comparison import film_report
from pssf.patient_comparison.comparison_page import Section, Table, render_page
from pssf.patient_comparison.films import domain_shift
from pssf.patient_comparison.films.contact_sheets import make_contact_sheet
from pssf.patient_comparison.films.film_features import FilmSource, centre_on_joint, measure_located_film
from pssf.patient_comparison.films.film_normalisation import (
    PITCH_MM,
    PLATEAU_MM,
    JointPosition,
    bin_film,
    joint_centre_px,
    resample_joint_field,
    stretch_contrast,
)
from pssf.patient_comparison.films.film_outline import find_cheapest_path, trace_outline
from pssf.patient_comparison.films.grade_effects import _split_half_reliability, compare_grade_effects
from pssf.patient_comparison.films.observer_study import make_observer_sheet, select_observer_films
from pssf.patient_comparison.films.outline_features import find_plateau_edges, measure_shape_features
from pssf.patient_comparison.films.simulated_films import match_pixel_sizes
from pssf.study.report.report_elements import Picture

HALF_MM = PLATEAU_MM / 2


def render_knee(pixel_mm=0.3, gap_mm=5.0, notch_mm=12.0, rows=500, cols=520, size=1.0, side="right"):
    """Render a film with simple shapes around the centre: tibia, femur with a notch, and soft tissue."""
    y, x = np.mgrid[:rows, :cols] * pixel_mm
    x = (x - (cols - 1) * pixel_mm / 2) / size
    y = (y - (rows - 1) * pixel_mm / 2) / size
    if side == "left":
        x = -x
    film = np.full((rows, cols), 0.25)
    half = np.where(y > 0, HALF_MM - 0.35 * np.clip(y - 10, 0, None), HALF_MM - 1.0)
    tibia = (y > gap_mm / 2) & (np.abs(x) < half)
    roof = -gap_mm / 2 - notch_mm * np.exp(-((x / 10) ** 2))
    film[tibia | ((y < roof) & (np.abs(x) < half))] = 0.7
    film += 0.01 * np.random.default_rng(1).standard_normal(film.shape)
    return gaussian_filter(film, 1.0)


def locate_centre(film, pixel_mm, side="right", size=1.0):
    rows, cols = film.shape
    return JointPosition(row=(rows - 1) / 2, col=(cols - 1) / 2, side=side, pitch_mm=pixel_mm / size)


@pytest.mark.parametrize("gap_mm", [3.0, 6.0])
def test_contours_of_simple_shapes_are_traced_within_two_pixels(gap_mm):
    film = render_knee(gap_mm=gap_mm)
    outline = trace_outline(stretch_contrast(resample_joint_field(film, locate_centre(film, 0.3))))
    row, _ = joint_centre_px()
    beside = np.abs(outline.columns - joint_centre_px()[1]) * PITCH_MM > 25.0
    assert np.abs((outline.tibia[beside] - row) * PITCH_MM - gap_mm / 2).max() < 1.5 * PITCH_MM
    assert np.abs((outline.femur[beside] - row) * PITCH_MM + gap_mm / 2).max() < 1.5 * PITCH_MM
    lateral, medial = find_plateau_edges(outline)
    assert (medial - lateral) * PITCH_MM == pytest.approx(PLATEAU_MM, abs=2 * PITCH_MM)


def test_split_half_reliability_follows_spearman_and_brown():
    halves = np.random.default_rng(0).normal(size=(3, 2, 12)) + np.linspace(-2, 2, 12)
    r = np.mean([np.corrcoef(*pair)[0, 1] for pair in halves])
    assert 0.3 < r < 0.95
    assert _split_half_reliability(halves) == pytest.approx(2 * r / (1 + r))
    assert _split_half_reliability(halves * [[[1.0], [-1.0]]]) == 0.0
    assert np.isnan(_split_half_reliability(np.full((2, 2, 5), np.nan)))


def test_in_bone_contact_the_femur_contour_ends_at_the_tibia():
    """Check a film with a sclerotic tibia and a darker band in the femur 12 mm above the joint."""
    film = render_knee(gap_mm=5.0)
    y, x = (np.mgrid[:500, :520] - [[[249.5]], [[259.5]]]) * 0.3
    worn = (x > 12.0) & (x < HALF_MM - 1.0)
    film[worn & (np.abs(y) <= 3.2)] = 0.7
    film[worn & (y > 2.5) & (y < 6.0)] = 0.9
    film[worn & (y < -10.0) & (y > -14.0)] = 0.6
    film = gaussian_filter(film, 1.0)
    outline = trace_outline(stretch_contrast(resample_joint_field(film, locate_centre(film, 0.3))))
    across_mm = (outline.columns - joint_centre_px()[1]) * PITCH_MM
    gap_mm = (outline.tibia - outline.femur) * PITCH_MM
    assert gap_mm[(across_mm > 20.0) & (across_mm < 34.0)].max() < 2.0
    assert gap_mm[across_mm < -25.0] == pytest.approx(5.0, abs=1.5 * PITCH_MM)


def test_the_tibial_contour_follows_the_faint_edge_of_the_spine():
    film = render_knee()
    y, x = (np.mgrid[:500, :520] - [[[249.5]], [[259.5]]]) * 0.3
    tip_mm = 8.0
    film[(y < 2.5) & (y > 2.5 - tip_mm + np.abs(x))] = 0.42
    outline = trace_outline(
        stretch_contrast(resample_joint_field(gaussian_filter(film, 1.0), locate_centre(film, 0.3)))
    )
    across_mm = (outline.columns - joint_centre_px()[1]) * PITCH_MM
    rise_mm = np.median(outline.tibia[np.abs(across_mm) > 20.0]) - outline.tibia
    flank = np.abs(across_mm) < tip_mm - 3.0
    assert_allclose(rise_mm[flank] * PITCH_MM, tip_mm - np.abs(across_mm[flank]), atol=1.0)


@pytest.mark.parametrize("notch_mm", [12.0, 16.0, 24.0])
def test_the_tibial_contour_stays_below_a_dark_notch(notch_mm):
    film, high_mm = render_knee(notch_mm=notch_mm), 4.0
    y, x = (np.mgrid[:500, :520] - [[[249.5]], [[259.5]]]) * 0.3
    film[(y < 2.5) & (y > 2.5 - np.clip(1.4 * (high_mm + 6.0 - np.abs(x)), 0.0, high_mm))] = 0.42
    outline = trace_outline(
        stretch_contrast(resample_joint_field(gaussian_filter(film, 1.0), locate_centre(film, 0.3)))
    )
    across_mm = np.abs(outline.columns - joint_centre_px()[1]) * PITCH_MM
    rise_mm = (np.median(outline.tibia[across_mm > 20.0]) - outline.tibia) * PITCH_MM
    assert_allclose(rise_mm[across_mm < 4.0], high_mm, atol=1.0)


@pytest.mark.parametrize("step", [0.1, 0.15])
def test_a_sharper_fat_edge_is_not_mistaken_for_the_bone_edge(step):
    film = gaussian_filter(render_knee(), 6.0)
    x = (np.mgrid[:500, :520][1] - 259.5) * 0.3
    for beyond in (x - 52.0, -x - 52.0):
        film -= step * np.clip(beyond / 0.3, 0.0, 1.0)
    width_mm = PLATEAU_MM / 1.2
    edges = find_plateau_edges(
        trace_outline(stretch_contrast(resample_joint_field(film, locate_centre(film, 0.3, size=1.2))), width_mm)
    )
    assert np.ptp(edges) * PITCH_MM == pytest.approx(width_mm, abs=3 * PITCH_MM)


def test_shape_features_measure_the_gap_and_the_notch():
    shallow, deep = (
        measure_shape_features(trace_outline(stretch_contrast(resample_joint_field(film, locate_centre(film, 0.3)))))
        for film in (render_knee(gap_mm=4.0, notch_mm=8.0), render_knee(gap_mm=4.0, notch_mm=14.0))
    )
    assert shallow["joint space"]["medial_mean"] * PLATEAU_MM == pytest.approx(4.0, abs=0.7)
    assert (deep["shape"]["notch_depth"] - shallow["shape"]["notch_depth"]) * PLATEAU_MM == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize(("side", "size", "pixel_mm"), [("left", 1.0, 0.3), ("right", 1.1, 0.3), ("right", 1.0, 0.2)])
def test_normalised_films_do_not_depend_on_side_size_or_pitch(side, size, pixel_mm):
    one, other = render_knee(), render_knee(pixel_mm=pixel_mm, side=side, size=size, rows=760, cols=760)
    first = centre_on_joint(one, locate_centre(one, 0.3))
    second = centre_on_joint(other, locate_centre(other, pixel_mm, side, size))
    difference = stretch_contrast(resample_joint_field(one, first)) - stretch_contrast(
        resample_joint_field(other, second)
    )
    assert np.abs(difference).mean() < 8


def test_a_binned_film_equals_one_with_larger_pixels():
    """Check that films are binned before normalisation, and positions are in pixels of the original film."""
    fine, coarse = (
        render_knee(pixel_mm=pixel_mm, rows=rows, cols=rows) for pixel_mm, rows in ((0.15, 1020), (0.45, 340))
    )
    smaller, position = bin_film(fine, locate_centre(fine, 0.15), 3)
    assert smaller.shape == coarse.shape
    binned, plain_form = (
        stretch_contrast(resample_joint_field(film, centre_on_joint(film, near)))
        for film, near in ((smaller, position), (coarse, locate_centre(coarse, 0.45)))
    )
    assert np.abs(binned - plain_form).mean() < 8
    values = measure_located_film(fine, locate_centre(fine, 0.15), 0.15, 3)
    plain = measure_located_film(fine, locate_centre(fine, 0.15), 0.15)
    assert values["pitch_mm"] == pytest.approx(plain["pitch_mm"], rel=0.02)
    assert abs(values["joint_row_px"] - plain["joint_row_px"]) < 5
    assert abs(values["joint_col_px"] - plain["joint_col_px"]) < 5
    # Removing 90 rows at the top moves the joint up by 45 pixels relative to the image centre.
    cut = measure_located_film(fine[90:], dataclasses.replace(locate_centre(fine, 0.15), row=509.5 - 90), 0.15)
    down = [one["tone|joint_offset_down_mm"] for one in (plain, cut)]
    assert down[0] - down[1] == pytest.approx(45 * plain["pitch_mm"], abs=0.2)
    assert cut["tone|joint_offset_right_mm"] == pytest.approx(plain["tone|joint_offset_right_mm"], abs=0.2)
    assert 0 < cut["tone|mean_grey"] < 1
    back = position.rebin(1 / 3)
    assert (back.row, back.col, back.pitch_mm) == pytest.approx((509.5, 509.5, 0.15))


@pytest.mark.parametrize("side", [1.0, 2.5, 3.0, 3.37])
def test_area_means_over_squares_of_fractional_size_are_exact(side):
    """Check that area means of a linear ramp are exact, and that the sum of a single bright pixel is preserved."""
    rows, cols = np.mgrid[:40, :31].astype(float)
    # Pixels are constant over their area, so means of a ramp are exact only over squares of whole pixels.
    means = downsample_by_area(2.0 * rows - 3.0 * cols, side)
    middle = (np.arange(40) + 0.5) * side - 0.5
    plane = 2.0 * middle[: len(means), None] - 3.0 * middle[None, : means.shape[1]]
    assert means.shape == (int(40 / side), int(31 / side))
    assert np.abs(means - plane).max() < (0.0 if side in (1.0, 3.0) else 5 / (8 * side)) + 1e-9
    spot = np.zeros((40, 31))
    spot[11, 17] = 1.0
    assert downsample_by_area(spot, side).sum() * side**2 == pytest.approx(1.0)
    whole = np.random.default_rng(0).random((39, 30))
    assert np.allclose(downsample_by_area(whole, 3.0), downsample_by_blocks(whole, 3))


def test_simulated_films_are_resampled_to_patient_pixel_sizes():
    films = tuple(
        Film(file=f"{n}.tif", grade=n % 5, subject="1", side=None, pixel_mm=0.15, sha256="") for n in range(40)
    )
    simulated = FilmSource(name="simulated", folder=Path(), films=films)
    clinic = [{"status": "found", "pitch_mm": mm} for mm in (0.4, 0.45, 0.5)] + [{"status": "no knee"}]
    records = {"few": [{"status": "found", "pitch_mm": 9.0}], "clinic": clinic}
    pixel_sizes_mm = [film.resampled_pixel_mm for film in match_pixel_sizes(simulated, records, 3).films]
    assert set(pixel_sizes_mm) == {0.4, 0.45, 0.5}
    assert pixel_sizes_mm == [film.resampled_pixel_mm for film in match_pixel_sizes(simulated, records, 3).films]
    assert match_pixel_sizes(simulated, {}, 3) is simulated


def test_centring_corrects_an_offset_and_a_wrong_pitch():
    film = render_knee()
    right = locate_centre(film, 0.3)
    off = dataclasses.replace(right, row=right.row + 12, col=right.col - 20, pitch_mm=0.27)
    found = centre_on_joint(film, off)
    assert found.pitch_mm == pytest.approx(0.3, rel=0.03)
    assert abs(found.row - right.row) * 0.3 < 2.0
    assert abs(found.col - right.col) * 0.3 < 2.0


@pytest.mark.parametrize("change", [{"side": "both"}, {"pitch_mm": 0.0}])
def test_an_invalid_joint_position_raises_an_error(change):
    with pytest.raises(pssf.InputError, match=next(iter(change))):
        JointPosition(**{"row": 1.0, "col": 1.0, "side": "right", "pitch_mm": 0.3, **change})


def test_a_film_without_contrast_raises_an_error():
    with pytest.raises(pssf.InputError, match="must have contrast"):
        stretch_contrast(np.full((20, 20), 0.4))


def test_the_cheapest_path_equals_that_found_by_exhaustive_search():
    cost = np.random.default_rng(4).random((5, 4))
    path = find_cheapest_path(cost, 1)
    paths = np.stack(np.meshgrid(*4 * [np.arange(5)], indexing="ij"), axis=-1).reshape(-1, 4)
    steps = np.abs(np.diff(paths, axis=1))
    price = cost[paths, np.arange(4)].sum(axis=1) + 0.02 * (steps**1.5).sum(axis=1)
    price[steps.max(axis=1) > 1] = np.inf
    assert (path == paths[price.argmin()]).all()


def make_film_features(name, count, shift=0.0, effect=1.0, seed=0):
    """Make three features in two groups; `shift` is added to one feature, and `effect` to another one in grade 2."""
    rng = np.random.default_rng(seed)
    grades = np.repeat([0, 2], count // 2)
    values = rng.standard_normal((count, 3))
    values[:, 0] += shift
    values[:, 1] += effect * (grades == 2)
    columns = pd.MultiIndex.from_tuples([("texture", "a"), ("shape", "b"), ("shape", "c")])
    subjects = np.array([f"{name}{index // 2}" for index in range(count)])
    return domain_shift.FilmFeatures(
        name=name, features=pd.DataFrame(values, columns=columns), grades=grades, subjects=subjects
    )


SAMPLING = {"replicates": 200, "seed": 0}


def test_only_the_shifted_feature_group_separates_the_sources():
    rows = domain_shift.measure_source_separability(
        make_film_features("a", 120), make_film_features("b", 120, shift=4.0, seed=1), **SAMPLING
    )
    auc = {row["group"]: row["auc"] for row in rows}
    assert auc["texture"] > 0.98
    # The tolerance is 3.5 standard errors of the AUC.
    assert abs(auc["shape"] - 0.5) < 0.15
    assert rows[0]["leading_features"].startswith("texture a 1.00")
    assert all(row["low"] <= row["auc"] <= row["high"] for row in rows)


def test_a_model_transfers_if_grade_effects_have_the_same_sign():
    real = make_film_features("real", 160, effect=2.0)
    for effect, same in ((2.0, True), (-2.0, False)):
        simulated = make_film_features("simulated", 160, effect=effect, seed=2)
        row = next(
            row
            for row in domain_shift.measure_transfer(real, simulated, low=0, high=(2,), **SAMPLING)
            if row["group"] == "shape"
        )
        assert (row["auc"] > 0.8) == same
        assert row["patient_auc"] > 0.8
        assert row["gain_fraction"] == pytest.approx((row["auc"] - 0.5) / (row["patient_auc"] - 0.5), abs=2e-3)
        assert row["gain_fraction_low"] <= row["gain_fraction"] <= row["gain_fraction_high"]
        assert (row["gain_fraction_low"] > 0.8) == same


def test_grade_effects_correlate_if_they_have_the_same_sign():
    real = make_film_features("real", 160, effect=2.0)
    for effect, sign in ((2.0, 1.0), (-2.0, -1.0)):
        rows, groups = compare_grade_effects(
            real, make_film_features("simulated", 160, effect=effect, seed=2), low=0, high=(2,), **SAMPLING
        )
        row = next(one for one in groups if one["group"] == "all")
        assert row["features"] == len(rows) == len(real.features.columns)
        assert next(one for one in groups if one["group"] == "shape")["features"] == 2
        assert row["r_low"] <= row["r"] <= row["r_high"]
        assert row["r"] * sign > 0.8
        assert row["same_sign_low"] <= row["same_sign"] <= row["same_sign_high"]
        by_hand = real.features[real.grades == 2].mean() - real.features[real.grades == 0].mean()
        by_hand /= np.sqrt((real.features[real.grades == 2].var() + real.features[real.grades == 0].var()) / 2)
        assert_allclose([one["patient_effect"] for one in rows], by_hand, atol=1e-4)


def test_no_fraction_of_the_gain_is_reported_if_patient_films_show_none():
    row = domain_shift.measure_transfer(
        make_film_features("real", 80, effect=0.0), make_film_features("s", 80), low=0, high=(2,), **SAMPLING
    )[0]
    assert row["patient_low"] < 0.5
    assert (row["gain_fraction"], row["gain_fraction_low"], row["gain_fraction_high"]) == (None, None, None)


@pytest.mark.parametrize(("spread", "least", "most"), [(1.5, 0.95, 1.0), (0.0, 0.0, 0.5)])
def test_the_correlation_of_grade_effects_is_limited_by_reliability(spread, least, most):
    def make_films(name, seed):
        rng, shifts = np.random.default_rng(seed), np.random.default_rng(9).normal(0.0, spread, 40)
        grades = np.repeat([0, 2], 60)
        values = pd.DataFrame(rng.standard_normal((120, 40)) + np.outer(grades == 2, shifts))
        values.columns = pd.MultiIndex.from_tuples([("shape", str(number)) for number in range(40)])
        return domain_shift.FilmFeatures(name=name, features=values, grades=grades, subjects=np.arange(120).astype(str))

    _, groups = compare_grade_effects(make_films("real", 1), make_films("simulated", 2), low=0, high=(2,), **SAMPLING)
    assert least <= groups[-1]["max_r"] <= most


def test_the_highest_simulated_grade_replaces_missing_simulated_grades():
    real, simulated = make_film_features("real", 80), make_film_features("simulated", 80, seed=2)
    real = dataclasses.replace(real, grades=np.where(real.grades == 2, 3, 0))
    row = domain_shift.measure_transfer(real, simulated, low=0, high=(3, 4), **SAMPLING)[0]
    assert row["task"] == "0 v 3+4"
    assert row["trained_on"] == "0 v 2"


def test_no_auc_is_reported_for_too_few_films():
    rows = domain_shift.measure_source_separability(
        make_film_features("a", 120), make_film_features("b", 8, seed=1), **SAMPLING
    )
    assert all("auc" not in row for row in rows)


@pytest.mark.parametrize(("subjects", "decided"), [(1, False), (4, False), (5, True)])
def test_no_auc_is_reported_for_films_of_too_few_subjects(subjects, decided):
    many, few = make_film_features("a", 120), make_film_features("b", 20, seed=1)
    few = dataclasses.replace(few, subjects=np.array([f"b{index % subjects}" for index in range(20)]))
    assert {"auc" in row for row in domain_shift.measure_source_separability(many, few, **SAMPLING)} == {decided}
    transfer = domain_shift.measure_transfer(few, many, low=0, high=(2,), **SAMPLING)
    assert {"auc" in row for row in transfer} == {decided}


def test_cross_validation_keeps_both_knees_of_a_subject_together():
    rng = np.random.default_rng(0)
    subjects = np.repeat(np.arange(60), 2)
    fingerprint = pd.DataFrame(rng.standard_normal((60, 30))[subjects])
    truth = np.repeat(rng.random(60) < 0.5, 2)
    value = domain_shift.cross_validate(fingerprint, truth, subjects, 0)
    # Leakage between the knees of a subject would give an AUC of 1.
    assert abs(domain_shift.auc(truth, value) - 0.5) < 0.25


def make_records(source, count, grades=(0, 2)):
    film = render_knee()
    values = measure_located_film(film, locate_centre(film, 0.3), 0.3)
    rng = np.random.default_rng(len(source))
    rows = []
    for index in range(count):
        noisy = {name: value + 0.01 * rng.standard_normal() for name, value in values.items() if "|" in name}
        rows.append({
            **values, **noisy, "source": source, "file": f"{index}.png", "subject": f"{source}{index}", "side": "right",
            "grade": grades[index % len(grades)], "status": "found", "polarity": "bone bright", "pixel_mm": 0.3,
            "binned": 1, "pixel_height": 1.0,
        })  # fmt: skip
    return [*rows, {"source": source, "file": "x.png", "subject": "x", "grade": 0, "status": "no knee"}]


def test_the_films_section_has_counts_comparisons_and_figures():
    film = render_knee()
    given = {"clinic": make_records("clinic", 24), "simulated": make_records("simulated", 24)}
    section = film_report.make_films_section(given, lambda source, file: film, Execution(), replicates=50)
    tables = {table.name: table.rows for table in section.tables}
    assert [(row["found"], row["no knee"]) for row in tables["radiographs_found"]] == [(24, 1), (24, 1)]
    assert {row["group"] for row in tables["source_separability"]} == {
        "joint space", "contour", "margins", "shape", "subchondral plate", "first order", "texture", "all",
    }  # fmt: skip
    ratios = {row["measure"]: row for row in tables["outline_ratios"]}
    assert {"notch_depth", "metaphysis_width", "medial_tibia_8mm"} <= ratios.keys()
    # Both sources contain the same film with noise of the same SD.
    notch = ratios["notch_depth"]
    assert (notch["patients"], notch["simulated"]) == (24, 24)
    assert abs(notch["difference_sd"]) < 4 * np.sqrt(2 / 24)
    assert 0.5 < notch["sd_ratio"] < 2.0
    assert [figure.name for figure in section.figures] == ["sheet_0", "sheet_2", "observer_study"]
    assert section.summary.startswith("clinic against simulated: AUC 0.")
    assert all(figure.png.startswith(b"\x89PNG") for figure in section.figures)


def test_the_comparison_page_is_self_contained():
    picture = Picture(
        name="p", png=make_contact_sheet([("row", [np.zeros((8, 9), np.uint8)])]), alt="alt <text>", caption="c"
    )
    rows = [{"a": 1.23456, "b": float("nan")}, {"a": None, "c": "x & y"}]
    section = Section(
        name="Part", summary="line", text="t", tables=(Table(name="n", rows=rows, caption="k"),), figures=(picture,)
    )
    page = render_page([section], {"knees": 3})
    assert "1.235" in page
    assert "x &amp; y" in page
    assert "alt &lt;text&gt;" in page
    assert "http" not in page.replace("http-equiv", "")


def test_the_observer_sheet_has_equal_numbers_of_films_from_both_sources():
    def make_record(number, status="found"):
        return {"status": status, "file": f"{number}.png", "grade": number % 5}

    records = {
        "clinic": [make_record(k) for k in range(20)] + [make_record(99, "low score")],
        "few": [make_record(k) for k in range(3)],
        "simulated": [make_record(k) for k in range(100, 130)],
    }
    displayed = []

    def normalise(name, one):
        displayed.append((name, one["file"]))
        return np.full((10, 12), 7, np.uint8)

    order = select_observer_films(records, "simulated", seed=3)
    (figure,), (key,) = make_observer_sheet(order, normalise)
    assert figure.png.startswith(b"\x89PNG")
    assert [(row["source"], row["file"]) for row in key.rows] == displayed
    sources = [row["source"] for row in key.rows]
    assert (sources.count("clinic"), sources.count("simulated"), key.max_rows_shown) == (12, 12, 0)
    assert sources != sorted(sources)
    assert len({row["file"] for row in key.rows}) == 24
    assert select_observer_films(records, "simulated", seed=3) == order
    assert select_observer_films({"few": records["few"], "simulated": records["simulated"]}, "simulated", seed=3) == []
    assert make_observer_sheet([], normalise) == ((), ())
