"""The pictures of the report, as PNG. No global state: every figure is an object of its own."""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from ..predictions import truth_and_probability
from ..settings import MODELS
from ..statistics.metrics import confusion, mean_roc
from ..tasks import least_grades

# Okabe & Ito 2008: told apart with any colour vision.
COLOURS = {"lr": "#0072B2", "rf": "#D55E00", "xgb": "#009E73"}
_DASHES = ("-", "--", ":", "-.")
SCENARIOS = {"within": "Within protocol", "cross": "Cross-protocol", "multi": "Multi-protocol"}
_DPI = 110
_AUCS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


@dataclass(frozen=True, kw_only=True)
class PanelImage:
    """One radiograph of the panel: a display rendering and, in its pixels, the places to draw.

    display   (rows, cols), bone bright
    located   row, column of the joint line where it was found
    known     row, column of the joint line as it is
    region    side of the region
    status    one of `radiomics.locate.STATUSES`
    """

    display: NDArray[np.uint8]
    title: str
    located: tuple[float, float]
    known: tuple[float, float]
    region: float
    status: str


def panel(images: list[list[PanelImage | None]], row_labels: list[str]) -> bytes:
    """Radiographs with the found region and the known joint line; rows are protocols, columns grades."""
    cols = max(len(row) for row in images)
    figure = Figure(figsize=(3.2 * cols, 3.25 * len(images) + 0.3), layout="constrained")
    axes = figure.subplots(len(images), cols, squeeze=False)
    for axis in axes.ravel():
        axis.set_xticks([])
        axis.set_yticks([])
    for row, line in enumerate(images):
        axes[row, 0].set_ylabel(row_labels[row], fontsize=11)
        for axis, image in zip(axes[row], line, strict=False):
            if image is None:
                continue
            axis.imshow(image.display, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
            top, left = (at - image.region / 2 for at in image.located)
            edge = "#F0E442" if image.status == "found" else "#D55E00"
            side = image.region
            axis.add_patch(Rectangle((left, top), side, side, fill=False, edgecolor=edge, linewidth=1.6))
            axis.plot(image.known[1], image.known[0], "+", color="#56B4E9", markersize=11, markeredgewidth=1.8)
            if row == 0:
                axis.set_title(image.title, fontsize=11)
    return png(figure)


def robustness(predictions: pd.DataFrame, scores: pd.DataFrame, selection: str, published: dict[str, str]) -> bytes:
    """Grade 0 vs 2, a column a scenario: the mean ROC curve of the splits above, mean AUC with its interval below.

    predictions, scores  of all arms; those of `selection` are drawn
    published            scenario -> the paper's AUC, to be read beside
    """
    part, scores = (of[(of["task"] == "0 vs 2") & (of["selection"] == selection)] for of in (predictions, scores))
    scenarios = [name for name in SCENARIOS if (part["scenario"] == name).any()]
    figure = Figure(figsize=(3.6 * max(1, len(scenarios)), 7.0), layout="constrained")
    axes = figure.subplots(2, max(1, len(scenarios)), squeeze=False, height_ratios=(3.1, 2.2))
    for column, scenario in enumerate(scenarios):
        of = part[part["scenario"] == scenario]
        tests = [name for name in dict.fromkeys(of["tested_on"]) if name != "all"]
        _curves(axes[0, column], of, tests)
        axes[0, column].set_title(SCENARIOS[scenario], fontsize=11)
        of_scores = scores[(scores["scenario"] == scenario) & scores["model"].isin(list(MODELS))]
        _intervals(axes[1, column], of_scores, tests, published.get(scenario, ""))
    axes[0, 0].set_ylabel("sensitivity")
    axes[1, 0].set_ylabel("AUC, mean over the splits")
    return png(figure)


def _curves(axis: Any, of: pd.DataFrame, tests: list[str]) -> None:
    axis.plot([0, 1], [0, 1], color="0.75", linewidth=1)
    for model in dict.fromkeys(of["model"]):
        for dash, tested_on in zip(_DASHES, tests, strict=False):
            if model not in COLOURS:
                continue
            rows = of[(of["model"] == model) & (of["tested_on"] == tested_on)]
            if rows.empty:
                continue
            truth, probability = truth_and_probability(rows)
            false, true = mean_roc(truth, probability[:, 1], rows["repeat"].to_numpy())
            axis.plot(false, true, dash, color=COLOURS[model], linewidth=1.6)
    axis.set(xlim=(-0.01, 1), ylim=(0, 1.01), xlabel="1 − specificity")
    axis.set_box_aspect(1)
    lines = [Line2D([], [], color="0.3", ls=dash, label=plain(name)) for dash, name in _dashed(tests)]
    axis.legend(handles=lines, fontsize=7.5, loc="lower right", frameon=False)


def _intervals(axis: Any, scores: pd.DataFrame, tests: list[str], published: str) -> None:
    models = list(dict.fromkeys(scores["model"]))
    for place, tested_on in enumerate(tests):
        rows = scores[scores["tested_on"] == tested_on].set_index("model")
        for index, model in enumerate(name for name in models if name in rows.index):
            value, low, high = rows.loc[model, ["auc", "auc_low", "auc_high"]].astype(float)
            at = place + 0.22 * (index - (len(models) - 1) / 2)
            axis.plot([at, at], [low, high], color=COLOURS[model], linewidth=2)
            axis.plot(at, value, "o", color=COLOURS[model], markersize=5, label=MODELS[model] if not place else None)
            axis.annotate(
                f"{value:.2f}",
                (at, high if np.isfinite(high) else value),  # of one split there is no interval
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                rotation=90,
            )
    axis.axhline(0.5, color="0.75", linewidth=1)
    names = [plain(name) for name in tests]
    axis.set(xlim=(-0.6, len(tests) - 0.4), ylim=(0.3, 1.12), xticks=range(len(tests)), yticks=_AUCS)
    axis.set_xticklabels(names, fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    if published:
        axis.text(0.02, 0.03, f"the paper: {published}", transform=axis.transAxes, fontsize=8, color="0.4")
    axis.legend(fontsize=7.5, loc="lower right", frameon=False)


def calibration_curves(curve: pd.DataFrame, selection: str) -> bytes:
    """Share of grade 2 against its mean predicted probability, in ten bins; the size of a point is its count."""
    part = curve[curve["selection"] == selection]
    figure = Figure(figsize=(4.6, 4.8), layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.75", linewidth=1)
    for model, rows in part.groupby("model", sort=False):
        if model in COLOURS:
            x, y, count = (rows[name].to_numpy(float) for name in ("mean_probability", "observed_share", "predictions"))
            axis.plot(x, y, color=COLOURS[model], linewidth=1.2, label=MODELS[str(model)])
            axis.scatter(x, y, s=8 + 140 * count / count.sum(), color=COLOURS[model])
    axis.set(
        xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), xlabel="predicted probability of grade 2", ylabel="share of grade 2"
    )
    axis.set_box_aspect(1)
    # Curves may be anywhere in the square.
    figure.legend(*axis.get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside lower center", ncols=3)
    return png(figure)


def confusions(predictions: pd.DataFrame, task: str, selection: str) -> bytes:
    """Confusion matrices of a task, splits pooled: rows are scenarios, columns models; shade is the share of a row."""
    part = predictions[(predictions["task"] == task) & (predictions["selection"] == selection)]
    arms = [arm for arm in dict.fromkeys(zip(part["scenario"], part["tested_on"], strict=True)) if _shown(arm)]
    models = list(dict.fromkeys(part["model"]))
    figure = Figure(figsize=(2.7 * max(1, len(models)), 2.45 * max(1, len(arms))), layout="constrained")
    axes = figure.subplots(max(1, len(arms)), max(1, len(models)), squeeze=False)
    for row, (scenario, tested_on) in enumerate(arms):
        for col, model in enumerate(models):
            axis = axes[row, col]
            chosen = part[(part["scenario"] == scenario) & (part["tested_on"] == tested_on) & (part["model"] == model)]
            _matrix(axis, confusion(*truth_and_probability(chosen)), least_grades(task))
            axis.set_title(f"{MODELS[model]}\n{SCENARIOS[scenario]}: {plain(tested_on)}", fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("true grade")
    for axis in axes[-1, :]:
        axis.set_xlabel("predicted grade")
    return png(figure)


def _matrix(axis: Any, counts: NDArray[np.int64], grades: tuple[int, ...]) -> None:
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for (row, col), count in np.ndenumerate(counts):
        ink = "white" if share[row, col] > 0.6 else "black"
        axis.text(col, row, f"{share[row, col]:.2f}\n({count})", ha="center", va="center", color=ink, fontsize=8)
    axis.set_xticks(range(len(grades)), [str(grade) for grade in grades])
    axis.set_yticks(range(len(grades)), [str(grade) for grade in grades])


def _shown(arm: tuple[str, str]) -> bool:
    scenario, tested_on = arm
    return scenario in ("within", "cross") or (scenario == "multi" and tested_on == "all")


def _dashed(tests: list[str]) -> list[tuple[Any, str]]:
    return list(zip(_DASHES, tests, strict=False))


def plain(name: str) -> str:
    """A protocol as it is written."""
    return "all protocols" if name == "all" else name.replace("_", " ")


def png(figure: Figure) -> bytes:
    """The figure as a file; the same numbers give the same bytes."""
    buffer = BytesIO()
    # The library would put its name and version in it.
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
