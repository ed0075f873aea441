"""Show progress on standard error: a bar with rate and remaining time on a terminal, otherwise lines of text."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from .stage_timer import Stage


@contextmanager
def show_progress_bar(name: str, stage: Stage) -> Iterator[None]:
    """Show the progress of a stage while the context is open.

    On a terminal, a bar shows rate and remaining time. Otherwise, a line of text is printed after each tenth of the
    work.

    Parameters
    ----------
    name : str
        Name of the stage.
    stage : Stage
        Stage that counts the work.

    Yields
    ------
    None
        The display ends at the end of the block.
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
        # TimeRemainingColumn of rich is not used, because its rate would include the items of an earlier run.
        TextColumn("{task.fields[stage].rate_text}", style="progress.remaining"),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=stage.total, stage=stage)
        stage.on_change = lambda done: progress.update(task, completed=done)
        try:
            yield
        except BaseException:
            progress.live.transient = (
                True  # After an error the bar is removed, so that only the error message is visible.
            )
            raise


@contextmanager
def show_status(message: str) -> Iterator[Callable[[str], None]]:
    """Show a message on standard error while the context is open.

    Without a terminal the first message is not shown, and each later message is printed as a line.

    Parameters
    ----------
    message : str
        Text of the message, such as "measuring".

    Yields
    ------
    callable
        Function that takes a new text and displays it instead of the message.
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
            _print_line(f"{name}: {done} of {stage.total}, {stage.rate_text}")

    return shown


def _print_line(text: str) -> None:
    """Print a line on standard error."""
    print(text, file=sys.stderr, flush=True)
