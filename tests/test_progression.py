"""Check disease progression: no recovery, constant patient attributes and reported true change."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pssf
from pssf import InputError, Knee, Osteophyte
from pssf.data.knees.grade_tables import load_grade_table
from pssf.data.knees.oarsi_table import load_oarsi_thresholds
from pssf.data.knees.progression_table import load_progression_rates
from pssf.model.knee import knee_to_dict

SIGN_OF_CHANGE = {"jsw_medial_mm": -1, "jsw_lateral_mm": -1, "subchondral_plate": 1, "age_years": 1,
                  "osteophyte_count": 1, "largest_osteophyte_mm": 1, "notch_growth_mm": 1, "effusion_mm": 1,
                  "grade_change": 1}  # fmt: skip
CHANGEABLE = {"jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "age_years", "varus_deg", "osteophytes",
           "notch_growth_mm", "effusion_mm", "grade", "reader_grade"}  # fmt: skip


def sample_knee(grade, seed, grade_table="population"):
    return pssf.sample_knee(grade=grade, rng=np.random.default_rng((grade, seed)), grade_table=grade_table)


def make_knee(grade):
    """Make a knee that is consistent with a KL grade."""
    beak = () if grade < 2 else (Osteophyte(site="medial_tibia", size_mm=2.0),)
    space = dict(jsw_medial_mm=4.0 if grade < 3 else 2.0, jsw_lateral_mm=4.5)
    return Knee(jsw_definition="read", osteophytes=beak, grade=grade, **space)


@given(grade=st.integers(0, 4), seed=st.integers(0, 2**20), years=st.floats(0, 30))
@settings(max_examples=150, deadline=None)
def test_progression_never_reverses_and_keeps_patient_attributes(grade, seed, years):
    knee = dataclasses.replace(sample_knee(grade, seed), age_years=60.0)
    visits = [pssf.progress(knee, at, np.random.default_rng(seed)) for at in (years / 2, years)]
    for before, after in zip((knee, *visits), (*visits, visits[-1]), strict=True):
        change = pssf.true_change(before, after)
        assert all(sign * change[name] >= 0 for name, sign in SIGN_OF_CHANGE.items())
    first, last = (knee_to_dict(one) for one in (knee, visits[-1]))
    assert {name for name in first if first[name] != last[name]} <= CHANGEABLE
    assert last["age_years"] == pytest.approx(60.0 + years, abs=1e-4)


def test_jsw_loss_is_linear_in_time_and_zero_years_change_nothing():
    for grade in range(5):
        knee = sample_knee(grade, 3)
        assert pssf.progress(knee, 0.0, np.random.default_rng(5)) == knee
        spaces = [pssf.progress(knee, at, np.random.default_rng(5)).jsw_medial_mm for at in (1.0, 2.0, 3.0)]
        # JSW decreases linearly until it reaches zero.
        assert spaces[2] == 0.0 or spaces[0] - spaces[1] == pytest.approx(spaces[1] - spaces[2], abs=2e-4)


@pytest.mark.parametrize("grade", range(5))
def test_jsw_loss_per_year_agrees_with_the_rate_of_the_grade(grade):
    law, count = load_progression_rates(), 400
    knee = make_knee(grade)
    later = [pssf.progress(knee, 1.0, np.random.default_rng(seed)) for seed in range(count)]
    lost = [max(knee.jsw_medial_mm - one.jsw_medial_mm, knee.jsw_lateral_mm - one.jsw_lateral_mm) for one in later]
    mean, sd = law.loss_mm[grade]
    assert abs(np.mean(lost) - mean) < 4 * sd / np.sqrt(count)
    assert 0.06 <= mean <= 0.19


def test_the_grade_rises_when_jsw_loss_crosses_a_threshold():
    narrow = Knee(jsw_definition="read", jsw_medial_mm=3.1, jsw_lateral_mm=4.2, grade=2, reader_grade=1,
                  osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=2.0),))  # fmt: skip
    visits = [pssf.progress(narrow, 12.0, np.random.default_rng(seed)) for seed in range(60)]
    for later in visits:
        lost = max(1 - later.jsw_medial_mm / (3.71 + 0.3), 1 - later.jsw_lateral_mm / (5.22 + 0.3))
        assert later.grade == 2 + (lost >= 0.26) + (lost >= 0.67)
        assert later.reader_grade == later.grade - 1
    assert len({later.grade for later in visits}) > 1


def test_a_growing_osteophyte_that_becomes_definite_changes_kl_to_2():
    doubtful = Knee(jsw_definition="read", jsw_medial_mm=6.0, jsw_lateral_mm=7.0, grade=1,
                    osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=1.0),))  # fmt: skip
    visits = [pssf.progress(doubtful, 4.0, np.random.default_rng(seed)) for seed in range(60)]
    for later in visits:
        assert later.grade == 1 + (max(one.size_mm for one in later.osteophytes) >= 1.2)
    assert len({later.grade for later in visits}) == 2


def test_sampled_knees_do_not_change_grade_at_baseline():
    for grade in (0, 1):
        stayed = [pssf.progress(sample_knee(grade, seed), 0.0, np.random.default_rng(seed)).grade for seed in range(60)]
        assert set(stayed) == {grade}
        sizes = [
            one.size_mm for seed in range(60) for one in sample_knee(grade, seed).osteophytes if "spine" not in one.site
        ]
        assert max(sizes) <= load_progression_rates().step.definite_mm[grade]


def test_jsw_loss_thresholds_agree_with_the_population_table():
    laws, cuts = load_grade_table("population").spaces, load_oarsi_thresholds()
    assert cuts.healthy_mm["read"] == tuple(mean for mean, _ in laws.medial["0"])
    assert cuts.male_excess_mm["read"] == laws.male_excess_mm
    jsw_laws = ((laws.medial, cuts.healthy_mm["read"][0]), (laws.lateral, cuts.healthy_mm["read"][1]))
    lost = np.array([[1 - law[grade][0][0] / healthy for grade in ("2", "3", "4")] for law, healthy in jsw_laws])
    between = (lost[:, 1:] + lost[:, :-1]) / 2
    assert np.abs(between - np.array(load_oarsi_thresholds().kellgren_lawrence.jsw_loss_fractions)).max() < 0.02


@pytest.mark.parametrize("grade", range(5))
def test_notch_growth_and_effusion_increase_at_the_grade_specific_rate(grade):
    law, count = load_progression_rates(), 400
    later = [pssf.progress(make_knee(grade), 1.0, np.random.default_rng(seed)) for seed in range(count)]
    for name, (mean, sd) in (("notch_growth_mm", law.notch_mm[grade]), ("effusion_mm", law.swelling_mm[grade])):
        assert abs(np.mean([getattr(one, name) for one in later]) - mean) < 4 * sd / np.sqrt(count)
    unchanged = pssf.progress(dataclasses.replace(make_knee(grade), effusion_mm=9.5), 20.0, np.random.default_rng(0))
    assert unchanged.effusion_mm == 9.5


def test_asymmetric_jsw_loss_increases_varus():
    knee = dataclasses.replace(sample_knee(3, 1), jsw_medial_mm=2.0, jsw_lateral_mm=4.5, varus_deg=1.0)
    change = pssf.true_change(knee, pssf.progress(knee, 10.0, np.random.default_rng(0)))
    assert change["jsw_medial_mm"] < change["jsw_lateral_mm"] <= 0
    assert change["varus_deg"] == pytest.approx(1.27 * (change["jsw_lateral_mm"] - change["jsw_medial_mm"]), abs=1e-3)


def test_invalid_arguments_of_progress_raise_an_error():
    for arguments, match in (
        ((Knee(), -1.0, np.random.default_rng(0)), "years must be .*, got -1"),
        ((Knee(), 1.0, "7"), "rng must be a whole number"),
        (("knee", 1.0, np.random.default_rng(0)), "knee must be a Knee, got 'knee'"),
        ((Knee(age_years=95.0), 10.0, np.random.default_rng(0)), "age_years must be .*, got 105"),
    ):
        with pytest.raises(InputError, match=match):
            pssf.progress(*arguments)


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [("x", pssf.Knee(), "before must be a Knee, got 'x'"), (pssf.Knee(), None, "after must be a Knee, got ")],
)
def test_true_change_requires_two_knee_objects(before, after, line):
    with pytest.raises(pssf.InputError, match=line):
        pssf.true_change(before, after)
