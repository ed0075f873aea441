"""How good models are on films that they have learnt nothing from."""

import numpy as np
import pandas as pd

from ...core.checks import Array
from ..predictions import class_of
from ..tasks import GRADED, TASKS, Classes
from .metrics import METRICS, percentiles, weighted_kappa, weighted_scores
from .subjects import draws, worst_grades

# Contrast -> the grades of films that count as without and with osteoarthritis; of each there may be models.
CONTRASTS = {name: classes for name, classes in TASKS.items() if len(classes) == 2}
KAPPA = "kappa"
COLUMNS = [
    *("films_of", "learnt", "model", "selection", "films", "subjects", "without", "with"),
    *(f"{metric}{end}" for metric in METRICS for end in ("", "_low", "_high")),
]
GRADED_COLUMNS = [
    *("learnt", "model", "selection", "films", "subjects"),
    *(f"{metric}{end}" for metric in (KAPPA, *METRICS) for end in ("", "_low", "_high")),
]
_STREAM = 2**31 + 1
# A bootstrap of one subject always draws the same.
_LEAST_SUBJECTS = 2


def score_films(predictions: pd.DataFrame, *, replicates: int, seed: int) -> pd.DataFrame:
    """One row a contrast, task, model and selection: COLUMNS; for contrasts of which the films have both sides.

    95 % intervals by a bootstrap of the films' subjects within their grade, each with all its films; the models stay
    as they were fitted. NaN where a side has fewer than two subjects.

    predictions  of models of grade 0 against others: task, model, selection, subject (text), grade, p (of the others);
                 one row a film that a region was found in and whose grade is known
    """
    rows = []
    for contrast, (without, with_) in CONTRASTS.items():
        part = predictions[predictions["grade"].isin((*without, *with_))]
        for (task, model, selection), of in part.groupby(["task", "model", "selection"], sort=False):
            truth = of["grade"].isin(with_).to_numpy(np.int64)
            if len(set(truth)) == 2:
                label = {"films_of": contrast, "learnt": task, "model": model, "selection": selection}
                rows.append(label | _counts(of, truth) | _scores(of, truth, replicates, seed))
    return pd.DataFrame(rows, columns=COLUMNS)


def _counts(of: pd.DataFrame, truth: np.ndarray) -> dict[str, int]:
    counts = {"films": len(of), "subjects": of["subject"].nunique()}
    return counts | {"without": int((truth == 0).sum()), "with": int(truth.sum())}


def _scores(of: pd.DataFrame, truth: np.ndarray, replicates: int, seed: int) -> dict[str, float]:
    p = of["p"].to_numpy(np.float64)
    values = weighted_scores(truth, np.stack([1 - p, p], axis=1), _weights(of, replicates, seed))
    enough = all(of["subject"][truth == side].nunique() >= _LEAST_SUBJECTS for side in (0, 1))
    return _with_intervals(values, dict.fromkeys(METRICS, enough))


def score_grades(predictions: pd.DataFrame, *, replicates: int, seed: int) -> pd.DataFrame:
    """One row a task of GRADED, model and selection: GRADED_COLUMNS; quadratic kappa first.

    Of films whose grade is one of the task's. 95 % intervals as `score_films` has them: of kappa with two grades or
    more, of the others, which are means over all classes, with all; NaN where a grade has fewer than two subjects.

    predictions  task, model, selection, subject (text), grade, p0, p1 and so on: one row a film
    """
    rows = []
    for (task, model, selection), every in predictions.groupby(["task", "model", "selection"], sort=False):
        classes = GRADED[task]
        of = every[every["grade"].isin(sum(classes, ()))]
        if of["grade"].nunique() > 1:
            label = {"learnt": task, "model": model, "selection": selection}
            counts = {"films": len(of), "subjects": of["subject"].nunique()}
            rows.append(label | counts | _graded(of, classes, replicates, seed))
    return pd.DataFrame(rows, columns=GRADED_COLUMNS)


def _graded(of: pd.DataFrame, classes: Classes, replicates: int, seed: int) -> dict[str, float]:
    truth = class_of(of["grade"].to_numpy(np.int64), classes)
    probability = of[[f"p{place}" for place in range(len(classes))]].to_numpy(np.float64)
    weights = _weights(of, replicates, seed)
    values = {KAPPA: weighted_kappa(truth, probability, weights)} | weighted_scores(truth, probability, weights)
    subjects = of["subject"].groupby(truth).nunique()
    enough = bool((subjects >= _LEAST_SUBJECTS).all())
    all_there = enough and len(subjects) == len(classes)
    return _with_intervals(values, {KAPPA: enough} | dict.fromkeys(METRICS, all_there))


def _weights(of: pd.DataFrame, replicates: int, seed: int) -> Array:
    """(films, 1 + replicates)  how often each film is in a sample of the subjects"""
    worst = worst_grades(of["subject"], of["grade"])
    weights = draws(worst, replicates=replicates, seed=seed, stream=_STREAM)
    return np.asarray(weights[worst.index.get_indexer(of["subject"])])


def _with_intervals(values: dict[str, Array], enough: dict[str, bool]) -> dict[str, float]:
    """Each metric of all films, and its percentiles where there are enough subjects."""
    row = dict[str, float]()
    for metric, of_samples in values.items():
        low, high = percentiles(of_samples[1:]) if enough[metric] else (np.nan, np.nan)
        row |= {metric: float(of_samples[0]), f"{metric}_low": low, f"{metric}_high": high}
    return row


def counted(films: pd.DataFrame) -> pd.DataFrame:
    """grade ("unknown" where it is not), films, found, and a column a reason of refusal; the last row is of all.

    Where films show two knees, of which one is read, a last column counts them.

    films  one row a film: grade, status; film_knees, if it is known
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
