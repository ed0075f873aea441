"""Measure the domain shift between patient and simulated radiographs: separability and classifier transfer."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.impute import SimpleImputer
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from ...core.checks import Array
from ...study.statistics.scores.metrics import auc, percentile_interval, weighted_auc
from .film_features import GROUP_SEPARATOR, TOLD, Record

Row = dict[str, Any]
# Name of the feature group that contains all features.
ALL_FEATURES = "all"
# Number of cross-validation folds.
FOLDS = 5
# Minimum number of radiographs in each class for which a result is reported.
_MIN_FILMS = 10
# Inverse strength of the L2 penalty, dimensionless; assumed suitable for hundreds of features and radiographs.
_INVERSE_PENALTY = 0.1
# Number of features with the highest individual AUC that are reported.
_LEADING_COUNT = 8
_NO_GAIN_FRACTION: dict[str, float | None] = {
    "gain_fraction": None, "gain_fraction_low": None, "gain_fraction_high": None,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmFeatures:
    """Features of the radiographs of one source.

    Parameters
    ----------
    name : str
        Name of the source.
    features : pandas.DataFrame
        One row per radiograph; columns are (group, feature).
    grades : (films,) int64 array
        Grade of each radiograph; -1 if unknown.
    subjects : (films,) array of str
        Subject of each radiograph; the two knees of a person have the same subject.
    """

    name: str
    features: pd.DataFrame
    grades: NDArray[np.int64]
    subjects: NDArray[Any]

    def select_grades(self, grades: Sequence[int]) -> "FilmFeatures":
        """Select the radiographs with one of several grades.

        Parameters
        ----------
        grades : sequence of int
            Grades to select.

        Returns
        -------
        FilmFeatures
            Selected radiographs.
        """
        here = np.isin(self.grades, grades)
        return FilmFeatures(
            name=self.name, features=self.features[here], grades=self.grades[here], subjects=self.subjects[here]
        )


def make_film_features(name: str, records: Sequence[Record]) -> FilmFeatures:
    """Collect the classifier features of all radiographs with a localised joint.

    Parameters
    ----------
    name : str
        Name of the source.
    records : sequence of dict
        Records from ``measure_films``.

    Returns
    -------
    FilmFeatures
        Features of all groups that are used for training.
    """
    table = pd.DataFrame([record for record in records if record["status"] == "found"])
    columns = [name for name in table if GROUP_SEPARATOR in name and name.split(GROUP_SEPARATOR)[0] not in TOLD]
    features = table[columns].astype(float)
    features.columns = pd.MultiIndex.from_tuples([tuple(name.split(GROUP_SEPARATOR)) for name in columns])
    return FilmFeatures(
        name=name,
        features=features.reset_index(drop=True),
        grades=table["grade"].fillna(-1).astype(int).to_numpy(),
        subjects=table["subject"].astype(str).to_numpy(),
    )


def measure_source_separability(first: FilmFeatures, second: FilmFeatures, *, replicates: int, seed: int) -> list[Row]:
    """Measure how well classifiers distinguish the radiographs of two sources, with one classifier per feature group.

    Every subject belongs to only one cross-validation fold.

    Parameters
    ----------
    first : FilmFeatures
        Features of one source.
    second : FilmFeatures
        Features of the other source.
    replicates : int
        Number of bootstrap replicates.
    seed : int
        Seed for the cross-validation folds and the bootstrap.

    Returns
    -------
    list of dict
        One row per feature group. ``auc`` is the area under the ROC curve; ``low`` and ``high`` are the limits of the
        95 % bootstrap interval over subjects, with fixed models. ``leading_features`` lists the features with the
        highest individual AUC.
    """
    table = pd.concat([first.features, second.features], ignore_index=True)
    truth = np.repeat([False, True], [len(first.features), len(second.features)])
    subjects = np.concatenate(
        [np.char.add("a:", first.subjects.astype(str)), np.char.add("b:", second.subjects.astype(str))]
    )
    rows = []
    for group, columns in group_features(table).items():
        row = {"first": first.name, "second": second.name, "group": group, "features": len(columns)}
        row |= {"first_radiographs": len(first.features), "second_radiographs": len(second.features)}
        if _has_enough_films(truth, subjects):
            value = cross_validate(table[columns], truth, subjects, seed)
            drawn = bootstrap_auc(truth, value, subjects, replicates=replicates, seed=seed)
            row |= _auc_with_interval(truth, value, drawn)
            row["leading_features"] = "; ".join(
                f"{name} {one:.2f}" for name, one in find_leading_features(table[columns], truth)
            )
        rows.append(row)
    return rows


def measure_transfer(
    real: FilmFeatures, simulated: FilmFeatures, *, low: int, high: Sequence[int], replicates: int, seed: int
) -> list[Row]:
    """Predict grades of patient radiographs with classifiers trained on simulated and on patient radiographs.

    Parameters
    ----------
    real : FilmFeatures
        Features of patient radiographs.
    simulated : FilmFeatures
        Features of simulated radiographs. If no simulated radiograph has a grade in `high`, the positive class is the
        highest simulated grade.
    low : int
        Grade of the negative class.
    high : sequence of int
        Grades of the positive class.
    replicates : int
        Number of bootstrap replicates.
    seed : int
        Seed for the classifiers, the cross-validation folds and the bootstrap.

    Returns
    -------
    list of dict
        One row per feature group, with AUC and 95 % interval after training on simulated radiographs. Columns with the
        prefix ``patient_`` contain these results after training on patient radiographs. ``gain_fraction`` is the gain
        over chance (AUC - 0.5) from simulated radiographs, divided by the gain from patient radiographs. The interval
        of ``gain_fraction`` uses the same bootstrap subjects for both classifiers. ``gain_fraction`` is empty if the
        interval of the patient AUC includes 0.5.
    """
    highest = [grade for grade in high if grade in simulated.grades] or [int(simulated.grades.max())]
    here, there = real.select_grades([low, *high]), simulated.select_grades([low, *highest])
    truth, known = here.grades != low, there.grades != low
    rows = []
    for group, columns in group_features(real.features).items():
        row = {
            "source": real.name, "task": f"{low} v {'+'.join(map(str, high))}", "group": group,
            "trained_on": f"{low} v {'+'.join(map(str, highest))}", "patient_radiographs": len(truth),
            "simulated_radiographs": len(known),
        }  # fmt: skip
        if _has_enough_films(truth, here.subjects) and min(np.bincount(known, minlength=2)) >= _MIN_FILMS:
            carried = make_classifier(seed).fit(there.features[columns].to_numpy(), known)
            value = carried.predict_proba(here.features[columns].to_numpy())[:, 1]
            own = cross_validate(here.features[columns], truth, here.subjects, seed)
            drawn, drawn_own = (
                bootstrap_auc(truth, one, here.subjects, replicates=replicates, seed=seed) for one in (value, own)
            )
            by_simulated, by_real = _auc_with_interval(truth, value, drawn), _auc_with_interval(truth, own, drawn_own)
            row |= by_simulated | {f"patient_{name}": one for name, one in by_real.items()}
            row |= (
                _compute_gain_fraction(truth, (value, own), (drawn, drawn_own))
                if by_real["low"] > 0.5
                else _NO_GAIN_FRACTION
            )
        rows.append(row)
    return rows


def _has_enough_films(truth: NDArray[np.bool_], subjects: NDArray[Any]) -> bool:
    """Return whether each class has enough radiographs, and at least one subject per fold."""
    kinds = [subjects[truth == kind] for kind in (False, True)]
    return all(len(of) >= _MIN_FILMS and len(set(of.tolist())) >= FOLDS for of in kinds)


def group_features(features: pd.DataFrame) -> dict[str, list[Any]]:
    """List the columns of each feature group.

    Parameters
    ----------
    features : pandas.DataFrame
        Feature table with (group, feature) columns.

    Returns
    -------
    dict of str to list
        Columns of each group; the last entry, ``"all"``, contains the columns of all groups.
    """
    names = dict.fromkeys(group for group, _ in features.columns)
    groups = {group: [column for column in features.columns if column[0] == group] for group in names}
    return {**groups, ALL_FEATURES: list(features.columns)}


def make_classifier(seed: int) -> Pipeline:
    """Make an L2-regularised logistic regression on standardised features.

    Parameters
    ----------
    seed : int
        Seed of the logistic regression solver.

    Returns
    -------
    sklearn.pipeline.Pipeline
        Imputation, standardisation and logistic regression.
    """
    return make_pipeline(
        SimpleImputer(strategy="median", keep_empty_features=True),
        StandardScaler(),
        LogisticRegression(C=_INVERSE_PENALTY, max_iter=5000, random_state=seed, class_weight="balanced"),
    )


def cross_validate(features: pd.DataFrame, truth: NDArray[np.bool_], subjects: NDArray[Any], seed: int) -> Array:
    """Predict the class of each radiograph with a classifier that was trained on other subjects (cross-validation).

    Parameters
    ----------
    features : pandas.DataFrame
        Features, one row per radiograph.
    truth : (films,) bool array
        True class of each radiograph.
    subjects : (films,) array of str
        Subject of each radiograph.
    seed : int
        Seed for the cross-validation folds and the classifiers.

    Returns
    -------
    (films,) array
        Predicted probability of the positive class.
    """
    values, probability = features.to_numpy(), np.empty(len(truth))
    folds = StratifiedGroupKFold(FOLDS, shuffle=True, random_state=seed)
    for training, testing in folds.split(values, truth, subjects):
        probability[testing] = (
            make_classifier(seed).fit(values[training], truth[training]).predict_proba(values[testing])[:, 1]
        )
    return probability


def find_leading_features(features: pd.DataFrame, truth: NDArray[np.bool_]) -> list[tuple[str, float]]:
    """Find the features with the highest individual AUC.

    Parameters
    ----------
    features : pandas.DataFrame
        Features, one row per radiograph.
    truth : (films,) bool array
        True class of each radiograph.

    Returns
    -------
    list of tuple of (str, float)
        Name and AUC of each feature; an AUC below 0.5 is replaced by 1 minus AUC.
    """
    alone = {}
    for column in features:
        values = features[column].to_numpy()
        value = auc(truth, np.nan_to_num(values, nan=np.nanmedian(values)))
        alone[" ".join(column)] = max(value, 1 - value)
    return sorted(alone.items(), key=lambda item: (-item[1], item[0]))[:_LEADING_COUNT]


def _auc_with_interval(truth: NDArray[np.bool_], value: Array, resampled: Array) -> dict[str, float]:
    """Compute the AUC of predicted values, and the AUC interval from bootstrap samples."""
    low, high = percentile_interval(resampled)
    return {"auc": round(auc(truth, value), 4), "low": round(low, 4), "high": round(high, 4)}


def _compute_gain_fraction(
    truth: NDArray[np.bool_], values: tuple[Array, Array], resampled: tuple[Array, Array]
) -> Mapping[str, float]:
    """Divide the gain over chance of one prediction by the gain of another, with a paired bootstrap interval."""
    whole = [auc(truth, value) - 0.5 for value in values]
    beyond = resampled[1] - 0.5
    low, high = percentile_interval((resampled[0] - 0.5) / np.where(beyond > 0, beyond, np.nan))
    return {
        "gain_fraction": round(whole[0] / whole[1], 3),
        "gain_fraction_low": round(low, 3),
        "gain_fraction_high": round(high, 3),
    }


def bootstrap_auc(
    truth: NDArray[np.bool_], value: Array, subjects: NDArray[Any], *, replicates: int, seed: int
) -> Array:
    """Compute the AUC of every bootstrap sample of subjects; samples with only one class are omitted.

    Parameters
    ----------
    truth : (films,) bool array
        True class of each radiograph.
    value : (films,) array, any unit
        Predicted value of each radiograph; higher values predict the positive class.
    subjects : (films,) array of str
        Subject of each radiograph.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    (replicates,) array
        AUC of each bootstrap sample that contains both classes.
    """
    rng = np.random.default_rng(seed)
    _, of_film = np.unique(subjects, return_inverse=True)
    times = np.column_stack([sample_bootstrap_counts(of_film, rng) for _ in range(replicates)])
    both = (times[truth].sum(axis=0) > 0) & (times[~truth].sum(axis=0) > 0)
    return weighted_auc(truth, value, times[:, both].astype(np.float64))


def sample_bootstrap_counts(subject_index: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Sample subjects with replacement and count how often each radiograph is sampled.

    Parameters
    ----------
    subject_index : (films,) int64 array
        Zero-based subject index of each radiograph.
    rng : numpy.random.Generator
        Random generator.

    Returns
    -------
    (films,) int64 array
        How often each radiograph is sampled; the counts are equal for all radiographs of a subject.
    """
    count = subject_index.max() + 1
    return np.bincount(rng.integers(0, count, count), minlength=count)[subject_index]
