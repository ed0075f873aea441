"""Run time of each stage, and growth of the run time with the number of items."""

from typing import Any

import numpy as np

from ...core.stage_timer import Timer

# Smallest number of completion times for which a growth exponent is fitted (assumed).
_MIN_MARKS = 8


def summarise_cost(timer: Timer) -> list[dict[str, Any]]:
    """Summarise the run time of each stage.

    Parameters
    ----------
    timer : Timer
        Timer of the run.

    Returns
    -------
    list of dict
        One entry per stage: stage, seconds, made (number of items), unit, seconds_each, growth. Unknown values are
        None.
    """
    rows = []
    for name, stage in timer.stages.items():
        row = {"stage": name, "seconds": stage.seconds, "made": stage.newly_done, "unit": stage.unit}
        each = stage.seconds / stage.newly_done if stage.newly_done else None
        exponent = fit_growth_exponent(stage.completion_times_s) if stage.time_exponent is None else stage.time_exponent
        rows.append(row | {"seconds_each": each, "growth": exponent})
    return rows


def fit_growth_exponent(marks: list[float]) -> float | None:
    """Fit the exponent b in seconds = a n^b; b is 1 if each item takes the same time.

    The fit is a least-squares fit to the logarithms. The first quarter of the items is omitted because processes are
    still starting.

    Parameters
    ----------
    marks : list of float
        Time from the beginning of the stage until each item was done, in s.

    Returns
    -------
    float or None
        Exponent; None with fewer than eight items.
    """
    if len(marks) < _MIN_MARKS:
        return None
    first = len(marks) // 4
    count = np.arange(first + 1, len(marks) + 1)
    return float(np.polyfit(np.log(count), np.log(marks[first:]), 1)[0])
