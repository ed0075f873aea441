"""How often the study's intervals hold the truth, over cohorts that are each split, trained and tested anew.

Two grades of Gaussian features a known distance apart, and logistic regression: the AUC and the balanced accuracy of a
linear model on endless subjects are a formula, and so is its mean F1 on tests of the size of a split's, on which that
depends; their mean over fresh training sets of the size of a split's is the truth. (Needs the extra `study`.)
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binom, norm
from sklearn.linear_model import LogisticRegression

from ..core.checks import Array
from ..core.parallel import ordered_map
from ..study.learn.split import split_subjects
from ..study.predictions import ARM
from ..study.statistics.intervals import differences, intervals, share_tested
from ..study.statistics.metrics import percentiles, weighted_scores
from ..study.statistics.scores import score_splits
from ..study.statistics.subjects import draws
from .engines import Row

# Twenty subjects a grade are six tested, the fewest that anything is decided from.
FEWEST = (20, 20)
Counts = tuple[int, int]  # subjects of either grade
_MEASURES = ("auc", "balanced_accuracy", "macro_f1")
_FEATURES, _SPLITS = 5, 20
# Model -> the features that it sees; the JSW's arm stands for a model that knows less.
_SEEN = {"lr": slice(0, _FEATURES), "jsw": slice(0, 2)}
_DISTANCES = (0.0, 1.2, 2.0)
_BOOTSTRAP, _NO_WIDTH = "bootstrap", "no width"
_WORDS = {
    "auc": "AUC",
    "balanced_accuracy": "balanced accuracy",
    "macro_f1": "macro F1",
    "difference of auc": "difference of AUC",
    "difference of balanced_accuracy": "difference of balanced accuracy",
    "difference of macro_f1": "difference of macro F1",
    _BOOTSTRAP: "AUC, by a bootstrap of subjects over the splits",
}


@dataclass(frozen=True)
class Population:
    """Grades `apart` standard deviations apart in the first and the third feature together."""

    apart: float

    def cohort(self, subjects: Counts, rng: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
        """Features (subjects, 5) and grade index (subjects,), the grades evenly in turn."""
        place = np.concatenate([(np.arange(count) + 0.5) / count for count in subjects])
        grade = np.repeat([0, 1], subjects)[np.argsort(place, kind="stable")]
        return rng.normal(size=(len(grade), _FEATURES)) + grade[:, None] * self._step(), grade

    def truth(self, trained: Counts, tested: Counts) -> dict[str, Array]:
        """Model -> mean (_MEASURES) of those that have learnt from so many subjects, on so many others."""
        rng = np.random.default_rng(1)
        of_model: dict[str, list[tuple[float, float, float]]] = {name: [] for name in _SEEN}
        for _ in range(600):
            values, grade = self.cohort(trained, rng)
            for name, seen in _SEEN.items():
                of_model[name].append(self._performance(_fit(values[:, seen], grade), seen, tested))
        return {name: np.mean(values, axis=0) for name, values in of_model.items()}

    def _step(self) -> Array:
        return np.asarray(self.apart / np.sqrt(2) * np.eye(_FEATURES)[[0, 2]].sum(axis=0))

    def _performance(self, model: LogisticRegression, seen: slice, tested: Counts) -> tuple[float, float, float]:
        weight, step = model.coef_[0], self._step()[seen]
        length = np.linalg.norm(weight)
        zero, one = model.intercept_[0] / length, (model.intercept_[0] + weight @ step) / length
        right = float(norm.cdf(-zero)), float(norm.cdf(one))
        return float(norm.cdf((one - zero) / np.sqrt(2))), float(np.mean(right)), mean_f1(right, tested)


def coverage_rows(workers: int, cohorts: int = 200) -> list[Row]:
    """A row a distance between grades and a measure: in what share of the cohorts the 95 % interval holds the truth."""
    rows: list[Row] = []
    for apart in _DISTANCES:
        misses, truth = missed(apart, FEWEST, cohorts, workers), _truth(apart, FEWEST)["lr"][0]
        for measure, count in misses.drop(_NO_WIDTH).items():
            rows.append({
                "true_auc": float(truth), "measure": _WORDS[measure], "cohorts": cohorts, "held": 1 - count / cohorts,
            })  # fmt: skip
    return rows


def missed(apart: float, subjects: Counts, cohorts: int, workers: int = 1) -> pd.Series:
    """How many cohorts have an interval that misses the truth, by measure; how many have one of no width."""
    shared = {"apart": apart, "subjects": subjects, "truth": _truth(apart, subjects)}
    return pd.DataFrame(ordered_map(_one_cohort, range(cohorts), shared=shared, workers=workers)).sum()


def mean_f1(right: tuple[float, float], tested: Counts) -> float:
    """Mean macro F1 of tests of so many subjects of either grade, called right with these probabilities."""
    zeros, ones = np.arange(tested[0] + 1)[:, None], np.arange(tested[1] + 1)[None, :]
    probability = binom.pmf(zeros, tested[0], right[0]) * binom.pmf(ones, tested[1], right[1])
    # 2 right / (true + called), of either grade.
    f1 = zeros / (sum(tested) + zeros - ones) + ones / (sum(tested) + ones - zeros)
    return float((probability * f1).sum())


@cache
def _truth(apart: float, subjects: Counts) -> dict[str, Array]:
    grade = np.repeat([0, 1], subjects)
    split = split_subjects(range(len(grade)), grade.tolist(), seed=0)
    trained, tested = (np.bincount(grade[part], minlength=2).tolist() for part in (split.training, split.test))
    return Population(apart).truth(tuple(trained), tuple(tested))


def _one_cohort(seed: int, apart: float, subjects: Counts, truth: dict[str, Array]) -> dict[str, bool]:
    values, grade = Population(apart).cohort(subjects, np.random.default_rng([5, seed]))
    predictions, listed = _studied(values, grade, seed)
    splits, ratio = score_splits(predictions), share_tested(listed)
    of = intervals(splits, ratio).set_index("model").loc["lr"]
    less = differences(splits, ratio).set_index("metric")
    row = {name: not of[f"{name}_low"] <= truth["lr"][k] <= of[f"{name}_high"] for k, name in enumerate(_MEASURES)}
    for k, name in enumerate(_MEASURES):
        gain = truth["lr"][k] - truth["jsw"][k]
        row[f"difference of {name}"] = not less.loc[name, "low"] <= gain <= less.loc[name, "high"]
    low, high = _bootstrap(predictions, grade, seed)
    row[_BOOTSTRAP] = not low <= truth["lr"][0] <= high
    return row | {_NO_WIDTH: bool(of["auc_low"] == of["auc_high"])}


def _fit(values: Array, grade: NDArray[np.int64]) -> LogisticRegression:
    return LogisticRegression(solver="newton-cholesky").fit(values, grade)


def _studied(values: Array, grade: NDArray[np.int64], seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Predictions of all splits as the study has them, and the subjects of each part."""
    parts, listed = [], []
    for repeat in range(_SPLITS):
        split = split_subjects(range(len(grade)), grade.tolist(), seed=seed, repeat=repeat)
        listed.append(split.table().assign(repeat=repeat))
        for model, seen in _SEEN.items():
            p = _fit(values[split.training, seen], grade[split.training]).predict_proba(values[split.test, seen])
            arm = ("0 vs 2", "within", "reference", "reference", model, "none" if model == "jsw" else "l1")
            table = pd.DataFrame({"subject": split.test, "truth": grade[split.test], "p0": p[:, 0], "p1": p[:, 1]})
            parts.append(table.assign(**dict(zip(ARM, arm, strict=True)), repeat=repeat))
    return pd.concat(parts, ignore_index=True), pd.concat(listed, ignore_index=True)


def _bootstrap(predictions: pd.DataFrame, grade: NDArray[np.int64], seed: int) -> tuple[float, float]:
    """Interval of the AUC by percentiles over samples of the subjects, the splits and their models as they are."""
    weights = draws(pd.Series(grade), replicates=300, seed=seed, stream=0)
    of = [
        weighted_scores(part["truth"].to_numpy(), part[["p0", "p1"]].to_numpy(), weights[part["subject"]])["auc"]
        for _, part in predictions[predictions["model"] == "lr"].groupby("repeat")
    ]
    return percentiles(np.nanmean(of, axis=0)[1:])
