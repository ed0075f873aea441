"""Within, cross and multi protocol: train and test on held-out subjects, many times over.

Multi-protocol training has as many radiographs of each knee as there are protocols. What is due to their number and
what to the protocols is told apart by `mixed`: every knee under one of them, as many radiographs as within a protocol.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..predictions import NONE, Outcome, class_of, joined
from ..settings import StudySettings
from ..statistics.reliability import protocols_of
from ..tasks import Classes, tasks_of
from .baselines import baselines_of
from .models import Fitted, tune
from .permutation import permuted
from .selection import preparation
from .split import seed_of_split, split_subjects
from .transfer import harmonise, stable_features

_STREAM = 6  # key under a repeat, beside those of `ladder`, `responses` and `confounders`
Part = tuple[pd.DataFrame, NDArray[np.int64]]


@dataclass(frozen=True)
class _Parts:
    """Radiographs of one task in the three parts of a split."""

    task: str
    classes: Classes
    training: pd.DataFrame
    validation: pd.DataFrame
    test: pd.DataFrame


@dataclass(frozen=True)
class _Recipe:
    """What to fit on which protocol, and (scenario, protocol, radiographs) to test it on."""

    trained_on: str
    selection: str
    names: list[str]
    models: dict[str, str]  # label -> classifier
    tests: list[tuple[str, str, pd.DataFrame]]


@dataclass
class _Gathered:
    predictions: list[pd.DataFrame] = field(default_factory=list)
    importances: list[dict[str, Any]] = field(default_factory=list)
    offered: list[dict[str, Any]] = field(default_factory=list)
    permutation: list[dict[str, Any]] = field(default_factory=list)
    tuning: list[dict[str, Any]] = field(default_factory=list)


def one_split(repeat: int, *, table: pd.DataFrame, names: list[str], settings: StudySettings) -> Outcome:
    """All tasks that its grades allow, scenarios, selections and models on one split of the subjects; baselines beside.

    table  one row a radiograph: radiograph, knee, subject, grade, protocol, the features of `names`, and what
           `baselines.measures_of` finds in it
    """
    split = split_subjects(table["subject"], table["grade"], seed=settings.seed, repeat=repeat)
    seed = seed_of_split(settings.seed, repeat)
    protocols = protocols_of(table, settings.reference)
    stable = None
    if len(protocols) > 1:
        table = table.assign(mixed=_one_each(table, protocols, settings.seed, repeat))
        stable = stable_features(table[table["subject"].isin(split.training)], names, protocols)
    gathered = _Gathered()
    for task, classes in tasks_of(table["grade"]).items():
        rows = table[table["grade"].isin(sum(classes, ()))]
        held = (rows[rows["subject"].isin(subjects)] for subjects in (split.training, split.validation, split.test))
        parts = _Parts(task, classes, *held)
        for recipe in _recipes(parts, protocols, names, stable or [], settings):
            _follow(recipe, parts, settings, seed, repeat, gathered)
    return Outcome(
        predictions=joined(gathered.predictions) if gathered.predictions else pd.DataFrame(),
        importances=pd.DataFrame(gathered.importances),
        offered=pd.DataFrame(gathered.offered, columns=["task", "trained_on", "selection", "repeat", "feature"]),
        permutation=pd.DataFrame(gathered.permutation),
        tuning=pd.DataFrame(gathered.tuning),
        stable=None if stable is None else len(stable),
        subjects=split.table().assign(repeat=repeat),
    )


def _recipes(
    parts: _Parts, protocols: list[str], names: list[str], stable: list[str], settings: StudySettings
) -> Iterator[_Recipe]:
    """All that is fitted for one task and split."""
    reference, *others = protocols
    models = {name: name for name in settings.models}
    plain = [("cross", other, _of(parts.test, other)) for other in others]
    within = [("within", reference, _of(parts.test, reference)), *plain]
    multi = [("multi", name, _of(parts.test, name)) for name in ("all", *protocols)] if others else []
    harmonised = [("cross_harmonised", other, _harmonised(parts, names, other, reference)) for other in others]
    for selection in settings.selections:
        yield _Recipe(reference, selection, names, models, within + harmonised)
        if stable and others:
            yield _Recipe(reference, selection, stable, models, [("cross_stable", *test[1:]) for test in plain])
        if others:
            yield _Recipe("all", selection, names, models, multi)
        if others and len(parts.classes) == 2:
            yield _Recipe("mixed", selection, names, models, [("mixed", *test[1:]) for test in within])
    for label, (classifier, columns) in baselines_of(parts.training, names).items():
        yield _Recipe(reference, NONE, columns, {label: classifier}, within)
        if others:
            yield _Recipe("all", NONE, columns, {label: classifier}, multi)


def _follow(
    recipe: _Recipe, parts: _Parts, settings: StudySettings, seed: int, repeat: int, gathered: _Gathered
) -> None:
    """Fit, tune, test, and keep what came out."""
    fit_on, check_on = (
        part_of(_of(part, recipe.trained_on), recipe.names, parts.classes)
        for part in (parts.training, parts.validation)
    )
    if set(fit_on[1]) != set(range(len(parts.classes))):
        return  # all regions of a grade were refused under this protocol
    prepared = preparation(recipe.selection, rho=settings.rho, most=settings.most_features, seed=seed)
    prepared.fit(*fit_on)
    if recipe.selection != NONE and recipe.tests[0][0] == "within":
        of = {"task": parts.task, "trained_on": recipe.trained_on, "selection": recipe.selection, "repeat": repeat}
        gathered.offered += [{**of, "feature": name} for name in prepared.named_steps["drop"].kept_]
    tested = joined(rows.assign(scenario=name, tested_on=on) for name, on, rows in recipe.tests)
    for label, classifier in recipe.models.items():
        arm = {"task": parts.task, "trained_on": recipe.trained_on, "model": label, "selection": recipe.selection}
        fitted = tune(prepared, classifier, fit_on, check_on, seed=seed)
        gathered.predictions.append(_predict(fitted, tested, recipe.names, parts.classes).assign(**arm, repeat=repeat))
        scenario, _, rows = recipe.tests[0]
        if recipe.selection == NONE or scenario not in ("within", "multi"):
            continue
        gathered.tuning += [
            {**arm, "repeat": repeat, "parameter": name, "value": value} for name, value in fitted.parameters.items()
        ]
        for feature, share in fitted.importance.items():
            gathered.importances.append({**arm, "repeat": repeat, "feature": feature, "share": share})
        if scenario == "within" and len(parts.classes) == 2:
            drops = permuted(fitted.pipeline, *part_of(rows, recipe.names, parts.classes), seed=seed)
            label_of = {"model": label, "selection": recipe.selection, "repeat": repeat}
            gathered.permutation += [{**label_of, "feature": name, "drop": drop} for name, drop in drops.items()]


def _of(table: pd.DataFrame, protocol: str) -> pd.DataFrame:
    if protocol == "mixed":
        return table[table["mixed"]]
    return table if protocol == "all" else table[table["protocol"] == protocol]


def _one_each(table: pd.DataFrame, protocols: list[str], seed: int, repeat: int) -> NDArray[np.bool_]:
    """(radiographs,) whether a radiograph is its knee's only one where each knee is taken once, every grade alike."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(repeat, _STREAM)))
    own: dict[Any, str] = {}
    for _, knees in table.drop_duplicates("knee").sort_values("knee").groupby("grade")["knee"]:
        own |= {knee: protocols[place % len(protocols)] for place, knee in enumerate(rng.permutation(knees))}
    return np.asarray(table["protocol"] == table["knee"].map(own))


def _harmonised(parts: _Parts, names: list[str], protocol: str, reference: str) -> pd.DataFrame:
    """Test radiographs under a protocol, with the features of its training radiographs laid onto the reference's."""
    test = _of(parts.test, protocol)
    of, onto = (_of(parts.training, name)[names] for name in (protocol, reference))
    return test.drop(columns=names).join(harmonise(test[names], of, onto))


def part_of(table: pd.DataFrame, names: list[str], classes: Classes) -> Part:
    """Features (rows, features) of radiographs, and the class of each one's grade (rows,)."""
    return table[names], class_of(table["grade"].to_numpy(), classes)


def _predict(fitted: Fitted, tested: pd.DataFrame, names: list[str], classes: Classes) -> pd.DataFrame:
    """The predictions of all tests of a recipe, whose radiographs stand one test below the other."""
    features, truth = part_of(tested, names, classes)
    probability = fitted.pipeline.predict_proba(features) if len(tested) else np.empty((0, len(classes)))
    labels = tested[["radiograph", "knee", "subject", "protocol", "scenario", "tested_on"]].assign(truth=truth)
    return labels.assign(**{f"p{k}": probability[:, k].astype(np.float64) for k in range(len(classes))})
