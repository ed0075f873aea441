"""The pictures of the report that are response curves, as PNG."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ..design import Axis
from ..statistics.breaks import STABLE
from ..statistics.reliability import THRESHOLD
from ..statistics.responses import AUC, ICC, MEDIAN_ICC, ODDS, SHIFT
from .figures import png

# Okabe & Ito 2008, a colour a feature; what is of all features or of the model is black.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
_PANELS = {
    SHIFT: "change of a feature, SD of knees",
    ICC: "ICC(2,1) with the protocol's own",
    ODDS: "threshold shift, log odds",
    AUC: "AUC, grade 0 vs 2",
}


def response(curves: pd.DataFrame, breaks: pd.DataFrame, axis: Axis, leading: Sequence[str]) -> bytes:
    """One axis: feature values, ICC, threshold shift and AUC, each with its interval.

    curves   rows of one axis, of `statistics.responses`
    breaks   rows of one axis, of `statistics.breaks`
    leading  features that are drawn one by one
    """
    figure = Figure(figsize=(13.2, 3.7), layout="constrained")
    axes = figure.subplots(1, len(_PANELS))
    colours = dict(zip(leading, _COLOURS, strict=False))
    for panel, (measure, label) in zip(axes, _PANELS.items(), strict=True):
        rows = curves[curves["measure"] == measure]
        for name in leading if measure in (SHIFT, ICC) else [""]:
            _curve(panel, rows[rows["feature"] == name], colours.get(name, "black"), name)
        panel.set_ylabel(label, fontsize=9)
        panel.axvline(axis.own, color="0.75", linewidth=1, linestyle=":")
        _scaled(panel, axis)
    _curve(axes[1], curves[curves["measure"] == MEDIAN_ICC], "black", "median of all features")
    axes[1].axhline(THRESHOLD, color="0.6", linewidth=1, linestyle="--")
    axes[1].set_ylim(-0.05, 1.04)
    axes[3].set_ylim(0.0, 1.04)
    axes[3].axhline(0.5, color="0.8", linewidth=1)
    for row in breaks.to_dict("records"):
        _broken(axes[1] if row["conclusion"] == STABLE else axes[3], row)
    handles, labels = axes[1].get_legend_handles_labels()
    names = [label.split("_", 1)[-1].replace("_", " ") for label in labels]
    figure.legend(handles, names, fontsize=8, frameon=False, loc="outside lower center", ncols=len(names))
    figure.supxlabel(axis.label, fontsize=9)
    return png(figure)


def _curve(panel: Any, rows: pd.DataFrame, colour: str, label: str) -> None:
    rows = rows.sort_values("step")
    at = rows["step"].to_numpy(float)
    panel.fill_between(at, rows["low"], rows["high"], color=colour, alpha=0.13, linewidth=0)
    panel.plot(at, rows["value"], "o-", color=colour, markersize=3, linewidth=1.4, label=label)


def _scaled(panel: Any, axis: Axis) -> None:
    if axis.scale == "log":
        panel.set_xscale("log")
        panel.minorticks_off()
    texts = [f"1/{round(1 / step)}" if axis.scale == "log" and step < 1 else f"{step:.3g}" for step in axis.steps]
    panel.set_xticks(axis.steps, texts, fontsize=7.5)
    panel.tick_params(axis="y", labelsize=8)
    panel.spines[["top", "right"]].set_visible(False)


def _broken(panel: Any, row: dict[str, Any]) -> None:
    """Where a conclusion breaks: a line, and its interval as far as it was measured."""
    if row["from"] <= row["value"] <= row["to"]:
        panel.axvline(row["value"], color="#D55E00", linewidth=1.2)
    low, high = np.clip([row["low"], row["high"]], row["from"], row["to"])
    if high > low:
        panel.axvspan(low, high, color="#D55E00", alpha=0.09, linewidth=0)
