"""Model performance on the same test knees at every step of a protocol parameter."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logit

from ...core.processes.execution import Execution
from ...data.code_hash import require_same_code
from ..design.classification_tasks import TASKS, Classes, select_contrast
from ..design.study_settings import StudySettings
from ..predictions import find_class_indices
from ..statistics.scores.metrics import auc
from ..statistics.scores.subject_resampling import worst_grades
from ..statistics.scores.tested_subjects import TEST_COUNT_COLUMNS, count_test_subjects
from .each_split import map_splits
from .models.classifiers import tune_classifier
from .models.feature_selection import build_feature_pipeline
from .subject_split import derive_split_seed

# Second key of the random stream, after the split index; `incremental_value` uses another key.
_SPLIT_STREAM = 3
# Fraction of the subjects outside the test set that is used for validation.
_VALIDATION_FRACTION = 0.15
# Minimum distance of a probability from 0 and 1, dimensionless; it keeps the log odds finite.
_MIN_PROBABILITY = 1e-6
_COLUMNS = [
    "repeat",
    "axis",
    "step_index",
    "training_subjects",
    "curved",
    *TEST_COUNT_COLUMNS,
    "auc",
    "auc_own",
    "shift",
]


@dataclass(frozen=True)
class ResponseSplit:
    """Training, validation and test subjects of one split for response curves.

    Attributes
    ----------
    training : list
        Subjects for fitting models.
    validation : list
        Subjects for selecting hyperparameters.
    test : list
        Test subjects, all of which have response curves.
    """

    training: list[Any]
    validation: list[Any]
    test: list[Any]


def split_curve_subjects(base: pd.DataFrame, curve_subjects: list[Any], seed: int, repeat: int) -> ResponseSplit:
    """Split the subjects for response curves.

    Half of the subjects with response curves are test subjects. Of all other subjects, 15 % are used for validation and
    85 % for training.

    Parameters
    ----------
    base : DataFrame
        One row per radiograph: subject and grade.
    curve_subjects : list
        Subjects with response curves.
    seed : int
        Seed of the study.
    repeat : int
        Index of the split, starting at 0.

    Returns
    -------
    ResponseSplit
        Training, validation and test subjects, each sorted.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(repeat, _SPLIT_STREAM)))
    worst = worst_grades(base["subject"], base["grade"])
    parts: dict[str, list[Any]] = {"training": [], "validation": [], "test": []}
    for grade in sorted(set(worst)):
        members = worst.index[worst == grade]
        shuffled = rng.permutation([one for one in members if one in set(curve_subjects)]).tolist()
        parts["test"] += shuffled[: len(shuffled) // 2]
        others = rng.permutation([one for one in members if one not in set(parts["test"])]).tolist()
        held = max(1, round(_VALIDATION_FRACTION * len(others)))
        parts["validation"] += others[:held]
        parts["training"] += others[held:]
    return ResponseSplit(**{name: sorted(subjects) for name, subjects in parts.items()})


def evaluate_response_curves(
    base: pd.DataFrame, steps: pd.DataFrame, names: list[str], settings: StudySettings, execution: Execution
) -> pd.DataFrame:
    """Evaluate a model trained on the reference protocol at every step of every axis, for each split.

    The function `select_contrast` selects the task for the grades in `steps`. The model is the first classifier with
    the first feature selection in the settings.

    Parameters
    ----------
    base : DataFrame
        Cohort radiographs under the reference protocol, with a located region: knee, subject, grade, features.
    steps : DataFrame
        Radiographs at the steps of all axes, with a located region: knee, subject, grade, kind (axis), repeat_index,
        features.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    execution : Execution
        Workers, scheduler, timer and progress bar.

    Returns
    -------
    DataFrame
        One row per split and step. Columns: repeat, axis, step_index, training_subjects, curved (number of subjects
        with response curves), `TEST_COUNT_COLUMNS`, auc, auc_own (AUC of the same knees in the cohort) and shift. The
        shift is the mean change in the log odds of the more severe class, relative to the cohort radiographs.

    Raises
    ------
    InputError
        A worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    classes = TASKS[select_contrast(steps["grade"])]
    base, steps = (table[table["grade"].isin(sum(classes, ()))] for table in (base, steps))
    shared = {"base": base, "steps": steps, "names": names, "settings": settings, "classes": classes}
    tables = map_splits(evaluate_response_split, range(settings.repeats), shared, execution, "model response curves")
    return pd.DataFrame([row for rows in tables for row in rows], columns=_COLUMNS)


def evaluate_response_split(
    repeat: int,
    *,
    base: pd.DataFrame,
    steps: pd.DataFrame,
    names: list[str],
    settings: StudySettings,
    classes: Classes,
    code: dict[str, str],
) -> list[dict[str, Any]]:
    """Train the model on one split and evaluate it at every step of every axis.

    Parameters
    ----------
    repeat : int
        Index of the split, starting at 0.
    base : DataFrame
        Cohort radiographs, as for `evaluate_response_curves`.
    steps : DataFrame
        Radiographs at the steps of all axes, as for `evaluate_response_curves`.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    classes : tuple of tuple of int
        Grades in each of the two classes.
    code : dict of str to str
        Code hashes of the process that started the run, keyed by subpackage.

    Returns
    -------
    list of dict
        Rows of the table that `evaluate_response_curves` returns; empty if the training set lacks a class.

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    curved = sorted(set(steps["subject"]) & set(base["subject"]))
    halves = split_curve_subjects(base, curved, settings.seed, repeat)
    seed = derive_split_seed(settings.seed, repeat)
    training, validation, test = (
        base[base["subject"].isin(of)] for of in (halves.training, halves.validation, halves.test)
    )
    fit_on, check_on = (
        (part[names], find_class_indices(part["grade"].to_numpy(), classes)) for part in (training, validation)
    )
    if len(set(fit_on[1])) < len(classes):
        return []
    prepared = build_feature_pipeline(
        settings.selections[0], rho=settings.rho, max_features=settings.most_features, seed=seed
    )
    fitted = tune_classifier(prepared.fit(*fit_on), settings.models[0], fit_on, check_on, seed=seed)

    def odds(part: pd.DataFrame) -> pd.Series:
        """Compute the log odds of the more severe class for each knee."""
        p = fitted.pipeline.predict_proba(part[names])[:, 1].astype(np.float64)
        return pd.Series(logit(np.clip(p, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY)), index=part["knee"].to_numpy())

    own = odds(test)
    rows = []
    for (axis, step_index), part in steps[steps["knee"].isin(own.index)].groupby(["kind", "repeat_index"], sort=False):
        here, positive = odds(part), part["grade"].isin(classes[1]).to_numpy()
        before = own.loc[here.index]
        row = {"repeat": repeat, "axis": axis, "step_index": int(step_index), "training_subjects": len(halves.training)}
        row |= {"curved": len(curved), "shift": float((here - before).mean())}
        row |= count_test_subjects(part["subject"], positive, (False, True))
        scores = {"auc": auc(positive, here.to_numpy()), "auc_own": auc(positive, before.to_numpy())}
        rows.append(row | scores)
    return rows
