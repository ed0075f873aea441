"""Baselines on the fixed splits of a benchmark data set: true and measured JSW, radiomics, and a small network.

All baselines are trained on one protocol. Radiomics and the network are also tested on every other protocol. JSW is a
property of the knee, so the JSW baselines are tested once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import InputError
from ...core.processes.execution import Execution
from ...data.code_hash import require_same_code
from ..design.classification_tasks import Classes, find_tasks
from ..design.study_settings import StudySettings
from ..predictions import NO_SELECTION, find_class_indices
from ..statistics.features.reliability import list_protocols
from .each_split import map_splits
from .incremental_value import (
    PredictorSet,
    build_predictor_table,
    find_predictor_sets,
    fit_predictor_set,
)
from .models.classifiers import FittedModel
from .models.small_network import PYTORCH_MISSING, is_pytorch_installed, train_network
from .subject_split import PARTS, derive_split_seed, split_subjects

# Label of each baseline.
PREDICTORS = {"jsw": "True JSW", "measured": "Measured JSW", "radiomics": "Radiomics", "cnn": "Small CNN"}
BENCHMARK_TASKS = ("0 vs 2", "0 vs 3+4", "0/1/2/3/4")
# Baselines that use knee properties instead of the image.
_KNEE_PREDICTORS = ("jsw", "measured")

# Function from a table of knees to class probabilities.
Model = Callable[[pd.DataFrame], NDArray[np.float64]]


@dataclass(frozen=True)
class BenchmarkData:
    """Tables and images for training and testing the baselines.

    Parameters
    ----------
    predictor_tables : mapping of str to DataFrame
        Table from `incremental_value.build_predictor_table` for each protocol, keyed by protocol; the first protocol is
        used for training.
    names : list of str
        Names of the features.
    images : mapping of str to (size, size) float32 array, optional
        Image of each radiograph, from `small_network.make_network_input`, dimensionless. If None, no network is
        trained.
    """

    predictor_tables: Mapping[str, pd.DataFrame]
    names: list[str]
    images: Mapping[str, NDArray[np.float32]] | None = None


def build_benchmark_data(
    usable: pd.DataFrame,
    names: list[str],
    parameters: pd.DataFrame,
    settings: StudySettings,
    images: Mapping[str, NDArray[np.float32]] | None = None,
) -> BenchmarkData:
    """Build the tables of all protocols from radiographs with a located region.

    Parameters
    ----------
    usable : DataFrame
        Radiographs with a located region: radiograph, knee, subject, grade, protocol and features.
    names : list of str
        Names of the features.
    parameters : DataFrame
        Knee parameters, from `statistics.analyses.knee_parameters.extract_knee_parameters`.
    settings : StudySettings
        Study settings; the reference protocol is used for training.
    images : mapping of str to (size, size) float32 array, dimensionless, optional
        Image of each radiograph, from `small_network.make_network_input`. If None, no network is trained.

    Returns
    -------
    BenchmarkData
        Predictor tables and images of the data set.

    Raises
    ------
    InputError
        No region is located under the training protocol.
    """
    if not (usable["protocol"] == settings.reference).any():
        raise InputError(
            f"at least one region must be located under {settings.reference}, got 0: "
            "the baselines are trained on this protocol"
        )
    known = {}
    for protocol in list_protocols(usable, settings.reference):
        part = usable[usable["protocol"] == protocol]
        table = build_predictor_table(part, names, parameters, replace(settings, reference=protocol))
        known[protocol] = table.assign(radiograph=part["radiograph"].to_numpy())
    return BenchmarkData(known, names, images)


def make_splits(manifest: pd.DataFrame, settings: StudySettings) -> pd.DataFrame:
    """Make the fixed splits of all subjects in a manifest, including subjects without a located region.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: subject and grade.
    settings : StudySettings
        Study settings; seed and number of splits are used.

    Returns
    -------
    DataFrame
        Columns repeat, subject and part (training, validation or test).

    Raises
    ------
    InputError
        A grade has fewer than three subjects.
    """
    tables = [
        split_subjects(manifest["subject"], manifest["grade"], seed=settings.seed, repeat=repeat).to_table()
        for repeat in range(settings.repeats)
    ]
    return pd.concat([table.assign(repeat=k) for k, table in enumerate(tables)], ignore_index=True)


def predict_baselines(
    films: BenchmarkData, splits: pd.DataFrame, settings: StudySettings, execution: Execution
) -> pd.DataFrame:
    """Train all baselines on every split, and predict the classes of the test subjects.

    Parameters
    ----------
    films : BenchmarkData
        Tables and images of the data set.
    splits : DataFrame
        Splits from `make_splits`.
    settings : StudySettings
        Settings of models and splits.
    execution : Execution
        Workers, scheduler, timer and progress bar.

    Returns
    -------
    DataFrame
        Predictions, with the columns of `predictions.SplitOutcome.predictions`; the column ``model`` is one of
        `PREDICTORS`.

    Raises
    ------
    InputError
        No split contains the grades of a task, or a worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    shared = {"films": films, "splits": splits, "settings": settings}
    rows = map_splits(predict_baselines_split, range(settings.repeats), shared, execution, "baselines")
    predictions = pd.DataFrame([row for of_split in rows for row in of_split])
    if predictions.empty:
        grades = sorted({int(grade) for table in films.predictor_tables.values() for grade in table["grade"]})
        raise InputError(
            "grades with a located region must include all grades of at least one task among "
            f"{', '.join(BENCHMARK_TASKS)}, got {grades}"
        )
    return predictions


def explain_missing_network() -> str:
    """Explain why no network is trained.

    Returns
    -------
    str
        Text with the reason; "" if PyTorch is installed.
    """
    return "" if is_pytorch_installed() else PYTORCH_MISSING


def predict_baselines_split(
    repeat: int, *, films: BenchmarkData, splits: pd.DataFrame, settings: StudySettings, code: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Train all baselines on one split, and predict the classes of the test subjects.

    Parameters
    ----------
    repeat : int
        Index of the split, starting at 0.
    films : BenchmarkData
        Tables and images of the data set.
    splits : DataFrame
        Splits from `make_splits`.
    settings : StudySettings
        Settings of models and splits.
    code : mapping of str to str
        Code hashes of the process that started the run, keyed by subpackage.

    Returns
    -------
    list of dict
        Rows of the table that `predict_baselines` returns.

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    split = splits[splits["repeat"] == repeat]
    people = {part: set(split.loc[split["part"] == part, "subject"]) for part in PARTS}
    reference, seed = next(iter(films.predictor_tables)), derive_split_seed(settings.seed, repeat)
    first = films.predictor_tables[reference]
    rows: list[dict[str, Any]] = []
    for task, classes in find_tasks(first["grade"]).items():
        grades = sum(classes, ())
        training, validation = (
            first[first["subject"].isin(people[part]) & first["grade"].isin(grades)] for part in PARTS[:2]
        )
        if task not in BENCHMARK_TASKS or set(_find_truth(training, classes)) != set(range(len(classes))):
            continue
        for name, model in _fit_models(films, training, validation, classes, settings, seed).items():
            for protocol, table in films.predictor_tables.items():
                test = table[table["subject"].isin(people["test"]) & table["grade"].isin(grades)]
                if test.empty or (name in _KNEE_PREDICTORS and protocol != reference):
                    continue
                scenario = "within" if protocol == reference else "cross"
                arm = {"task": task, "scenario": scenario, "trained_on": reference, "tested_on": protocol}
                arm |= {"model": name, "selection": NO_SELECTION, "protocol": protocol}
                rows += _build_prediction_rows(test, classes, model(test), {**arm, "repeat": repeat})
    return rows


def _fit_models(
    films: BenchmarkData,
    training: pd.DataFrame,
    validation: pd.DataFrame,
    classes: Classes,
    settings: StudySettings,
    seed: int,
) -> dict[str, Model]:
    """Fit every baseline; return, by name, a function from a table to class probabilities (rows, classes)."""
    truths = [_find_truth(part, classes) for part in (training, validation)]
    models: dict[str, Model] = {}
    for name, predictor_set in find_predictor_sets(training, films.names).items():
        if name in PREDICTORS:
            fitted = fit_predictor_set(predictor_set, (training, truths[0]), (validation, truths[1]), settings, seed)
            models[name] = partial(_predict_probabilities, fitted, predictor_set)
    if films.images is not None:
        shown = [
            (_stack_images(films, part), truth) for part, truth in zip((training, validation), truths, strict=True)
        ]
        network = train_network(shown[0], shown[1], len(classes), seed=seed)
        models["cnn"] = lambda test: network(_stack_images(films, test))
    return models


def _predict_probabilities(fitted: FittedModel, predictor_set: PredictorSet, test: pd.DataFrame) -> NDArray[np.float64]:
    """Predict the class probabilities (rows, classes) of a table with a fitted predictor set."""
    return np.asarray(fitted.pipeline.predict_proba(test[predictor_set.columns]), np.float64)


def _stack_images(films: BenchmarkData, table: pd.DataFrame) -> NDArray[np.float32]:
    """Stack the images of all radiographs in a table as an array (rows, size, size)."""
    assert films.images is not None
    side = next(iter(films.images.values())).shape[0]
    shown = [films.images[name] for name in table["radiograph"]]
    return np.stack(shown) if shown else np.zeros((0, side, side), np.float32)


def _find_truth(table: pd.DataFrame, classes: Classes) -> NDArray[np.int64]:
    """Find the class index of each table row, as a (rows,) array."""
    return find_class_indices(table["grade"].to_numpy(), classes)


def _build_prediction_rows(
    test: pd.DataFrame, classes: Classes, probability: NDArray[np.float64], arm: dict[str, Any]
) -> list[dict[str, Any]]:
    """Build the prediction rows of one combination of task, protocols and baseline."""
    whose = test[["radiograph", "knee", "subject"]].to_dict("records")
    return [
        {**arm, **one, "truth": int(truth), **{f"p{k}": float(p) for k, p in enumerate(of_one)}}
        for one, truth, of_one in zip(whose, _find_truth(test, classes), probability, strict=True)
    ]
