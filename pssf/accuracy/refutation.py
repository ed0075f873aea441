"""What the study says of a cohort that has nothing to say: labels drawn at random. No claim may hold there.

Feature tables are made up, with names and correlations like those of radiographs, since the answer must not be in them.
(Needs the extra `study`.)
"""

import numpy as np
import pandas as pd

from ..core.parallel import ordered_map
from ..study import StudySettings
from ..study.learn.scenarios import one_split
from ..study.predictions import joined
from ..study.statistics.claims import claims
from ..study.statistics.evidence import tables_of_models
from ..study.statistics.reliability import reliability
from .engines import Row

# Those of the trends, and two thirds of texture as a study has it; the families of the claim on importance among them.
NAMES = [
    *("firstorder_linear_Mean", "firstorder_linear_Energy", "glcm_Contrast", "glcm_JointEntropy"),
    *("glcm_DifferenceAverage", "glcm_Id", "glszm_a", "glszm_b", "glrlm_a", "shape2D_a"),
]
# Of logistic regression one claim is, and of any other model another one.
SETTINGS = StudySettings(models=("lr", "xgb"), selections=("l1",), repeats=8, replicates=400)
# The stability of features does not depend on labels: this one is refuted by features without a knee's part.
_OF_NO_LABEL = "A subset of features is stable"


def random_cohort(seed: int, subjects: int = 90) -> pd.DataFrame:
    """One row a radiograph: a knee a subject, two protocols; features of the knee, two factors behind them."""
    rng = np.random.default_rng([20, seed])
    grade = rng.permutation(np.arange(subjects) % 3)
    load = rng.normal(size=(2, len(NAMES)))
    own = rng.normal(size=(subjects, 2)) @ load + rng.normal(size=(subjects, len(NAMES)))
    parts = []
    for protocol in ("reference", "other"):
        values = own + 0.3 * rng.normal(size=own.shape) + (protocol == "other") * rng.normal(size=len(NAMES))
        table = pd.DataFrame(values, columns=NAMES).assign(subject=range(subjects), knee=range(subjects), grade=grade)
        parts.append(table.assign(protocol=protocol, radiograph=[f"{k}_{protocol}" for k in range(subjects)]))
    return joined(parts)


def refutation_rows(workers: int, cohorts: int = 20) -> list[Row]:
    """A row a claim: in how many of so many cohorts of random labels any of its measures holds, and any does not hold.

    In a cohort of neither it is not decidable: that no claim may hold is asked, not that all are refuted.
    """
    tables = ordered_map(_claimed, range(cohorts), shared={}, workers=workers)
    verdicts = joined(table.assign(seed=seed) for seed, table in enumerate(tables))
    keys, counts = [verdicts["claim"], verdicts["seed"]], {}
    for column, verdict in (("held", "holds"), ("refuted", "does not hold")):
        of_cohorts = (verdicts["verdict"] == verdict).groupby(keys, sort=False).any()
        counts[column] = of_cohorts.groupby("claim", sort=False).sum().drop(_OF_NO_LABEL)
    table = pd.DataFrame(counts).rename_axis("claim").reset_index()
    return [{**row, "cohorts": cohorts} for row in table.to_dict("records")]


def _claimed(seed: int) -> pd.DataFrame:
    """The claims of a cohort of random labels."""
    table = random_cohort(seed)
    outcomes = [one_split(r, table=table, names=NAMES, settings=SETTINGS) for r in range(SETTINGS.repeats)]
    tables = tables_of_models(outcomes, SETTINGS)
    tables["reliability"] = reliability(table, NAMES, "reference", replicates=100)
    predictions, importances, offered = (
        joined(getattr(one, name) for one in outcomes) for name in ("predictions", "importances", "offered")
    )
    return claims(table, predictions, importances, offered, tables, SETTINGS)
