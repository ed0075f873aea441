"""The pictures of the report with their captions, from the tables of the study."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.blocks import block_mean
from ...detector import present
from ...radiomics.table import Load
from ..settings import SELECTIONS, StudySettings
from ..statistics.importance import by_family
from ..statistics.parameters import strongest
from ..statistics.reliability import protocols_of
from ..tasks import GRADED
from . import feature_figures, figures
from .figures import PanelImage
from .page import PAPER, Picture

_SHRINK = 4  # of the radiographs in the panel; the file stays small and the joint can be seen


def gallery(
    located: pd.DataFrame,
    load_pixels: Load,
    settings: StudySettings,
    predictions: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
) -> dict[str, Picture]:
    """Name -> picture: panel, robustness, confusion, calibration, stability, icc, importance; without those that the
    cohort cannot give.

    located  of `localisation.errors`
    tables   of `evidence`
    """
    # The first selection of the settings, whatever its result: a picture of the best would be a choice by test results.
    selection = settings.selections[0]
    pictures = {"panel": _panel(located, load_pixels, settings)}
    pictures["robustness"] = _robustness(predictions, tables["scores"], selection)
    graded = [task for task in GRADED if (predictions["task"] == task).any()]
    if graded:
        # Of the most grades there are.
        pictures["confusion"] = _confusion(predictions, graded[-1], selection)
    pictures["calibration"] = _calibration(tables["calibration_curve"], selection)
    if len(tables["reliability"]):
        pictures["stability"] = _stability(tables, settings, selection)
        pictures["icc"] = Picture(
            name="icc",
            png=feature_figures.heat_map(tables["reliability"]),
            alt="Heat map of the intraclass correlation of every feature, by form of ICC and set of protocols",
            caption="ICC of every feature. Features are sorted by family (white lines), columns by form of ICC and the "
            "protocols compared. Grey: the feature is the same in every radiograph.",
        )
    pictures["importance"] = _importance(tables["importance"], settings, selection)
    return pictures


def _panel(located: pd.DataFrame, load_pixels: Load, settings: StudySettings) -> Picture:
    protocols = protocols_of(located, settings.reference)
    first = located.drop_duplicates("grade").sort_values("grade")["knee"].tolist()
    rows = []
    for protocol in protocols:
        part = located[(located["protocol"] == protocol) & located["knee"].isin(first)].set_index("knee")
        of = [part.loc[knee].to_dict() if knee in part.index else None for knee in first]
        rows.append([None if row is None else _image(row, load_pixels(row["file"]), settings.region_px) for row in of])
    return Picture(
        name="panel",
        png=figures.panel(rows, [figures.plain(name) for name in protocols]),
        alt="Simulated knee radiographs with the region and the joint line; columns are KL-like grades, rows protocols",
        caption="After the paper’s figure 3: the first knee of each KL-like grade under every protocol, rendered for "
        "the eye (bone bright). "
        f"Yellow: the region of {settings.region_px} × {settings.region_px} pixels about the found joint line, orange "
        "where the match was refused. Blue cross: the known medial joint line.",
    )


def _image(row: dict[str, Any], pixels: NDArray[np.uint16], region_px: int) -> PanelImage:
    rows, cols = (length // _SHRINK for length in pixels.shape)
    shown = present(pixels)[: rows * _SHRINK, : cols * _SHRINK]
    small = block_mean(shown, _SHRINK)
    return PanelImage(
        display=np.round(small).astype(np.uint8),
        title=f"grade {row['grade']}",
        located=(row["row_px"] / _SHRINK, row["col_px"] / _SHRINK),
        known=(row["truth_medial_row_px"] / _SHRINK, row["truth_medial_col_px"] / _SHRINK),
        region=region_px / _SHRINK,
        status=row["status"],
    )


def _robustness(predictions: pd.DataFrame, scores: pd.DataFrame, selection: str) -> Picture:
    published = {scenario: str(PAPER[scenario]) for scenario in figures.SCENARIOS}
    return Picture(
        name="robustness",
        png=figures.robustness(predictions, scores, selection, published),
        alt="ROC curves and AUC with intervals of grade 0 against 2, within, across and over protocols, by model",
        caption=f"After the paper’s figure 5. Grade 0 against 2, {SELECTIONS[selection]} selection. Above: the mean "
        "over the splits of their ROC curves, a colour a model (as below), a line style a test protocol. "
        "Below: AUC, mean over the splits, with its 95 % interval; the paper’s own number is only printed beside.",
    )


def _calibration(curve: pd.DataFrame, selection: str) -> Picture:
    return Picture(
        name="calibration",
        png=figures.calibration_curves(curve, selection),
        alt="Observed share of grade 2 against predicted probability in ten bins, for each model",
        caption=f"Grade 0 against 2 within protocol, {SELECTIONS[selection]} selection: test predictions of all splits "
        "in ten bins of probability; a point is as large as its bin is full. On the line a probability means what it "
        "says.",
    )


def _stability(tables: dict[str, pd.DataFrame], settings: StudySettings, selection: str) -> Picture:
    part = tables["importance"][tables["importance"]["selection"] == selection]
    mean = (part.groupby("feature")["share"].sum() / len(settings.models)).reset_index()
    return Picture(
        name="stability",
        png=feature_figures.stability_and_importance(tables["reliability"], mean, strongest(tables["follows"])),
        alt="Heat map of the ICC of every feature by condition, and bars of the most important features",
        caption="After the paper’s figure 6. Left: ICC(2,1) of every feature, a row each, by family and from stable to "
        "unstable. Right: the features that the models lean on most for grade 0 against 2 (mean share over the models, "
        f"{SELECTIONS[selection]} selection), coloured by family; beside each bar the parameter of the knee that the "
        "feature follows most, with Spearman’s ρ (follows.csv): where the paper interprets, the truth is known here.",
    )


def _confusion(predictions: pd.DataFrame, task: str, selection: str) -> Picture:
    return Picture(
        name="confusion",
        png=figures.confusions(predictions, task, selection),
        alt=f"Confusion matrices of grades {task} for each scenario and model",
        caption=f"Grades {task}, {SELECTIONS[selection]} selection; test predictions of all splits pooled. "
        "Share of the true grade, and in brackets the number of predictions (a knee is counted in each split that "
        "tests it).",
    )


def _importance(features: pd.DataFrame, settings: StudySettings, selection: str) -> Picture:
    families = by_family(features[features["selection"] == selection])
    return Picture(
        name="importance",
        png=feature_figures.family_bars(families[[model for model in settings.models if model in families]]),
        alt="Bar chart of the share of each feature family in the importance of each model",
        caption=f"Grade 0 against 2, trained on {settings.reference.replace('_', ' ')}, {SELECTIONS[selection]} "
        "selection: absolute coefficients of standardised features (logistic regression), decrease of "
        "impurity (random forest), gain (XGBoost), each scaled to a sum of 1 and averaged over the splits.",
    )
