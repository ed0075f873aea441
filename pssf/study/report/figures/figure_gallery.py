"""Figures of the report with their captions, made from the tables of the study."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ....core.checks import Array
from ....core.resample import downsample_by_blocks
from ....detector import render_for_display
from ....radiomics.features.feature_families import SQUARE
from ....radiomics.features.feature_table import LoadPixels, read_landmark_columns
from ....texture import make_texture_region
from ...design.classification_tasks import MULTICLASS_TASKS
from ...design.study_settings import SELECTIONS, StudySettings
from ...statistics.analyses.knee_parameters import select_strongest_correlations
from ...statistics.features.feature_importance import sum_by_family
from ...statistics.features.reliability import list_protocols
from ...study_data import StudyData
from ..published_results import PAPER_RESULTS
from ..report_elements import Picture
from . import feature_figures, result_figures
from .result_figures import PanelImage

# Side length, in px, of the blocks averaged in the panel figure; the size keeps the file small and the joint visible.
_BLOCK_PX = 4


def make_gallery(study: StudyData) -> dict[str, Picture]:
    """Make all figures for which the study has data.

    Parameters
    ----------
    study : StudyData
        Study with predictions and the tables of `statistics.result_tables`.

    Returns
    -------
    dict of str to Picture
        Figures by name: panel, robustness, confusion, calibration, stability, icc and importance.
    """
    settings, predictions, tables = study.settings, study.predictions, study.tables
    # Figures show the first feature selection in the settings, because choosing the best would use test results.
    selection = settings.selections[0]
    pictures = {"panel": _make_panel(study.located, study.run.load_pixels, settings)}
    pictures["robustness"] = _make_robustness_picture(predictions, tables["scores"], selection)
    graded = [task for task in MULTICLASS_TASKS if (predictions["task"] == task).any()]
    if graded:
        # The last multiclass task has the most grades.
        pictures["confusion"] = _make_confusion_picture(predictions, graded[-1], selection)
    pictures["calibration"] = _make_calibration_picture(tables["calibration_curve"], selection)
    if len(tables["reliability"]):
        pictures["stability"] = _make_stability_picture(tables, settings, selection)
        pictures["icc"] = Picture(
            name="icc",
            png=feature_figures.draw_icc_heat_map(tables["reliability"]),
            alt="Heat map of the intraclass correlation of every feature, by form of ICC and set of conditions",
            caption="ICC of every feature. Features are sorted by family (white lines), columns by form of ICC and "
            "compared conditions. Grey: the ICC is undefined, because the feature has the same value in every "
            "radiograph.",
        )
    pictures["importance"] = _make_importance_picture(tables["importance"], settings, selection)
    return pictures


def _make_panel(located: pd.DataFrame, load_pixels: LoadPixels, settings: StudySettings) -> Picture:
    """Make the figure of example radiographs: the first knee of each grade under every protocol."""
    protocols = list_protocols(located, settings.reference)
    first = located.drop_duplicates("grade").sort_values("grade")["knee"].tolist()
    rows = []
    for protocol in protocols:
        part = located[(located["protocol"] == protocol) & located["knee"].isin(first)].set_index("knee")
        of = [part.loc[knee].to_dict() if knee in part.index else None for knee in first]
        rows.append([None if row is None else _make_panel_image(row, load_pixels(row["file"]), settings) for row in of])
    return Picture(
        name="panel",
        png=result_figures.draw_panel(rows, [result_figures.format_protocol(name) for name in protocols]),
        alt="Simulated knee radiographs with region and joint line; columns are KL-like grades, rows are protocols",
        caption="The first knee of each KL-like grade under every protocol, rendered for display with bone bright "
        f"(layout as in figure 3 of arXiv 2601.11642). Yellow: region of {settings.region_px} × {settings.region_px} "
        "pixels at the located joint line. Orange: the joint was not located. Blue cross: true medial joint line."
        + (" Green: measured regions of the tibia." if set(settings.areas) != {SQUARE} else ""),
    )


def _make_panel_image(row: dict[str, Any], pixels: NDArray[np.uint16], settings: StudySettings) -> PanelImage:
    """Downsample one radiograph and convert its joint positions to the pixels of the smaller image."""
    rows, cols = (length // _BLOCK_PX for length in pixels.shape)
    shown = render_for_display(pixels)[: rows * _BLOCK_PX, : cols * _BLOCK_PX]
    small = downsample_by_blocks(shown, _BLOCK_PX)
    return PanelImage(
        display=np.round(small).astype(np.uint8),
        title=f"grade {row['grade']}",
        found_joint_px=(row["row_px"] / _BLOCK_PX, row["col_px"] / _BLOCK_PX),
        true_joint_px=(row["truth_medial_row_px"] / _BLOCK_PX, row["truth_medial_col_px"] / _BLOCK_PX),
        region_side_px=settings.region_px / _BLOCK_PX,
        status=row["status"],
        areas=_make_area_masks(row, small, settings.areas) if row["status"] == "found" else (),
    )


def _make_area_masks(row: dict[str, Any], small: Array, areas: tuple[str, ...]) -> tuple[NDArray[np.bool_], ...]:
    """Make the masks of the measured regions of the tibia in the smaller image (rows, cols)."""
    regions = [area for area in areas if area != SQUARE]
    if not regions:
        return ()
    landmarks = {name: (at[0] / _BLOCK_PX, at[1] / _BLOCK_PX) for name, at in read_landmark_columns(row).items()}
    pixel_mm = row["pixel_mm"] * _BLOCK_PX
    return tuple(make_texture_region(area, landmarks, small, side=row["side"], pixel_mm=pixel_mm) for area in regions)


def _make_robustness_picture(predictions: pd.DataFrame, scores: pd.DataFrame, selection: str) -> Picture:
    """Make the figure of ROC curves and AUCs per scenario."""
    published = {scenario: str(PAPER_RESULTS[scenario]) for scenario in result_figures.SCENARIO_LABELS}
    return Picture(
        name="robustness",
        png=result_figures.draw_robustness(predictions, scores, selection, published),
        alt="ROC curves and AUC with intervals for grade 0 vs 2, by scenario (within, cross, multi) and model",
        caption=f"Grade 0 vs 2, {SELECTIONS[selection]} selection (layout as in figure 5 of arXiv 2601.11642). Top: "
        "mean ROC curve over the splits; colours show models, as in the bottom row, and line styles show test "
        "protocols. Bottom: mean AUC over the splits with its 95 % interval. The AUC published in arXiv 2601.11642 is "
        "printed for comparison only.",
    )


def _make_calibration_picture(curve: pd.DataFrame, selection: str) -> Picture:
    """Make the figure of the calibration curves."""
    return Picture(
        name="calibration",
        png=result_figures.draw_calibration_curves(curve, selection),
        alt="Observed fraction of grade 2 against predicted probability in ten bins, for each model",
        caption=f"Grade 0 vs 2 within protocol, {SELECTIONS[selection]} selection: test predictions of all splits in "
        "ten probability bins. The area of a point increases with the number of predictions in its bin. The diagonal "
        "shows perfect calibration.",
    )


def _make_stability_picture(tables: dict[str, pd.DataFrame], settings: StudySettings, selection: str) -> Picture:
    """Make the figure of the stability and importance of features."""
    part = tables["importance"][tables["importance"]["selection"] == selection]
    mean = (part.groupby("feature")["importance"].sum() / len(settings.models)).reset_index()
    return Picture(
        name="stability",
        png=feature_figures.draw_stability_and_importance(
            tables["reliability"], mean, select_strongest_correlations(tables["feature_parameter_correlations"])
        ),
        alt="Heat map of the ICC of every feature by condition, and bars of the most important features",
        caption="Layout as in figure 6 of arXiv 2601.11642. Left: ICC(2,1) of every feature, one row per feature, "
        "sorted by family and by mean ICC. Right: the most important features for grade 0 vs 2 (mean importance over "
        f"the models, {SELECTIONS[selection]} selection), coloured by family. Next to each bar: the true knee "
        "parameter that correlates most strongly with the feature, and Spearman’s ρ "
        "(feature_parameter_correlations.csv).",
    )


def _make_confusion_picture(predictions: pd.DataFrame, task: str, selection: str) -> Picture:
    """Make the figure of the confusion matrices."""
    return Picture(
        name="confusion",
        png=result_figures.draw_confusion_matrices(predictions, task, selection),
        alt=f"Confusion matrices of grades {task} for each scenario and model",
        caption=f"Grades {task}, {SELECTIONS[selection]} selection; test predictions of all splits pooled. "
        "Each cell shows the fraction of the predictions for knees of the true grade, and in brackets the number of "
        "predictions. A knee is counted in each split in which it is a test knee.",
    )


def _make_importance_picture(features: pd.DataFrame, settings: StudySettings, selection: str) -> Picture:
    """Make the figure of the importance of feature families."""
    families = sum_by_family(features[features["selection"] == selection])
    return Picture(
        name="importance",
        png=feature_figures.draw_family_bars(families[[model for model in settings.models if model in families]]),
        alt="Bar chart of the importance of each feature family for each model",
        caption=f"Grade 0 vs 2, trained on {settings.reference.replace('_', ' ')}, {SELECTIONS[selection]} "
        "selection: absolute coefficients of standardised features (logistic regression), impurity "
        "decrease (random forest) or gain (XGBoost), each scaled to a sum of 1 and averaged over the splits.",
    )
