"""Seconds of stages, and how fast they go."""

import pytest

from pssf.core.stage_timer import Stage, Timer


class Clock:
    seconds = 0.0

    def __call__(self):
        return self.seconds


def test_what_stood_before_counts_as_done_and_not_for_the_rate():
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


def test_time_left_does_not_fall_below_nothing():
    clock = Clock()
    stage = Stage(total=2, now=clock)
    clock.seconds = 1.0
    stage.advance()
    clock.seconds = 100.0
    assert stage.seconds_left() == 0.0


def test_whatever_shows_a_stage_is_told_all_that_is_done():
    shown, stage = [], Stage(total=5)
    stage.on_change = shown.append
    stage.add_already_done(2)
    stage.advance()
    stage.advance(2)
    assert shown == [2, 3, 5]


def test_a_timer_gives_the_seconds_of_each_stage_and_marks_of_all_that_is_made_in_it():
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


def test_a_lap_lasts_since_the_lap_before_it():
    clock = Clock()
    timer = Timer(clock)
    for clock.seconds, name in ((1.0, "anatomy"), (3.5, "rays")):
        timer.lap(name)
    assert timer.seconds == {"anatomy": 1.0, "rays": 2.5}


def test_a_stage_that_fails_is_timed_too():
    timer = Timer(iter([0.0, 0.0, 2.0]).__next__)
    with pytest.raises(KeyError), timer.stage("cohort"):
        raise KeyError
    assert timer.seconds == {"cohort": 2.0}
