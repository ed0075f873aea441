"""Check the summary of run times and their growth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pssf.core.stage_timer import Timer
from pssf.study.report.run_cost import fit_growth_exponent, summarise_cost


@given(exponent=st.floats(0.3, 3), each=st.floats(1e-3, 10), count=st.integers(8, 300))
def test_the_growth_exponent_of_a_power_law_is_recovered(exponent, each, count):
    assert fit_growth_exponent(list(each * np.arange(1, count + 1) ** exponent)) == pytest.approx(exponent, rel=1e-6)


def test_a_constant_start_up_time_lowers_the_exponent_of_short_runs():
    few, many = (fit_growth_exponent(list(5 + 1.0 * np.arange(1, count + 1))) for count in (12, 2000))
    assert few < 0.8
    assert 0.97 < many < 1


def test_seven_time_marks_give_no_growth_exponent():
    assert fit_growth_exponent([1.0] * 7) is None


def test_a_cost_row_lists_seconds_in_total_and_for_each_item():
    timer = Timer()
    for name, count in (("cohort", 4), ("claims", 0)):
        with timer.stage(name, "radiographs" if count else "") as stage:
            stage.advance(count)
        stage.seconds = 4.0
    first, second = summarise_cost(timer)
    assert first == {
        "stage": "cohort", "seconds": 4.0, "made": 4, "unit": "radiographs", "seconds_each": 1.0, "growth": None
    }  # fmt: skip
    assert second["seconds_each"] is None


def test_a_known_growth_exponent_is_not_estimated():
    timer = Timer()
    with timer.stage("training and testing", "splits") as stage:
        stage.advance(20)
    stage.time_exponent = 1.7
    assert summarise_cost(timer)[0]["growth"] == 1.7
