"""What shows that work goes on: a bar with rate and time left on a terminal, elsewhere lines."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from .timer import Stage


@contextmanager
def bar(what: str, stage: Stage) -> Iterator[None]:
    """A progress bar on standard error, with rate and time left; where that is no terminal, a line at each tenth."""
    console = Console(stderr=True)
    if not console.is_terminal:
        stage.shown = _tenths(what, stage)
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
        task = progress.add_task(what, total=stage.total, stage=stage)
        stage.shown = lambda done: progress.update(task, completed=done)
        try:
            yield
        except BaseException:
            progress.live.transient = True  # a refusal is one line
            raise


@contextmanager
def waiting(why: str) -> Iterator[Callable[[str], None]]:
    """Says on standard error what is being waited for, while it lasts; gives what says that it is something else now.

    Where that is no terminal, only what comes later is said, a line each.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _line
        return
    with console.status(why) as status:
        yield status.update


def _tenths(what: str, stage: Stage) -> Callable[[int], None]:
    """What says how many are done, whenever another tenth is."""
    said = 0

    def shown(done: int) -> None:
        nonlocal said
        if stage.made and 10 * done // max(1, stage.total) > said:
            said = 10 * done // max(1, stage.total)
            _line(f"{what}: {done} of {stage.total}, {rate(stage)}")

    return shown


def _line(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def rate(stage: Stage) -> str:
    """Rate and time left as text."""
    per_minute, left = stage.per_minute(), stage.seconds_left()
    if per_minute is None or left is None:
        return "-- / min"
    return f"{per_minute:.1f} / min, {timedelta(seconds=round(left))} left"


class _RateColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(rate(task.fields["stage"]), style="progress.remaining")
