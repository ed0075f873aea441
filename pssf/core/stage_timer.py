"""Measure the stages of a run: wall time, items done, rate and remaining time."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from time import perf_counter


def make_interval_check(seconds: float, clock: Callable[[], float] = perf_counter) -> Callable[[], bool]:
    """Create a function that reports whether an interval has passed.

    Parameters
    ----------
    seconds : float
        Length of the interval, in s.
    clock : callable, optional
        Function that returns the current time, in s.

    Returns
    -------
    callable
        Function that returns True if the interval has passed since its creation or its last True result.
    """
    last = clock()

    def due() -> bool:
        nonlocal last
        if clock() - last <= seconds:
            return False
        last = clock()
        return True

    return due


class Stage:
    """Count the work of one stage and measure its rate and duration.

    Parameters
    ----------
    unit : str, default ""
        Unit of the counted items, such as "radiographs".
    total : int, default 0
        Number of items to do; 0 if unknown.
    now : callable, optional
        Function that returns the current time, in s.

    Attributes
    ----------
    unit : str
        Unit of the counted items.
    total : int
        Number of items to do; 0 if unknown.
    already_done : int
        Number of items that an earlier run completed. They count towards the total, but not towards the rate.
    newly_done : int
        Number of items completed in this run.
    completion_times_s : list of float
        Time at which each new item was done, in s from the start of the stage.
    seconds : float
        Wall time of the stage, in s; 0 until the stage has ended.
    time_exponent : float or None
        Exponent of the increase of run time with the number of items; None if the exponent must be estimated from
        `completion_times_s`.
    on_change : callable
        Function that is called with the number of items done whenever the number changes.
    """

    def __init__(self, unit: str = "", total: int = 0, now: Callable[[], float] = perf_counter) -> None:
        self.unit, self.total = unit, total
        self.already_done = self.newly_done = 0
        self.completion_times_s = list[float]()
        self.seconds = 0.0
        self.time_exponent: float | None = None
        self.on_change: Callable[[int], None] = lambda done: None
        self._now = now
        self._start_s = self._rate_start_s = self._last = now()

    @property
    def done(self) -> int:
        """Number of items completed by this run and by an earlier run."""
        return self.already_done + self.newly_done

    def add_already_done(self, count: int) -> None:
        """Count items that an earlier run completed, and restart the measurement of the rate.

        Parameters
        ----------
        count : int
            Number of items.
        """
        self._rate_start_s = self._last = self._now()
        self.already_done += count
        self.on_change(self.done)

    def advance(self, count: int = 1) -> None:
        """Count newly completed items.

        Parameters
        ----------
        count : int, default 1
            Number of items.
        """
        self._last = self._now()
        self.newly_done += count
        self.completion_times_s += [self._last - self._start_s] * count
        self.on_change(self.done)

    def end(self) -> None:
        """End the stage and record its wall time."""
        self.seconds = self._now() - self._start_s

    def rate_per_minute(self) -> float | None:
        """Compute the mean rate up to the last completed item.

        Returns
        -------
        float or None
            Items per minute, or None before the first item.
        """
        spent = self._last - self._rate_start_s
        return 60 * self.newly_done / spent if spent > 0 else None

    def seconds_left(self) -> float | None:
        """Estimate the remaining time from the mean rate.

        Returns
        -------
        float or None
            Remaining time, in s, or None before the first item.
        """
        rate = self.rate_per_minute()
        return max(0.0, 60 * (self.total - self.done) / rate - (self._now() - self._last)) if rate else None

    @property
    def rate_text(self) -> str:
        """Rate and remaining time, such as "12.0 / min, 0:01:30 left"; "-- / min" until the rate is known."""
        per_minute, left = self.rate_per_minute(), self.seconds_left()
        if per_minute is None or left is None:
            return "-- / min"
        return f"{per_minute:.1f} / min, {timedelta(seconds=round(left))} left"


class Timer:
    """Measure the stages of a run and store them in the order of their start.

    Parameters
    ----------
    now : callable, optional
        Function that returns the current time, in s.

    Attributes
    ----------
    stages : dict of str to Stage
        Stages in the order of their start, keyed by name.
    """

    def __init__(self, now: Callable[[], float] = perf_counter) -> None:
        self.stages = dict[str, Stage]()
        self._now, self._last = now, now()

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each stage, in s, keyed by stage name."""
        return {name: stage.seconds for name, stage in self.stages.items()}

    def lap(self, name: str) -> None:
        """Record a stage that began at the end of the previous lap and ends now.

        Parameters
        ----------
        name : str
            Name of the stage.
        """
        lap = self.stages[name] = Stage(now=self._now)
        now = self._now()
        lap.seconds, self._last = now - self._last, now

    @contextmanager
    def stage(self, name: str, unit: str = "", total: int = 0) -> Iterator[Stage]:
        """Time a stage while the context is open; the time is also recorded if the work fails.

        Parameters
        ----------
        name : str
            Name of the stage.
        unit : str, default ""
            Unit of the counted items.
        total : int, default 0
            Number of items to do; 0 if unknown.

        Yields
        ------
        Stage
            Stage that counts the items.
        """
        stage = self.stages[name] = Stage(unit, total, self._now)
        try:
            yield stage
        finally:
            stage.end()
