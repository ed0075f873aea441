"""A bar that shows a stage of the work: rate, and time left."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

from .timer import Stage


@contextmanager
def bar(what: str, stage: Stage) -> Iterator[None]:
    """A progress bar on standard error, with rate and time left, where that is a terminal."""
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        _RateColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=stage.total, stage=stage)
        stage.shown = lambda done: progress.update(task, completed=done)
        try:
            yield
        except BaseException:
            progress.live.transient = True  # a refusal is one line
            raise


def rate(stage: Stage) -> str:
    """Rate and time left as text."""
    per_minute, left = stage.per_minute(), stage.seconds_left()
    if per_minute is None or left is None:
        return "-- / min"
    return f"{per_minute:.1f} / min, {timedelta(seconds=round(left))} left"


class _RateColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(rate(task.fields["stage"]), style="progress.remaining")
