"""Where a conclusion breaks along a response curve, read off between its steps, with an interval.

From the protocol's own step outwards, the first place where the conclusion no longer holds. Of a median ICC the
interval is of the places in samples of the knees; of a loss of AUC it is where the ends of its 95 per cent interval
cross.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ...core.checks import Array
from ..design import Axis
from .claims import UNDECIDED
from .metrics import LEVELS
from .reliability import THRESHOLD
from .responses import AUC, LOSS, Curves, first_crossing
from .tested import LEAST_OF_A_CLASS, LEAST_TESTED

COLUMNS = ["axis", "conclusion", "side", "value", "low", "high", "from", "to", "knees", "reading"]
_CHANCE = 0.5  # AUC
STABLE = f"half of the features have an ICC(2,1) of {THRESHOLD:g}"


def breaks(curves: Curves, models: pd.DataFrame, axes: Mapping[str, Axis], difference: float) -> pd.DataFrame:
    """Where conclusions break: that features are stable, and that a model loses no more than a difference of AUC.

    curves      of `responses.curves_of_features`
    models      of `responses.curves_of_models`
    difference  of AUC that may be lost
    returns     axis, conclusion, side (below | above the protocol's own step), value, low, high, in the axis's steps
                (infinite: not within what was measured), from, to (what was measured), knees (tested; 0 where the AUC
                is not above chance to begin with, or too few of a class are tested), reading (in words)
    """
    rows = []
    for name, axis in axes.items():
        of_models = models[models["axis"] == name].set_index("turn")
        losses, scores = (of_models[of_models["measure"] == measure] for measure in (LOSS, AUC))
        counts = curves.table[curves.table["axis"] == name].groupby("turn")["knees"].median()
        for side, turns in _ways(axis).items():
            at = np.array([axis.steps[turn - 1] for turn in turns])
            ends = {"axis": name, "side": side, "from": min(axis.steps), "to": max(axis.steps)}
            if all((name, turn) in curves.medians for turn in turns):
                margins = np.stack([curves.medians[name, turn] - THRESHOLD for turn in turns])
                places = np.array([_crossing(at, margin, axis) for margin in margins.T])
                # The nearest places, since between one that is infinite and another there is none.
                low, high = np.percentile(places[1:], LEVELS, method="nearest")
                label = {**ends, "conclusion": STABLE, "knees": int(counts.loc[turns].min())}
                rows.append(_row(label, places[0], low, high))
            if set(turns) <= set(losses.index):
                part = losses.loc[turns]
                # What is not told apart to begin with has nothing to lose.
                above = bool(scores.loc[turns[0], "low"] > _CHANCE)
                label = {**ends, "conclusion": f"AUC loses at most {difference:g}"}
                decidable = above and part["rarest"].min() >= LEAST_OF_A_CLASS
                label["knees"] = int(part["knees"].min()) if decidable else 0
                margins = difference - part[["value", "low", "high"]].to_numpy(np.float64)
                value, one, other = (_crossing(at, margin, axis) for margin in margins.T)
                rows.append(_row(label, value, *sorted((one, other))))
    return pd.DataFrame(rows, columns=COLUMNS)


def _ways(axis: Axis) -> dict[str, list[int]]:
    """Side -> numbers of the steps from the protocol's own on, for sides that have any."""
    order = sorted(range(1, len(axis.steps) + 1), key=lambda turn: axis.steps[turn - 1])
    own = order.index(axis.steps.index(axis.own) + 1)
    ways = {"below": order[own::-1], "above": order[own:]}
    return {side: turns for side, turns in ways.items() if len(turns) > 1}


def _crossing(at: Array, margin: Array, axis: Axis) -> float:
    if axis.scale == "log":
        return float(np.exp(first_crossing(np.log(at), margin)))
    return first_crossing(at, margin)


def _row(label: dict[str, Any], value: float, low: float, high: float) -> dict[str, Any]:
    row = {**label, "value": value, "low": low, "high": high}
    return {**row, "reading": _reading(row)}


def _reading(row: Mapping[str, Any]) -> str:
    if row["knees"] < LEAST_TESTED:
        return UNDECIDED
    least, most = row["from"], row["to"]

    def place(value: float) -> str:
        if least <= value <= most:
            return f"{value:.3g}"
        return f"beyond {least if value < least else most:.3g}"

    interval = f"{place(row['low'])} to {place(row['high'])}"
    if least <= row["value"] <= most:
        return f"{row['side']} {place(row['value'])} ({interval})"
    return f"holds to {least if row['value'] < least else most:.3g} (breaks at {interval})"
