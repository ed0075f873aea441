"""How a model answers where a protocol leaves what it has learnt: the same test knees, a step at a time."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logit

from ...core.execution import Execution
from ...data.code import require_code
from ..predictions import class_of
from ..settings import StudySettings
from ..statistics.metrics import auc
from ..statistics.subjects import worst_grades
from ..statistics.tested import TESTED, count_tested
from ..tasks import TASKS, Classes, contrast_of
from .each_split import each_split
from .models import tune
from .selection import preparation
from .split import seed_of_split

_SPLIT = 3  # key of the stream under a repeat, beside that of `ladder`
_VALIDATION = 0.15
_CLIP = 1e-6
_COLUMNS = ["repeat", "axis", "turn", "trained", "curved", *TESTED, "auc", "auc_own", "shift"]


@dataclass(frozen=True)
class Halves:
    """Subjects of a split of response curves; no subject is in two parts."""

    training: list[Any]
    validation: list[Any]
    test: list[Any]


def split_curves(base: pd.DataFrame, curved: list[Any], seed: int, repeat: int) -> Halves:
    """Half of the subjects with curves are tested; of all others 15 per cent validate, and the rest is learnt from.

    base    one row a radiograph: subject, grade
    curved  subjects with curves
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(repeat, _SPLIT)))
    worst = worst_grades(base["subject"], base["grade"])
    parts: dict[str, list[Any]] = {"training": [], "validation": [], "test": []}
    for grade in sorted(set(worst)):
        members = worst.index[worst == grade]
        shuffled = rng.permutation([one for one in members if one in set(curved)]).tolist()
        parts["test"] += shuffled[: len(shuffled) // 2]
        others = rng.permutation([one for one in members if one not in set(parts["test"])]).tolist()
        held = max(1, round(_VALIDATION * len(others)))
        parts["validation"] += others[:held]
        parts["training"] += others[held:]
    return Halves(**{name: sorted(subjects) for name, subjects in parts.items()})


def respond(
    base: pd.DataFrame, steps: pd.DataFrame, names: list[str], settings: StudySettings, execution: Execution
) -> pd.DataFrame:
    """What models of the reference make of every step, split by split: of the contrast that the steps' grades are of.

    The first model and selection of the settings, whatever their results.

    base     radiographs of the cohort under the reference, with a region: knee, subject, grade, features
    steps    radiographs along the axes, with a region: knee, subject, grade, kind (axis), turn, features
    returns  repeat, axis, turn, trained, curved (subjects of whom half are tested), TESTED; auc, and auc_own of
             the same knees as the cohort has them; shift: mean change of the log odds of the worse class, by which
             a threshold would have to move
    raises   WorkersLostError when workers keep being killed
    """
    classes = TASKS[contrast_of(steps["grade"])]
    base, steps = (table[table["grade"].isin(sum(classes, ()))] for table in (base, steps))
    shared = {"base": base, "steps": steps, "names": names, "settings": settings, "classes": classes}
    tables = each_split(respond_split, range(settings.repeats), shared, execution, "response curves")
    return pd.DataFrame([row for rows in tables for row in rows], columns=_COLUMNS)


def respond_split(
    repeat: int,
    *,
    base: pd.DataFrame,
    steps: pd.DataFrame,
    names: list[str],
    settings: StudySettings,
    classes: Classes,
    code: dict[str, str],
) -> list[dict[str, Any]]:
    """Rows of `respond` of one split.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    curved = sorted(set(steps["subject"]) & set(base["subject"]))
    halves = split_curves(base, curved, settings.seed, repeat)
    seed = seed_of_split(settings.seed, repeat)
    training, validation, test = (
        base[base["subject"].isin(of)] for of in (halves.training, halves.validation, halves.test)
    )
    fit_on, check_on = ((part[names], class_of(part["grade"].to_numpy(), classes)) for part in (training, validation))
    if len(set(fit_on[1])) < len(classes):
        return []
    prepared = preparation(settings.selections[0], rho=settings.rho, most=settings.most_features, seed=seed)
    fitted = tune(prepared.fit(*fit_on), settings.models[0], fit_on, check_on, seed=seed)

    def odds(part: pd.DataFrame) -> pd.Series:
        p = fitted.pipeline.predict_proba(part[names])[:, 1].astype(np.float64)
        return pd.Series(logit(np.clip(p, _CLIP, 1 - _CLIP)), index=part["knee"].to_numpy())

    own = odds(test)
    rows = []
    for (axis, turn), part in steps[steps["knee"].isin(own.index)].groupby(["kind", "turn"], sort=False):
        here, positive = odds(part), part["grade"].isin(classes[1]).to_numpy()
        before = own.loc[here.index]
        row = {"repeat": repeat, "axis": axis, "turn": int(turn), "trained": len(halves.training)}
        row |= {"curved": len(curved), "shift": float((here - before).mean())}
        row |= count_tested(part["subject"], positive, (False, True))
        scores = {"auc": auc(positive, here.to_numpy()), "auc_own": auc(positive, before.to_numpy())}
        rows.append(row | scores)
    return rows
