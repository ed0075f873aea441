"""A bar that shows a stage of the work."""

from rich.console import Console

from pssf.core import progress
from pssf.core.execution import Execution
from pssf.core.timer import Stage


def test_rate_and_time_left_are_told_from_the_first_that_is_made_on():
    now = iter([0.0, 0.0, 30.0, 40.0])
    stage = Stage("radiographs", 100, lambda: next(now))
    stage.keep(70)
    assert progress.rate(stage) == "-- / min"
    stage.advance(10)
    assert progress.rate(stage) == "20.0 / min, 0:00:50 left"


def test_a_bar_that_is_no_terminal_writes_nothing(capsys):
    with Execution(bar=progress.bar).stage("radiographs", "radiographs", 3) as stage:
        stage.keep(1)
        stage.advance(2)
    assert stage.done == 3
    assert capsys.readouterr() == ("", "")


def test_a_bar_shows_what_is_done_of_how_many_and_the_rate(monkeypatch, capsys):
    monkeypatch.setattr(progress, "Console", lambda stderr: Console(stderr=stderr, force_terminal=True, width=120))
    with Execution(bar=progress.bar).stage("radiographs", "radiographs", 3) as stage:
        stage.keep(1)
        stage.advance(2)
    line = capsys.readouterr().err
    assert "radiographs" in line
    assert "3/3" in line
    assert "/ min" in line
