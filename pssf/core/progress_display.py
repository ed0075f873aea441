"""Progress display on standard error: a bar with rate and time left on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from .stage_timer import Stage


@contextmanager
def show_progress_bar(name: str, stage: Stage) -> Iterator[None]:
    """Show the progress of a stage while the context is open.

    A terminal shows a bar with rate and time left. Anything else gets a line of text at each tenth of the work.

    Parameters
    ----------
    name : str
        Name of the stage.
    stage : Stage
        Stage that counts the work.

    Yields
    ------
    None
        The display ends with the context.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        stage.on_change = _make_tenths_reporter(name, stage)
        yield
        return
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        _RateColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=stage.total, stage=stage)
        stage.on_change = lambda done: progress.update(task, completed=done)
        try:
            yield
        except BaseException:
            progress.live.transient = True  # The bar is removed, so that the error message stands alone.
            raise


@contextmanager
def show_status(message: str) -> Iterator[Callable[[str], None]]:
    """Show a message on standard error while the context is open.

    Without a terminal the first message is not shown; each later one is a line.

    Parameters
    ----------
    message : str
        What is being waited for.

    Yields
    ------
    callable
        Function that replaces the message by another text.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _print_line
        return
    with console.status(message) as status:
        yield status.update


def _make_tenths_reporter(name: str, stage: Stage) -> Callable[[int], None]:
    """Create a callback that prints a line whenever another tenth of the work is done."""
    said = 0

    def shown(done: int) -> None:
        nonlocal said
        if stage.newly_done and 10 * done // max(1, stage.total) > said:
            said = 10 * done // max(1, stage.total)
            _print_line(f"{name}: {done} of {stage.total}, {format_rate(stage)}")

    return shown


def _print_line(text: str) -> None:
    """Print a line on standard error."""
    print(text, file=sys.stderr, flush=True)


def format_rate(stage: Stage) -> str:
    """Format the rate and the remaining time of a stage.

    Parameters
    ----------
    stage : Stage
        Stage that counts the work.

    Returns
    -------
    str
        For example "12.0 / min, 0:01:30 left"; "-- / min" until the rate is known.
    """
    per_minute, left = stage.rate_per_minute(), stage.seconds_left()
    if per_minute is None or left is None:
        return "-- / min"
    return f"{per_minute:.1f} / min, {timedelta(seconds=round(left))} left"


class _RateColumn(ProgressColumn):
    """Show rate and time left in a column of the progress bar."""

    def render(self, task: Task) -> Text:
        """Return the text of the column for a task."""
        return Text(format_rate(task.fields["stage"]), style="progress.remaining")
