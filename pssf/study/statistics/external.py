"""How good models are on films that they have learnt nothing from."""

import numpy as np
import pandas as pd

from ..predictions import TASKS
from .metrics import METRICS, percentiles, weighted_scores
from .subjects import draws, worst_grades

# Contrast -> the grades of films that count as without and with osteoarthritis; of each there may be models.
CONTRASTS = {name: classes for name, classes in TASKS.items() if len(classes) == 2}
COLUMNS = [
    *("films_of", "learnt", "model", "selection", "films", "subjects", "without", "with"),
    *(f"{metric}{end}" for metric in METRICS for end in ("", "_low", "_high")),
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
    worst = worst_grades(of["subject"], of["grade"])
    weights = draws(worst, replicates=replicates, seed=seed, stream=_STREAM)
    p = of["p"].to_numpy(np.float64)
    values = weighted_scores(truth, np.stack([1 - p, p], axis=1), weights[worst.index.get_indexer(of["subject"])])
    enough = all(of["subject"][truth == side].nunique() >= _LEAST_SUBJECTS for side in (0, 1))
    row = dict[str, float]()
    for metric in METRICS:
        low, high = percentiles(values[metric][1:]) if enough else (np.nan, np.nan)
        row |= {metric: float(values[metric][0]), f"{metric}_low": low, f"{metric}_high": high}
    return row


def counted(films: pd.DataFrame) -> pd.DataFrame:
    """grade ("unknown" where it is not), films, found, and a column a reason of refusal; the last row is of all.

    films  one row a film: grade, status
    """
    grades = films["grade"].map(lambda grade: "unknown" if pd.isna(grade) else str(int(grade)))
    reasons = sorted(set(films["status"]) - {"found"})
    rows = []
    for name in [*sorted(set(grades)), "all"]:
        status = films["status"] if name == "all" else films["status"][grades == name]
        row = {"grade": name, "films": len(status), "found": int((status == "found").sum())}
        rows.append(row | {reason: int((status == reason).sum()) for reason in reasons})
    return pd.DataFrame(rows)
