"""Result of a study: paths of all output files, and the main tables."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class StudyResult:
    """Paths of all output files and main tables of a study.

    Attributes
    ----------
    report : Path
        Path of ``report.html``.
    pictures : dict of str to Path
        Path of each figure (PNG file), keyed by figure name.
    tables : dict of str to Path
        Path of each table (CSV file), keyed by table name.
    models : dict of str to Path
        Path of each model trained on all subjects (skops file), keyed by model name; see `learn.models.model_file`.
    scores : DataFrame
        One row per combination of task, scenario and model: mean, spread and 95 % interval of AUC, balanced accuracy
        and macro F1.
    differences : DataFrame
        One row per metric and pair of model combinations: paired difference, 95 % interval, p, and p after Holm's
        correction.
    reliability : DataFrame
        One row per feature and set of conditions: ICC(2,1), ICC(3,1), intervals of both ICCs, variance components.
    localisation : DataFrame
        One row per protocol and grade: errors of the located joint line.
    seconds : dict of str to float
        Wall time of each stage in s, including stages before the study, such as simulation.
    origin : str
        Origin of the results: "this run", or "an earlier run" if the files of a run with the same inputs were reused.
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
