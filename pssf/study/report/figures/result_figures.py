"""Figures of the results, as PNG, made without the global state of matplotlib."""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from ...design.classification_tasks import lowest_grades
from ...design.study_settings import MODELS
from ...predictions import extract_truth_and_probability
from ...statistics.scores.metrics import confusion_matrix, mean_roc

# Colours of Okabe and Ito 2008, which are distinguishable with any colour vision.
MODEL_COLOURS = {"lr": "#0072B2", "rf": "#D55E00", "xgb": "#009E73"}
_LINE_STYLES = ("-", "--", ":", "-.")
SCENARIO_LABELS = {"within": "Within protocol", "cross": "Cross-protocol", "multi": "Multi-protocol"}
# Resolution of the figures, in dots per inch.
_DPI = 110
# Ticks of AUC axes, dimensionless.
_AUC_TICKS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


@dataclass(frozen=True, kw_only=True)
class PanelImage:
    """Radiograph in the figure of all grades and protocols, with located and true joint line.

    Parameters
    ----------
    display : (rows, cols) uint8 array
        Display rendering with bone bright.
    title : str
        Title above the image.
    found_joint_px : tuple of float
        Row and column of the located joint line, in px.
    true_joint_px : tuple of float
        Row and column of the true joint line, in px.
    region_side_px : float
        Side length of the region, in px.
    status : str
        Status of the localisation; "found" if the joint was located.
    areas : tuple of (rows, cols) bool arrays, default ()
        Masks of measured regions of the tibia.
    """

    display: NDArray[np.uint8]
    title: str
    found_joint_px: tuple[float, float]
    true_joint_px: tuple[float, float]
    region_side_px: float
    status: str
    areas: tuple[NDArray[np.bool_], ...] = ()


def draw_panel(images: list[list[PanelImage | None]], row_labels: list[str]) -> bytes:
    """Draw radiographs with the located region and the true joint line.

    Parameters
    ----------
    images : list of list of PanelImage or None
        Images; rows are protocols, columns are grades. None: the panel is empty.
    row_labels : list of str
        Label of each row.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
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
            top, left = (at - image.region_side_px / 2 for at in image.found_joint_px)
            edge = "#F0E442" if image.status == "found" else "#D55E00"
            side = image.region_side_px
            axis.add_patch(Rectangle((left, top), side, side, fill=False, edgecolor=edge, linewidth=1.6))
            axis.plot(
                image.true_joint_px[1], image.true_joint_px[0], "+", color="#56B4E9", markersize=11, markeredgewidth=1.8
            )
            for area in image.areas:
                axis.contour(area, levels=[0.5], colors="#009E73", linewidths=1.2)
            if row == 0:
                axis.set_title(image.title, fontsize=11)
    return encode_png(figure)


def draw_robustness(
    predictions: pd.DataFrame, scores: pd.DataFrame, selection: str, published_auc: dict[str, str]
) -> bytes:
    """Draw ROC curves and AUC of grade 0 vs 2, one column per scenario.

    The upper row shows the mean ROC curve over the splits, the lower row the mean AUC with its interval.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all arms (see `ARM_COLUMNS`).
    scores : DataFrame
        Scores of all arms (see `ARM_COLUMNS`).
    selection : str
        Feature selection to draw.
    published_auc : dict of str to str
        AUC in the published study for each scenario, printed next to the intervals.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    part, scores = (of[(of["task"] == "0 vs 2") & (of["selection"] == selection)] for of in (predictions, scores))
    scenarios = [name for name in SCENARIO_LABELS if (part["scenario"] == name).any()]
    figure = Figure(figsize=(3.6 * max(1, len(scenarios)), 7.0), layout="constrained")
    axes = figure.subplots(2, max(1, len(scenarios)), squeeze=False, height_ratios=(3.1, 2.2))
    for column, scenario in enumerate(scenarios):
        of = part[part["scenario"] == scenario]
        tests = [name for name in dict.fromkeys(of["tested_on"]) if name != "all"]
        _draw_roc_curves(axes[0, column], of, tests)
        axes[0, column].set_title(SCENARIO_LABELS[scenario], fontsize=11)
        of_scores = scores[(scores["scenario"] == scenario) & scores["model"].isin(list(MODELS))]
        _draw_auc_intervals(axes[1, column], of_scores, tests, published_auc.get(scenario, ""))
    axes[0, 0].set_ylabel("sensitivity")
    axes[1, 0].set_ylabel("AUC, mean over the splits")
    return encode_png(figure)


def _draw_roc_curves(axis: Any, predictions: pd.DataFrame, tests: list[str]) -> None:
    """Draw the mean ROC curve of each model and test protocol."""
    axis.plot([0, 1], [0, 1], color="0.75", linewidth=1)
    for model in dict.fromkeys(predictions["model"]):
        for dash, tested_on in zip(_LINE_STYLES, tests, strict=False):
            if model not in MODEL_COLOURS:
                continue
            rows = predictions[(predictions["model"] == model) & (predictions["tested_on"] == tested_on)]
            if rows.empty:
                continue
            truth, probability = extract_truth_and_probability(rows)
            false, true = mean_roc(truth, probability[:, 1], rows["repeat"].to_numpy())
            axis.plot(false, true, dash, color=MODEL_COLOURS[model], linewidth=1.6)
    axis.set(xlim=(-0.01, 1), ylim=(0, 1.01), xlabel="1 − specificity")
    axis.set_box_aspect(1)
    lines = [
        Line2D([], [], color="0.3", ls=dash, label=format_protocol(name)) for dash, name in _pair_line_styles(tests)
    ]
    axis.legend(handles=lines, fontsize=7.5, loc="lower right", frameon=False)


def _draw_auc_intervals(axis: Any, scores: pd.DataFrame, tests: list[str], published_auc: str) -> None:
    """Draw the AUC of each model and test protocol with its interval."""
    models = list(dict.fromkeys(scores["model"]))
    for place, tested_on in enumerate(tests):
        rows = scores[scores["tested_on"] == tested_on].set_index("model")
        for index, model in enumerate(name for name in models if name in rows.index):
            value, low, high = rows.loc[model, ["auc", "auc_low", "auc_high"]].astype(float)
            if not np.isfinite(value):
                continue
            at = place + 0.22 * (index - (len(models) - 1) / 2)
            axis.plot([at, at], [low, high], color=MODEL_COLOURS[model], linewidth=2)
            axis.plot(
                at, value, "o", color=MODEL_COLOURS[model], markersize=5, label=MODELS[model] if not place else None
            )
            axis.annotate(
                f"{value:.2f}",
                (at, high if np.isfinite(high) else value),  # A single split has no interval.
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                rotation=90,
            )
    axis.axhline(0.5, color="0.75", linewidth=1)
    names = [format_protocol(name) for name in tests]
    axis.set(xlim=(-0.6, len(tests) - 0.4), ylim=(0.3, 1.12), xticks=range(len(tests)), yticks=_AUC_TICKS)
    axis.set_xticklabels(names, fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    if published_auc:
        axis.text(0.02, 0.03, f"published: {published_auc}", transform=axis.transAxes, fontsize=8, color="0.4")
    axis.legend(fontsize=7.5, loc="lower right", frameon=False)


def draw_calibration_curves(curve: pd.DataFrame, selection: str) -> bytes:
    """Draw the observed fraction of grade 2 against the mean predicted probability in ten bins.

    The area of a point increases with the number of predictions in its bin.

    Parameters
    ----------
    curve : DataFrame
        Table from `calibration.compute_calibration_curve`.
    selection : str
        Feature selection to draw.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    part = curve[curve["selection"] == selection]
    figure = Figure(figsize=(4.6, 4.8), layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.75", linewidth=1)
    for model, rows in part.groupby("model", sort=False):
        if model in MODEL_COLOURS:
            x, y, count = (
                rows[name].to_numpy(float) for name in ("mean_probability", "observed_fraction", "predictions")
            )
            axis.plot(x, y, color=MODEL_COLOURS[model], linewidth=1.2, label=MODELS[str(model)])
            axis.scatter(x, y, s=8 + 140 * count / count.sum(), color=MODEL_COLOURS[model])
    axis.set(
        xlim=(-0.02, 1.02),
        ylim=(-0.02, 1.02),
        xlabel="predicted probability of grade 2",
        ylabel="observed fraction of grade 2",
    )
    axis.set_box_aspect(1)
    # The legend is outside the axes because it could cover curves.
    figure.legend(*axis.get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside lower center", ncols=3)
    return encode_png(figure)


def draw_confusion_matrices(predictions: pd.DataFrame, task: str, selection: str) -> bytes:
    """Draw the confusion matrices of a task over all splits; rows are scenarios, columns are models.

    The colour of a cell shows the fraction of the knees with the true grade that have the predicted grade.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of all arms (see `ARM_COLUMNS`).
    task : str
        Classification task.
    selection : str
        Feature selection to draw.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    part = predictions[(predictions["task"] == task) & (predictions["selection"] == selection)]
    arms = [arm for arm in dict.fromkeys(zip(part["scenario"], part["tested_on"], strict=True)) if _is_drawn(arm)]
    models = list(dict.fromkeys(part["model"]))
    figure = Figure(figsize=(2.7 * max(1, len(models)), 2.45 * max(1, len(arms))), layout="constrained")
    axes = figure.subplots(max(1, len(arms)), max(1, len(models)), squeeze=False)
    for row, (scenario, tested_on) in enumerate(arms):
        for col, model in enumerate(models):
            axis = axes[row, col]
            of_model = part[
                (part["scenario"] == scenario) & (part["tested_on"] == tested_on) & (part["model"] == model)
            ]
            _draw_confusion_matrix(
                axis, confusion_matrix(*extract_truth_and_probability(of_model)), lowest_grades(task)
            )
            axis.set_title(f"{MODELS[model]}\n{SCENARIO_LABELS[scenario]}: {format_protocol(tested_on)}", fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("true grade")
    for axis in axes[-1, :]:
        axis.set_xlabel("predicted grade")
    return encode_png(figure)


def _draw_confusion_matrix(axis: Any, counts: NDArray[np.int64], grades: tuple[int, ...]) -> None:
    """Draw one confusion matrix."""
    fraction = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axis.imshow(fraction, cmap="Blues", vmin=0, vmax=1)
    for (row, col), count in np.ndenumerate(counts):
        ink = "white" if fraction[row, col] > 0.6 else "black"
        axis.text(col, row, f"{fraction[row, col]:.2f}\n({count})", ha="center", va="center", color=ink, fontsize=8)
    axis.set_xticks(range(len(grades)), [str(grade) for grade in grades])
    axis.set_yticks(range(len(grades)), [str(grade) for grade in grades])


def _is_drawn(arm: tuple[str, str]) -> bool:
    """Check whether an arm is drawn in the figure of confusion matrices."""
    scenario, tested_on = arm
    return scenario in ("within", "cross") or (scenario == "multi" and tested_on == "all")


def _pair_line_styles(tests: list[str]) -> list[tuple[Any, str]]:
    """Pair each test protocol with a line style."""
    return list(zip(_LINE_STYLES, tests, strict=False))


def format_protocol(name: str) -> str:
    """Format the name of a protocol.

    Parameters
    ----------
    name : str
        Name of the protocol, or "all".

    Returns
    -------
    str
        Name with spaces, or "all protocols".
    """
    return "all protocols" if name == "all" else name.replace("_", " ")


def encode_png(figure: Figure) -> bytes:
    """Encode a figure as PNG; the same data give the same bytes.

    Parameters
    ----------
    figure : Figure
        Figure to encode.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    buffer = BytesIO()
    # `Software: None` keeps matplotlib from writing its version into the file.
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
