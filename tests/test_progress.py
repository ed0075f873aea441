import pytest

from pssf.core.progress import Pace, bar, shown


class Clock:
    seconds = 0.0

    def __call__(self):
        return self.seconds


def test_what_stood_before_counts_as_done_and_not_for_the_rate():
    clock = Clock()
    pace = Pace(100, now=clock)
    clock.seconds = 5.0
    pace.found(70)
    assert (pace.per_minute(), pace.seconds_left(), shown(pace)) == (None, None, "-- / min")
    clock.seconds = 35.0
    pace.made(10)
    assert pace.done == 80
    assert pace.per_minute() == pytest.approx(20.0)
    assert pace.seconds_left() == pytest.approx(60.0)
    clock.seconds = 45.0
    assert pace.seconds_left() == pytest.approx(50.0)
    assert shown(pace) == "20.0 / min, 0:00:50 left"


def test_time_left_does_not_fall_below_nothing():
    clock = Clock()
    pace = Pace(2, now=clock)
    clock.seconds = 1.0
    pace.made(1)
    clock.seconds = 100.0
    assert pace.seconds_left() == 0.0


def test_a_bar_that_is_no_terminal_writes_nothing(capsys):
    with bar("radiographs", 3) as pace:
        pace.found(1)
        pace.made(2)
    assert pace.done == 3
    assert capsys.readouterr() == ("", "")
