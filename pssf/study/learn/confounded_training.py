"""Training on data in which age, BMI or imaging site is associated with grade, at a specified strength s.

For age and BMI, a fraction (1 + s)/2 of the training subjects with grade 2 is above the median. The same fraction of
the training subjects with grade 0 is below the median. Subsampling of the subjects sets these fractions; the number of
remaining subjects does not depend on s.

For the imaging site, a fraction (1 + s)/2 of the subjects with grade 2 is imaged under the second protocol. The same
fraction of the subjects with grade 0 is imaged under the reference protocol.

Test subjects are weighted so that confounder and grade are associated as in training, or not at all.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.processes.execution import Execution
from ...data.code_hash import require_same_code
from ..design.classification_tasks import TASKS
from ..design.study_settings import StudySettings
from ..predictions import find_class_indices
from ..statistics.features.reliability import list_protocols
from ..statistics.scores.metrics import weighted_scores
from .each_split import map_splits
from .models.classifiers import tune_classifier
from .models.feature_selection import build_feature_pipeline
from .subject_split import derive_split_seed, split_subjects

# Label of each confounder, keyed by column name.
CONFOUNDERS = {"age_years": "age", "bmi": "BMI", "site": "site (protocol)"}
CLASSES = TASKS["0 vs 2"]
# Minimum number of training subjects per grade.
_MIN_SUBJECTS_PER_GRADE = 4
# Second key of the random stream, after the split index; `incremental_value` and `response_curves` use other keys.
_STREAM = 4
_COLUMNS = ["repeat", "confounder", "strength", "model", "training_subjects", "test_subjects", "tied", "untied"]


@dataclass(frozen=True)
class ConfoundedSplit:
    """Radiographs of one split, with added columns for the value (``c``) and the level (``high``) of the confounder.

    Attributes
    ----------
    training : DataFrame
        Training radiographs, in which the confounder is associated with grade.
    validation : DataFrame
        Validation radiographs, in which the confounder is associated with grade as in training.
    test : DataFrame
        Test radiographs: one per knee for age and BMI; one per knee and protocol for the imaging site.
    """

    training: pd.DataFrame
    validation: pd.DataFrame
    test: pd.DataFrame


def evaluate_confounding(
    radiographs: pd.DataFrame, names: list[str], confounders: list[str], settings: StudySettings, execution: Execution
) -> pd.DataFrame:
    """Evaluate naive and adjusted models (grade 0 vs 2) on test subjects with and without the association.

    Parameters
    ----------
    radiographs : DataFrame
        Radiographs with a located region: knee, subject, grade, protocol, features; also age_years and bmi if known.
    names : list of str
        Names of the features.
    confounders : list of str
        Confounders, from `CONFOUNDERS`.
    settings : StudySettings
        Study settings of models and splits, and strengths of the association.
    execution : Execution
        Workers, scheduler, timer and progress bar.

    Returns
    -------
    DataFrame
        Columns: repeat, confounder, strength, model ("naive" or "adjusted"), training_subjects, test_subjects, tied
        (AUC with the association) and untied (AUC without the association).

    Raises
    ------
    InputError
        A worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    radiographs = radiographs[radiographs["grade"].isin(sum(CLASSES, ()))]
    shared = {"known": radiographs, "names": names, "confounders": confounders, "settings": settings}
    tables = map_splits(evaluate_confounding_split, range(settings.repeats), shared, execution, "confounders")
    return pd.DataFrame([row for rows in tables for row in rows], columns=_COLUMNS)


def evaluate_confounding_split(
    repeat: int,
    *,
    known: pd.DataFrame,
    names: list[str],
    confounders: list[str],
    settings: StudySettings,
    code: dict[str, str],
) -> list[dict[str, Any]]:
    """Evaluate naive and adjusted models on one split.

    Parameters
    ----------
    repeat : int
        Index of the split, starting at 0.
    known : DataFrame
        Table of radiographs, as for `evaluate_confounding`.
    names : list of str
        Names of the features.
    confounders : list of str
        Confounders, from `CONFOUNDERS`.
    settings : StudySettings
        Settings of models and splits.
    code : dict of str to str
        Code hashes of the process that started the run, keyed by subpackage.

    Returns
    -------
    list of dict
        Rows of the table that `evaluate_confounding` returns.

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    rows = []
    for confounder in confounders:
        for strength in settings.strengths:
            tie = build_confounded_split(known, confounder, strength, settings, repeat)
            if tie is not None:
                label = {"repeat": repeat, "confounder": confounder, "strength": strength}
                label |= {
                    "training_subjects": tie.training["subject"].nunique(),
                    "test_subjects": tie.test["subject"].nunique(),
                }
                rows += [label | scores for scores in _score_models(tie, names, strength, settings, repeat)]
    return rows


def build_confounded_split(
    radiographs: pd.DataFrame, confounder: str, strength: float, settings: StudySettings, repeat: int
) -> ConfoundedSplit | None:
    """Build one split in which a confounder is associated with grade.

    Parameters
    ----------
    radiographs : DataFrame
        Table of radiographs, as for `evaluate_confounding`.
    confounder : str
        Confounder, from `CONFOUNDERS`.
    strength : float
        Strength of the association, 0 to 0.95.
    settings : StudySettings
        Study settings; seed, reference protocol and strengths are used.
    repeat : int
        Index of the split, starting at 0.

    Returns
    -------
    ConfoundedSplit or None
        Radiographs of the split; None if there are too few subjects.
    """
    split = split_subjects(radiographs["subject"], radiographs["grade"], seed=settings.seed, repeat=repeat)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(repeat, _STREAM)))
    pools = [radiographs[radiographs["subject"].isin(of)] for of in (split.training, split.validation, split.test)]
    if confounder == "site":
        sites = list_protocols(radiographs, settings.reference)[:2]
        training, validation = (_assign_sites(pool, sites, strength, rng) for pool in pools[:2])
        return ConfoundedSplit(training, validation, _add_site_level(pools[2][pools[2]["protocol"].isin(sites)], sites))
    of_reference = [pool[pool["protocol"] == settings.reference] for pool in pools]
    middle = float(of_reference[0][confounder].median())
    leveled = [pool.assign(c=pool[confounder], high=pool[confounder] > middle) for pool in of_reference]
    training, validation = (_subsample_subjects(pool, strength, max(settings.strengths), rng) for pool in leveled[:2])
    if (
        training["grade"].nunique() < 2
        or training.groupby("grade")["subject"].nunique().min() < _MIN_SUBJECTS_PER_GRADE
    ):
        return None
    return ConfoundedSplit(training, validation, leveled[2])


def _is_matched(part: pd.DataFrame) -> NDArray[np.bool_]:
    """Report for each radiograph whether the confounder level is the level associated with its grade."""
    return np.asarray(part["high"].to_numpy(bool) == (part["grade"] == CLASSES[1][0]).to_numpy())


def _subsample_subjects(
    pool: pd.DataFrame, strength: float, strongest: float, rng: np.random.Generator
) -> pd.DataFrame:
    """Subsample each grade so that a fraction (1 + strength)/2 of its subjects has the associated level.

    The number of subjects is the largest number that is possible for every strength.
    """
    subjects = pool.drop_duplicates("subject")
    cells = {
        key: rng.permutation(part["subject"].to_numpy())
        for key, part in subjects.groupby([subjects["grade"], _is_matched(subjects)])
    }
    grades = sum(CLASSES, ())
    counts = [len(cells.get((grade, side), ())) for grade in grades for side in (True, False)]
    # The number of subjects is the same for all strengths, so that only the association differs.
    most = int(min(counts) * 2 / (1 + strongest))
    kept: list[Any] = []
    for grade in grades:
        on_side = round(most * (1 + strength) / 2)
        kept += [*cells.get((grade, True), ())[:on_side], *cells.get((grade, False), ())[: most - on_side]]
    return pool[pool["subject"].isin(kept)]


def _assign_sites(pool: pd.DataFrame, sites: list[str], strength: float, rng: np.random.Generator) -> pd.DataFrame:
    """Assign one of two protocols to each subject, so that protocol and grade are associated."""
    parts = []
    for place, (grade,) in enumerate(CLASSES):
        part = pool[pool["grade"] == grade]
        shuffled = rng.permutation(np.sort(part["subject"].unique()))
        own = set(shuffled[: round(len(shuffled) * (1 + strength) / 2)].tolist())
        site = np.where(part["subject"].isin(own), sites[place], sites[1 - place])
        parts.append(part[part["protocol"] == site])
    return _add_site_level(pd.concat(parts), sites)


def _add_site_level(table: pd.DataFrame, sites: list[str]) -> pd.DataFrame:
    """Add the columns ``c`` (1 for the second site, 0 for the first) and ``high`` (True for the second site)."""
    second = table["protocol"] == sites[1]
    return table.assign(c=second.astype(float), high=second)


def _score_models(
    confounded_split: ConfoundedSplit, names: list[str], strength: float, settings: StudySettings, repeat: int
) -> list[dict[str, Any]]:
    """Score the naive and the adjusted model on test subjects with and without the association."""
    seed = derive_split_seed(settings.seed, repeat)
    weights = np.stack([compute_cell_weights(confounded_split.test, tie_of) for tie_of in (strength, 0.0)], axis=1)
    rows = []
    for model in ("naive", "adjusted"):
        slopes = np.zeros(len(names)) if model == "naive" else fit_confounder_slopes(confounded_split.training, names)
        middle = float(confounded_split.training["c"].mean())
        parts = []
        for part in (confounded_split.training, confounded_split.validation, confounded_split.test):
            features = part[names] - np.outer(part["c"].to_numpy(float) - middle, slopes)
            parts.append((features, find_class_indices(part["grade"].to_numpy(), CLASSES)))
        prepared = build_feature_pipeline(
            settings.selections[0], rho=settings.rho, max_features=settings.most_features, seed=seed
        )
        fitted = tune_classifier(prepared.fit(*parts[0]), settings.models[0], *parts[:2], seed=seed)
        probability = fitted.pipeline.predict_proba(parts[2][0]).astype(np.float64)
        scores = weighted_scores(parts[2][1], probability, weights)["auc"]
        rows.append({"model": model, "tied": float(scores[0]), "untied": float(scores[1])})
    return rows


def compute_cell_weights(part: pd.DataFrame, strength: float) -> Array:
    """Compute weights for which confounder level and grade have an association of specified strength.

    Parameters
    ----------
    part : DataFrame
        Test radiographs: subject, grade, high.
    strength : float
        Strength of the association, 0 to 0.95.

    Returns
    -------
    (rows,) float array
        Weight of each row, dimensionless; NaN if a combination of confounder level and grade is missing.
    """
    matched = _is_matched(part)
    sizes = part.groupby([part["grade"], matched])["subject"].transform("size").to_numpy(float)
    weights = np.where(matched, 1 + strength, 1 - strength) / sizes
    whole = len(part.groupby([part["grade"], matched])) == 2 * len(CLASSES)
    return weights if whole else np.full(len(part), np.nan)


def fit_confounder_slopes(training: pd.DataFrame, names: list[str]) -> Array:
    """Fit the slope of each feature against the confounder by least squares, with a separate intercept for each grade.

    Parameters
    ----------
    training : DataFrame
        Training radiographs: grade, c and features.
    names : list of str
        Names of the features.

    Returns
    -------
    (features,) float array
        Slopes, in units of the feature per unit of the confounder; 0 for a feature with missing values.
    """
    design = np.column_stack([np.ones(len(training)), training["grade"] == CLASSES[1][0], training["c"]]).astype(float)
    values = training[names].to_numpy(np.float64)
    whole = np.isfinite(values).all(axis=0)
    slopes = np.zeros(len(names))
    if np.linalg.matrix_rank(design) == design.shape[1]:
        slopes[whole] = np.linalg.lstsq(design, values[:, whole], rcond=None)[0][2]
    return slopes
