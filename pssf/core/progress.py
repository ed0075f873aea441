"""How fast a stage of the work goes, and a bar that shows it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from time import perf_counter

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text


class Pace:
    """Counts what a stage has done; what an earlier run did is part of the total, and not of the rate.

    total  to be done
    moved  is told how many are done, whenever that changes
    now    seconds of a clock
    """

    def __init__(
        self, total: int, moved: Callable[[int], None] = lambda done: None, now: Callable[[], float] = perf_counter
    ) -> None:
        self.total, self.done = total, 0
        self._moved, self._now = moved, now
        self._began = self._last = now()
        self._made = 0

    def found(self, count: int) -> None:
        """So many stood already."""
        self._began = self._last = self._now()
        self._step(count)

    def made(self, count: int) -> None:
        """So many were done now."""
        self._last = self._now()
        self._made += count
        self._step(count)

    def per_minute(self) -> float | None:
        """Mean rate up to the last that was done, or None before the first."""
        spent = self._last - self._began
        return 60 * self._made / spent if spent > 0 else None

    def seconds_left(self) -> float | None:
        """Time left at that rate, or None before the first."""
        rate = self.per_minute()
        return max(0.0, 60 * (self.total - self.done) / rate - (self._now() - self._last)) if rate else None

    def _step(self, count: int) -> None:
        self.done += count
        self._moved(self.done)


@contextmanager
def bar(what: str, total: int) -> Iterator[Pace]:
    """A progress bar on standard error, with rate and time left, where that is a terminal."""
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        _PaceColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        pace = Pace(total, lambda done: progress.update(task, completed=done))
        task = progress.add_task(what, total=total, pace=pace)
        try:
            yield pace
        except BaseException:
            progress.live.transient = True  # a refusal is one line
            raise


def shown(pace: Pace) -> str:
    """Rate and time left as text."""
    rate, left = pace.per_minute(), pace.seconds_left()
    if rate is None or left is None:
        return "-- / min"
    return f"{rate:.1f} / min, {timedelta(seconds=round(left))} left"


class _PaceColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(shown(task.fields["pace"]), style="progress.remaining")
