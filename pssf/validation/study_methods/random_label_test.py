"""Random-label test: evaluation of the study claims on cohorts with random grades, in which no claim may hold.

Feature tables are synthetic and contain no information about the grade. Feature names and correlations resemble those
of radiographs. The module needs the optional dependencies ``study``.
"""

import numpy as np
import pandas as pd

from ...core.processes.parallel_map import map_in_parallel
from ...study import StudySettings
from ...study.learn.protocol_scenarios import evaluate_split
from ...study.predictions import concatenate_tables
from ...study.statistics.features.reliability import compute_reliability
from ...study.statistics.result_tables import build_model_tables
from ...study.statistics.scores.claims import evaluate_claims
from ..raycasting.raycast_engines import Row

# Synthetic features. They include the features that the trend claims need and the families that the importance claim
# needs; two thirds are texture features, as in a study.
FEATURE_NAMES = [
    *("firstorder_linear_Mean", "firstorder_linear_Energy", "glcm_Contrast", "glcm_JointEntropy"),
    *("glcm_DifferenceAverage", "glcm_Id", "glszm_a", "glszm_b", "glrlm_a", "shape2D_a"),
]
# Two models are needed, because one claim concerns logistic regression and another claim concerns any other model.
SETTINGS = StudySettings(models=("lr", "xgb"), selections=("l1",), repeats=8, replicates=400)
# Claim that is omitted, because feature stability does not depend on labels and random labels cannot refute it.
_LABEL_FREE_CLAIM = "A subset of features is stable"


def sample_random_label_cohort(seed: int, subjects: int = 90) -> pd.DataFrame:
    """Sample a feature table with random grades.

    Each subject has one knee and a radiograph under each of two protocols. Two latent factors correlate the features.

    Parameters
    ----------
    seed : int
        Seed of the cohort.
    subjects : int, default 90
        Number of subjects.

    Returns
    -------
    pandas.DataFrame
        One row per radiograph.
    """
    rng = np.random.default_rng([20, seed])
    grade = rng.permutation(np.arange(subjects) % 3)
    load = rng.normal(size=(2, len(FEATURE_NAMES)))
    own = rng.normal(size=(subjects, 2)) @ load + rng.normal(size=(subjects, len(FEATURE_NAMES)))
    parts = []
    for protocol in ("reference", "other"):
        values = own + 0.3 * rng.normal(size=own.shape) + (protocol == "other") * rng.normal(size=len(FEATURE_NAMES))
        table = pd.DataFrame(values, columns=FEATURE_NAMES).assign(
            subject=range(subjects), knee=range(subjects), grade=grade
        )
        parts.append(table.assign(protocol=protocol, radiograph=[f"{k}_{protocol}" for k in range(subjects)]))
    return concatenate_tables(parts)


def count_false_claims(workers: int, cohorts: int = 20) -> list[Row]:
    """Count the random-label cohorts in which each claim holds, and the cohorts in which it does not hold.

    Parameters
    ----------
    workers : int
        Number of worker processes.
    cohorts : int, default 20
        Number of cohorts.

    Returns
    -------
    list of dict
        One row per claim. ``held`` counts the cohorts in which at least one measure of the claim holds. ``refuted``
        counts the cohorts in which at least one measure does not hold.

    Notes
    -----
    A claim may be undecidable in a cohort; such a cohort is counted in neither column. The test requires that no claim
    holds, not that every claim is refuted.
    """
    tables = map_in_parallel(_evaluate_claims, range(cohorts), shared={}, workers=workers)
    verdicts = concatenate_tables(table.assign(seed=seed) for seed, table in enumerate(tables))
    keys, counts = [verdicts["claim"], verdicts["seed"]], {}
    for column, verdict in (("held", "holds"), ("refuted", "does not hold")):
        of_cohorts = (verdicts["verdict"] == verdict).groupby(keys, sort=False).any()
        counts[column] = of_cohorts.groupby("claim", sort=False).sum().drop(_LABEL_FREE_CLAIM)
    table = pd.DataFrame(counts).rename_axis("claim").reset_index()
    return [{**row, "cohorts": cohorts} for row in table.to_dict("records")]


def _evaluate_claims(seed: int) -> pd.DataFrame:
    """Evaluate the claims of one cohort with random labels."""
    table = sample_random_label_cohort(seed)
    outcomes = [evaluate_split(r, table=table, names=FEATURE_NAMES, settings=SETTINGS) for r in range(SETTINGS.repeats)]
    tables = build_model_tables(outcomes, SETTINGS)
    tables["reliability"] = compute_reliability(table, FEATURE_NAMES, "reference", replicates=100)
    predictions, importances, offered = (
        concatenate_tables(getattr(one, name) for one in outcomes)
        for name in ("predictions", "importances", "selection_candidates")
    )
    return evaluate_claims(table, predictions, importances, offered, tables, SETTINGS)
