"""Final models: fitted to all subjects of the cohort and saved."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...design.classification_tasks import find_tasks, lowest_grades
from ...design.study_settings import StudySettings
from ..subject_split import split_subjects
from .classifiers import FittedModel, fit_with_parameters, tune_classifier
from .feature_selection import build_feature_pipeline
from .labelled_features import make_labelled_features


@dataclass(frozen=True, kw_only=True)
class RefittedModel:
    """Final model and its training data.

    Attributes
    ----------
    name : str
        Name of the model, used as file name.
    task : str
        Name of the classification task.
    grades : tuple of int
        Lowest grade of each class, in order of the classes.
    model : str
        Name of the classifier.
    selection : str
        Name of the feature selection.
    trained_on : tuple of str
        Protocols of the training radiographs.
    fitted : FittedModel
        Fitted pipeline, hyperparameters and feature importances.
    features : tuple of str
        Names of the selected features.
    subjects : int
        Number of training subjects.
    radiographs : int
        Number of training radiographs.
    """

    name: str
    task: str
    grades: tuple[int, ...]
    model: str
    selection: str
    trained_on: tuple[str, ...]
    fitted: FittedModel
    features: tuple[str, ...]
    subjects: int
    radiographs: int


def refit_models(
    table: pd.DataFrame, names: list[str], settings: StudySettings, trained_on: Mapping[str, Sequence[str]]
) -> Iterator[RefittedModel]:
    """Fit a model to all subjects for every task, feature selection, classifier and set of protocols.

    The hyperparameters are selected with the validation subjects of the first split. Feature selection and classifier
    are then fitted to all subjects. No subject remains for testing, so performance is estimated only from the splits.

    Parameters
    ----------
    table : DataFrame
        Radiographs with a located region: subject, grade, protocol and features.
    names : list of str
        Names of the features.
    settings : StudySettings
        Settings of models and splits.
    trained_on : mapping of str to sequence of str
        Protocols of each training set, keyed by the label of the set.

    Yields
    ------
    RefittedModel
        Final model for each task, feature selection, classifier and set of protocols.

    Raises
    ------
    InputError
        A grade has too few subjects.
    """
    split = split_subjects(table["subject"], table["grade"], seed=settings.seed)
    seed = int(np.random.SeedSequence(settings.seed, spawn_key=(0, 2)).generate_state(1)[0] >> 1)
    for label, protocols in trained_on.items():
        of_protocols = table[table["protocol"].isin(list(protocols))]
        for task, classes in find_tasks(of_protocols["grade"]).items():
            rows = of_protocols[of_protocols["grade"].isin(sum(classes, ()))]
            first = rows[rows["subject"].isin(split.training)]
            fit_on = make_labelled_features(first, names, classes)
            if len(set(fit_on[1])) < len(classes):
                continue  # At least one class has no located region under these protocols.
            check_on = make_labelled_features(rows[rows["subject"].isin(split.validation)], names, classes)
            whole = make_labelled_features(rows, names, classes)
            for selection in settings.selections:
                on_first, on_whole = (
                    build_feature_pipeline(
                        selection, rho=settings.rho, max_features=settings.most_features, seed=seed
                    ).fit(*part)
                    for part in (fit_on, whole)
                )
                for model in settings.models:
                    chosen = tune_classifier(on_first, model, fit_on, check_on, seed=seed).parameters
                    fitted = fit_with_parameters(on_whole, model, chosen, whole, seed=seed)
                    yield RefittedModel(
                        name=f"{model}_{selection}_{_task_slug(task)}_{label}",
                        task=task,
                        grades=lowest_grades(task),
                        model=model,
                        selection=selection,
                        trained_on=tuple(protocols),
                        fitted=fitted,
                        features=tuple(fitted.pipeline.named_steps["select"].kept_),
                        subjects=rows["subject"].nunique(),
                        radiographs=len(rows),
                    )


def _task_slug(task: str) -> str:
    """Convert a task name to text for a file name, such as "0v34" for "0 vs 3+4"."""
    return task.replace(" vs ", "v").replace("/", "").replace("+", "")
