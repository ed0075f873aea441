"""What a run cost, stage by stage, and how that grows with what is made."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

_FEWEST = 8  # marks that a growth is read from


@dataclass
class Spent:
    """Of one stage.

    seconds  wall time
    made     how many, now; what an earlier run left is not counted
    marks    seconds from the beginning of the stage, as each was made
    growth   exponent of the seconds in the number made, where it is known otherwise than by the marks
    """

    seconds: float = 0.0
    unit: str = ""
    made: int = 0
    marks: list[float] = field(default_factory=list)
    growth: float | None = None


class Meter:
    """The stages of a run in their order.

    now  seconds of a clock
    """

    def __init__(self, now: Callable[[], float] = perf_counter) -> None:
        self.stages = dict[str, Spent]()
        self._now = now

    @contextmanager
    def stage(self, name: str, unit: str = "") -> Iterator[Callable[[int], None]]:
        """Time a stage; gives what is told how many more have been made."""
        spent = self.stages[name] = Spent(unit=unit)
        began = self._now()

        def made(more: int = 1) -> None:
            spent.made += more
            spent.marks += [self._now() - began] * more

        try:
            yield made
        finally:
            spent.seconds = self._now() - began

    def seconds(self) -> dict[str, float]:
        """stage -> wall time"""
        return {name: spent.seconds for name, spent in self.stages.items()}

    def rows(self) -> list[dict[str, Any]]:
        """One entry a stage: stage, seconds, made, unit, seconds_each, growth; None where there is none."""
        rows = []
        for name, spent in self.stages.items():
            grows = growth(spent.marks) if spent.growth is None else spent.growth
            row = {"stage": name, "seconds": spent.seconds, "made": spent.made, "unit": spent.unit}
            each = spent.seconds / spent.made if spent.made else None
            rows.append(row | {"seconds_each": each, "growth": grows})
        return rows


def growth(marks: list[float]) -> float | None:
    """Exponent b of seconds = a n^b: 1 where each costs the same however many there are.

    By least squares of the logarithms, from a quarter of the marks on: before it, processes are still starting.
    marks    seconds from the beginning until the first, the second, ... was made
    returns  None for fewer than eight
    """
    if len(marks) < _FEWEST:
        return None
    first = len(marks) // 4
    count = np.arange(first + 1, len(marks) + 1)
    return float(np.polyfit(np.log(count), np.log(marks[first:]), 1)[0])
