"""Confounders by design: what a model learns where age, BMI or site goes with grade, as strongly as is chosen.

Of a strength s, a share (1 + s)/2 of the subjects of grade 2 that a model learns from are above the median of age or
BMI, and as many of grade 0 below it; subjects are left out until it is so, as many whatever the strength. Of the site,
that share of the subjects of grade 2 is taken under the second protocol and of grade 0 under the reference. The tested
subjects are weighted, so that what is above and below is tied to grade as in training, or not at all.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.execution import Execution
from ...data.code import require_code
from ..predictions import class_of
from ..settings import StudySettings
from ..statistics.metrics import weighted_scores
from ..statistics.reliability import protocols_of
from ..tasks import TASKS
from .each_split import each_split
from .models import tune
from .selection import preparation
from .split import seed_of_split, split_subjects

CONFOUNDERS = {"age_years": "age", "bmi": "BMI", "site": "site (protocol)"}
CLASSES = TASKS["0 vs 2"]
_FEWEST = 4  # subjects of a grade to learn from
_STREAM = 4  # key under a repeat, beside those of `ladder` and `responses`
_COLUMNS = ["repeat", "confounder", "strength", "model", "trained", "test_subjects", "tied", "untied"]


@dataclass(frozen=True)
class Tie:
    """Radiographs of a split with a confounder in the column `c` and whether it is `high` in each.

    test  of each tested subject and level that it has: once, but of a site under both
    """

    training: pd.DataFrame
    validation: pd.DataFrame
    test: pd.DataFrame


def confound(
    known: pd.DataFrame, names: list[str], confounders: list[str], settings: StudySettings, execution: Execution
) -> pd.DataFrame:
    """AUC of grade 0 against 2, of a naive and an adjusted model, tested where the confounder goes with grade and not.

    known        radiographs with a region: knee, subject, grade, protocol, features, age_years, bmi
    confounders  of CONFOUNDERS
    returns      repeat, confounder, strength, model (naive | adjusted), trained, test_subjects, tied, untied (AUC)
    raises       WorkersLostError when workers keep being killed
    """
    known = known[known["grade"].isin(sum(CLASSES, ()))]
    shared = {"known": known, "names": names, "confounders": confounders, "settings": settings}
    tables = each_split(confound_split, range(settings.repeats), shared, execution, "confounders")
    return pd.DataFrame([row for rows in tables for row in rows], columns=_COLUMNS)


def confound_split(
    repeat: int,
    *,
    known: pd.DataFrame,
    names: list[str],
    confounders: list[str],
    settings: StudySettings,
    code: dict[str, str],
) -> list[dict[str, Any]]:
    """Rows of `confound` of one split.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    rows = []
    for confounder in confounders:
        for strength in settings.strengths:
            tie = tied(known, confounder, strength, settings, repeat)
            if tie is not None:
                label = {"repeat": repeat, "confounder": confounder, "strength": strength}
                label |= {"trained": tie.training["subject"].nunique(), "test_subjects": tie.test["subject"].nunique()}
                rows += [label | scores for scores in _scored(tie, names, strength, settings, repeat)]
    return rows


def tied(known: pd.DataFrame, confounder: str, strength: float, settings: StudySettings, repeat: int) -> Tie | None:
    """The radiographs of a split with a confounder tied to grade; None where subjects are too few for it.

    known  of `confound`
    """
    split = split_subjects(known["subject"], known["grade"], seed=settings.seed, repeat=repeat)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(repeat, _STREAM)))
    pools = [known[known["subject"].isin(of)] for of in (split.training, split.validation, split.test)]
    if confounder == "site":
        sites = protocols_of(known, settings.reference)[:2]
        training, validation = (_at_sites(pool, sites, strength, rng) for pool in pools[:2])
        return Tie(training, validation, _leveled(pools[2][pools[2]["protocol"].isin(sites)], sites))
    of_reference = [pool[pool["protocol"] == settings.reference] for pool in pools]
    middle = float(of_reference[0][confounder].median())
    leveled = [pool.assign(c=pool[confounder], high=pool[confounder] > middle) for pool in of_reference]
    training, validation = (_thinned(pool, strength, max(settings.strengths), rng) for pool in leveled[:2])
    if training["grade"].nunique() < 2 or training.groupby("grade")["subject"].nunique().min() < _FEWEST:
        return None
    return Tie(training, validation, leveled[2])


def _matched(part: pd.DataFrame) -> NDArray[np.bool_]:
    """(rows,) whether a radiograph's level is the one that its grade is tied to"""
    return np.asarray(part["high"].to_numpy(bool) == (part["grade"] == CLASSES[1][0]).to_numpy())


def _thinned(pool: pd.DataFrame, strength: float, strongest: float, rng: np.random.Generator) -> pd.DataFrame:
    """Of each grade so many subjects, of whom (1 + strength)/2 are on the side that it is tied to.

    strongest  for which there must be enough of them too
    """
    subjects = pool.drop_duplicates("subject")
    cells = {
        key: rng.permutation(part["subject"].to_numpy())
        for key, part in subjects.groupby([subjects["grade"], _matched(subjects)])
    }
    grades = sum(CLASSES, ())
    counts = [len(cells.get((grade, side), ())) for grade in grades for side in (True, False)]
    # As many whatever the strength, up to the strongest.
    most = int(min(counts) * 2 / (1 + strongest))
    kept: list[Any] = []
    for grade in grades:
        on_side = round(most * (1 + strength) / 2)
        kept += [*cells.get((grade, True), ())[:on_side], *cells.get((grade, False), ())[: most - on_side]]
    return pool[pool["subject"].isin(kept)]


def _at_sites(pool: pd.DataFrame, sites: list[str], strength: float, rng: np.random.Generator) -> pd.DataFrame:
    """Each subject under one of two protocols."""
    parts = []
    for place, (grade,) in enumerate(CLASSES):
        part = pool[pool["grade"] == grade]
        shuffled = rng.permutation(np.sort(part["subject"].unique()))
        own = set(shuffled[: round(len(shuffled) * (1 + strength) / 2)].tolist())
        site = np.where(part["subject"].isin(own), sites[place], sites[1 - place])
        parts.append(part[part["protocol"] == site])
    return _leveled(pd.concat(parts), sites)


def _leveled(table: pd.DataFrame, sites: list[str]) -> pd.DataFrame:
    second = table["protocol"] == sites[1]
    return table.assign(c=second.astype(float), high=second)


def _scored(tie: Tie, names: list[str], strength: float, settings: StudySettings, repeat: int) -> list[dict[str, Any]]:
    """Model and its two AUCs."""
    seed = seed_of_split(settings.seed, repeat)
    weights = np.stack([cell_weights(tie.test, tie_of) for tie_of in (strength, 0.0)], axis=1)
    rows = []
    for model in ("naive", "adjusted"):
        slopes = np.zeros(len(names)) if model == "naive" else slopes_on(tie.training, names)
        middle = float(tie.training["c"].mean())
        parts = []
        for part in (tie.training, tie.validation, tie.test):
            features = part[names] - np.outer(part["c"].to_numpy(float) - middle, slopes)
            parts.append((features, class_of(part["grade"].to_numpy(), CLASSES)))
        prepared = preparation(settings.selections[0], rho=settings.rho, most=settings.most_features, seed=seed)
        fitted = tune(prepared.fit(*parts[0]), settings.models[0], *parts[:2], seed=seed)
        probability = fitted.pipeline.predict_proba(parts[2][0]).astype(np.float64)
        scores = weighted_scores(parts[2][1], probability, weights)["auc"]
        rows.append({"model": model, "tied": float(scores[0]), "untied": float(scores[1])})
    return rows


def cell_weights(part: pd.DataFrame, strength: float) -> Array:
    """(rows,) weights that tie a level to grade so strongly, whatever the counts; NaN where a level lacks a grade."""
    matched = _matched(part)
    sizes = part.groupby([part["grade"], matched])["subject"].transform("size").to_numpy(float)
    weights = np.where(matched, 1 + strength, 1 - strength) / sizes
    whole = len(part.groupby([part["grade"], matched])) == 2 * len(CLASSES)
    return weights if whole else np.full(len(part), np.nan)


def slopes_on(training: pd.DataFrame, names: list[str]) -> Array:
    """(features,) slope of each feature on the confounder at a given grade, by least squares; 0 of one with a hole.

    training  grade, c, features
    """
    design = np.column_stack([np.ones(len(training)), training["grade"] == CLASSES[1][0], training["c"]]).astype(float)
    values = training[names].to_numpy(np.float64)
    whole = np.isfinite(values).all(axis=0)
    slopes = np.zeros(len(names))
    if np.linalg.matrix_rank(design) == design.shape[1]:
        slopes[whole] = np.linalg.lstsq(design, values[:, whole], rcond=None)[0][2]
    return slopes
