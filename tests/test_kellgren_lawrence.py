"""Check Kellgren-Lawrence grades derived from an anatomy and grades that contradict it."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pssf
from pssf import InputError, Knee, Osteophyte
from pssf.data.knees.oarsi_table import load_oarsi_thresholds
from pssf.model.kellgren_lawrence import allowed_grades, derive_grade


def make_knee(size_mm, **fields):
    osteophytes = (Osteophyte(site="medial_tibia", size_mm=size_mm),) if size_mm else ()
    return Knee(osteophytes=osteophytes, **fields)


@pytest.mark.parametrize(
    ("size_mm", "jsw_mm", "grade"),
    [
        (0.0, 5.0, 0), (0.3, 5.0, 0), (0.6, 5.0, 1), (0.0, 3.4, 1), (0.8, 5.0, 2), (4.0, 5.0, 2),
        (2.0, 3.6, 3), (2.0, 1.5, 4), (0.0, 2.0, 3), (0.0, 0.5, 3),
    ],
)  # fmt: skip
def test_a_grade_is_derived_from_osteophytes_and_joint_space(size_mm, jsw_mm, grade):
    assert derive_grade(make_knee(size_mm, jsw_medial_mm=jsw_mm), load_oarsi_thresholds()) == grade


@pytest.mark.parametrize(
    ("size_mm", "jsw_mm", "grade"), [(0.0, 5.0, 2), (0.0, 5.0, 4), (3.0, 5.0, 0), (3.0, 5.0, 1), (2.0, 0.5, 1)]
)
def test_a_grade_that_contradicts_the_anatomy_is_rejected(size_mm, jsw_mm, grade):
    with pytest.raises(InputError, match=rf"grade must be .* for this anatomy .*, got {grade}: omit grade"):
        make_knee(size_mm, jsw_medial_mm=jsw_mm, grade=grade)


def test_a_sampled_knee_cannot_be_changed_into_another_grade():
    knee = pssf.sample_knee(grade=4, rng=1)
    healthy = dict(osteophytes=(), jsw_medial_mm=5.0, jsw_lateral_mm=6.0)
    with pytest.raises(InputError, match="grade must be 0 to 1"):
        dataclasses.replace(knee, **healthy)
    with pytest.raises(InputError, match="got 0"):
        dataclasses.replace(knee, grade=0)
    assert dataclasses.replace(knee, **healthy, grade=None).grade is None


@settings(max_examples=300, deadline=None)
@given(seed=st.integers(0, 2**32), grade=st.integers(0, 4), table=st.sampled_from(("population", "paper")))
def test_sampled_knees_have_the_requested_grade(seed, grade, table):
    grade = min(grade, 2) if table == "paper" else grade
    knee = pssf.sample_knee(grade=grade, rng=seed, grade_table=table)
    low, high = allowed_grades(knee, load_oarsi_thresholds())
    assert low <= knee.grade == grade <= high
    assert low <= derive_grade(knee, load_oarsi_thresholds()) <= high


@settings(max_examples=300, deadline=None)
@given(
    size_mm=st.floats(0, 8), medial=st.floats(0, 10), lateral=st.floats(0, 10), sex=st.sampled_from(("male", "female"))
)
def test_a_grade_can_be_derived_for_every_anatomy(size_mm, medial, lateral, sex):
    knee = make_knee(size_mm if size_mm >= 0.2 else 0.0, jsw_medial_mm=medial, jsw_lateral_mm=lateral, sex=sex)
    low, high = allowed_grades(knee, load_oarsi_thresholds())
    assert 0 <= low <= derive_grade(knee, load_oarsi_thresholds()) <= high <= 4


def test_the_truth_has_the_grade_of_the_anatomy(small):
    osteophyte = Osteophyte(site="medial_tibia", size_mm=2.0)
    for knee, grade in (
        (Knee(), 0),
        (Knee(osteophytes=(osteophyte,)), 2),
        (Knee(osteophytes=(osteophyte,), grade=3), 3),
    ):
        truth = pssf.build(knee).truth(small)
        assert (truth.grade, truth.readings["XRKL"]) == (grade, grade)


def test_knees_of_a_user_table_have_the_grade_defined_by_the_table(tmp_path):
    own = tmp_path / "my table.toml"
    own.write_text('base = "paper"\n[grade.2]\nosteophyte_count = [0, 0]\njsw_medial_mm = [5.0, 5.0]\n')
    knees = [pssf.sample_knee(grade=2, rng=np.random.default_rng(k), grade_table=str(own)) for k in range(20)]
    assert {(knee.grade, knee.grade_table, knee.osteophytes) for knee in knees} == {(2, "my table.toml", ())}
