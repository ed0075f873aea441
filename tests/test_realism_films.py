"""Films in the standard form: outlines, features, domains, the page."""

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
from pssf.study.report.report_page import Picture

HALF_MM = PLATEAU_MM / 2


def drawn_knee(pixel_mm=0.3, gap_mm=5.0, notch_mm=12.0, rows=500, cols=520, size=1.0, side="right"):
    """A film of plain shapes about its middle: a tibia, a femur with a notch, soft tissue beside them."""
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


def middle_of(film, pixel_mm, side="right", size=1.0):
    rows, cols = film.shape
    return JointPosition(row=(rows - 1) / 2, col=(cols - 1) / 2, side=side, pitch_mm=pixel_mm / size)


@pytest.mark.parametrize("gap_mm", [3.0, 6.0])
def test_contours_of_plain_shapes_are_traced_to_a_pixel(gap_mm):
    film = drawn_knee(gap_mm=gap_mm)
    outline = trace_outline(stretch_contrast(resample_joint_field(film, middle_of(film, 0.3))))
    row, _ = joint_centre_px()
    beside = np.abs(outline.columns - joint_centre_px()[1]) * PITCH_MM > 25.0
    assert np.abs((outline.tibia[beside] - row) * PITCH_MM - gap_mm / 2).max() < 1.5 * PITCH_MM
    assert np.abs((outline.femur[beside] - row) * PITCH_MM + gap_mm / 2).max() < 1.5 * PITCH_MM
    lateral, medial = find_plateau_edges(outline)
    assert (medial - lateral) * PITCH_MM == pytest.approx(PLATEAU_MM, abs=2 * PITCH_MM)


def test_the_reliability_of_all_is_browns_of_two_halves():
    halves = np.random.default_rng(0).normal(size=(3, 2, 12)) + np.linspace(-2, 2, 12)
    r = np.mean([np.corrcoef(*pair)[0, 1] for pair in halves])
    assert 0.3 < r < 0.95
    assert _split_half_reliability(halves) == pytest.approx(2 * r / (1 + r))
    assert _split_half_reliability(halves * [[[1.0], [-1.0]]]) == 0.0
    assert np.isnan(_split_half_reliability(np.full((2, 2, 5), np.nan)))


def test_where_bone_lies_on_bone_the_femur_ends_at_the_tibia_and_not_at_an_edge_within():
    """With a sclerotic tibia, and a band of the femur that is darker than what is about it, 12 mm above the joint."""
    film = drawn_knee(gap_mm=5.0)
    y, x = (np.mgrid[:500, :520] - [[[249.5]], [[259.5]]]) * 0.3
    worn = (x > 12.0) & (x < HALF_MM - 1.0)
    film[worn & (np.abs(y) <= 3.2)] = 0.7
    film[worn & (y > 2.5) & (y < 6.0)] = 0.9
    film[worn & (y < -10.0) & (y > -14.0)] = 0.6
    film = gaussian_filter(film, 1.0)
    outline = trace_outline(stretch_contrast(resample_joint_field(film, middle_of(film, 0.3))))
    across_mm = (outline.columns - joint_centre_px()[1]) * PITCH_MM
    gap_mm = (outline.tibia - outline.femur) * PITCH_MM
    assert gap_mm[(across_mm > 20.0) & (across_mm < 34.0)].max() < 2.0
    assert gap_mm[across_mm < -25.0] == pytest.approx(5.0, abs=1.5 * PITCH_MM)


def test_the_tibia_begins_at_the_faint_outline_of_its_spine_and_not_at_the_sharper_edge_at_its_foot():
    film = drawn_knee()
    y, x = (np.mgrid[:500, :520] - [[[249.5]], [[259.5]]]) * 0.3
    tip_mm = 8.0
    film[(y < 2.5) & (y > 2.5 - tip_mm + np.abs(x))] = 0.42
    outline = trace_outline(stretch_contrast(resample_joint_field(gaussian_filter(film, 1.0), middle_of(film, 0.3))))
    across_mm = (outline.columns - joint_centre_px()[1]) * PITCH_MM
    rise_mm = np.median(outline.tibia[np.abs(across_mm) > 20.0]) - outline.tibia
    flank = np.abs(across_mm) < tip_mm - 3.0
    assert_allclose(rise_mm[flank] * PITCH_MM, tip_mm - np.abs(across_mm[flank]), atol=1.0)


@pytest.mark.parametrize("notch_mm", [12.0, 16.0, 24.0])
def test_the_tibia_stays_below_a_dark_notch_however_faint_its_eminence(notch_mm):
    film, high_mm = drawn_knee(notch_mm=notch_mm), 4.0
    y, x = (np.mgrid[:500, :520] - [[[249.5]], [[259.5]]]) * 0.3
    film[(y < 2.5) & (y > 2.5 - np.clip(1.4 * (high_mm + 6.0 - np.abs(x)), 0.0, high_mm))] = 0.42
    outline = trace_outline(stretch_contrast(resample_joint_field(gaussian_filter(film, 1.0), middle_of(film, 0.3))))
    across_mm = np.abs(outline.columns - joint_centre_px()[1]) * PITCH_MM
    rise_mm = (np.median(outline.tibia[across_mm > 20.0]) - outline.tibia) * PITCH_MM
    assert_allclose(rise_mm[across_mm < 4.0], high_mm, atol=1.0)


@pytest.mark.parametrize("step", [0.1, 0.15])
def test_an_edge_of_fat_beyond_the_bone_is_no_side_of_it_though_it_is_sharper(step):
    film = gaussian_filter(drawn_knee(), 6.0)
    x = (np.mgrid[:500, :520][1] - 259.5) * 0.3
    for beyond in (x - 52.0, -x - 52.0):
        film -= step * np.clip(beyond / 0.3, 0.0, 1.0)
    width_mm = PLATEAU_MM / 1.2
    edges = find_plateau_edges(
        trace_outline(stretch_contrast(resample_joint_field(film, middle_of(film, 0.3, size=1.2))), width_mm)
    )
    assert np.ptp(edges) * PITCH_MM == pytest.approx(width_mm, abs=3 * PITCH_MM)


def test_features_tell_the_gap_and_the_notch():
    shallow, deep = (
        measure_shape_features(trace_outline(stretch_contrast(resample_joint_field(film, middle_of(film, 0.3)))))
        for film in (drawn_knee(gap_mm=4.0, notch_mm=8.0), drawn_knee(gap_mm=4.0, notch_mm=14.0))
    )
    assert shallow["joint space"]["medial_mean"] * PLATEAU_MM == pytest.approx(4.0, abs=0.7)
    assert (deep["shape"]["notch_depth"] - shallow["shape"]["notch_depth"]) * PLATEAU_MM == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize(("side", "size", "pixel_mm"), [("left", 1.0, 0.3), ("right", 1.1, 0.3), ("right", 1.0, 0.2)])
def test_a_film_of_another_side_size_or_pitch_has_the_same_form(side, size, pixel_mm):
    one, other = drawn_knee(), drawn_knee(pixel_mm=pixel_mm, side=side, size=size, rows=760, cols=760)
    here = centre_on_joint(one, middle_of(one, 0.3))
    there = centre_on_joint(other, middle_of(other, pixel_mm, side, size))
    difference = stretch_contrast(resample_joint_field(one, here)) - stretch_contrast(
        resample_joint_field(other, there)
    )
    assert np.abs(difference).mean() < 8


def test_a_film_made_smaller_has_the_form_of_one_taken_in_larger_pixels():
    """Crops are made smaller before they are given; what is told of the film is told in its own pixels."""
    fine, coarse = (
        drawn_knee(pixel_mm=pixel_mm, rows=rows, cols=rows) for pixel_mm, rows in ((0.15, 1020), (0.45, 340))
    )
    smaller, place = bin_film(fine, middle_of(fine, 0.15), 3)
    assert smaller.shape == coarse.shape
    here, there = (
        stretch_contrast(resample_joint_field(film, centre_on_joint(film, near)))
        for film, near in ((smaller, place), (coarse, middle_of(coarse, 0.45)))
    )
    assert np.abs(here - there).mean() < 8
    values = measure_located_film(fine, middle_of(fine, 0.15), 0.15, 3)
    plain = measure_located_film(fine, middle_of(fine, 0.15), 0.15)
    assert values["pitch_mm"] == pytest.approx(plain["pitch_mm"], rel=0.02)
    assert abs(values["joint_row_px"] - plain["joint_row_px"]) < 5
    assert abs(values["joint_col_px"] - plain["joint_col_px"]) < 5
    # Cut off at the top by 90 pixels, its joint is 45 nearer to the top of what is left than to its middle.
    cut = measure_located_film(fine[90:], dataclasses.replace(middle_of(fine, 0.15), row=509.5 - 90), 0.15)
    down = [one["tone|joint_down_mm"] for one in (plain, cut)]
    assert down[0] - down[1] == pytest.approx(45 * plain["pitch_mm"], abs=0.2)
    assert cut["tone|joint_aside_mm"] == pytest.approx(plain["tone|joint_aside_mm"], abs=0.2)
    assert 0 < cut["tone|mean_grey"] < 1
    back = place.rebin(1 / 3)
    assert (back.row, back.col, back.pitch_mm) == pytest.approx((509.5, 509.5, 0.15))


@pytest.mark.parametrize("side", [1.0, 2.5, 3.0, 3.37])
def test_means_over_squares_that_share_pixels_are_exact(side):
    """The mean of a plane over a square is its value in the middle; of single bright pixels the sum stays."""
    rows, cols = np.mgrid[:40, :31].astype(float)
    # Pixels hold the mean of their own area, so that a plane is a plane of steps: whole squares alone are exact.
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


def test_simulated_films_are_made_smaller_to_pitches_of_the_largest_real_source():
    films = tuple(
        Film(file=f"{n}.tif", grade=n % 5, subject="1", side=None, pixel_mm=0.15, sha256="") for n in range(40)
    )
    simulated = FilmSource(name="simulated", folder=Path(), films=films)
    clinic = [{"status": "found", "pitch_mm": mm} for mm in (0.4, 0.45, 0.5)] + [{"status": "no knee"}]
    records = {"few": [{"status": "found", "pitch_mm": 9.0}], "clinic": clinic}
    made = [film.resampled_pixel_mm for film in match_pixel_sizes(simulated, records, 3).films]
    assert set(made) == {0.4, 0.45, 0.5}
    assert made == [film.resampled_pixel_mm for film in match_pixel_sizes(simulated, records, 3).films]
    assert match_pixel_sizes(simulated, {}, 3) is simulated


def test_a_place_off_by_centimetres_and_a_wrong_pitch_are_mended():
    film = drawn_knee()
    right = middle_of(film, 0.3)
    off = dataclasses.replace(right, row=right.row + 12, col=right.col - 20, pitch_mm=0.27)
    found = centre_on_joint(film, off)
    assert found.pitch_mm == pytest.approx(0.3, rel=0.03)
    assert abs(found.row - right.row) * 0.3 < 2.0
    assert abs(found.col - right.col) * 0.3 < 2.0


@pytest.mark.parametrize("change", [{"side": "both"}, {"pitch_mm": 0.0}])
def test_a_place_that_is_none_is_refused(change):
    with pytest.raises(pssf.InputError, match=next(iter(change))):
        JointPosition(**{"row": 1.0, "col": 1.0, "side": "right", "pitch_mm": 0.3, **change})


def test_a_film_without_contrast_is_refused():
    with pytest.raises(pssf.InputError, match="must have contrast"):
        stretch_contrast(np.full((20, 20), 0.4))


def test_the_cheapest_path_is_the_cheapest_of_all_paths():
    cost = np.random.default_rng(4).random((5, 4))
    path = find_cheapest_path(cost, 1)
    ways = np.stack(np.meshgrid(*4 * [np.arange(5)], indexing="ij"), axis=-1).reshape(-1, 4)
    steps = np.abs(np.diff(ways, axis=1))
    price = cost[ways, np.arange(4)].sum(axis=1) + 0.02 * (steps**1.5).sum(axis=1)
    price[steps.max(axis=1) > 1] = np.inf
    assert (path == ways[price.argmin()]).all()


def films_of(name, count, shift=0.0, effect=1.0, seed=0):
    """Two features in two groups; `shift` moves one of them for all, grade 2 has `effect` more of the other."""
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


CHANCE = {"replicates": 200, "seed": 0}


def test_sources_that_differ_in_a_group_are_told_apart_by_it_alone():
    rows = domain_shift.measure_source_separability(films_of("a", 120), films_of("b", 120, shift=4.0, seed=1), **CHANCE)
    auc = {row["group"]: row["auc"] for row in rows}
    assert auc["texture"] > 0.98
    assert abs(auc["shape"] - 0.5) < 0.15  # 3.5 standard errors
    assert rows[0]["leading"].startswith("texture a 1.00")
    assert all(row["low"] <= row["auc"] <= row["high"] for row in rows)


def test_what_is_learnt_carries_over_where_the_effect_is_the_same_and_not_where_it_is_turned_round():
    real = films_of("real", 160, effect=2.0)
    for effect, same in ((2.0, True), (-2.0, False)):
        simulated = films_of("simulated", 160, effect=effect, seed=2)
        row = next(
            row
            for row in domain_shift.measure_transfer(real, simulated, low=0, high=(2,), **CHANCE)
            if row["group"] == "shape"
        )
        assert (row["auc"] > 0.8) == same
        assert row["real_auc"] > 0.8
        assert row["way"] == pytest.approx((row["auc"] - 0.5) / (row["real_auc"] - 0.5), abs=2e-3)
        assert row["way_low"] <= row["way"] <= row["way_high"]
        assert (row["way_low"] > 0.8) == same


def test_effects_are_alike_where_grades_act_alike_and_their_intervals_hold_them():
    real = films_of("real", 160, effect=2.0)
    for effect, sign in ((2.0, 1.0), (-2.0, -1.0)):
        rows, groups = compare_grade_effects(
            real, films_of("simulated", 160, effect=effect, seed=2), low=0, high=(2,), **CHANCE
        )
        row = next(one for one in groups if one["group"] == "all")
        assert row["features"] == len(rows) == len(real.features.columns)
        assert next(one for one in groups if one["group"] == "shape")["features"] == 2
        assert row["r_low"] <= row["r"] <= row["r_high"]
        assert row["r"] * sign > 0.8
        assert row["same_sign_low"] <= row["same_sign"] <= row["same_sign_high"]
        by_hand = real.features[real.grades == 2].mean() - real.features[real.grades == 0].mean()
        by_hand /= np.sqrt((real.features[real.grades == 2].var() + real.features[real.grades == 0].var()) / 2)
        assert_allclose([one["real"] for one in rows], by_hand, atol=1e-4)


def test_where_real_films_teach_nothing_for_sure_no_share_of_the_way_is_told():
    row = domain_shift.measure_transfer(
        films_of("real", 80, effect=0.0), films_of("s", 80), low=0, high=(2,), **CHANCE
    )[0]
    assert row["real_low"] < 0.5
    assert (row["way"], row["way_low"], row["way_high"]) == (None, None, None)


@pytest.mark.parametrize(("spread", "least", "most"), [(1.5, 0.95, 1.0), (0.0, 0.0, 0.5)])
def test_correlation_of_effects_is_seen_at_most_as_far_as_films_tell_them(spread, least, most):
    def films(name, seed):
        rng, shifts = np.random.default_rng(seed), np.random.default_rng(9).normal(0.0, spread, 40)
        grades = np.repeat([0, 2], 60)
        values = pd.DataFrame(rng.standard_normal((120, 40)) + np.outer(grades == 2, shifts))
        values.columns = pd.MultiIndex.from_tuples([("shape", str(number)) for number in range(40)])
        return domain_shift.FilmFeatures(name=name, features=values, grades=grades, subjects=np.arange(120).astype(str))

    _, groups = compare_grade_effects(films("real", 1), films("simulated", 2), low=0, high=(2,), **CHANCE)
    assert least <= groups[-1]["most"] <= most


def test_grades_that_are_not_drawn_are_stood_for_by_the_highest_that_is():
    real, simulated = films_of("real", 80), films_of("simulated", 80, seed=2)
    real = dataclasses.replace(real, grades=np.where(real.grades == 2, 3, 0))
    row = domain_shift.measure_transfer(real, simulated, low=0, high=(3, 4), **CHANCE)[0]
    assert row["task"] == "0 v 3+4"
    assert row["trained_on"] == "0 v 2"


def test_of_too_few_films_nothing_is_said():
    rows = domain_shift.measure_source_separability(films_of("a", 120), films_of("b", 8, seed=1), **CHANCE)
    assert all("auc" not in row for row in rows)


@pytest.mark.parametrize(("people", "decided"), [(1, False), (4, False), (5, True)])
def test_of_films_of_too_few_people_nothing_is_said(people, decided):
    many, few = films_of("a", 120), films_of("b", 20, seed=1)
    few = dataclasses.replace(few, subjects=np.array([f"b{index % people}" for index in range(20)]))
    assert {"auc" in row for row in domain_shift.measure_source_separability(many, few, **CHANCE)} == {decided}
    learnt = domain_shift.measure_transfer(few, many, low=0, high=(2,), **CHANCE)
    assert {"auc" in row for row in learnt} == {decided}


def test_both_knees_of_a_person_are_never_on_both_sides_of_a_fold():
    rng = np.random.default_rng(0)
    people = np.repeat(np.arange(60), 2)
    fingerprint = pd.DataFrame(rng.standard_normal((60, 30))[people])
    truth = np.repeat(rng.random(60) < 0.5, 2)
    value = domain_shift.cross_validate(fingerprint, truth, people, 0)
    assert abs(domain_shift.auc(truth, value) - 0.5) < 0.25  # a leak gives 1


def records(source, count, grades=(0, 2)):
    film = drawn_knee()
    values = measure_located_film(film, middle_of(film, 0.3), 0.3)
    rng = np.random.default_rng(len(source))
    made = []
    for index in range(count):
        noisy = {name: value + 0.01 * rng.standard_normal() for name, value in values.items() if "|" in name}
        made.append({
            **values, **noisy, "source": source, "file": f"{index}.png", "subject": f"{source}{index}", "side": "right",
            "grade": grades[index % len(grades)], "status": "found", "polarity": "bone bright", "pixel_mm": 0.3,
            "binned": 1, "pixel_height": 1.0,
        })  # fmt: skip
    return [*made, {"source": source, "file": "x.png", "subject": "x", "grade": 0, "status": "no knee"}]


def test_the_part_on_films_counts_compares_and_shows():
    film = drawn_knee()
    given = {"clinic": records("clinic", 24), "simulated": records("simulated", 24)}
    section = film_report.make_films_section(given, lambda source, file: film, Execution(), replicates=50)
    tables = {table.name: table.rows for table in section.tables}
    assert [(row["found"], row["no knee"]) for row in tables["films_found"]] == [(24, 1), (24, 1)]
    assert {row["group"] for row in tables["films_domains"]} == {
        "joint space", "contour", "margins", "shape", "plate", "first order", "texture", "all",
    }  # fmt: skip
    ratios = {row["measure"]: row for row in tables["films_ratios"]}
    assert {"notch_depth", "metaphysis_width", "medial_tibia_8mm"} <= ratios.keys()
    # Both are the same film with noise of the same size.
    notch = ratios["notch_depth"]
    assert (notch["given"], notch["drawn"]) == (24, 24)
    assert abs(notch["off_sd"]) < 4 * np.sqrt(2 / 24)
    assert 0.5 < notch["spread_ratio"] < 2.0
    assert [figure.name for figure in section.figures] == ["sheet_0", "sheet_2", "blind"]
    assert section.summary.startswith("clinic against simulated: AUC 0.")
    assert all(figure.png.startswith(b"\x89PNG") for figure in section.figures)


def test_the_page_holds_what_it_is_given_and_fetches_nothing():
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


def test_a_reader_is_shown_as_many_real_films_as_simulated_ones_and_the_key_tells_which():
    def film(number, status="found"):
        return {"status": status, "file": f"{number}.png", "grade": number % 5}

    records = {
        "clinic": [film(k) for k in range(20)] + [film(99, "low score")],
        "few": [film(k) for k in range(3)],
        "simulated": [film(k) for k in range(100, 130)],
    }
    shown = []

    def form(name, one):
        shown.append((name, one["file"]))
        return np.full((10, 12), 7, np.uint8)

    order = select_observer_films(records, "simulated", seed=3)
    (figure,), (key,) = make_observer_sheet(order, form)
    assert figure.png.startswith(b"\x89PNG")
    assert [(row["source"], row["file"]) for row in key.rows] == shown
    sources = [row["source"] for row in key.rows]
    assert (sources.count("clinic"), sources.count("simulated"), key.max_rows_shown) == (12, 12, 0)
    assert sources != sorted(sources)
    assert len({row["file"] for row in key.rows}) == 24
    assert select_observer_films(records, "simulated", seed=3) == order
    assert select_observer_films({"few": records["few"], "simulated": records["simulated"]}, "simulated", seed=3) == []
    assert make_observer_sheet([], form) == ((), ())
