"""Check the progress display of the stages of a run."""

import re

from rich.console import Console

from pssf.core import progress_display
from pssf.core.processes.execution import Execution
from pssf.core.stage_timer import Stage


def test_rate_and_remaining_time_consider_only_items_of_this_run():
    now = iter([0.0, 0.0, 30.0, 40.0])
    stage = Stage("radiographs", 100, lambda: next(now))
    stage.add_already_done(70)
    assert stage.rate_text == "-- / min"
    stage.advance(10)
    assert stage.rate_text == "20.0 / min, 0:00:50 left"


def test_without_a_terminal_one_line_is_printed_per_tenth_of_the_items(capsys):
    with Execution(progress_bar=progress_display.show_progress_bar).stage("radiographs", "radiographs", 40) as stage:
        stage.add_already_done(10)
        for _ in range(30):
            stage.advance()
    out, lines = capsys.readouterr()
    assert out == ""
    assert re.sub(r"[\d.]+ / min, [\d:]+ left", "RATE", lines).splitlines() == [
        f"radiographs: {done} of 40, RATE" for done in (11, *range(12, 41, 4))
    ]


def test_without_a_terminal_status_is_printed_as_lines(capsys):
    with progress_display.show_status("measuring") as report:
        report("scatter")
    assert capsys.readouterr() == ("", "scatter\n")


def test_the_progress_bar_shows_the_count_and_the_rate(monkeypatch, capsys):
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
