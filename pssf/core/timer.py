"""Seconds of stages: laps one after the other, or stages that count what they make and how fast."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter


def seldom(seconds: float, now: Callable[[], float] = perf_counter) -> Callable[[], bool]:
    """What says yes when so many seconds have gone by since it was made, or last said so."""
    last = now()

    def due() -> bool:
        nonlocal last
        if now() - last <= seconds:
            return False
        last = now()
        return True

    return due


class Stage:
    """What a stage of the work has done, how fast, and how long it took.

    unit     of what is counted
    total    to be done; 0 where that is not known
    kept     how many an earlier run had done: part of the total, and not of the rate
    made     how many were done now
    marks    seconds from the beginning, as each was made
    seconds  wall time, once the stage has ended
    growth   exponent of the seconds in the number made, where it is known otherwise than by the marks
    shown    is told how many are done, whenever that changes
    """

    def __init__(self, unit: str = "", total: int = 0, now: Callable[[], float] = perf_counter) -> None:
        self.unit, self.total = unit, total
        self.kept = self.made = 0
        self.marks = list[float]()
        self.seconds = 0.0
        self.growth: float | None = None
        self.shown: Callable[[int], None] = lambda done: None
        self._now = now
        self._began = self._rated = self._last = now()

    @property
    def done(self) -> int:
        """How many are done, whoever did them."""
        return self.kept + self.made

    def keep(self, count: int) -> None:
        """So many stood already; the rate counts from here."""
        self._rated = self._last = self._now()
        self.kept += count
        self.shown(self.done)

    def advance(self, count: int = 1) -> None:
        """So many more were done now."""
        self._last = self._now()
        self.made += count
        self.marks += [self._last - self._began] * count
        self.shown(self.done)

    def end(self) -> None:
        """The stage is over."""
        self.seconds = self._now() - self._began

    def per_minute(self) -> float | None:
        """Mean rate up to the last that was done, or None before the first."""
        spent = self._last - self._rated
        return 60 * self.made / spent if spent > 0 else None

    def seconds_left(self) -> float | None:
        """Time left at that rate, or None before the first."""
        rate = self.per_minute()
        return max(0.0, 60 * (self.total - self.done) / rate - (self._now() - self._last)) if rate else None


class Timer:
    """The stages of a run in their order.

    stages  name -> stage
    now     seconds of a clock
    """

    def __init__(self, now: Callable[[], float] = perf_counter) -> None:
        self.stages = dict[str, Stage]()
        self._now, self._last = now, now()

    @property
    def seconds(self) -> dict[str, float]:
        """stage -> wall time"""
        return {name: stage.seconds for name, stage in self.stages.items()}

    def lap(self, name: str) -> None:
        """A stage ends that began where the lap before it ended."""
        lap = self.stages[name] = Stage(now=self._now)
        now = self._now()
        lap.seconds, self._last = now - self._last, now

    @contextmanager
    def stage(self, name: str, unit: str = "", total: int = 0) -> Iterator[Stage]:
        """Time a stage, also where it fails; gives what counts it."""
        stage = self.stages[name] = Stage(unit, total, self._now)
        try:
            yield stage
        finally:
            stage.end()
