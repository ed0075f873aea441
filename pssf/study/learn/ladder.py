"""What a grade can be told by, a rung at a time: true parameters, true and measured joint space, features, and both.

Every rung is logistic regression on the same splits, under the reference protocol, of grade 0 against each other one:
rungs differ by what is known alone. Joint spaces that stand beside features pass selection by, so that features are
asked for what they add.
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

from ...core.execution import Execution
from ...data.code import require_code
from ...radiomics.families import TEXTURES, family
from ..predictions import class_of
from ..settings import StudySettings
from ..statistics.metrics import auc
from ..statistics.parameters import PARAMETERS
from ..statistics.subjects import worst_grades
from ..statistics.tested import TESTED, count_tested
from .each_split import each_split
from .models import Fitted, tune
from .scenarios import Part
from .selection import preparation
from .split import Split, seed_of_split, split_subjects

RUNGS = {
    "parameters": "all true parameters",
    "jsw": "true JSW",
    "measured": "measured JSW",
    "radiomics": "radiomics",
    "texture": "measured JSW and texture",
    "both": "measured JSW and radiomics",
}
# Standard error of a joint space measured by software on semiflexed films of one unit (Mazzuca 1999, J Rheumatol 26,
# 1359; 174 knees radiographed twice): positioning is in it.
READING_SD_MM = 0.32
_SPACES = ("medial", "lateral", "least")
_NOMINAL = ("nominal_jsw_medial_mm", "nominal_jsw_lateral_mm")
_TRUE, _MEASURED = (tuple(f"{kind}_{name}_mm" for name in _SPACES) for kind in ("true", "measured"))
_READING, _THINNING = 2**31 + 5, 2  # keys of streams under a seed and under a split's
_COLUMNS = ["grades", "rung", "repeat", "trained", *TESTED, "auc"]


@dataclass(frozen=True)
class Job:
    """A split, of whose subjects to learn from a share is taken."""

    repeat: int
    share: float = 1.0


@dataclass(frozen=True)
class Rung:
    """Columns that are selected from, and those that are known whatever a selection says."""

    selected: tuple[str, ...]
    always: tuple[str, ...]

    @property
    def columns(self) -> list[str]:
        """All of them."""
        return [*self.always, *self.selected]


class SelectBeside(TransformerMixin, BaseEstimator):
    """What a preparation selects of some columns, and other columns beside it, standardised.

    prepare  unfitted `selection.preparation`, or None where nothing is selected
    always   names of the columns beside
    """

    def __init__(self, prepare: Pipeline | None, always: Sequence[str]) -> None:
        self.prepare = prepare
        self.always = always

    def fit(self, X: pd.DataFrame, y: Any = None) -> "SelectBeside":
        self.scale_ = StandardScaler().fit(X[list(self.always)]) if self.always else None
        if self.prepare is not None:
            self.prepare.fit(X.drop(columns=list(self.always)), y)
        chosen = [] if self.prepare is None else self.prepare.named_steps["select"].kept_
        self.kept_ = [*self.always, *chosen]
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        parts = []
        if self.scale_ is not None:
            columns = list(self.always)
            parts.append(pd.DataFrame(self.scale_.transform(X[columns]), columns=columns, index=X.index))
        if self.prepare is not None:
            parts.append(self.prepare.transform(X.drop(columns=list(self.always))))
        return pd.concat(parts, axis=1)


def known_of(usable: pd.DataFrame, names: list[str], parameters: pd.DataFrame, settings: StudySettings) -> pd.DataFrame:
    """One row a radiograph of the reference: knee, subject, grade, features, parameters, spaces true and measured.

    A measured space is the true one with the error of a reading, drawn for each knee and compartment apart.

    parameters  of `parameters.parameters_of`; what it lacks, and rungs of it, are left out
    """
    part = usable[usable["protocol"] == settings.reference][["knee", "subject", "grade", *names]]
    columns = [name for name in PARAMETERS if name in parameters]
    known = part.merge(parameters[["knee", *columns]], on="knee", how="left")
    if set(_NOMINAL) <= set(known):
        true = known[list(_NOMINAL)].to_numpy(np.float64)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(_READING,)))
        # Of all knees in their order, so that a refused radiograph changes no other knee's reading.
        places = np.searchsorted(np.sort(parameters["knee"].to_numpy()), known["knee"].to_numpy())
        read = true + READING_SD_MM * rng.standard_normal((len(parameters), 2))[places]
        for columns_of, values in ((_TRUE, true), (_MEASURED, read)):
            known[list(columns_of)] = np.column_stack([values, values.min(axis=1)])
    return known


def rungs_of(known: pd.DataFrame, names: list[str]) -> dict[str, Rung]:
    """Those of RUNGS that a table of `known_of` has the columns of.

    names  of the features
    """
    columns = tuple(name for name in PARAMETERS if name in known)
    textures = tuple(name for name in names if family(name) in TEXTURES)
    read = _MEASURED if set(_MEASURED) <= set(known) else ()
    rungs = {
        "parameters": Rung((), (*columns, "true_least_mm")) if read else Rung((), ()),
        "jsw": Rung((), _TRUE if read else ()),
        "measured": Rung((), read),
        "radiomics": Rung(tuple(names), ()),
        "texture": Rung(textures, read) if read and textures else Rung((), ()),
        "both": Rung(tuple(names), read) if read else Rung((), ()),
    }
    return {name: rung for name, rung in rungs.items() if rung.selected or rung.always}


def climb(
    known: pd.DataFrame,
    names: list[str],
    settings: StudySettings,
    execution: Execution,
    *,
    shares: Sequence[float] = (1.0,),
    rungs: Sequence[str] = tuple(RUNGS),
    stage: str = "ladder",
) -> pd.DataFrame:
    """AUC of every rung on every split, learnt from shares of the subjects that a split learns from.

    Of more than one share the stage gets as its growth the exponent of the seconds of a split in the subjects learnt
    from.

    known    of `known_of`
    names    of the features
    shares   of training and validation subjects of each grade, at least two; the smaller are among the larger, and
             the tested are the same for all
    rungs    of RUNGS; those that `known` lacks columns of are left out
    stage    of the execution's timer
    returns  grades (0 vs 1 and so on), rung, repeat, trained, TESTED, auc, share
    raises   InputError for too few subjects of a grade; WorkersLostError when workers keep being killed
    """
    jobs = [Job(repeat, share) for share in shares for repeat in range(settings.repeats)]
    chosen = {name: rung for name, rung in rungs_of(known, names).items() if name in rungs}
    shared = {"known": known, "rungs": chosen, "settings": settings}
    tables = each_split(climb_split, jobs, shared, execution, stage)
    timed = np.array([(job.share, rows[0]["seconds"]) for job, rows in zip(jobs, tables, strict=True) if rows])
    if len(timed) and np.ptp(timed[:, 0]) > 0:
        learnt, seconds = np.log(timed).T
        execution.timer.stages[stage].growth = float(np.polyfit(learnt, seconds, 1)[0])
    rows = [row | {"share": job.share} for job, of_job in zip(jobs, tables, strict=True) for row in of_job]
    return pd.DataFrame(rows, columns=[*_COLUMNS, "share"])


def climb_split(
    job: Job, *, known: pd.DataFrame, rungs: Mapping[str, Rung], settings: StudySettings, code: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Rows of `climb` of one job, and in each the seconds of work that all of them took.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here, or for too few subjects of a grade
    """
    require_code(code)
    began = process_time()
    split = split_subjects(known["subject"], known["grade"], seed=settings.seed, repeat=job.repeat)
    learnt = thinned(split, known, job, settings.seed)
    seed = seed_of_split(settings.seed, job.repeat)
    first, *others = sorted({int(grade) for grade in known["grade"]})
    rows = []
    for grade in others:
        part = known[known["grade"].isin((first, grade))]
        training, validation, test = (part[part["subject"].isin(of)] for of in (*learnt, split.test))
        label = {"grades": f"{first} vs {grade}", "repeat": job.repeat, "trained": training["subject"].nunique()}
        label |= count_tested(test["subject"], test["grade"], (first, grade))
        if training["grade"].nunique() == test["grade"].nunique() == 2:
            for name, value in _scores(training, validation, test, rungs, settings, seed, (first, grade)):
                rows.append({**label, "rung": name, "auc": value})
    seconds = process_time() - began
    return [row | {"seconds": seconds} for row in rows]


def thinned(split: Split, known: pd.DataFrame, job: Job, seed: int) -> list[list[Any]]:
    """Training and validation subjects, of each grade a share of each: two at least, the same first ones."""
    if job.share >= 1:
        return [split.training.tolist(), split.validation.tolist()]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(job.repeat, _THINNING)))
    worst = worst_grades(known["subject"], known["grade"])
    parts = []
    for subjects in (split.training, split.validation):
        kept: list[Any] = []
        for grade in sorted(set(worst)):
            members = rng.permutation([one for one in subjects if worst[one] == grade])
            kept += members[: max(2, round(job.share * len(members)))].tolist()
        parts.append(kept)
    return parts


def _scores(
    training: pd.DataFrame,
    validation: pd.DataFrame,
    test: pd.DataFrame,
    rungs: Mapping[str, Rung],
    settings: StudySettings,
    seed: int,
    grades: tuple[int, int],
) -> Iterator[tuple[str, float]]:
    """Rung and AUC; an arm that a grade is missing from has none."""
    classes = tuple((grade,) for grade in grades)
    truths = [class_of(part["grade"].to_numpy(), classes) for part in (training, validation, test)]
    for name, rung in rungs.items():
        fitted = fitted_rung(rung, (training, truths[0]), (validation, truths[1]), settings, seed)
        yield name, auc(truths[2] == 1, fitted.pipeline.predict_proba(test[rung.columns])[:, 1])


def fitted_rung(rung: Rung, training: Part, validation: Part, settings: StudySettings, seed: int) -> Fitted:
    """Logistic regression of what a rung knows, by the first selection of the settings.

    training, validation  table with the rung's columns, class index (rows,)
    """
    prepare = None
    if rung.selected:
        prepare = preparation(settings.selections[0], rho=settings.rho, most=settings.most_features, seed=seed)
    prepared = Pipeline([("select", SelectBeside(prepare, rung.always))])
    fit_on, check_on = ((table[rung.columns], truth) for table, truth in (training, validation))
    return tune(prepared.fit(*fit_on), "lr", fit_on, check_on, seed=seed)
