"""A bar that shows a stage of the work."""

import re

from rich.console import Console

from pssf.core import progress_display
from pssf.core.processes.execution import Execution
from pssf.core.stage_timer import Stage


def test_rate_and_time_left_are_told_from_the_first_that_is_made_on():
    now = iter([0.0, 0.0, 30.0, 40.0])
    stage = Stage("radiographs", 100, lambda: next(now))
    stage.add_already_done(70)
    assert progress_display.format_rate(stage) == "-- / min"
    stage.advance(10)
    assert progress_display.format_rate(stage) == "20.0 / min, 0:00:50 left"


def test_where_there_is_no_terminal_each_tenth_is_a_line_with_rate_and_time_left(capsys):
    with Execution(progress_bar=progress_display.show_progress_bar).stage("radiographs", "radiographs", 40) as stage:
        stage.add_already_done(10)
        for _ in range(30):
            stage.advance()
    out, lines = capsys.readouterr()
    assert out == ""
    assert re.sub(r"[\d.]+ / min, [\d:]+ left", "RATE", lines).splitlines() == [
        f"radiographs: {done} of 40, RATE" for done in (11, *range(12, 41, 4))
    ]


def test_what_is_waited_for_is_told_by_lines_where_there_is_no_terminal(capsys):
    with progress_display.show_status("measuring") as told:
        told("scatter")
    assert capsys.readouterr() == ("", "scatter\n")


def test_a_bar_shows_what_is_done_of_how_many_and_the_rate(monkeypatch, capsys):
    monkeypatch.setattr(
        progress_display, "Console", lambda stderr: Console(stderr=stderr, force_terminal=True, width=120)
    )
    with Execution(progress_bar=progress_display.show_progress_bar).stage("radiographs", "radiographs", 3) as stage:
        stage.add_already_done(1)
        stage.advance(2)
    line = capsys.readouterr().err
    assert "radiographs" in line
    assert "3/3" in line
    assert "/ min" in line
