"""Training and testing within one protocol, across protocols and on several protocols.

Multi-protocol training has one radiograph per knee and protocol, and therefore more training radiographs than training
within one protocol. The scenario ``mixed`` separates the effect of the number of radiographs from the effect of the
protocols. In this scenario, each knee has one radiograph, under one of the protocols.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..design.classification_tasks import Classes, find_tasks
from ..design.study_settings import StudySettings
from ..predictions import (
    NO_SELECTION,
    SplitOutcome,
    concatenate_tables,
)
from ..statistics.features.reliability import list_protocols
from .models.classifiers import FittedModel, tune_classifier
from .models.feature_selection import build_feature_pipeline
from .models.labelled_features import make_labelled_features
from .models.permutation_importance import compute_permutation_importance
from .models.trivial_baselines import find_baselines
from .protocol_transfer import find_stable_features, harmonise_features
from .subject_split import derive_split_seed, split_subjects

# Second key of the random stream, after the split index. The modules `incremental_value`, `response_curves` and
# `confounded_training` use other keys.
_STREAM = 6


@dataclass(frozen=True)
class _TaskSplit:
    """Training, validation and test radiographs of one task and split."""

    task: str
    classes: Classes
    training: pd.DataFrame
    validation: pd.DataFrame
    test: pd.DataFrame


@dataclass(frozen=True)
class _TrainingPlan:
    """Features and classifiers to fit under one protocol, and test sets as (scenario, protocol, radiographs)."""

    trained_on: str
    selection: str
    names: list[str]
    models: dict[str, str]  # Classifier of each model, keyed by model label.
    test_sets: list[tuple[str, str, pd.DataFrame]]


@dataclass
class _CollectedRows:
    """Rows of the tables in `SplitOutcome`, collected over all training plans of a split."""

    predictions: list[pd.DataFrame] = field(default_factory=list)
    importances: list[dict[str, Any]] = field(default_factory=list)
    selection_candidates: list[dict[str, Any]] = field(default_factory=list)
    permutation: list[dict[str, Any]] = field(default_factory=list)
    tuning: list[dict[str, Any]] = field(default_factory=list)


def evaluate_split(repeat: int, *, table: pd.DataFrame, names: list[str], settings: StudySettings) -> SplitOutcome:
    """Train and test all tasks, scenarios, feature selections, classifiers and baselines for one split.

    Parameters
    ----------
    repeat : int
        Index of the split, starting at 0.
    table : DataFrame
        One row per radiograph: radiograph, knee, subject, grade, protocol, features, and the columns from
        `trivial_baselines.find_baseline_columns`.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.

    Returns
    -------
    SplitOutcome
        Predictions, importances and other tables of the split.

    Raises
    ------
    InputError
        A grade has too few subjects.
    """
    split = split_subjects(table["subject"], table["grade"], seed=settings.seed, repeat=repeat)
    seed = derive_split_seed(settings.seed, repeat)
    protocols = list_protocols(table, settings.reference)
    stable = None
    if len(protocols) > 1:
        table = table.assign(mixed=_assign_one_protocol(table, protocols, settings.seed, repeat))
        stable = find_stable_features(table[table["subject"].isin(split.training)], names, protocols)
    gathered = _CollectedRows()
    for task, classes in find_tasks(table["grade"]).items():
        rows = table[table["grade"].isin(sum(classes, ()))]
        held = (rows[rows["subject"].isin(subjects)] for subjects in (split.training, split.validation, split.test))
        parts = _TaskSplit(task, classes, *held)
        for recipe in _plan_trainings(parts, protocols, names, stable or [], settings):
            _run_training_plan(recipe, parts, settings, seed, repeat, gathered)
    return SplitOutcome(
        predictions=concatenate_tables(gathered.predictions) if gathered.predictions else pd.DataFrame(),
        importances=pd.DataFrame(gathered.importances),
        selection_candidates=pd.DataFrame(
            gathered.selection_candidates, columns=["task", "trained_on", "selection", "repeat", "feature"]
        ),
        permutation=pd.DataFrame(gathered.permutation),
        tuning=pd.DataFrame(gathered.tuning),
        stable_feature_count=None if stable is None else len(stable),
        subjects=split.to_table().assign(repeat=repeat),
    )


def _plan_trainings(
    parts: _TaskSplit, protocols: list[str], names: list[str], stable: list[str], settings: StudySettings
) -> Iterator[_TrainingPlan]:
    """Yield all training plans for one task and split."""
    reference, *others = protocols
    models = {name: name for name in settings.models}
    plain = [("cross", other, _select_protocol(parts.test, other)) for other in others]
    within = [("within", reference, _select_protocol(parts.test, reference)), *plain]
    multi = [("multi", name, _select_protocol(parts.test, name)) for name in ("all", *protocols)] if others else []
    harmonised = [("cross_harmonised", other, _harmonise_test_part(parts, names, other, reference)) for other in others]
    for selection in settings.selections:
        yield _TrainingPlan(reference, selection, names, models, within + harmonised)
        if stable and others:
            yield _TrainingPlan(reference, selection, stable, models, [("cross_stable", *test[1:]) for test in plain])
        if others:
            yield _TrainingPlan("all", selection, names, models, multi)
        if others and len(parts.classes) == 2:
            yield _TrainingPlan("mixed", selection, names, models, [("mixed", *test[1:]) for test in within])
    for label, (classifier, columns) in find_baselines(parts.training, names).items():
        yield _TrainingPlan(reference, NO_SELECTION, columns, {label: classifier}, within)
        if others:
            yield _TrainingPlan("all", NO_SELECTION, columns, {label: classifier}, multi)


def _run_training_plan(
    recipe: _TrainingPlan, parts: _TaskSplit, settings: StudySettings, seed: int, repeat: int, gathered: _CollectedRows
) -> None:
    """Fit, tune and test the classifiers of one plan and collect the resulting rows."""
    fit_on, check_on = (
        make_labelled_features(_select_protocol(part, recipe.trained_on), recipe.names, parts.classes)
        for part in (parts.training, parts.validation)
    )
    if set(fit_on[1]) != set(range(len(parts.classes))):
        return  # At least one class has no located region under the training protocol.
    prepared = build_feature_pipeline(
        recipe.selection, rho=settings.rho, max_features=settings.most_features, seed=seed
    )
    prepared.fit(*fit_on)
    if recipe.selection != NO_SELECTION and recipe.test_sets[0][0] == "within":
        of = {"task": parts.task, "trained_on": recipe.trained_on, "selection": recipe.selection, "repeat": repeat}
        gathered.selection_candidates += [{**of, "feature": name} for name in prepared.named_steps["drop"].kept_]
    tested = concatenate_tables(rows.assign(scenario=name, tested_on=on) for name, on, rows in recipe.test_sets)
    for label, classifier in recipe.models.items():
        arm = {"task": parts.task, "trained_on": recipe.trained_on, "model": label, "selection": recipe.selection}
        fitted = tune_classifier(prepared, classifier, fit_on, check_on, seed=seed)
        gathered.predictions.append(
            _predict_test_sets(fitted, tested, recipe.names, parts.classes).assign(**arm, repeat=repeat)
        )
        scenario, _, rows = recipe.test_sets[0]
        if recipe.selection == NO_SELECTION or scenario not in ("within", "multi"):
            continue
        gathered.tuning += [
            {**arm, "repeat": repeat, "parameter": name, "value": value} for name, value in fitted.parameters.items()
        ]
        for feature, importance in fitted.importance.items():
            gathered.importances.append({**arm, "repeat": repeat, "feature": feature, "importance": importance})
        if scenario == "within" and len(parts.classes) == 2:
            drops = compute_permutation_importance(
                fitted.pipeline, *make_labelled_features(rows, recipe.names, parts.classes), seed=seed
            )
            label_of = {"model": label, "selection": recipe.selection, "repeat": repeat}
            gathered.permutation += [{**label_of, "feature": name, "drop": drop} for name, drop in drops.items()]


def _select_protocol(table: pd.DataFrame, protocol: str) -> pd.DataFrame:
    """Select radiographs by protocol; "all" selects all protocols, and "mixed" selects one radiograph per knee."""
    if protocol == "mixed":
        return table[table["mixed"]]
    return table if protocol == "all" else table[table["protocol"] == protocol]


def _assign_one_protocol(table: pd.DataFrame, protocols: list[str], seed: int, repeat: int) -> NDArray[np.bool_]:
    """Select one radiograph of each knee so that all protocols are equally frequent within each grade.

    Return a boolean mask (radiographs,).
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(repeat, _STREAM)))
    own: dict[Any, str] = {}
    for _, knees in table.drop_duplicates("knee").sort_values("knee").groupby("grade")["knee"]:
        own |= {knee: protocols[place % len(protocols)] for place, knee in enumerate(rng.permutation(knees))}
    return np.asarray(table["protocol"] == table["knee"].map(own))


def _harmonise_test_part(parts: _TaskSplit, names: list[str], protocol: str, reference: str) -> pd.DataFrame:
    """Harmonise the features of test radiographs under one protocol with the reference protocol."""
    test = _select_protocol(parts.test, protocol)
    of, onto = (_select_protocol(parts.training, name)[names] for name in (protocol, reference))
    return test.drop(columns=names).join(harmonise_features(test[names], of, onto))


def _predict_test_sets(fitted: FittedModel, tested: pd.DataFrame, names: list[str], classes: Classes) -> pd.DataFrame:
    """Predict the classes in all test sets of a training plan; `tested` concatenates these test sets in one table."""
    features, truth = make_labelled_features(tested, names, classes)
    probability = fitted.pipeline.predict_proba(features) if len(tested) else np.empty((0, len(classes)))
    labels = tested[["radiograph", "knee", "subject", "protocol", "scenario", "tested_on"]].assign(truth=truth)
    return labels.assign(**{f"p{k}": probability[:, k].astype(np.float64) for k in range(len(classes))})
