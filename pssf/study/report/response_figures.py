"""The pictures of the report that are response curves, as PNG."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter, SymmetricalLogLocator

from ..design import Axis
from ..statistics.breaks import STABLE
from ..statistics.claims import UNDECIDED
from ..statistics.reliability import THRESHOLD
from ..statistics.responses import AUC, ICC, MEDIAN_ICC, ODDS, SHIFT
from .figures import png

# Okabe & Ito 2008, a colour a feature; what is of all features or of the model is black.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
# Changes beyond this are drawn on a scale that is logarithmic beyond 1.
_FAR_SD = 3.0
_PANELS = {
    SHIFT: "change of a feature, SD of knees",
    ICC: "ICC(2,1) with the protocol's own",
    ODDS: "threshold shift, log odds",
    AUC: "AUC, grade {task}",
}


def response(curves: pd.DataFrame, breaks: pd.DataFrame, axis: Axis, leading: Sequence[str], task: str) -> bytes:
    """One axis: feature values, ICC, threshold shift and AUC, each with its interval.

    curves   rows of one axis, of `statistics.responses`
    breaks   rows of one axis, of `statistics.breaks`
    leading  features that are drawn one by one
    task     whose AUC it is
    """
    figure = Figure(figsize=(13.2, 3.7), layout="constrained")
    axes = figure.subplots(1, len(_PANELS))
    colours = dict(zip(leading, _COLOURS, strict=False))
    for panel, (measure, label) in zip(axes, _PANELS.items(), strict=True):
        rows = curves[curves["measure"] == measure]
        for name in leading if measure in (SHIFT, ICC) else [""]:
            _curve(panel, rows[rows["feature"] == name], colours.get(name, "black"), name)
        panel.set_ylabel(label.format(task=task), fontsize=9)
        panel.axvline(axis.own, color="0.75", linewidth=1, linestyle=":")
        _scaled(panel, axis)
    _curve(axes[1], curves[curves["measure"] == MEDIAN_ICC], "black", "median of all features")
    # Features of noise change by fifty times what others do; without them a linear scale has the better ticks.
    if max(np.abs(axes[0].get_ylim())) > _FAR_SD:
        axes[0].set_yscale("symlog", linthresh=1.0)
        axes[0].yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=1.0, subs=[1, 2, 5]))
        axes[0].yaxis.set_major_formatter(ScalarFormatter())
    axes[1].axhline(THRESHOLD, color="0.6", linewidth=1, linestyle="--")
    axes[1].set_ylim(-0.05, 1.04)
    axes[3].set_ylim(0.0, 1.04)
    axes[3].axhline(0.5, color="0.8", linewidth=1)
    for row in breaks[breaks["reading"] != UNDECIDED].to_dict("records"):
        _broken(axes[1] if row["conclusion"] == STABLE else axes[3], row)
    handles, labels = axes[1].get_legend_handles_labels()
    names = [_plain(label) for label in labels]
    figure.legend(handles, names, fontsize=8, frameon=False, loc="outside lower center", ncols=len(names))
    figure.suptitle(axis.label, fontsize=10)
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


def meaning(shares: pd.DataFrame, follows: pd.DataFrame, leading: Sequence[str]) -> bytes:
    """Total shares of variance of the leading features; beside it slopes with noise held against correlations.

    shares   of `statistics.space.shares`
    follows  of `statistics.space.beside`
    """
    figure = Figure(figsize=(15.4, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.9, 1.0))
    table = shares[shares["feature"].isin(leading)]
    if len(table):
        _shares(left, table, leading)
    else:
        left.set_axis_off()
    known = follows.dropna(subset=["rho", "slope"])
    right.plot([-1, 1], [-1, 1], color="0.75", linewidth=1)
    right.plot(known["rho"], known["slope"], ".", color="0.7", markersize=3)
    for name, colour in zip(leading, _COLOURS, strict=False):
        rows = known[known["feature"] == name]
        reach = rows[["slope_low", "slope_high"]].to_numpy(float).T
        right.vlines(rows["rho"], *reach, color=colour, linewidth=1.2, alpha=0.7)
        right.plot(rows["rho"], rows["slope"], "o", color=colour, markersize=4, label=_plain(name))
    far = float(np.nanquantile(np.abs(known["slope"]), 0.99)) if len(known) else 1.0
    right.set(
        xlim=(-1, 1), ylim=(-1.3 * max(far, 1), 1.3 * max(far, 1)), xlabel="correlation over the cohort, Spearman"
    )
    right.set_ylabel("slope with noise held, SD a SD")
    right.spines[["top", "right"]].set_visible(False)
    right.legend(fontsize=7.5, frameon=False, loc="upper left")
    return png(figure)


def _shares(axis: Any, table: pd.DataFrame, leading: Sequence[str]) -> None:
    wide = table.pivot(index="feature", columns="group", values="total")
    names = [name for name in leading if name in wide.index]
    groups = list(dict.fromkeys(table["group"]))
    values = wide.loc[names, groups].to_numpy(float)
    axis.imshow(np.clip(values, 0, 1), cmap="Blues", vmin=0, vmax=1, aspect="auto")
    cells = table.set_index(["feature", "group"])
    for (row, col), value in np.ndenumerate(values):
        low, high = cells.loc[(names[row], groups[col]), ["total_low", "total_high"]]
        text = f"{value:.2f}\n{low:.2f} to {high:.2f}".replace("-", "−")
        axis.text(col, row, text, ha="center", va="center", fontsize=7, color="white" if value > 0.6 else "black")
    axis.set_xticks(range(len(groups)), ["\n".join(name.split(" ", 1)) for name in groups], fontsize=8)
    axis.set_yticks(range(len(names)), [_plain(name) for name in names], fontsize=8)
    axis.set_title("total share of variance, 95 %", fontsize=9)


def _plain(name: str) -> str:
    return name.replace("_", " ")
