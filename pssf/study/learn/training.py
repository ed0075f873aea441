"""Train and test the models of all splits in parallel."""

from collections.abc import Mapping

import pandas as pd

from ...core.processes.execution import Execution
from ...data.code_hash import require_same_code
from ..design.study_settings import StudySettings
from ..predictions import SplitOutcome
from .each_split import map_splits
from .models.trivial_baselines import find_baseline_columns
from .protocol_scenarios import evaluate_split


def train_all_splits(
    usable: pd.DataFrame, names: list[str], settings: StudySettings, execution: Execution
) -> list[SplitOutcome]:
    """Run `protocol_scenarios.evaluate_split` for every split.

    Parameters
    ----------
    usable : DataFrame
        Radiographs with a located region: radiograph, knee, subject, grade, protocol, features and baseline columns.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    execution : Execution
        Workers, scheduler, timer and progress bar.

    Returns
    -------
    list of SplitOutcome
        Predictions and tables of each split, in order.

    Raises
    ------
    InputError
        A grade has too few subjects, or a worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    table = usable[["radiograph", "knee", "subject", "grade", "protocol", *find_baseline_columns(usable), *names]]
    shared = {"table": table, "names": names, "settings": settings}
    return map_splits(train_split, range(settings.repeats), shared, execution, "training and testing")


def train_split(
    repeat: int, *, table: pd.DataFrame, names: list[str], settings: StudySettings, code: Mapping[str, str]
) -> SplitOutcome:
    """Train and test the models of one split.

    Parameters
    ----------
    repeat : int
        Index of the split, starting at 0.
    table : DataFrame
        Table of radiographs, as for `train_all_splits`.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    code : mapping of str to str
        Code hashes of the process that started the run, keyed by subpackage.

    Returns
    -------
    SplitOutcome
        Predictions and tables of the split.

    Raises
    ------
    InputError
        The code hashes of this process differ from `code`, or a grade has too few subjects.
    """
    require_same_code(code)
    return evaluate_split(repeat, table=table, names=names, settings=settings)
