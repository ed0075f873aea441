"""The pictures of the report with their captions, from the tables of the study."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..detector import present
from ..radiomics.table import Load
from . import StudySettings, figures
from .figures import Shot
from .importance import by_family
from .reliability import protocols_of
from .report import Picture
from .selection import SELECTIONS

_SHRINK = 4  # of the radiographs in the panel; the file stays small and the joint can be seen


def gallery(
    located: pd.DataFrame,
    load_pixels: Load,
    settings: StudySettings,
    predictions: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
) -> dict[str, Picture]:
    """Name -> picture: panel, roc, confusion, icc, importance; without those that the cohort cannot give.

    located  of `localisation.errors`
    tables   `reliability` and `importance`
    """
    # The first selection of the settings, whatever its result: a picture of the best would be a choice by test results.
    selection = settings.selections[0]
    pictures = {"panel": _panel(located, load_pixels, settings), "roc": _roc(predictions, selection)}
    if (predictions["task"] == "0/1/2").any():
        pictures["confusion"] = _confusion(predictions, selection)
    if len(tables["reliability"]):
        pictures["icc"] = Picture(
            name="icc",
            png=figures.heat_map(tables["reliability"]),
            alt="Heat map of the intraclass correlation of every feature, by form of ICC and set of protocols",
            caption="ICC of every feature. Features are sorted by family (white lines), columns by form of ICC and the "
            "protocols compared. Grey: the feature is the same in every radiograph.",
        )
    pictures["importance"] = _importance(tables["importance"], settings, selection)
    return pictures


def _panel(located: pd.DataFrame, load_pixels: Load, settings: StudySettings) -> Picture:
    protocols = protocols_of(located, settings.reference)
    lines, labels = [], []
    for grade, part in located.groupby("grade", sort=True):
        knee = part["knee"].iloc[0]
        line = [
            _shot(row, load_pixels(row["file"]), settings.region_px)
            for row in part[part["knee"] == knee].to_dict("records")
        ]
        line.sort(key=lambda shot: protocols.index(shot.title))
        lines.append(line)
        labels.append(f"grade {grade}, knee {knee}")
    return Picture(
        name="panel",
        png=figures.panel(lines, labels),
        alt="Simulated knee radiographs with the region and the joint line; rows are KL-like grades, columns protocols",
        caption="The first knee of each KL-like grade under every protocol, rendered for the eye (bone bright). "
        f"Yellow: the region of {settings.region_px} × {settings.region_px} pixels about the found joint line, orange "
        "where the match was refused. Blue cross: the known medial joint line.",
    )


def _shot(row: dict[str, Any], pixels: NDArray[np.uint16], region_px: int) -> Shot:
    rows, cols = (length // _SHRINK for length in pixels.shape)
    shown = present(pixels)[: rows * _SHRINK, : cols * _SHRINK]
    small = shown.reshape(rows, _SHRINK, cols, _SHRINK).mean(axis=(1, 3))
    return Shot(
        display=np.round(small).astype(np.uint8),
        title=row["protocol"],
        found=(row["row_px"] / _SHRINK, row["col_px"] / _SHRINK),
        known=(row["truth_medial_row_px"] / _SHRINK, row["truth_medial_col_px"] / _SHRINK),
        region=region_px / _SHRINK,
        status=row["status"],
    )


def _roc(predictions: pd.DataFrame, selection: str) -> Picture:
    return Picture(
        name="roc",
        png=figures.roc(predictions, selection),
        alt="ROC curves of grade 0 against 2 within, across and over protocols, for three models",
        caption=f"Grade 0 against 2, {SELECTIONS[selection]} selection; test predictions of all splits pooled. The "
        "number is the AUC of the pooled curve, which differs from the mean over splits in the table.",
    )


def _confusion(predictions: pd.DataFrame, selection: str) -> Picture:
    return Picture(
        name="confusion",
        png=figures.confusions(predictions, selection),
        alt="Confusion matrices of grades 0, 1 and 2 for each scenario and model",
        caption=f"Grades 0, 1 and 2, {SELECTIONS[selection]} selection; test predictions of all splits pooled. "
        "Share of the true grade, and in brackets the number of predictions (a knee is counted in each split that "
        "tests it).",
    )


def _importance(features: pd.DataFrame, settings: StudySettings, selection: str) -> Picture:
    families = by_family(features[features["selection"] == selection])
    return Picture(
        name="importance",
        png=figures.family_bars(families[[model for model in settings.models if model in families]]),
        alt="Bar chart of the share of each feature family in the importance of each model",
        caption=f"Grade 0 against 2, trained on {settings.reference.replace('_', ' ')}, {SELECTIONS[selection]} "
        "selection: absolute coefficients of standardised features (logistic regression), decrease of "
        "impurity (random forest), gain (XGBoost), each scaled to a sum of 1 and averaged over the splits.",
    )
