"""Check the timer: seconds and rates of stages."""

import pytest

from pssf.core.stage_timer import Stage, Timer


class Clock:
    seconds = 0.0

    def __call__(self):
        return self.seconds


def test_items_of_an_earlier_run_count_as_done_but_not_for_the_rate():
    clock = Clock()
    stage = Stage("radiographs", 100, clock)
    clock.seconds = 5.0
    stage.add_already_done(70)
    assert (stage.rate_per_minute(), stage.seconds_left()) == (None, None)
    clock.seconds = 35.0
    stage.advance(10)
    assert (stage.already_done, stage.newly_done, stage.done) == (70, 10, 80)
    assert stage.rate_per_minute() == pytest.approx(20.0)
    assert stage.seconds_left() == pytest.approx(60.0)
    clock.seconds = 45.0
    assert stage.seconds_left() == pytest.approx(50.0)


def test_the_remaining_time_is_never_negative():
    clock = Clock()
    stage = Stage(total=2, now=clock)
    clock.seconds = 1.0
    stage.advance()
    clock.seconds = 100.0
    assert stage.seconds_left() == 0.0


def test_a_display_receives_every_change_of_the_count():
    counts, stage = [], Stage(total=5)
    stage.on_change = counts.append
    stage.add_already_done(2)
    stage.advance()
    stage.advance(2)
    assert counts == [2, 3, 5]


def test_a_timer_records_seconds_per_stage_and_completion_times():
    clock = Clock()
    timer = Timer(clock)
    with timer.stage("cohort", "radiographs", 4) as stage:
        for clock.seconds, count in ((1.0, 1), (3.0, 3)):
            stage.advance(count)
        clock.seconds = 4.0
    with timer.stage("claims"):
        clock.seconds = 4.5
    assert stage.completion_times_s == [1.0, 3.0, 3.0, 3.0]
    assert timer.seconds == {"cohort": 4.0, "claims": 0.5}


def test_a_lap_measures_the_time_since_the_previous_lap():
    clock = Clock()
    timer = Timer(clock)
    for clock.seconds, name in ((1.0, "anatomy"), (3.5, "rays")):
        timer.lap(name)
    assert timer.seconds == {"anatomy": 1.0, "rays": 2.5}


def test_a_failed_stage_is_timed():
    timer = Timer(iter([0.0, 0.0, 2.0]).__next__)
    with pytest.raises(KeyError), timer.stage("cohort"):
        raise KeyError
    assert timer.seconds == {"cohort": 2.0}
