"""What a study ends with."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class StudyResult:
    """Where everything is, and the tables that the report was made from.

    pictures      name -> PNG
    tables        name -> CSV
    models        name -> skops file of a model that has learnt from all subjects; see `learn.modelfile`
    scores        one row an arm: mean, spread and interval of AUC, balanced accuracy, macro F1
    differences   one row a pair of arms and metric: paired difference, interval, p, p after Holm
    reliability   one row a feature and set of conditions: ICC(2,1), ICC(3,1), intervals, shares of variance
    localisation  one row a protocol and grade
    seconds       wall time of each stage, those before the study included
    origin        this run, or an earlier run: nothing had changed since
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
