"""The pictures of the report, as PNG. No global state: every figure is an object of its own."""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from sklearn.metrics import roc_curve

from ..radiomics.features import FAMILIES, family
from .metrics import auc, confusion
from .models import MODELS
from .reliability import ICC_FORMS
from .scenarios import TASKS, truth_and_probability

# Okabe & Ito 2008: told apart with any colour vision.
_COLOURS = {"lr": "#0072B2", "rf": "#D55E00", "xgb": "#009E73"}
_DASHES = ("-", "--", ":", "-.")
FAMILY_NAMES = dict(zip(FAMILIES, ("First order", "Shape", "GLCM", "GLRLM", "GLSZM", "NGTDM", "GLDM"), strict=True))
_DPI = 110


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One radiograph of the panel: a display rendering and, in its pixels, the places to draw."""

    display: NDArray[np.uint8]
    title: str
    found: tuple[float, float]
    known: tuple[float, float]
    region: float
    status: str


def panel(shots: list[list[Shot]], row_labels: list[str]) -> bytes:
    """Radiographs with the found region and the known joint line; rows are grades, columns protocols."""
    cols = max(len(row) for row in shots)
    figure = Figure(figsize=(3.2 * cols, 3.25 * len(shots) + 0.3), layout="constrained")
    axes = figure.subplots(len(shots), cols, squeeze=False)
    for axis in axes.ravel():
        axis.set_xticks([])
        axis.set_yticks([])
    for row, line in enumerate(shots):
        axes[row, 0].set_ylabel(row_labels[row], fontsize=11)
        for axis, shot in zip(axes[row], line, strict=False):
            axis.imshow(shot.display, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
            top, left = (at - shot.region / 2 for at in shot.found)
            edge = "#F0E442" if shot.status == "found" else "#D55E00"
            axis.add_patch(Rectangle((left, top), shot.region, shot.region, fill=False, edgecolor=edge, linewidth=1.6))
            axis.plot(shot.known[1], shot.known[0], "+", color="#56B4E9", markersize=11, markeredgewidth=1.8)
            if row == 0:
                axis.set_title(_plain(shot.title), fontsize=11)
    return _png(figure)


def roc(predictions: pd.DataFrame, selection: str) -> bytes:
    """ROC curves of 0 vs 2, predictions of all splits pooled; a panel a scenario, a curve a model and test protocol."""
    part = predictions[(predictions["task"] == "0 vs 2") & (predictions["selection"] == selection)]
    scenarios = [name for name in ("within", "cross", "multi") if (part["scenario"] == name).any()]
    width, height, below = 3.6 * max(1, len(scenarios)), 5.4, 2.05  # inches; the legends stand below the panels
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(1, max(1, len(scenarios)), squeeze=False)[0]
    figure.subplots_adjust(left=0.6 / width, right=1 - 0.1 / width, bottom=below / height, top=1 - 0.3 / height)
    for axis, scenario in zip(axes, scenarios, strict=False):
        of = part[part["scenario"] == scenario]
        tests = [name for name in dict.fromkeys(of["tested_on"]) if name != "all"]
        axis.plot([0, 1], [0, 1], color="0.75", linewidth=1)
        for model in dict.fromkeys(of["model"]):
            for dash, tested_on in zip(_DASHES, tests, strict=False):
                chosen = of[(of["model"] == model) & (of["tested_on"] == tested_on)]
                truth, probability = truth_and_probability(chosen)
                if len(set(truth)) < 2:
                    continue
                false, true, _ = roc_curve(truth, probability[:, 1])
                label = f"{model.upper()}, {_plain(tested_on)}: {auc(truth == 1, probability[:, 1]):.2f}"
                axis.plot(false, true, dash, color=_COLOURS[model], linewidth=1.6, label=label)
        axis.set(xlim=(-0.01, 1), ylim=(0, 1.01), title=_title(scenario), xlabel="1 − specificity")
        axis.set_box_aspect(1)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.18), frameon=False)
    axes[0].set_ylabel("sensitivity")
    return _png(figure)


def confusions(predictions: pd.DataFrame, selection: str) -> bytes:
    """Confusion matrices of 0/1/2, splits pooled: rows are scenarios, columns models; shade is the share of a row."""
    part = predictions[(predictions["task"] == "0/1/2") & (predictions["selection"] == selection)]
    arms = [arm for arm in dict.fromkeys(zip(part["scenario"], part["tested_on"], strict=True)) if _shown(arm)]
    models = list(dict.fromkeys(part["model"]))
    figure = Figure(figsize=(2.7 * max(1, len(models)), 2.45 * max(1, len(arms))), layout="constrained")
    axes = figure.subplots(max(1, len(arms)), max(1, len(models)), squeeze=False)
    for row, (scenario, tested_on) in enumerate(arms):
        for col, model in enumerate(models):
            axis = axes[row, col]
            chosen = part[(part["scenario"] == scenario) & (part["tested_on"] == tested_on) & (part["model"] == model)]
            _matrix(axis, confusion(*truth_and_probability(chosen)))
            axis.set_title(f"{MODELS[model]}\n{_title(scenario)}: {_plain(tested_on)}", fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("true grade")
    for axis in axes[-1, :]:
        axis.set_xlabel("predicted grade")
    return _png(figure)


def heat_map(reliability: pd.DataFrame) -> bytes:
    """ICC of every feature: columns are the forms and sets of protocols, features sorted by family, in two blocks."""
    table = reliability.pivot(index="feature", columns="across", values=list(ICC_FORMS))
    sets = list(dict.fromkeys(reliability["across"]))
    columns = [(form, label) for form in ICC_FORMS for label in sets]
    order = sorted(table.index, key=lambda name: (FAMILIES.index(family(name)), name))
    values = table.loc[order, columns].to_numpy(dtype=float)
    half = -(-len(order) // 2)
    figure = Figure(figsize=(10.2, 0.148 * half + 1.9), layout="constrained")
    axes = figure.subplots(1, 2)
    shown: Any = None
    for axis, start in zip(axes, (0, half), strict=True):
        block = values[start : start + half]
        axis.set_facecolor("0.82")  # what shows through where an ICC is undefined
        shown = axis.imshow(block, cmap="viridis", vmin=0, vmax=1, aspect="auto", interpolation="nearest")
        axis.set_xticks(range(len(columns)), [f"{form}, {_plain(label)}" for form, label in columns], fontsize=6.5)
        axis.tick_params(axis="x", rotation=90)
        axis.set_yticks(range(len(block)), order[start : start + half], fontsize=6)
        for row, name in enumerate(order[start : start + half]):
            if row and family(name) != family(order[start + row - 1]):
                axis.axhline(row - 0.5, color="white", linewidth=1.5)
        axis.axvline(len(sets) - 0.5, color="white", linewidth=1.5)
    bar = figure.colorbar(shown, ax=axes, shrink=0.5, pad=0.01, extend="min")
    bar.ax.axhline(0.9, color="white", linewidth=1.5)
    bar.set_label("ICC (line: 0.90; grey: undefined)", fontsize=8)
    return _png(figure)


def family_bars(families: pd.DataFrame) -> bytes:
    """Share of each family in what the models lean on; a bar a model."""
    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / max(1, families.shape[1])
    for index, model in enumerate(families.columns):
        at = np.arange(len(families)) + (index - (families.shape[1] - 1) / 2) * width
        axis.bar(at, families[model], width * 0.92, color=_COLOURS[model], label=MODELS[model])
    axis.set_xticks(range(len(families)), [FAMILY_NAMES[name] for name in families.index])
    axis.set_ylabel("mean share of importance")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=9)
    return _png(figure)


def _matrix(axis: Any, counts: NDArray[np.int64]) -> None:
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for (row, col), count in np.ndenumerate(counts):
        ink = "white" if share[row, col] > 0.6 else "black"
        axis.text(col, row, f"{share[row, col]:.2f}\n({count})", ha="center", va="center", color=ink, fontsize=8)
    grades = TASKS["0/1/2"]
    axis.set_xticks(range(len(grades)), [str(grade) for grade in grades])
    axis.set_yticks(range(len(grades)), [str(grade) for grade in grades])


def _shown(arm: tuple[str, str]) -> bool:
    scenario, tested_on = arm
    return scenario in ("within", "cross") or (scenario == "multi" and tested_on == "all")


def _title(scenario: str) -> str:
    return {"within": "Within protocol", "cross": "Cross-protocol", "multi": "Multi-protocol"}[scenario]


def _plain(name: str) -> str:
    return "all protocols" if name == "all" else name.replace("_", " ")


def _png(figure: Figure) -> bytes:
    buffer = BytesIO()
    # Without the library's name and version in the file, the same numbers give the same bytes.
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
