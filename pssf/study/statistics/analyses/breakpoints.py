"""Breakpoints: the step of a response curve at which a conclusion no longer holds, with an interval.

A conclusion is followed from the protocol's own step outwards to the first step at which it fails. The interval for a
median ICC is from the breakpoints in the bootstrap samples. The interval for a loss of AUC is where the ends of its
95 % interval cross the limit.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ....core.checks import Array
from ...design.response_curve_design import ProtocolAxis
from ..features.reliability import ICC_THRESHOLD
from ..scores.claims import UNDECIDED
from ..scores.metrics import INTERVAL_PERCENTILES
from ..scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS
from .response_curve_statistics import (
    AUC,
    LOSS,
    FeatureCurves,
    find_first_crossing,
)

COLUMNS = ["axis", "conclusion", "side", "value", "low", "high", "from", "to", "knees", "reading"]
# AUC of a model that predicts by chance.
_CHANCE_AUC = 0.5
# Conclusion about the features in the table of breakpoints.
STABILITY_CONCLUSION = f"half of the features have ICC(2,1) of at least {ICC_THRESHOLD:g}"


def find_breakpoints(
    curves: FeatureCurves, models: pd.DataFrame, axes: Mapping[str, ProtocolAxis], difference: float
) -> pd.DataFrame:
    """Find where two conclusions break: that features are stable, and that a model loses little AUC.

    Parameters
    ----------
    curves : FeatureCurves
        Response curves of the features.
    models : DataFrame
        Response curves of the models, of `compute_model_curves`.
    axes : mapping of str to ProtocolAxis
        Axes by name.
    difference : float
        Difference of AUC that may be lost.

    Returns
    -------
    DataFrame
        One row per axis, conclusion and side (below or above the protocol's own step). Columns: value, low, high in
        steps of the axis, infinite beyond the measured range; from, to (measured range); knees; reading (in words).
        knees is 0 if the AUC is not above chance at the own step, or if too few subjects of a class are tested.
    """
    rows = []
    for name, axis in axes.items():
        of_models = models[models["axis"] == name].set_index("turn")
        losses, scores = (of_models[of_models["measure"] == measure] for measure in (LOSS, AUC))
        counts = curves.table[curves.table["axis"] == name].groupby("turn")["knees"].median()
        for side, turns in _order_steps(axis).items():
            at = np.array([axis.steps[turn - 1] for turn in turns])
            ends = {"axis": name, "side": side, "from": min(axis.steps), "to": max(axis.steps)}
            if all((name, turn) in curves.median_icc_samples for turn in turns):
                margins = np.stack([curves.median_icc_samples[name, turn] - ICC_THRESHOLD for turn in turns])
                places = np.array([_find_crossing(at, margin, axis) for margin in margins.T])
                # Percentiles must be observed values, because infinite values cannot be interpolated.
                low, high = np.percentile(places[1:], INTERVAL_PERCENTILES, method="nearest")
                label = {**ends, "conclusion": STABILITY_CONCLUSION, "knees": int(counts.loc[turns].min())}
                rows.append(_make_row(label, places[0], low, high))
            if set(turns) <= set(losses.index):
                part = losses.loc[turns]
                # A model at chance level has no AUC to lose.
                above = bool(scores.loc[turns[0], "low"] > _CHANCE_AUC)
                label = {**ends, "conclusion": f"AUC falls by at most {difference:g}"}
                decidable = above and part["rarest"].min() >= MIN_TEST_SUBJECTS_PER_CLASS
                label["knees"] = int(part["knees"].min()) if decidable else 0
                margins = difference - part[["value", "low", "high"]].to_numpy(np.float64)
                value, one, other = (_find_crossing(at, margin, axis) for margin in margins.T)
                rows.append(_make_row(label, value, *sorted((one, other))))
    return pd.DataFrame(rows, columns=COLUMNS)


def _order_steps(axis: ProtocolAxis) -> dict[str, list[int]]:
    """List the numbers of the steps from the protocol's own step outwards, for each side that has any."""
    order = sorted(range(1, len(axis.steps) + 1), key=lambda turn: axis.steps[turn - 1])
    own = order.index(axis.steps.index(axis.reference_step) + 1)
    ways = {"below": order[own::-1], "above": order[own:]}
    return {side: turns for side, turns in ways.items() if len(turns) > 1}


def _find_crossing(step_values: Array, margin: Array, axis: ProtocolAxis) -> float:
    """Find where a margin first falls below 0, interpolating on the scale of the axis."""
    if axis.scale == "log":
        return float(np.exp(find_first_crossing(np.log(step_values), margin)))
    return find_first_crossing(step_values, margin)


def _make_row(label: dict[str, Any], value: float, low: float, high: float) -> dict[str, Any]:
    """Make one row of the table of breakpoints."""
    row = {**label, "value": value, "low": low, "high": high}
    return {**row, "reading": _describe_breakpoint(row)}


def _describe_breakpoint(row: Mapping[str, Any]) -> str:
    """Describe a breakpoint and its interval in words."""
    if row["knees"] < MIN_TEST_SUBJECTS:
        return UNDECIDED
    least, most = row["from"], row["to"]

    def place(value: float) -> str:
        """Format a value, or the end of the measured range that it is beyond."""
        if least <= value <= most:
            return f"{value:.3g}"
        return f"beyond {least if value < least else most:.3g}"

    interval = f"{place(row['low'])} to {place(row['high'])}"
    if least <= row["value"] <= most:
        return f"{row['side']} {place(row['value'])} ({interval})"
    return f"holds to {least if row['value'] < least else most:.3g} (breaks at {interval})"
