"""The pictures of the report that are about what a grade can be told by, as PNG."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ..learn.confounders import CONFOUNDERS
from ..learn.ladder import RUNGS
from ..statistics.confounders import ADJUSTED, TIED, UNTIED
from ..statistics.ladder import CEILING
from ..statistics.learning import WANTED, power_curve
from .figures import png

# Okabe & Ito 2008; what is true in black and grey, what a film gives in colour.
RUNG_COLOURS = dict(zip(RUNGS, ("#000000", "0.45", "#E69F00", "#0072B2", "#56B4E9", "#009E73"), strict=True))
_ASKED = (("radiomics", "measured"), ("texture", "measured"), ("both", "measured"))

# As `statistics.learning.power` leaves pairs of grades out.
_NO_POWER = "no room for the difference\nbelow an AUC of 1,\nor splits that do not differ"


def ladder(rungs: pd.DataFrame, differences: pd.DataFrame) -> bytes:
    """A column a pair of grades: AUC of every rung with its interval above, paired differences below.

    rungs        of `ladder.rungs`, with rows of `ladder.ceiling` among them where they are known
    differences  of `ladder.differences`
    """
    pairs = list(dict.fromkeys(rungs["grades"]))
    figure = Figure(figsize=(2.0 + 2.6 * max(1, len(pairs)), 5.6), layout="constrained")
    axes = figure.subplots(2, max(1, len(pairs)), squeeze=False, height_ratios=(2.2, 1.2), sharey="row", sharex="row")
    for column, grades in enumerate(pairs):
        _climb(axes[0, column], rungs[rungs["grades"] == grades])
        _compare(axes[1, column], differences[differences["grades"] == grades])
        axes[0, column].set_title(f"grade {grades}", fontsize=10)
    names = [name for name in RUNGS if name in set(rungs["rung"])]
    axes[0, 0].set_yticks(range(len(names)), [RUNGS[name] for name in names], fontsize=8.5)
    axes[0, 0].set_ylim(len(names) - 0.5, -0.5)
    axes[1, 0].set_yticks(range(len(_ASKED)), [f"{RUNGS[a]}\nminus {RUNGS[b]}" for a, b in _ASKED], fontsize=7.5)
    axes[1, 0].set_ylim(len(_ASKED) - 0.5, -0.5)
    return png(figure)


def _climb(axis: Any, rows: pd.DataFrame) -> None:
    best = rows[rows["rung"] == CEILING]
    if len(best):
        axis.axvspan(best["low"].iloc[0], best["high"].iloc[0], color="0.9", linewidth=0)
        axis.axvline(best["auc"].iloc[0], color="0.55", linewidth=1.2, linestyle="--")
        axis.text(best["auc"].iloc[0], 5.45, "possible, at least ", ha="right", va="bottom", fontsize=7, color="0.35")
    names = [name for name in RUNGS if name in set(rows["rung"])]
    for place, name in enumerate(names):
        value, low, high = rows.set_index("rung").loc[name, ["auc", "low", "high"]].astype(float)
        axis.plot([low, high], [place, place], color=RUNG_COLOURS[name], linewidth=2)
        axis.plot(value, place, "o", color=RUNG_COLOURS[name], markersize=5)
        axis.annotate(
            f"{value:.2f}", (value, place), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=7
        )
    axis.axvline(0.5, color="0.8", linewidth=1)
    axis.set_xlabel("AUC", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)


def _compare(axis: Any, rows: pd.DataFrame) -> None:
    axis.axvline(0, color="0.6", linewidth=1)
    for place, (one, other) in enumerate(_ASKED):
        of = rows[(rows["rung"] == one) & (rows["minus"] == other)]
        if len(of) and np.isfinite(of["difference"].iloc[0]):
            value, low, high = of.iloc[0][["difference", "low", "high"]].astype(float)
            axis.plot([low, high], [place, place], color=RUNG_COLOURS[one], linewidth=2)
            axis.plot(value, place, "o", color=RUNG_COLOURS[one], markersize=5)
    axis.set_xlabel("difference of AUC", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)


def learning(curves: pd.DataFrame, power: pd.DataFrame) -> bytes:
    """A column a pair of grades: AUC against the subjects learnt from above, power against those of a cohort below.

    curves  of `learning.curves`
    power   of `learning.power`
    """
    pairs = list(dict.fromkeys(curves["grades"]))
    figure = Figure(figsize=(1.2 + 2.8 * max(1, len(pairs)), 5.6), layout="constrained")
    axes = figure.subplots(2, max(1, len(pairs)), squeeze=False, sharey="row")
    for column, grades in enumerate(pairs):
        axis = axes[0, column]
        for rung, rows in curves[curves["grades"] == grades].groupby("rung", sort=False):
            at, colour = rows["trained"].to_numpy(float), RUNG_COLOURS[str(rung)]
            axis.fill_between(at, rows["low"], rows["high"], color=colour, alpha=0.13, linewidth=0)
            axis.plot(at, rows["auc"], "o-", color=colour, markersize=4, linewidth=1.5, label=RUNGS[str(rung)])
        axis.axhline(0.5, color="0.8", linewidth=1)
        axis.set_title(f"grade {grades}", fontsize=10)
        axis.set_xlabel("subjects learnt from", fontsize=8.5)
        _powers(axes[1, column], power[power["grades"] == grades])
    axes[0, 0].set_ylabel("AUC", fontsize=8.5)
    axes[1, 0].set(ylim=(0, 1.02))
    axes[1, 0].set_ylabel("power", fontsize=8.5)
    for axis in axes.ravel():
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside lower center", ncols=3)
    return png(figure)


def _powers(axis: Any, rows: pd.DataFrame) -> None:
    if rows.empty:
        axis.set_axis_off()
        axis.text(0.5, 0.5, _NO_POWER, ha="center", va="center", fontsize=8, color="0.4", transform=axis.transAxes)
        return
    axis.axhline(WANTED, color="0.7", linewidth=1, linestyle="--")
    for _, row in rows.iterrows():
        at = np.geomspace(row["subjects"] / 4, max(4 * row["subjects"], 1.3 * row["needed_high"]), 60)
        colour = RUNG_COLOURS[row["rung"]]
        low, high = (power_curve(row, at * row["needed"] / row[f"needed_{end}"]) for end in ("high", "low"))
        axis.fill_between(at, low, high, color=colour, alpha=0.13, linewidth=0)
        axis.plot(at, power_curve(row, at), color=colour, linewidth=1.5)
        axis.plot(row["subjects"], row["power"], "o", color=colour, markersize=5)
    axis.set_xscale("log")
    axis.set_xlabel("subjects of a cohort", fontsize=8.5)


def confounders(table: pd.DataFrame) -> bytes:
    """A panel a confounder: AUC against the strength of its tie to grade.

    table  of `confounders.confounding`
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
        axis.set_xlabel("strength of the tie to grade", fontsize=8.5)
        axis.set(ylim=(0, 1.02))
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("AUC, grade 0 vs 2", fontsize=8.5)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside lower center", ncols=3)
    return png(figure)
