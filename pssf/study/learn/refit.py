"""The models that are kept: each is fitted once more, to all subjects of the cohort."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..settings import StudySettings
from ..tasks import least_grades, tasks_of
from .models import Fitted, refit, tune
from .scenarios import part_of
from .selection import preparation
from .split import split_subjects


@dataclass(frozen=True, kw_only=True)
class Kept:
    """A model that is kept, and what it has learnt from.

    trained_on   protocols, one or all of the cohort's
    grades       the least of each class, in their order
    """

    name: str
    task: str
    grades: tuple[int, ...]
    model: str
    selection: str
    trained_on: tuple[str, ...]
    fitted: Fitted
    features: tuple[str, ...]
    subjects: int
    radiographs: int


def refitted(
    table: pd.DataFrame, names: list[str], settings: StudySettings, trained_on: Mapping[str, Sequence[str]]
) -> Iterator[Kept]:
    """Every task, selection and model of the settings, on each set of protocols.

    The parameters are those that the first split's validation subjects choose; features are selected and models fitted
    anew on all subjects, so that no subject is left to say how good they are: that the splits say.

    table       radiographs with a region found: subject, grade, protocol, features
    names       of the features
    trained_on  how a set of protocols is called, and which they are
    """
    split = split_subjects(table["subject"], table["grade"], seed=settings.seed)
    seed = int(np.random.SeedSequence(settings.seed, spawn_key=(0, 2)).generate_state(1)[0] >> 1)
    for label, protocols in trained_on.items():
        of_protocols = table[table["protocol"].isin(list(protocols))]
        for task, classes in tasks_of(of_protocols["grade"]).items():
            rows = of_protocols[of_protocols["grade"].isin(sum(classes, ()))]
            first = rows[rows["subject"].isin(split.training)]
            fit_on = part_of(first, names, classes)
            if len(set(fit_on[1])) < len(classes):
                continue  # all regions of a grade were refused under these protocols
            check_on = part_of(rows[rows["subject"].isin(split.validation)], names, classes)
            whole = part_of(rows, names, classes)
            for selection in settings.selections:
                on_first, on_whole = (
                    preparation(selection, rho=settings.rho, most=settings.most_features, seed=seed).fit(*part)
                    for part in (fit_on, whole)
                )
                for model in settings.models:
                    chosen = tune(on_first, model, fit_on, check_on, seed=seed).parameters
                    fitted = refit(on_whole, model, chosen, whole, seed=seed)
                    yield Kept(
                        name=f"{model}_{selection}_{_short(task)}_{label}",
                        task=task,
                        grades=least_grades(task),
                        model=model,
                        selection=selection,
                        trained_on=tuple(protocols),
                        fitted=fitted,
                        features=tuple(fitted.pipeline.named_steps["select"].kept_),
                        subjects=rows["subject"].nunique(),
                        radiographs=len(rows),
                    )


def _short(task: str) -> str:
    """A task as part of a file's name."""
    return task.replace(" vs ", "v").replace("/", "").replace("+", "")
