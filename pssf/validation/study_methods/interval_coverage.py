"""Coverage of the confidence intervals of the study, over cohorts that are split, trained and tested independently.

Subjects have Gaussian features with a known separation between two grades, and the model is logistic regression. The
module needs the optional dependencies ``study``.

Notes
-----
For a linear model, AUC and balanced accuracy on infinitely many subjects have a closed form. Mean macro F1 depends on
the test-set size, and also has a closed form for the test-set size of a split. The true value is the mean over newly
sampled training sets with the training-set size of a split.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binom, norm
from sklearn.linear_model import LogisticRegression

from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...study.learn.subject_split import split_subjects
from ...study.predictions import ARM_COLUMNS
from ...study.statistics.scores.confidence_intervals import (
    compare_arms,
    compute_arm_intervals,
    compute_test_train_ratio,
)
from ...study.statistics.scores.metrics import percentile_interval, weighted_scores
from ...study.statistics.scores.split_scores import score_splits
from ...study.statistics.scores.subject_resampling import sample_bootstrap_counts
from ..raycasting.raycast_engines import Row

# With 20 subjects per grade, 6 are in the test set, which is the smallest number for which the study decides a claim.
MINIMUM_SUBJECTS = (20, 20)
# Number of subjects of each grade.
SubjectCounts = tuple[int, int]
_MEASURES = ("auc", "balanced_accuracy", "macro_f1")
# Number of features per subject.
_FEATURES = 5
# Number of splits per cohort.
_SPLITS = 20
# Feature columns of each model; the model `jsw` has fewer features, like a model that uses only joint space width.
_MODEL_FEATURES = {"lr": slice(0, _FEATURES), "jsw": slice(0, 2)}
# Distances between the two grade means, in standard deviations.
_SEPARATIONS_SD = (0.0, 1.2, 2.0)
_BOOTSTRAP = "bootstrap"
_NO_WIDTH = "no width"
_MEASURE_LABELS = {
    "auc": "AUC",
    "balanced_accuracy": "balanced accuracy",
    "macro_f1": "macro F1",
    "difference of auc": "difference of AUC",
    "difference of balanced_accuracy": "difference of balanced accuracy",
    "difference of macro_f1": "difference of macro F1",
    _BOOTSTRAP: "AUC, bootstrap of subjects over all splits",
}


@dataclass(frozen=True)
class Population:
    """Population with Gaussian features and a known separation between two grades.

    Attributes
    ----------
    separation_sd : float
        Distance between the grade means, in standard deviations. The first and the third feature contribute equally.
    """

    separation_sd: float

    def sample_cohort(self, subjects: SubjectCounts, rng: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
        """Sample a cohort with evenly interleaved grades.

        Parameters
        ----------
        subjects : tuple of int
            Number of subjects of each grade.
        rng : numpy.random.Generator
            Source of random numbers.

        Returns
        -------
        (subjects, 5) array
            Features in standard deviations.
        (subjects,) int64 array
            Grade of each subject, 0 or 1.
        """
        place = np.concatenate([(np.arange(count) + 0.5) / count for count in subjects])
        grade = np.repeat([0, 1], subjects)[np.argsort(place, kind="stable")]
        return rng.normal(size=(len(grade), _FEATURES)) + grade[:, None] * self._grade_shift(), grade

    def compute_expected_performance(self, trained: SubjectCounts, tested: SubjectCounts) -> dict[str, Array]:
        """Compute the expected performance of models trained on newly sampled cohorts.

        Parameters
        ----------
        trained : tuple of int
            Number of training subjects of each grade.
        tested : tuple of int
            Number of test subjects of each grade.

        Returns
        -------
        dict of str to (3,) array
            Mean AUC, balanced accuracy and macro F1 of each model over 600 training cohorts.
        """
        rng = np.random.default_rng(1)
        of_model: dict[str, list[tuple[float, float, float]]] = {name: [] for name in _MODEL_FEATURES}
        for _ in range(600):
            values, grade = self.sample_cohort(trained, rng)
            for name, seen in _MODEL_FEATURES.items():
                of_model[name].append(
                    self._compute_model_performance(_fit_logistic_regression(values[:, seen], grade), seen, tested)
                )
        return {name: np.mean(values, axis=0) for name, values in of_model.items()}

    def _grade_shift(self) -> Array:
        """Return the difference between the grade means, (5,), in standard deviations."""
        return np.asarray(self.separation_sd / np.sqrt(2) * np.eye(_FEATURES)[[0, 2]].sum(axis=0))

    def _compute_model_performance(
        self, model: LogisticRegression, seen: slice, tested: SubjectCounts
    ) -> tuple[float, float, float]:
        """Compute AUC, balanced accuracy and mean macro F1 of a fitted linear model in closed form."""
        weight, step = model.coef_[0], self._grade_shift()[seen]
        length = np.linalg.norm(weight)
        zero, one = model.intercept_[0] / length, (model.intercept_[0] + weight @ step) / length
        right = float(norm.cdf(-zero)), float(norm.cdf(one))
        return float(norm.cdf((one - zero) / np.sqrt(2))), float(np.mean(right)), mean_macro_f1(right, tested)


def measure_interval_coverage(workers: int, cohorts: int = 200) -> list[Row]:
    """Measure the fraction of cohorts whose 95 % interval contains the true value.

    Parameters
    ----------
    workers : int
        Number of worker processes.
    cohorts : int, default 200
        Number of cohorts per separation.

    Returns
    -------
    list of dict
        One row per separation and performance measure: true AUC, measure, number of cohorts, and coverage (``held``).
    """
    rows: list[Row] = []
    for apart in _SEPARATIONS_SD:
        misses, truth = (
            count_missed_intervals(apart, MINIMUM_SUBJECTS, cohorts, workers),
            _compute_expected_performance(apart, MINIMUM_SUBJECTS)["lr"][0],
        )
        for measure, count in misses.drop(_NO_WIDTH).items():
            rows.append({
                "true_auc": float(truth), "measure": _MEASURE_LABELS[measure], "cohorts": cohorts,
                "held": 1 - count / cohorts,
            })  # fmt: skip
    return rows


def count_missed_intervals(separation_sd: float, subjects: SubjectCounts, cohorts: int, workers: int = 1) -> pd.Series:
    """Count the cohorts whose interval excludes the true value, and the cohorts whose AUC interval has zero width.

    Parameters
    ----------
    separation_sd : float
        Distance between the grade means, in standard deviations.
    subjects : tuple of int
        Number of subjects of each grade.
    cohorts : int
        Number of cohorts.
    workers : int, default 1
        Number of worker processes.

    Returns
    -------
    pandas.Series
        Number of cohorts whose interval excludes the true value, by measure. ``"no width"`` is the number of AUC
        intervals of zero width.
    """
    shared = {
        "separation_sd": separation_sd,
        "subjects": subjects,
        "truth": _compute_expected_performance(separation_sd, subjects),
    }
    return pd.DataFrame(map_in_parallel(_check_one_cohort, range(cohorts), shared=shared, workers=workers)).sum()


def mean_macro_f1(correct_probability: tuple[float, float], test_counts: SubjectCounts) -> float:
    """Compute the mean macro F1 over test sets with binomially distributed numbers of correct predictions.

    Parameters
    ----------
    correct_probability : tuple of float
        Probability of a correct prediction for a subject of each grade.
    test_counts : tuple of int
        Number of test subjects of each grade.

    Returns
    -------
    float
        Mean macro F1, 0 to 1.
    """
    zeros, ones = np.arange(test_counts[0] + 1)[:, None], np.arange(test_counts[1] + 1)[None, :]
    probability = binom.pmf(zeros, test_counts[0], correct_probability[0]) * binom.pmf(
        ones, test_counts[1], correct_probability[1]
    )
    # F1 of a grade is 2 x correct / (subjects of the grade + subjects predicted as the grade).
    f1 = zeros / (sum(test_counts) + zeros - ones) + ones / (sum(test_counts) + ones - zeros)
    return float((probability * f1).sum())


@cache
def _compute_expected_performance(separation_sd: float, subjects: SubjectCounts) -> dict[str, Array]:
    """Compute the expected performance for the numbers of training and test subjects in a study split."""
    grade = np.repeat([0, 1], subjects)
    split = split_subjects(range(len(grade)), grade.tolist(), seed=0)
    trained, tested = (np.bincount(grade[part], minlength=2).tolist() for part in (split.training, split.test))
    return Population(separation_sd).compute_expected_performance(tuple(trained), tuple(tested))


def _check_one_cohort(
    seed: int, separation_sd: float, subjects: SubjectCounts, truth: dict[str, Array]
) -> dict[str, bool]:
    """Sample one cohort and report, for each measure, whether its interval excludes the true value."""
    values, grade = Population(separation_sd).sample_cohort(subjects, np.random.default_rng([5, seed]))
    predictions, listed = _predict_all_splits(values, grade, seed)
    splits, ratio = score_splits(predictions), compute_test_train_ratio(listed)
    of = compute_arm_intervals(splits, ratio).set_index("model").loc["lr"]
    less = compare_arms(splits, ratio).set_index("metric")
    row = {name: not of[f"{name}_low"] <= truth["lr"][k] <= of[f"{name}_high"] for k, name in enumerate(_MEASURES)}
    for k, name in enumerate(_MEASURES):
        gain = truth["lr"][k] - truth["jsw"][k]
        row[f"difference of {name}"] = not less.loc[name, "low"] <= gain <= less.loc[name, "high"]
    low, high = _bootstrap_auc_interval(predictions, grade, seed)
    row[_BOOTSTRAP] = not low <= truth["lr"][0] <= high
    return row | {_NO_WIDTH: bool(of["auc_low"] == of["auc_high"])}


def _fit_logistic_regression(values: Array, grade: NDArray[np.int64]) -> LogisticRegression:
    """Fit a logistic regression to feature values (subjects, features) and grades (subjects,)."""
    return LogisticRegression(solver="newton-cholesky").fit(values, grade)


def _predict_all_splits(values: Array, grade: NDArray[np.int64], seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Train and test on every split as in the study; return predictions, and training and test subjects per split."""
    parts, listed = [], []
    for repeat in range(_SPLITS):
        split = split_subjects(range(len(grade)), grade.tolist(), seed=seed, repeat=repeat)
        listed.append(split.to_table().assign(repeat=repeat))
        for model, seen in _MODEL_FEATURES.items():
            p = _fit_logistic_regression(values[split.training, seen], grade[split.training]).predict_proba(
                values[split.test, seen]
            )
            arm = ("0 vs 2", "within", "reference", "reference", model, "none" if model == "jsw" else "l1")
            table = pd.DataFrame({"subject": split.test, "truth": grade[split.test], "p0": p[:, 0], "p1": p[:, 1]})
            parts.append(table.assign(**dict(zip(ARM_COLUMNS, arm, strict=True)), repeat=repeat))
    return pd.concat(parts, ignore_index=True), pd.concat(listed, ignore_index=True)


def _bootstrap_auc_interval(predictions: pd.DataFrame, grade: NDArray[np.int64], seed: int) -> tuple[float, float]:
    """Compute a percentile interval of the AUC over bootstrap samples of subjects.

    Splits and fitted models are the same in every bootstrap sample.
    """
    weights = sample_bootstrap_counts(pd.Series(grade), replicates=300, seed=seed, stream=0)
    of = [
        weighted_scores(part["truth"].to_numpy(), part[["p0", "p1"]].to_numpy(), weights[part["subject"]])["auc"]
        for _, part in predictions[predictions["model"] == "lr"].groupby("repeat")
    ]
    return percentile_interval(np.nanmean(of, axis=0)[1:])
