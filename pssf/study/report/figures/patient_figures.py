"""Figures of the test on patient radiographs."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ...design.study_settings import MODELS, SELECTIONS, StudySettings
from ...prediction.patient_test import FilmTestResult
from ..report_elements import Picture
from .result_figures import MODEL_COLOURS, encode_png


def make_film_pictures(external: FilmTestResult, settings: StudySettings) -> dict[str, Picture]:
    """Draw the predicted probability of grade 2 per KL grade of the patient radiographs.

    Parameters
    ----------
    external : FilmTestResult
        Results from `patient_test.evaluate_on_films`.
    settings : StudySettings
        Settings of the study; the figure shows the first feature selection in the settings.

    Returns
    -------
    dict of str to Picture
        Figure by name; empty if no radiograph with a located joint has a grade.
    """
    films, selection = external.tables["films"], settings.selections[0]
    graded = films[films["grade"].notna() & (films["status"] == "found")]
    columns = {model: f"{model}_{selection}_0v2_films grade 2" for model in settings.models}
    if graded.empty or not set(columns.values()) <= set(films.columns):
        return {}
    return {
        "films": Picture(
            name="films",
            png=_draw_by_grade(graded, columns),
            alt="Predicted probability of grade 2 of each patient radiograph, grouped by KL grade, one panel per model",
            caption="Predicted probability of KL-like grade 2 for each patient radiograph, grouped by the KL grade "
            f"that the reader assigned; {SELECTIONS[selection]} selection. Bar: median.",
        )
    }


def _draw_by_grade(graded: pd.DataFrame, columns: dict[str, str]) -> bytes:
    """Draw predicted probabilities and their medians per grade, one panel per model."""
    figure = Figure(figsize=(3.4 * len(columns), 3.2), layout="constrained")
    axes = figure.subplots(1, len(columns), squeeze=False, sharey=True)[0]
    for axis, (model, column) in zip(axes, columns.items(), strict=True):
        for grade, values in graded.groupby("grade")[column]:
            # The horizontal offset depends on rank, not on random numbers, so the figure is reproducible.
            across = (np.argsort(np.argsort(values.to_numpy(), kind="stable")) * 0.618) % 1.0 - 0.5
            axis.plot(grade + 0.5 * across, values, ".", color=MODEL_COLOURS[model], alpha=0.5, markersize=5)
            axis.hlines(values.median(), grade - 0.32, grade + 0.32, color="black", linewidth=1.6)
        axis.set_title(MODELS[model], fontsize=11)
        axis.set_xticks(sorted({int(grade) for grade in graded["grade"]}))
        axis.set_xlabel("KL grade assigned by the reader")
        axis.set_ylim(-0.02, 1.02)
    axes[0].set_ylabel("predicted probability of grade 2")
    return encode_png(figure)
