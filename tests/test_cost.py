"""What a run costs, and how that grows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pssf.study.report.cost import Meter, growth


@given(exponent=st.floats(0.3, 3), each=st.floats(1e-3, 10), count=st.integers(8, 300))
def test_growth_is_the_exponent_that_was_put_in(exponent, each, count):
    assert growth(list(each * np.arange(1, count + 1) ** exponent)) == pytest.approx(exponent, rel=1e-6)


def test_a_start_that_costs_once_lowers_the_growth_and_fades():
    few, many = (growth(list(5 + 1.0 * np.arange(1, count + 1))) for count in (12, 2000))
    assert few < 0.8
    assert 0.97 < many < 1


def test_few_marks_give_no_growth():
    assert growth([1.0] * 7) is None


def test_a_meter_gives_the_seconds_of_each_stage_and_of_each_made():
    clock = iter([10.0, 11.0, 13.0, 14.0, 20.0, 20.5])
    meter = Meter(now=lambda: next(clock))
    with meter.stage("cohort", "radiographs") as made:
        made(1)
        made(3)
    with meter.stage("claims"):
        pass
    assert meter.stages["cohort"].marks == [1.0, 3.0, 3.0, 3.0]
    assert meter.seconds() == {"cohort": 4.0, "claims": 0.5}
    first, second = meter.rows()
    assert first == {
        "stage": "cohort", "seconds": 4.0, "made": 4, "unit": "radiographs", "seconds_each": 1.0, "growth": None
    }  # fmt: skip
    assert second["seconds_each"] is None


def test_a_stage_that_fails_is_timed_too():
    meter = Meter()
    with pytest.raises(KeyError), meter.stage("cohort"):
        raise KeyError
    assert meter.seconds()["cohort"] >= 0
