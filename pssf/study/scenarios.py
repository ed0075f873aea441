"""Within, cross and multi protocol: train and test on held-out subjects, many times over."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from . import StudySettings
from .metrics import METRICS, score
from .models import tune
from .selection import preparation
from .split import split_subjects

TASKS = {"0 vs 2": (0, 2), "0/1/2": (0, 1, 2)}
ARM = ["task", "scenario", "trained_on", "tested_on", "model", "selection"]
Part = tuple[pd.DataFrame, NDArray[np.int64]]


@dataclass(frozen=True)
class Outcome:
    """Of one split.

    predictions  ARM, repeat, radiograph, knee, subject, protocol, truth (class index), p0, p1[, p2]
    importances  ARM without `tested_on`, repeat, feature, share
    """

    predictions: pd.DataFrame
    importances: pd.DataFrame


def one_split(repeat: int, *, table: pd.DataFrame, names: list[str], settings: StudySettings) -> Outcome:
    """All tasks, scenarios, selections and models on one split of the subjects.

    table  one row a radiograph: radiograph, knee, subject, grade, protocol, and the features of `names`
    """
    split = split_subjects(table["subject"], table["grade"], seed=settings.seed, repeat=repeat)
    predictions: list[pd.DataFrame] = []
    importances: list[dict[str, Any]] = []
    for task, grades in TASKS.items():
        rows = table[table["grade"].isin(grades)]
        if set(rows["grade"]) != set(grades):
            continue
        training, validation, test = (
            rows[rows["subject"].isin(subjects)] for subjects in (split.training, split.validation, split.test)
        )
        for trained_on, tests in _plan(table, settings.reference).items():
            train, check = (_of(part, trained_on) for part in (training, validation))
            seed = int(np.random.SeedSequence(settings.seed, spawn_key=(repeat, 1)).generate_state(1)[0] >> 1)
            for selection in settings.selections:
                fit_on, check_on = _part(train, names, grades), _part(check, names, grades)
                if set(fit_on[1]) != set(range(len(grades))):
                    continue  # all regions of a grade were refused under this protocol
                prepared = preparation(selection, rho=settings.rho, most=settings.most_features, seed=seed)
                prepared.fit(*fit_on)
                for model in settings.models:
                    arm = {"task": task, "trained_on": trained_on, "model": model, "selection": selection}
                    fitted = tune(prepared, model, fit_on, check_on, seed=seed)
                    found = _predict(fitted.pipeline, test, names, grades)
                    for tested_on, scenario in tests.items():
                        labels = {**arm, "scenario": scenario, "tested_on": tested_on, "repeat": repeat}
                        predictions.append(_of(found, tested_on).assign(**labels))
                    for feature, share in fitted.importance.items():
                        importances.append({**arm, "repeat": repeat, "feature": feature, "share": share})
    found = pd.concat(predictions, ignore_index=True) if predictions else pd.DataFrame()
    return Outcome(found, pd.DataFrame(importances))


def score_splits(predictions: pd.DataFrame) -> pd.DataFrame:
    """ARM, repeat, the METRICS, and the subjects and radiographs tested: one row a split."""
    rows = []
    for key, part in predictions.groupby([*ARM, "repeat"], sort=False):
        counts = {"test_subjects": part["subject"].nunique(), "test_radiographs": len(part)}
        rows.append(dict(zip([*ARM, "repeat"], key, strict=True)) | score(*truth_and_probability(part)) | counts)
    return pd.DataFrame(rows)


def summarise(scores: pd.DataFrame) -> pd.DataFrame:
    """One row an arm: mean and standard deviation of each metric over the splits that gave it, and how many did."""
    rows = []
    for key, part in scores.groupby(ARM, sort=False):
        row = dict(zip(ARM, key, strict=True)) | {"splits": int(part["auc"].notna().sum())}
        for metric in METRICS:
            spread = part[metric].std(ddof=1) if part[metric].notna().sum() > 1 else float("nan")
            row |= {metric: part[metric].mean(), f"{metric}_sd": spread}
        counts = {name: int(part[name].median()) for name in ("test_subjects", "test_radiographs")}
        rows.append(row | counts)
    return pd.DataFrame(rows)


def truth_and_probability(predictions: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(rows,) class index and (rows, classes) probability of predictions of one task."""
    columns = [f"p{k}" for k in range(len(TASKS[predictions["task"].iloc[0]]))]
    return predictions["truth"].to_numpy(np.int64), predictions[columns].to_numpy(np.float64)


def protocols_of(table: pd.DataFrame, reference: str) -> list[str]:
    """The protocols of a table: the reference first, then as they come."""
    return sorted(table["protocol"].unique(), key=lambda name: name != reference)


def _plan(table: pd.DataFrame, reference: str) -> dict[str, dict[str, str]]:
    """Protocol trained on -> protocol tested on -> scenario."""
    others = protocols_of(table, reference)[1:]
    plan = {reference: {reference: "within", **dict.fromkeys(others, "cross")}}
    if others:
        plan["all"] = dict.fromkeys(["all", reference, *others], "multi")
    return plan


def _of(table: pd.DataFrame, protocol: str) -> pd.DataFrame:
    return table if protocol == "all" else table[table["protocol"] == protocol]


def _part(table: pd.DataFrame, names: list[str], grades: tuple[int, ...]) -> Part:
    return table[names], np.searchsorted(grades, table["grade"].to_numpy())


def _predict(pipeline: Any, table: pd.DataFrame, names: list[str], grades: tuple[int, ...]) -> pd.DataFrame:
    features, truth = _part(table, names, grades)
    probability = pipeline.predict_proba(features) if len(table) else np.empty((0, len(grades)))
    found = table[["radiograph", "knee", "subject", "protocol"]].assign(truth=truth)
    return found.assign(**{f"p{k}": probability[:, k].astype(np.float64) for k in range(len(grades))})
