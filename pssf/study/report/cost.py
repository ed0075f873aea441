"""What a run cost, stage by stage, and how that grows with what is made."""

from typing import Any

import numpy as np

from ...core.timer import Timer

_FEWEST = 8  # marks that a growth is read from


def cost_rows(timer: Timer) -> list[dict[str, Any]]:
    """One entry a stage: stage, seconds, made, unit, seconds_each, growth; None where there is none."""
    rows = []
    for name, stage in timer.stages.items():
        row = {"stage": name, "seconds": stage.seconds, "made": stage.made, "unit": stage.unit}
        each = stage.seconds / stage.made if stage.made else None
        exponent = growth(stage.marks) if stage.growth is None else stage.growth
        rows.append(row | {"seconds_each": each, "growth": exponent})
    return rows


def growth(marks: list[float]) -> float | None:
    """Exponent b of seconds = a n^b: 1 where each costs the same however many there are.

    By least squares of the logarithms, from a quarter of the marks on: before it, processes are still starting.
    marks    (made,) seconds from the beginning until the first, the second, ... was made
    returns  None for fewer than eight
    """
    if len(marks) < _FEWEST:
        return None
    first = len(marks) // 4
    count = np.arange(first + 1, len(marks) + 1)
    return float(np.polyfit(np.log(count), np.log(marks[first:]), 1)[0])
