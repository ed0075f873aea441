"""Predictions of a model for the same test knees at every step of a protocol parameter."""

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

# Key of the random stream below a repeat; `incremental_value` uses another key.
_SPLIT_STREAM = 3
# Fraction of the subjects outside the test part that validate.
_VALIDATION_FRACTION = 0.15
# Probabilities are clipped to this distance from 0 and 1, so that their log odds are finite.
_MIN_PROBABILITY = 1e-6
_COLUMNS = ["repeat", "axis", "turn", "trained", "curved", *TEST_COUNT_COLUMNS, "auc", "auc_own", "shift"]


@dataclass(frozen=True)
class ResponseSplit:
    """Subjects of one split for response curves; no subject is in two parts.

    Attributes
    ----------
    training : list
        Subjects that models are fitted to.
    validation : list
        Subjects that choose the hyperparameters.
    test : list
        Subjects with response curves that are tested.
    """

    training: list[Any]
    validation: list[Any]
    test: list[Any]


def split_curve_subjects(base: pd.DataFrame, curve_subjects: list[Any], seed: int, repeat: int) -> ResponseSplit:
    """Split the subjects for response curves.

    Half of the subjects with response curves are tested. Of all other subjects, 15 % validate and the rest train.

    Parameters
    ----------
    base : DataFrame
        One row per radiograph: subject and grade.
    curve_subjects : list
        Subjects with response curves.
    seed : int
        Seed of the study.
    repeat : int
        Number of the split.

    Returns
    -------
    ResponseSplit
        Subjects of the three parts, sorted.
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
    """Evaluate a model of the reference protocol at every step, split by split.

    The task is the contrast of the grades of the steps. The model is the first classifier with the first selection of
    the settings, whatever its results.

    Parameters
    ----------
    base : DataFrame
        Radiographs of the cohort under the reference protocol, with a located region: knee, subject, grade, features.
    steps : DataFrame
        Radiographs along the axes, with a located region: knee, subject, grade, kind (axis), turn, features.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    execution : Execution
        Workers, scheduler, timer and progress bar.

    Returns
    -------
    DataFrame
        One row per split and step. Columns: repeat, axis, turn, trained, curved (subjects with curves, of whom half are
        tested), `TEST_COUNT_COLUMNS`, auc, auc_own (same knees in the cohort) and shift. The shift is the mean change
        of the log odds of the more severe class; a threshold would have to move by it.

    Raises
    ------
    InputError
        A worker runs other code.
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
    """Evaluate the model of one split at every step.

    Parameters
    ----------
    repeat : int
        Number of the split.
    base : DataFrame
        Radiographs of the cohort, as for `evaluate_response_curves`.
    steps : DataFrame
        Radiographs along the axes, as for `evaluate_response_curves`.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    classes : tuple of tuple of int
        Grades of the two classes.
    code : dict of str to str
        Hashes of the code where the run started.

    Returns
    -------
    list of dict
        Rows of `evaluate_response_curves`; empty if a class is missing in training.

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
        """Compute the log odds of the more severe class, indexed by knee."""
        p = fitted.pipeline.predict_proba(part[names])[:, 1].astype(np.float64)
        return pd.Series(logit(np.clip(p, _MIN_PROBABILITY, 1 - _MIN_PROBABILITY)), index=part["knee"].to_numpy())

    own = odds(test)
    rows = []
    for (axis, turn), part in steps[steps["knee"].isin(own.index)].groupby(["kind", "turn"], sort=False):
        here, positive = odds(part), part["grade"].isin(classes[1]).to_numpy()
        before = own.loc[here.index]
        row = {"repeat": repeat, "axis": axis, "turn": int(turn), "trained": len(halves.training)}
        row |= {"curved": len(curved), "shift": float((here - before).mean())}
        row |= count_test_subjects(part["subject"], positive, (False, True))
        scores = {"auc": auc(positive, here.to_numpy()), "auc_own": auc(positive, before.to_numpy())}
        rows.append(row | scores)
    return rows
