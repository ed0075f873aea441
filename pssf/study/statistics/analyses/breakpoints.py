"""Breakpoints: the first step of a response curve at which a conclusion fails, with an interval.

The search starts at the step of the unchanged protocol and ends at the first step at which the conclusion fails. For
the median ICC, the interval is computed from the breakpoints in the bootstrap samples. For the loss of AUC, the
interval extends between the steps at which the two limits of the 95 % interval of the loss cross the allowed loss.
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

COLUMNS = ["axis", "conclusion", "side", "value", "low", "high", "range_low", "range_high", "knees", "result"]
# AUC of a model without predictive value.
_CHANCE_AUC = 0.5
# Text of the conclusion on feature stability in the table of breakpoints.
STABILITY_CONCLUSION = f"half of the features have ICC(2,1) of at least {ICC_THRESHOLD:g}"


def find_breakpoints(
    curves: FeatureCurves, models: pd.DataFrame, axes: Mapping[str, ProtocolAxis], difference: float
) -> pd.DataFrame:
    """Find the breakpoints of two conclusions: features are stable, and the AUC loss of a model is small.

    Parameters
    ----------
    curves : FeatureCurves
        Response curves of the features.
    models : DataFrame
        Response curves of the models, from `compute_model_curves`.
    axes : mapping of str to ProtocolAxis
        Axes by name.
    difference : float
        Allowed loss of AUC.

    Returns
    -------
    DataFrame
        One row per axis, conclusion and side (below or above the step of the unchanged protocol). Columns: value, low,
        high (breakpoint and its interval in the unit of the protocol parameter; infinite outside the measured range);
        range_low, range_high (measured range); knees; result (description of the breakpoint). The number of knees is 0
        if the AUC under the unchanged protocol is not above chance or a class has too few test subjects.
    """
    rows = []
    for name, axis in axes.items():
        of_models = models[models["axis"] == name].set_index("step_index")
        losses, scores = (of_models[of_models["measure"] == measure] for measure in (LOSS, AUC))
        counts = curves.table[curves.table["axis"] == name].groupby("step_index")["knees"].median()
        for side, indices in _order_steps(axis).items():
            at = np.array([axis.steps[index - 1] for index in indices])
            ends = {"axis": name, "side": side, "range_low": min(axis.steps), "range_high": max(axis.steps)}
            if all((name, index) in curves.median_icc_samples for index in indices):
                margins = np.stack([curves.median_icc_samples[name, index] - ICC_THRESHOLD for index in indices])
                places = np.array([_find_crossing(at, margin, axis) for margin in margins.T])
                # The nearest observed value is used because infinite values cannot be interpolated.
                low, high = np.percentile(places[1:], INTERVAL_PERCENTILES, method="nearest")
                label = {**ends, "conclusion": STABILITY_CONCLUSION, "knees": int(counts.loc[indices].min())}
                rows.append(_make_row(label, places[0], low, high))
            if set(indices) <= set(losses.index):
                part = losses.loc[indices]
                # For a model at chance level, a loss of AUC has no meaning.
                above = bool(scores.loc[indices[0], "low"] > _CHANCE_AUC)
                label = {**ends, "conclusion": f"AUC falls by at most {difference:g}"}
                decidable = above and part["rarest"].min() >= MIN_TEST_SUBJECTS_PER_CLASS
                label["knees"] = int(part["knees"].min()) if decidable else 0
                margins = difference - part[["value", "low", "high"]].to_numpy(np.float64)
                value, one, other = (_find_crossing(at, margin, axis) for margin in margins.T)
                rows.append(_make_row(label, value, *sorted((one, other))))
    return pd.DataFrame(rows, columns=COLUMNS)


def _order_steps(axis: ProtocolAxis) -> dict[str, list[int]]:
    """List step numbers from the unchanged protocol downwards ("below") and upwards ("above"); omit an empty list."""
    order = sorted(range(1, len(axis.steps) + 1), key=lambda index: axis.steps[index - 1])
    own = order.index(axis.steps.index(axis.reference_step) + 1)
    ways = {"below": order[own::-1], "above": order[own:]}
    return {side: indices for side, indices in ways.items() if len(indices) > 1}


def _find_crossing(step_values: Array, margin: Array, axis: ProtocolAxis) -> float:
    """Find the axis value at which a margin first falls below 0, interpolated on the scale of the axis."""
    if axis.scale == "log":
        return float(np.exp(find_first_crossing(np.log(step_values), margin)))
    return find_first_crossing(step_values, margin)


def _make_row(label: dict[str, Any], value: float, low: float, high: float) -> dict[str, Any]:
    """Make one row of the table of breakpoints."""
    row = {**label, "value": value, "low": low, "high": high}
    return {**row, "result": _describe_breakpoint(row)}


def _describe_breakpoint(row: Mapping[str, Any]) -> str:
    """Describe a breakpoint and its interval in words."""
    if row["knees"] < MIN_TEST_SUBJECTS:
        return UNDECIDED
    least, most = row["range_low"], row["range_high"]

    def place(value: float) -> str:
        """Format a value, or the exceeded limit if the value is outside the measured range."""
        if least <= value <= most:
            return f"{value:.3g}"
        return f"beyond {least if value < least else most:.3g}"

    interval = f"{place(row['low'])} to {place(row['high'])}"
    if least <= row["value"] <= most:
        return f"{row['side']} {place(row['value'])} ({interval})"
    return f"holds to {least if row['value'] < least else most:.3g} (breakpoint interval: {interval})"
