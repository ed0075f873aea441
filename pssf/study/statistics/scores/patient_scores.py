"""Scores of models on patient radiographs that were not used in training."""

import numpy as np
import pandas as pd

from ....core.checks import Array
from ...design.classification_tasks import MULTICLASS_TASKS, TASKS, Classes
from ...predictions import find_class_indices
from .metrics import (
    METRICS,
    percentile_interval,
    weighted_kappa,
    weighted_scores,
)
from .subject_resampling import sample_row_counts

# Two-class tasks: name -> grades of patient radiographs without and with osteoarthritis.
CONTRASTS = {name: classes for name, classes in TASKS.items() if len(classes) == 2}
# Name of Cohen's kappa in tables.
KAPPA = "kappa"
COLUMNS = [
    *("contrast", "task", "model", "selection", "radiographs", "subjects", "negatives", "positives"),
    *(f"{metric}{end}" for metric in METRICS for end in ("", "_low", "_high")),
]
GRADED_COLUMNS = [
    *("task", "model", "selection", "radiographs", "subjects"),
    *(f"{metric}{end}" for metric in (KAPPA, *METRICS) for end in ("", "_low", "_high")),
]
# Key of the bootstrap random stream, combined with the seed of the study.
_STREAM = 2**31 + 1
# Smallest number of subjects per class for an interval; all bootstrap samples of a single subject are the same.
_LEAST_SUBJECTS = 2


def score_films(predictions: pd.DataFrame, *, replicates: int, seed: int) -> pd.DataFrame:
    """Score two-class models on patient radiographs.

    The 95 % intervals are computed from a bootstrap of subjects, with all their radiographs, within each grade. The
    models are not refitted. An interval is NaN if a class has fewer than two subjects.

    Parameters
    ----------
    predictions : DataFrame
        Predictions of two-class models, one row per radiograph with a located joint and a known grade: task, model,
        selection, subject (text), grade, p (probability of the class with osteoarthritis).
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    DataFrame
        One row per contrast, task, model and selection, with the columns `COLUMNS`. A contrast is omitted
        if all radiographs belong to the same class.
    """
    rows = []
    for contrast, (without, with_) in CONTRASTS.items():
        part = predictions[predictions["grade"].isin((*without, *with_))]
        for (task, model, selection), of in part.groupby(["task", "model", "selection"], sort=False):
            truth = of["grade"].isin(with_).to_numpy(np.int64)
            if len(set(truth)) == 2:
                label = {"contrast": contrast, "task": task, "model": model, "selection": selection}
                rows.append(label | _count_sides(of, truth) | _score_contrast(of, truth, replicates, seed))
    return pd.DataFrame(rows, columns=COLUMNS)


def _count_sides(predictions: pd.DataFrame, truth: np.ndarray) -> dict[str, int]:
    """Count radiographs and subjects, and the radiographs without and with osteoarthritis."""
    counts = {"radiographs": len(predictions), "subjects": predictions["subject"].nunique()}
    return counts | {"negatives": int((truth == 0).sum()), "positives": int(truth.sum())}


def _score_contrast(predictions: pd.DataFrame, truth: np.ndarray, replicates: int, seed: int) -> dict[str, float]:
    """Compute all metrics and intervals of one model for one contrast."""
    p = predictions["p"].to_numpy(np.float64)
    values = weighted_scores(
        truth,
        np.stack([1 - p, p], axis=1),
        sample_row_counts(predictions, replicates=replicates, seed=seed, stream=_STREAM),
    )
    enough = all(predictions["subject"][truth == side].nunique() >= _LEAST_SUBJECTS for side in (0, 1))
    return _make_interval_row(values, dict.fromkeys(METRICS, enough))


def score_grades(predictions: pd.DataFrame, *, replicates: int, seed: int) -> pd.DataFrame:
    """Score multiclass models on patient radiographs by quadratic kappa and the other metrics.

    Only radiographs with a grade of the task are scored. The 95 % intervals are computed as in `score_films`. The
    interval of kappa needs at least two grades. The other metrics are means over all classes, so their intervals need
    all grades.
    An interval is NaN if a grade has fewer than two subjects.

    Parameters
    ----------
    predictions : DataFrame
        One row per radiograph: task, model, selection, subject (text), grade, p0, p1 and so on.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    DataFrame
        One row per task in `MULTICLASS_TASKS`, model and selection, with the columns `GRADED_COLUMNS`.
    """
    rows = []
    for (task, model, selection), every in predictions.groupby(["task", "model", "selection"], sort=False):
        classes = MULTICLASS_TASKS[task]
        of = every[every["grade"].isin(sum(classes, ()))]
        if of["grade"].nunique() > 1:
            label = {"task": task, "model": model, "selection": selection}
            counts = {"radiographs": len(of), "subjects": of["subject"].nunique()}
            rows.append(label | counts | _score_multiclass(of, classes, replicates, seed))
    return pd.DataFrame(rows, columns=GRADED_COLUMNS)


def _score_multiclass(predictions: pd.DataFrame, classes: Classes, replicates: int, seed: int) -> dict[str, float]:
    """Compute all metrics and intervals of one multiclass model."""
    truth = find_class_indices(predictions["grade"].to_numpy(np.int64), classes)
    probability = predictions[[f"p{place}" for place in range(len(classes))]].to_numpy(np.float64)
    weights = sample_row_counts(predictions, replicates=replicates, seed=seed, stream=_STREAM)
    values = {KAPPA: weighted_kappa(truth, probability, weights)} | weighted_scores(truth, probability, weights)
    subjects = predictions["subject"].groupby(truth).nunique()
    enough = bool((subjects >= _LEAST_SUBJECTS).all())
    all_there = enough and len(subjects) == len(classes)
    return _make_interval_row(values, {KAPPA: enough} | dict.fromkeys(METRICS, all_there))


def _make_interval_row(values: dict[str, Array], enough: dict[str, bool]) -> dict[str, float]:
    """Make the table columns of all metrics from metric values on all radiographs and on the bootstrap samples.

    The interval of a metric is NaN if `enough` is False for the metric.
    """
    row = dict[str, float]()
    for metric, of_samples in values.items():
        low, high = percentile_interval(of_samples[1:]) if enough[metric] else (np.nan, np.nan)
        row |= {metric: float(of_samples[0]), f"{metric}_low": low, f"{metric}_high": high}
    return row


def count_films_by_grade(films: pd.DataFrame) -> pd.DataFrame:
    """Count patient radiographs by grade and status.

    Parameters
    ----------
    films : DataFrame
        One row per radiograph: grade, status, and film_knees if known.

    Returns
    -------
    DataFrame
        Columns: grade ("unknown" without a grade), films, found, and one column per other status. If some radiographs
        show two knees, the last column counts these radiographs; only one knee per radiograph is used. The last row is
        the total.
    """
    grades = films["grade"].map(lambda grade: "unknown" if pd.isna(grade) else str(int(grade)))
    reasons = sorted(set(films["status"]) - {"found"})
    is_pair = films["film_knees"] == "two" if "film_knees" in films else pd.Series(False, index=films.index)
    rows = []
    for name in [*sorted(set(grades)), "all"]:
        status = films["status"] if name == "all" else films["status"][grades == name]
        row = {"grade": name, "films": len(status), "found": int((status == "found").sum())}
        rows.append(row | {reason: int((status == reason).sum()) for reason in reasons})
        if is_pair.any():
            rows[-1]["two knees, one read"] = int(is_pair[status.index].sum())
    return pd.DataFrame(rows)
