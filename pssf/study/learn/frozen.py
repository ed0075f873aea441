"""Baselines on fixed splits of a frozen data set: true and measured joint space, radiomics, a small network.

All learn from one protocol. What reads the image is tested under every other protocol as well; a joint space is known
of the knee and not of the film, so it is tested once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import InputError
from ...core.execution import Execution
from ...data.code import require_code
from ..predictions import NONE, class_of
from ..settings import StudySettings
from ..statistics.reliability import protocols_of
from ..tasks import Classes, tasks_of
from .each_split import each_split
from .ladder import Rung, fitted_rung, known_of, rungs_of
from .models import Fitted
from .network import WITHOUT, is_installed, learnt
from .split import PARTS, seed_of_split, split_subjects

PREDICTORS = {"jsw": "True JSW", "measured": "Measured JSW", "radiomics": "Radiomics", "cnn": "Small CNN"}
TASKS = ("0 vs 2", "0 vs 3+4", "0/1/2/3/4")
_OF_KNEES = ("jsw", "measured")

Model = Callable[[pd.DataFrame], NDArray[np.float64]]


@dataclass(frozen=True)
class Films:
    """What predictors learn from: a table of `ladder.known_of` by protocol, the first the one to learn from.

    names   of the features
    images  radiograph -> (size, size) of `network.seen`; None: no network
    """

    known: Mapping[str, pd.DataFrame]
    names: list[str]
    images: Mapping[str, NDArray[np.float32]] | None = None


def films_of(
    usable: pd.DataFrame,
    names: list[str],
    parameters: pd.DataFrame,
    settings: StudySettings,
    images: Mapping[str, NDArray[np.float32]] | None = None,
) -> Films:
    """Films of radiographs with a region found.

    parameters  of `statistics.parameters.parameters_of`
    images      radiograph -> (size, size) of `network.seen`, dimensionless; None: no network
    raises      InputError where no region was found under the reference, which is learnt from
    """
    if not (usable["protocol"] == settings.reference).any():
        raise InputError(f"regions found under {settings.reference} = 0; allowed: 1 or more, which models learn from")
    known = {}
    for protocol in protocols_of(usable, settings.reference):
        part = usable[usable["protocol"] == protocol]
        table = known_of(part, names, parameters, replace(settings, reference=protocol))
        known[protocol] = table.assign(radiograph=part["radiograph"].to_numpy())
    return Films(known, names, images)


def splits_of(manifest: pd.DataFrame, settings: StudySettings) -> pd.DataFrame:
    """repeat, subject, part: the fixed splits, of all subjects of a manifest whether their regions are found or not.

    raises  InputError for a grade of fewer than three subjects
    """
    tables = [
        split_subjects(manifest["subject"], manifest["grade"], seed=settings.seed, repeat=repeat).table()
        for repeat in range(settings.repeats)
    ]
    return pd.concat([table.assign(repeat=k) for k, table in enumerate(tables)], ignore_index=True)


def predict(films: Films, splits: pd.DataFrame, settings: StudySettings, execution: Execution) -> pd.DataFrame:
    """Predictions of the test people, as `predictions` has them; model: one of PREDICTORS.

    splits  of `splits_of`
    raises  InputError where no split has the grades of a task; WorkersLostError when workers keep being killed
    """
    shared = {"films": films, "splits": splits, "settings": settings}
    rows = each_split(predict_split, range(settings.repeats), shared, execution, "baselines")
    predictions = pd.DataFrame([row for of_split in rows for row in of_split])
    if predictions.empty:
        grades = sorted({int(grade) for table in films.known.values() for grade in table["grade"]})
        raise InputError(f"grades with a region found = {grades}; allowed: those of one of {', '.join(TASKS)}")
    return predictions


def without_network() -> str:
    """Why there is no row of a network; "" where one can be trained."""
    return "" if is_installed() else WITHOUT


def predict_split(
    repeat: int, *, films: Films, splits: pd.DataFrame, settings: StudySettings, code: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Rows of `predict` of one split.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    split = splits[splits["repeat"] == repeat]
    people = {part: set(split.loc[split["part"] == part, "subject"]) for part in PARTS}
    reference, seed = next(iter(films.known)), seed_of_split(settings.seed, repeat)
    first = films.known[reference]
    rows: list[dict[str, Any]] = []
    for task, classes in tasks_of(first["grade"]).items():
        grades = sum(classes, ())
        training, validation = (
            first[first["subject"].isin(people[part]) & first["grade"].isin(grades)] for part in PARTS[:2]
        )
        if task not in TASKS or set(_truth(training, classes)) != set(range(len(classes))):
            continue
        for name, model in _models(films, training, validation, classes, settings, seed).items():
            for protocol, table in films.known.items():
                test = table[table["subject"].isin(people["test"]) & table["grade"].isin(grades)]
                if test.empty or (name in _OF_KNEES and protocol != reference):
                    continue
                scenario = "within" if protocol == reference else "cross"
                arm = {"task": task, "scenario": scenario, "trained_on": reference, "tested_on": protocol}
                arm |= {"model": name, "selection": NONE, "protocol": protocol}
                rows += _rows(test, classes, model(test), {**arm, "repeat": repeat})
    return rows


def _models(
    films: Films,
    training: pd.DataFrame,
    validation: pd.DataFrame,
    classes: Classes,
    settings: StudySettings,
    seed: int,
) -> dict[str, Model]:
    """Predictor -> what gives the probabilities (rows, classes) of a table."""
    truths = [_truth(part, classes) for part in (training, validation)]
    models: dict[str, Model] = {}
    for name, rung in rungs_of(training, films.names).items():
        if name in PREDICTORS:
            fitted = fitted_rung(rung, (training, truths[0]), (validation, truths[1]), settings, seed)
            models[name] = partial(_asked, fitted, rung)
    if films.images is not None:
        shown = [(_images(films, part), truth) for part, truth in zip((training, validation), truths, strict=True)]
        network = learnt(shown[0], shown[1], len(classes), seed=seed)
        models["cnn"] = lambda test: network(_images(films, test))
    return models


def _asked(fitted: Fitted, rung: Rung, test: pd.DataFrame) -> NDArray[np.float64]:
    return np.asarray(fitted.pipeline.predict_proba(test[rung.columns]), np.float64)


def _images(films: Films, table: pd.DataFrame) -> NDArray[np.float32]:
    assert films.images is not None
    side = next(iter(films.images.values())).shape[0]
    shown = [films.images[name] for name in table["radiograph"]]
    return np.stack(shown) if shown else np.zeros((0, side, side), np.float32)


def _truth(table: pd.DataFrame, classes: Classes) -> NDArray[np.int64]:
    return class_of(table["grade"].to_numpy(), classes)


def _rows(
    test: pd.DataFrame, classes: Classes, probability: NDArray[np.float64], arm: dict[str, Any]
) -> list[dict[str, Any]]:
    whose = test[["radiograph", "knee", "subject"]].to_dict("records")
    return [
        {**arm, **one, "truth": int(truth), **{f"p{k}": float(p) for k, p in enumerate(of_one)}}
        for one, truth, of_one in zip(whose, _truth(test, classes), probability, strict=True)
    ]
