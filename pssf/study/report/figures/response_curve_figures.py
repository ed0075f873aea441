"""Figures of response curves and of the sensitivity analysis, as PNG."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter, SymmetricalLogLocator

from ...design.response_curve_design import ProtocolAxis
from ...statistics.analyses.breakpoints import STABILITY_CONCLUSION
from ...statistics.analyses.response_curve_statistics import (
    AUC,
    ICC,
    MEDIAN_ICC,
    ODDS,
    SHIFT,
)
from ...statistics.features.reliability import ICC_THRESHOLD
from ...statistics.scores.claims import UNDECIDED
from ..cell_formats import format_fixed, format_interval
from .result_figures import encode_png

# Colours of Okabe and Ito 2008, one per feature; curves of the median over features and of the model are black.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
# Largest feature change, in SD, on a linear axis; a larger change needs an axis that is logarithmic beyond 1 SD.
_LOG_SCALE_FROM_SD = 3.0
# Measure of each panel -> label of its vertical axis.
_PANELS = {
    SHIFT: "feature change, SD over knees",
    ICC: "ICC(2,1) with the unchanged protocol",
    ODDS: "threshold shift, log odds",
    AUC: "AUC, grade {task}",
}


def draw_response_curves(
    curves: pd.DataFrame, breaks: pd.DataFrame, axis: ProtocolAxis, leading: Sequence[str], task: str
) -> bytes:
    """Draw the response curves of one axis: feature values, ICC, threshold shift and AUC, with intervals.

    Parameters
    ----------
    curves : DataFrame
        Response curves for the protocol parameter `axis`.
    breaks : DataFrame
        Breakpoints for the protocol parameter `axis`, from `find_breakpoints`.
    axis : ProtocolAxis
        Protocol parameter that is varied.
    leading : sequence of str
        Names of the features that are drawn individually.
    task : str
        Classification task of the AUC.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    figure = Figure(figsize=(13.2, 3.7), layout="constrained")
    axes = figure.subplots(1, len(_PANELS))
    colours = dict(zip(leading, _COLOURS, strict=False))
    for panel, (measure, label) in zip(axes, _PANELS.items(), strict=True):
        rows = curves[curves["measure"] == measure]
        for name in leading if measure in (SHIFT, ICC) else [""]:
            _draw_curve(panel, rows[rows["feature"] == name], colours.get(name, "black"), name)
        panel.set_ylabel(label.format(task=task), fontsize=9)
        panel.axvline(axis.reference_step, color="0.75", linewidth=1, linestyle=":")
        _scale_panel(panel, axis)
    _draw_curve(axes[1], curves[curves["measure"] == MEDIAN_ICC], "black", "median of all features")
    # Features that measure noise may change fifty times as much as other features, so a logarithmic scale is needed.
    if max(np.abs(axes[0].get_ylim())) > _LOG_SCALE_FROM_SD:
        axes[0].set_yscale("symlog", linthresh=1.0)
        axes[0].yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=1.0, subs=[1, 2, 5]))
        axes[0].yaxis.set_major_formatter(ScalarFormatter())
    axes[1].axhline(ICC_THRESHOLD, color="0.6", linewidth=1, linestyle="--")
    axes[1].set_ylim(-0.05, 1.04)
    axes[3].set_ylim(0.0, 1.04)
    axes[3].axhline(0.5, color="0.8", linewidth=1)
    for row in breaks[breaks["result"] != UNDECIDED].to_dict("records"):
        _draw_breakpoint(axes[1] if row["conclusion"] == STABILITY_CONCLUSION else axes[3], row)
    handles, labels = axes[1].get_legend_handles_labels()
    names = [_format_name(label) for label in labels]
    figure.legend(handles, names, fontsize=8, frameon=False, loc="outside lower center", ncols=len(names))
    figure.suptitle(axis.label, fontsize=10)
    return encode_png(figure)


def _draw_curve(panel: Any, rows: pd.DataFrame, colour: str, label: str) -> None:
    """Draw one response curve with its interval."""
    rows = rows.sort_values("step")
    at = rows["step"].to_numpy(float)
    panel.fill_between(at, rows["low"], rows["high"], color=colour, alpha=0.13, linewidth=0)
    panel.plot(at, rows["value"], "o-", color=colour, markersize=3, linewidth=1.4, label=label)


def _scale_panel(panel: Any, axis: ProtocolAxis) -> None:
    """Set the scale and the ticks of the horizontal axis of a panel."""
    if axis.scale == "log":
        panel.set_xscale("log")
        panel.minorticks_off()
    texts = [f"1/{round(1 / step)}" if axis.scale == "log" and step < 1 else f"{step:.3g}" for step in axis.steps]
    panel.set_xticks(axis.steps, texts, fontsize=7.5)
    panel.tick_params(axis="y", labelsize=8)
    panel.spines[["top", "right"]].set_visible(False)


def _draw_breakpoint(panel: Any, row: dict[str, Any]) -> None:
    """Draw a breakpoint as a line and its interval, clipped to the measured range, as a band."""
    if row["range_low"] <= row["value"] <= row["range_high"]:
        panel.axvline(row["value"], color="#D55E00", linewidth=1.2)
    low, high = np.clip([row["low"], row["high"]], row["range_low"], row["range_high"])
    if high > low:
        panel.axvspan(low, high, color="#D55E00", alpha=0.09, linewidth=0)


def draw_sensitivity(sobol_indices: pd.DataFrame, sensitivities: pd.DataFrame, leading: Sequence[str]) -> bytes:
    """Draw total Sobol indices of the most important features, and slopes against correlations.

    Parameters
    ----------
    sobol_indices : DataFrame
        Table from `compute_sobol_indices`.
    sensitivities : DataFrame
        Table from `merge_sensitivity_tables`.
    leading : sequence of str
        Names of the most important features, which are drawn in colour.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    figure = Figure(figsize=(15.4, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.9, 1.0))
    table = sobol_indices[sobol_indices["feature"].isin(leading)]
    if len(table):
        _draw_sobol_indices(left, table, leading)
    else:
        left.set_axis_off()
    known = sensitivities.dropna(subset=["rho", "slope"])
    right.plot([-1, 1], [-1, 1], color="0.75", linewidth=1)
    right.plot(known["rho"], known["slope"], ".", color="0.7", markersize=3)
    for name, colour in zip(leading, _COLOURS, strict=False):
        rows = known[known["feature"] == name]
        reach = rows[["slope_low", "slope_high"]].to_numpy(float).T
        right.vlines(rows["rho"], *reach, color=colour, linewidth=1.2, alpha=0.7)
        right.plot(rows["rho"], rows["slope"], "o", color=colour, markersize=4, label=_format_name(name))
    far = float(np.nanquantile(np.abs(known["slope"]), 0.99)) if len(known) else 1.0
    right.set(xlim=(-1, 1), ylim=(-1.3 * max(far, 1), 1.3 * max(far, 1)), xlabel="Spearman correlation over the cohort")
    right.set_ylabel("slope with fixed noise, SD per SD")
    right.spines[["top", "right"]].set_visible(False)
    right.legend(fontsize=7.5, frameon=False, loc="upper left")
    return encode_png(figure)


def _draw_sobol_indices(axis: Any, table: pd.DataFrame, leading: Sequence[str]) -> None:
    """Draw the total Sobol indices as a heat map with intervals."""
    wide = table.pivot(index="feature", columns="group", values="total")
    names = [name for name in leading if name in wide.index]
    groups = list(dict.fromkeys(table["group"]))
    values = wide.loc[names, groups].to_numpy(float)
    axis.imshow(np.clip(values, 0, 1), cmap="Blues", vmin=0, vmax=1, aspect="auto")
    cells = table.set_index(["feature", "group"])
    for (row, col), value in np.ndenumerate(values):
        low, high = cells.loc[(names[row], groups[col]), ["total_low", "total_high"]]
        text = f"{format_fixed(value)}\n{format_interval(low, high)}"
        axis.text(col, row, text, ha="center", va="center", fontsize=7, color="white" if value > 0.6 else "black")
    axis.set_xticks(range(len(groups)), ["\n".join(name.split(" ", 1)) for name in groups], fontsize=8)
    axis.set_yticks(range(len(names)), [_format_name(name) for name in names], fontsize=8)
    axis.set_title("total Sobol index with 95 % interval", fontsize=9)


def _format_name(name: str) -> str:
    """Format the name of a feature with spaces instead of underscores."""
    return name.replace("_", " ")
