"""Result of a study: paths of all files and the main tables."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class StudyResult:
    """Paths of all written files and main tables of a study.

    Attributes
    ----------
    report : Path
        Path of ``report.html``.
    pictures : dict of str to Path
        Path of the PNG file of each figure, by the name of the figure.
    tables : dict of str to Path
        Path of the CSV file of each table, by the name of the table.
    models : dict of str to Path
        Path of the skops file of each model trained on all subjects, by the name of the model; see
        `learn.models.model_file`.
    scores : DataFrame
        One row per arm: mean, spread and 95 % interval of AUC, balanced accuracy and macro F1.
    differences : DataFrame
        One row per pair of arms and metric: paired difference, 95 % interval, p, and p after Holm's correction.
    reliability : DataFrame
        One row per feature and set of conditions: ICC(2,1), ICC(3,1), their intervals, variance components.
    localisation : DataFrame
        One row per protocol and grade: errors of the located joint line.
    seconds : dict of str to float
        Wall time of each stage in s, including stages before the study.
    origin : str
        Origin of the results: "this run", or "an earlier run" with the same inputs, whose files were reused.
    """

    report: Path
    pictures: dict[str, Path]
    tables: dict[str, Path]
    models: dict[str, Path]
    scores: "pd.DataFrame"
    differences: "pd.DataFrame"
    reliability: "pd.DataFrame"
    localisation: "pd.DataFrame"
    seconds: dict[str, float]
    origin: str = "this run"
