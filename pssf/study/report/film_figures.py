"""Pictures of films of patients: what the models say of each grade."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ..external import External
from ..settings import MODELS, SELECTIONS, StudySettings
from .figures import COLOURS, png
from .page import Picture


def film_pictures(external: External, settings: StudySettings) -> dict[str, Picture]:
    """Name -> picture: probability of grade 2 by the films' grade, for the first selection; none without grades.

    external  of `external.tested_on_films`
    """
    films, selection = external.tables["films"], settings.selections[0]
    graded = films[films["grade"].notna() & (films["status"] == "found")]
    columns = {model: f"{model}_{selection}_0v2_films grade 2" for model in settings.models}
    if graded.empty or not set(columns.values()) <= set(films.columns):
        return {}
    return {
        "films": Picture(
            name="films",
            png=_by_grade(graded, columns),
            alt="Probability of grade 2 of every film by its grade, a panel a model, with the median of each grade",
            caption=f"Films of patients: probability of KL-like grade 2 by the reader’s grade, {SELECTIONS[selection]} "
            "selection; the bar is the median.",
        )
    }


def _by_grade(graded: pd.DataFrame, columns: dict[str, str]) -> bytes:
    figure = Figure(figsize=(3.4 * len(columns), 3.2), layout="constrained")
    axes = figure.subplots(1, len(columns), squeeze=False, sharey=True)[0]
    for axis, (model, column) in zip(axes, columns.items(), strict=True):
        for grade, values in graded.groupby("grade")[column]:
            # Spread by rank, so that the same films give the same picture.
            across = (np.argsort(np.argsort(values.to_numpy(), kind="stable")) * 0.618) % 1.0 - 0.5
            axis.plot(grade + 0.5 * across, values, ".", color=COLOURS[model], alpha=0.5, markersize=5)
            axis.hlines(values.median(), grade - 0.32, grade + 0.32, color="black", linewidth=1.6)
        axis.set_title(MODELS[model], fontsize=11)
        axis.set_xticks(sorted({int(grade) for grade in graded["grade"]}))
        axis.set_xlabel("KL grade of the film")
        axis.set_ylim(-0.02, 1.02)
    axes[0].set_ylabel("probability of grade 2")
    return png(figure)
