"""Figures of incremental predictive value, learning curves, power and confounding, as PNG."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from ...learn.confounded_training import CONFOUNDERS
from ...learn.incremental_value import PREDICTOR_SETS
from ...statistics.analyses.confounding_effects import ADJUSTED, TIED, UNTIED
from ...statistics.analyses.incremental_value_scores import BEST_POSSIBLE
from ...statistics.analyses.learning_curves import TARGET_POWER, compute_power_curve
from .result_figures import encode_png

# Colours of Okabe and Ito 2008. Sets of true parameters are black or grey; sets with measured predictors are coloured.
PREDICTOR_SET_COLOURS = dict(
    zip(PREDICTOR_SETS, ("#000000", "0.45", "#E69F00", "#0072B2", "#56B4E9", "#009E73"), strict=True)
)
# Pairs of predictor sets whose differences are drawn.
_DRAWN_COMPARISONS = (("radiomics", "measured"), ("texture", "measured"), ("both", "measured"))

# Text in place of the power curve for a pair of grades that `learning_curves.tabulate_power` omits.
_NO_POWER = "no power curve:\nAUC plus the difference\nwould exceed 1, or all splits\nhave the same AUC difference"


def draw_incremental_value(aucs: pd.DataFrame, differences: pd.DataFrame) -> bytes:
    """Draw AUCs of predictor sets and paired differences with intervals, one column per pair of grades.

    Parameters
    ----------
    aucs : DataFrame
        Table from `summarise_predictor_sets`, including the best possible AUC if it was estimated.
    differences : DataFrame
        Table from `compare_predictor_sets`.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    pairs = list(dict.fromkeys(aucs["grades"]))
    figure = Figure(figsize=(2.0 + 2.6 * max(1, len(pairs)), 5.6), layout="constrained")
    axes = figure.subplots(2, max(1, len(pairs)), squeeze=False, height_ratios=(2.2, 1.2), sharey="row", sharex="row")
    for column, grades in enumerate(pairs):
        _draw_auc_intervals(axes[0, column], aucs[aucs["grades"] == grades])
        _draw_differences(axes[1, column], differences[differences["grades"] == grades])
        axes[0, column].set_title(f"grade {grades}", fontsize=10)
    names = [name for name in PREDICTOR_SETS if name in set(aucs["predictor_set"])]
    axes[0, 0].set_yticks(range(len(names)), [PREDICTOR_SETS[name] for name in names], fontsize=8.5)
    axes[0, 0].set_ylim(len(names) - 0.5, -0.5)
    axes[1, 0].set_yticks(
        range(len(_DRAWN_COMPARISONS)),
        [f"{PREDICTOR_SETS[a]}\nminus {PREDICTOR_SETS[b]}" for a, b in _DRAWN_COMPARISONS],
        fontsize=7.5,
    )
    axes[1, 0].set_ylim(len(_DRAWN_COMPARISONS) - 0.5, -0.5)
    return encode_png(figure)


def _draw_auc_intervals(axis: Any, rows: pd.DataFrame) -> None:
    """Draw the AUC and interval of every predictor set for one pair of grades."""
    best = rows[rows["predictor_set"] == BEST_POSSIBLE]
    if len(best):
        axis.axvspan(best["low"].iloc[0], best["high"].iloc[0], color="0.9", linewidth=0)
        axis.axvline(best["auc"].iloc[0], color="0.55", linewidth=1.2, linestyle="--")
        axis.text(
            best["auc"].iloc[0], 5.45, "best possible (at least) ", ha="right", va="bottom", fontsize=7, color="0.35"
        )
    names = [name for name in PREDICTOR_SETS if name in set(rows["predictor_set"])]
    for place, name in enumerate(names):
        value, low, high = rows.set_index("predictor_set").loc[name, ["auc", "low", "high"]].astype(float)
        if not np.isfinite(value):
            continue
        axis.plot([low, high], [place, place], color=PREDICTOR_SET_COLOURS[name], linewidth=2)
        axis.plot(value, place, "o", color=PREDICTOR_SET_COLOURS[name], markersize=5)
        axis.annotate(
            f"{value:.2f}", (value, place), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=7
        )
    axis.axvline(0.5, color="0.8", linewidth=1)
    axis.set_xlabel("AUC", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)


def _draw_differences(axis: Any, rows: pd.DataFrame) -> None:
    """Draw the paired AUC differences and intervals for one pair of grades."""
    axis.axvline(0, color="0.6", linewidth=1)
    for place, (one, other) in enumerate(_DRAWN_COMPARISONS):
        of = rows[(rows["predictor_set"] == one) & (rows["reference_set"] == other)]
        if len(of) and np.isfinite(of["difference"].iloc[0]):
            value, low, high = of.iloc[0][["difference", "low", "high"]].astype(float)
            axis.plot([low, high], [place, place], color=PREDICTOR_SET_COLOURS[one], linewidth=2)
            axis.plot(value, place, "o", color=PREDICTOR_SET_COLOURS[one], markersize=5)
    axis.set_xlabel("AUC difference", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)


def draw_learning_curves(curves: pd.DataFrame, power: pd.DataFrame) -> bytes:
    """Draw AUC against number of training subjects, and power against cohort size, one column per pair of grades.

    Parameters
    ----------
    curves : DataFrame
        Table from `compute_learning_curves`.
    power : DataFrame
        Table from `tabulate_power`.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    pairs = list(dict.fromkeys(curves["grades"]))
    figure = Figure(figsize=(1.2 + 2.8 * max(1, len(pairs)), 5.6), layout="constrained")
    axes = figure.subplots(2, max(1, len(pairs)), squeeze=False, sharey="row")
    for column, grades in enumerate(pairs):
        axis = axes[0, column]
        for name, rows in curves[curves["grades"] == grades].groupby("predictor_set", sort=False):
            at, colour = rows["training_subjects"].to_numpy(float), PREDICTOR_SET_COLOURS[str(name)]
            axis.fill_between(at, rows["low"], rows["high"], color=colour, alpha=0.13, linewidth=0)
            axis.plot(at, rows["auc"], "o-", color=colour, markersize=4, linewidth=1.5, label=PREDICTOR_SETS[str(name)])
        axis.axhline(0.5, color="0.8", linewidth=1)
        axis.set_title(f"grade {grades}", fontsize=10)
        axis.set_xlabel("training subjects", fontsize=8.5)
        _draw_power(axes[1, column], power[power["grades"] == grades])
    axes[0, 0].set_ylabel("AUC", fontsize=8.5)
    axes[1, 0].set(ylim=(0, 1.02))
    axes[1, 0].set_ylabel("power", fontsize=8.5)
    for axis in axes.ravel():
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside lower center", ncols=3)
    return encode_png(figure)


def _draw_power(axis: Any, rows: pd.DataFrame) -> None:
    """Draw the power curve of one pair of grades."""
    if rows.empty:
        axis.set_axis_off()
        axis.text(0.5, 0.5, _NO_POWER, ha="center", va="center", fontsize=8, color="0.4", transform=axis.transAxes)
        return
    axis.axhline(TARGET_POWER, color="0.7", linewidth=1, linestyle="--")
    for _, row in rows.iterrows():
        at = np.geomspace(row["subjects"] / 4, max(4 * row["subjects"], 1.3 * row["required_subjects_high"]), 60)
        colour = PREDICTOR_SET_COLOURS[row["predictor_set"]]
        low, high = (
            compute_power_curve(row, at * row["required_subjects"] / row[f"required_subjects_{end}"])
            for end in ("high", "low")
        )
        axis.fill_between(at, low, high, color=colour, alpha=0.13, linewidth=0)
        axis.plot(at, compute_power_curve(row, at), color=colour, linewidth=1.5)
        axis.plot(row["subjects"], row["power"], "o", color=colour, markersize=5)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(ScalarFormatter())
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("number of subjects in the cohort", fontsize=8.5)


def draw_confounders(table: pd.DataFrame) -> bytes:
    """Draw AUC against the strength of the association with grade, one panel per confounder.

    Parameters
    ----------
    table : DataFrame
        Table from `confounding_effects.estimate_confounding`.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    names = list(dict.fromkeys(table["confounder"]))
    figure = Figure(figsize=(1.0 + 3.2 * len(names), 3.7), layout="constrained")
    axes = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    colours = {TIED: "#D55E00", UNTIED: "#0072B2", ADJUSTED: "#009E73"}
    for axis, name in zip(axes, names, strict=True):
        for measure, colour in colours.items():
            rows = table[(table["confounder"] == name) & (table["measure"] == measure)]
            at = rows["strength"].to_numpy(float)
            axis.fill_between(at, rows["low"], rows["high"], color=colour, alpha=0.1, linewidth=0)
            axis.plot(at, rows["value"], "o-", color=colour, markersize=4, linewidth=1.5, label=measure)
        axis.axhline(0.5, color="0.8", linewidth=1)
        axis.set_title(CONFOUNDERS[name], fontsize=10)
        axis.set_xlabel("strength of the association with grade", fontsize=8.5)
        axis.set(ylim=(0, 1.02))
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("AUC, grade 0 vs 2", fontsize=8.5)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside lower center", ncols=3)
    return encode_png(figure)
