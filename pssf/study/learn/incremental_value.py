"""Incremental value: AUC of predictor sets with true parameters, true or measured JSW, and features.

Every predictor set is evaluated by logistic regression on the same splits, under the reference protocol, for grade 0
against each other grade. The predictor sets differ only in their columns. If a set contains JSW and features, feature
selection applies only to the features, and JSW is always used. The AUC difference to JSW alone is the incremental value
of the features.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from ...core.processes.execution import Execution
from ...data.code_hash import require_same_code
from ...radiomics.features.feature_families import TEXTURES, feature_family
from ...texture import TEXTURE_FAMILIES
from ..design.study_settings import StudySettings
from ..predictions import find_class_indices
from ..statistics.analyses.knee_parameters import PARAMETERS
from ..statistics.scores.metrics import auc
from ..statistics.scores.subject_resampling import worst_grades
from ..statistics.scores.tested_subjects import TEST_COUNT_COLUMNS, count_test_subjects
from .each_split import map_splits
from .models.classifiers import FittedModel, tune_classifier
from .models.feature_selection import build_feature_pipeline
from .models.labelled_features import LabelledFeatures
from .subject_split import Split, derive_split_seed, split_subjects

# Label of each predictor set.
PREDICTOR_SETS = {
    "parameters": "all true parameters",
    "jsw": "true JSW",
    "measured": "measured JSW",
    "radiomics": "radiomics",
    "texture": "measured JSW and texture",
    "both": "measured JSW and radiomics",
}
# Standard error of JSW measured by software on semiflexed radiographs of the same X-ray unit, in mm (Mazzuca 1999, J
# Rheumatol 26, 1359; 174 knees radiographed twice). The standard error includes the repositioning error.
JSW_MEASUREMENT_SD_MM = 0.32
_JSW_LOCATIONS = ("medial", "lateral", "least")
_NOMINAL_JSW_COLUMNS = ("nominal_jsw_medial_mm", "nominal_jsw_lateral_mm")
_TRUE, _MEASURED = (tuple(f"{kind}_{name}_mm" for name in _JSW_LOCATIONS) for kind in ("true", "measured"))
# Key of the random stream for measurement errors, after the study seed.
_READING = 2**31 + 5
# Key of the random stream for subsampling, after the study seed and the split index.
_THINNING = 2
_COLUMNS = ["grades", "predictor_set", "repeat", "training_subjects", *TEST_COUNT_COLUMNS, "auc"]


@dataclass(frozen=True)
class SplitJob:
    """Split of the subjects, and fraction of its training subjects to use.

    Parameters
    ----------
    repeat : int
        Index of the split, starting at 0.
    training_fraction : float, default 1
        Fraction of the training and validation subjects, greater than 0 and at most 1.
    """

    repeat: int
    training_fraction: float = 1.0


@dataclass(frozen=True)
class PredictorSet:
    """Table columns that a predictor set uses.

    Parameters
    ----------
    candidate_columns : tuple of str
        Columns from which the feature selection selects.
    forced_columns : tuple of str
        Columns that are always used.
    """

    candidate_columns: tuple[str, ...]
    forced_columns: tuple[str, ...]

    @property
    def columns(self) -> list[str]:
        """All columns of the predictor set, starting with the forced columns."""
        return [*self.forced_columns, *self.candidate_columns]


class SelectWithForced(TransformerMixin, BaseEstimator):
    """Transformer that selects features and adds standardised forced columns, which bypass the selection.

    Parameters
    ----------
    selection_pipeline : Pipeline or None
        Unfitted pipeline from `feature_selection.build_feature_pipeline`. If None, only forced columns are used.
    forced_columns : sequence of str
        Names of the columns that bypass selection.
    """

    def __init__(self, selection_pipeline: Pipeline | None, forced_columns: Sequence[str]) -> None:
        self.selection_pipeline = selection_pipeline
        self.forced_columns = forced_columns

    def fit(self, X: pd.DataFrame, y: Any = None) -> "SelectWithForced":
        """Fit the scaler of the forced columns and the selection of the other columns.

        Parameters
        ----------
        X : DataFrame
            Training rows with all columns.
        y : (rows,) array, optional
            Class index of each row.

        Returns
        -------
        SelectWithForced
            Fitted transformer; ``kept_`` contains the output column names.
        """
        self.scale_ = StandardScaler().fit(X[list(self.forced_columns)]) if self.forced_columns else None
        if self.selection_pipeline is not None:
            self.selection_pipeline.fit(X.drop(columns=list(self.forced_columns)), y)
        chosen = [] if self.selection_pipeline is None else self.selection_pipeline.named_steps["select"].kept_
        self.kept_ = [*self.forced_columns, *chosen]
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """Return the standardised forced columns and the selected columns.

        Parameters
        ----------
        X : DataFrame
            Rows to transform, with all columns.

        Returns
        -------
        DataFrame
            Columns listed in ``kept_``.
        """
        parts = []
        if self.scale_ is not None:
            columns = list(self.forced_columns)
            parts.append(pd.DataFrame(self.scale_.transform(X[columns]), columns=columns, index=X.index))
        if self.selection_pipeline is not None:
            parts.append(self.selection_pipeline.transform(X.drop(columns=list(self.forced_columns))))
        return pd.concat(parts, axis=1)


def build_predictor_table(
    usable: pd.DataFrame, names: list[str], parameters: pd.DataFrame, settings: StudySettings
) -> pd.DataFrame:
    """Build the table of all predictors under the reference protocol.

    Measured JSW is true JSW plus a measurement error, which is sampled independently for each knee and compartment.

    Parameters
    ----------
    usable : DataFrame
        Radiographs with a located region: knee, subject, grade, protocol and features.
    names : list of str
        Names of the features.
    parameters : DataFrame
        Knee parameters, from `extract_knee_parameters`. Predictor sets with missing parameters are omitted.
    settings : StudySettings
        Study settings; reference protocol and seed are used.

    Returns
    -------
    DataFrame
        One row per radiograph: knee, subject, grade, features, parameters, true and measured JSW in mm.
    """
    part = usable[usable["protocol"] == settings.reference][["knee", "subject", "grade", *names]]
    columns = [name for name in PARAMETERS if name in parameters]
    known = part.merge(parameters[["knee", *columns]], on="knee", how="left")
    if set(_NOMINAL_JSW_COLUMNS) <= set(known):
        true = known[list(_NOMINAL_JSW_COLUMNS)].to_numpy(np.float64)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(_READING,)))
        # Errors are sampled for all knees in order, so that a missing radiograph does not change the errors of other
        # knees.
        places = np.searchsorted(np.sort(parameters["knee"].to_numpy()), known["knee"].to_numpy())
        read = true + JSW_MEASUREMENT_SD_MM * rng.standard_normal((len(parameters), 2))[places]
        for columns_of, values in ((_TRUE, true), (_MEASURED, read)):
            known[list(columns_of)] = np.column_stack([values, values.min(axis=1)])
    return known


def find_predictor_sets(predictor_table: pd.DataFrame, names: list[str]) -> dict[str, PredictorSet]:
    """Find the predictor sets for which a table contains all columns.

    Parameters
    ----------
    predictor_table : DataFrame
        Table from `build_predictor_table`.
    names : list of str
        Names of the features.

    Returns
    -------
    dict of str to PredictorSet
        Columns of each predictor set, keyed by its name in `PREDICTOR_SETS`.
    """
    columns = tuple(name for name in PARAMETERS if name in predictor_table)
    textures = tuple(name for name in names if feature_family(name) in (*TEXTURES, *TEXTURE_FAMILIES))
    read = _MEASURED if set(_MEASURED) <= set(predictor_table) else ()
    predictor_sets = {
        "parameters": PredictorSet((), (*columns, "true_least_mm")) if read else PredictorSet((), ()),
        "jsw": PredictorSet((), _TRUE if read else ()),
        "measured": PredictorSet((), read),
        "radiomics": PredictorSet(tuple(names), ()),
        "texture": PredictorSet(textures, read) if read and textures else PredictorSet((), ()),
        "both": PredictorSet(tuple(names), read) if read else PredictorSet((), ()),
    }
    return {
        name: predictor_set
        for name, predictor_set in predictor_sets.items()
        if predictor_set.candidate_columns or predictor_set.forced_columns
    }


def evaluate_predictor_sets(
    predictor_table: pd.DataFrame,
    names: list[str],
    settings: StudySettings,
    execution: Execution,
    *,
    training_fractions: Sequence[float] = (1.0,),
    predictor_set_names: Sequence[str] = tuple(PREDICTOR_SETS),
    stage: str = "incremental value",
) -> pd.DataFrame:
    """Compute the AUC of every predictor set on every split, trained on fractions of the training subjects.

    With several fractions, the timer stores the exponent of the power law between computing time and number of training
    subjects.

    Parameters
    ----------
    predictor_table : DataFrame
        Table from `build_predictor_table`.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    execution : Execution
        Workers, scheduler, timer and progress bar.
    training_fractions : sequence of float, default (1.0,)
        Fractions of the training and validation subjects of each grade; at least two subjects per grade are used. A
        smaller training set is a subset of a larger training set. The test subjects are the same for all fractions.
    predictor_set_names : sequence of str
        Names from `PREDICTOR_SETS`; sets with missing columns are omitted.
    stage : str
        Name of the stage in the timer.

    Returns
    -------
    DataFrame
        Columns: grades (such as "0 vs 1"), predictor_set (name), repeat, training_subjects, `TEST_COUNT_COLUMNS`,
        auc, training_fraction.

    Raises
    ------
    InputError
        A grade has too few subjects, or a worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    jobs = [SplitJob(repeat, fraction) for fraction in training_fractions for repeat in range(settings.repeats)]
    chosen = {
        name: predictor_set
        for name, predictor_set in find_predictor_sets(predictor_table, names).items()
        if name in predictor_set_names
    }
    shared = {"known": predictor_table, "predictor_sets": chosen, "settings": settings}
    tables = map_splits(evaluate_predictor_sets_split, jobs, shared, execution, stage)
    timed = np.array(
        [(job.training_fraction, rows[0]["seconds"]) for job, rows in zip(jobs, tables, strict=True) if rows]
    )
    if len(timed) and np.ptp(timed[:, 0]) > 0:
        learnt, seconds = np.log(timed).T
        execution.timer.stages[stage].time_exponent = float(np.polyfit(learnt, seconds, 1)[0])
    rows = [
        row | {"training_fraction": job.training_fraction}
        for job, of_job in zip(jobs, tables, strict=True)
        for row in of_job
    ]
    return pd.DataFrame(rows, columns=[*_COLUMNS, "training_fraction"])


def evaluate_predictor_sets_split(
    job: SplitJob,
    *,
    known: pd.DataFrame,
    predictor_sets: Mapping[str, PredictorSet],
    settings: StudySettings,
    code: Mapping[str, str],
) -> list[dict[str, Any]]:
    """Compute the AUC of every predictor set for one split and training fraction.

    Parameters
    ----------
    job : SplitJob
        Split and training fraction.
    known : DataFrame
        Table from `build_predictor_table`.
    predictor_sets : mapping of str to PredictorSet
        Predictor sets by name.
    settings : StudySettings
        Settings of models and splits.
    code : mapping of str to str
        Code hashes of the process that started the run, keyed by subpackage.

    Returns
    -------
    list of dict
        Rows of the table that `evaluate_predictor_sets` returns; ``seconds`` is the CPU time of the job, in s.

    Raises
    ------
    InputError
        The code hashes of this process differ from `code`, or a grade has too few subjects.
    """
    require_same_code(code)
    began = process_time()
    split = split_subjects(known["subject"], known["grade"], seed=settings.seed, repeat=job.repeat)
    learnt = subsample_subjects(split, known, job, settings.seed)
    seed = derive_split_seed(settings.seed, job.repeat)
    first, *others = sorted({int(grade) for grade in known["grade"]})
    rows = []
    for grade in others:
        part = known[known["grade"].isin((first, grade))]
        training, validation, test = (part[part["subject"].isin(of)] for of in (*learnt, split.test))
        label = {
            "grades": f"{first} vs {grade}",
            "repeat": job.repeat,
            "training_subjects": training["subject"].nunique(),
        }
        label |= count_test_subjects(test["subject"], test["grade"], (first, grade))
        if training["grade"].nunique() == test["grade"].nunique() == 2:
            for name, value in _score_predictor_sets(
                training, validation, test, predictor_sets, settings, seed, (first, grade)
            ):
                rows.append({**label, "predictor_set": name, "auc": value})
    seconds = process_time() - began
    return [row | {"seconds": seconds} for row in rows]


def subsample_subjects(split: Split, predictor_table: pd.DataFrame, job: SplitJob, seed: int) -> list[list[Any]]:
    """Select a fraction of the training and validation subjects of each grade.

    Parameters
    ----------
    split : Split
        Subjects of the split.
    predictor_table : DataFrame
        Table with the columns subject and grade.
    job : SplitJob
        Split and training fraction.
    seed : int
        Seed of the study.

    Returns
    -------
    list of list
        Training subjects and validation subjects, at least two per grade. A smaller subsample is a subset of a larger
        subsample.
    """
    if job.training_fraction >= 1:
        return [split.training.tolist(), split.validation.tolist()]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(job.repeat, _THINNING)))
    worst = worst_grades(predictor_table["subject"], predictor_table["grade"])
    parts = []
    for subjects in (split.training, split.validation):
        kept: list[Any] = []
        for grade in sorted(set(worst)):
            members = rng.permutation([one for one in subjects if worst[one] == grade])
            kept += members[: max(2, round(job.training_fraction * len(members)))].tolist()
        parts.append(kept)
    return parts


def _score_predictor_sets(
    training: pd.DataFrame,
    validation: pd.DataFrame,
    test: pd.DataFrame,
    predictor_sets: Mapping[str, PredictorSet],
    settings: StudySettings,
    seed: int,
    grades: tuple[int, int],
) -> Iterator[tuple[str, float]]:
    """Yield the name and the AUC of each predictor set; the AUC is NaN if a class has no test rows."""
    classes = tuple((grade,) for grade in grades)
    truths = [find_class_indices(part["grade"].to_numpy(), classes) for part in (training, validation, test)]
    for name, predictor_set in predictor_sets.items():
        fitted = fit_predictor_set(predictor_set, (training, truths[0]), (validation, truths[1]), settings, seed)
        yield name, auc(truths[2] == 1, fitted.pipeline.predict_proba(test[predictor_set.columns])[:, 1])


def fit_predictor_set(
    predictor_set: PredictorSet,
    training: LabelledFeatures,
    validation: LabelledFeatures,
    settings: StudySettings,
    seed: int,
) -> FittedModel:
    """Fit a logistic regression to a predictor set, with the first feature selection from the settings.

    Parameters
    ----------
    predictor_set : PredictorSet
        Columns of the predictor set.
    training : tuple of DataFrame and (rows,) int64 array
        Training rows, and class index of each row.
    validation : tuple of DataFrame and (rows,) int64 array
        Validation rows, and class index of each row.
    settings : StudySettings
        Study settings; the feature selection settings are used.
    seed : int
        Seed of the model fit.

    Returns
    -------
    FittedModel
        Fitted logistic regression with its feature selection.
    """
    prepare = None
    if predictor_set.candidate_columns:
        prepare = build_feature_pipeline(
            settings.selections[0], rho=settings.rho, max_features=settings.most_features, seed=seed
        )
    prepared = Pipeline([("select", SelectWithForced(prepare, predictor_set.forced_columns))])
    fit_on, check_on = ((table[predictor_set.columns], truth) for table, truth in (training, validation))
    return tune_classifier(prepared.fit(*fit_on), "lr", fit_on, check_on, seed=seed)
