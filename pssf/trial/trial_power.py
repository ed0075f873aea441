"""Check of the planned power: many trials of the planned size, with the treatment and without an effect.

The trials consist of knees of the population with their true course. The joint space is that of the knee, or the same
with the measurement error of a view and reader. No radiograph is simulated.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ..core.checks import Array
from ..core.processes.parallel_map import map_in_parallel
from ..core.random_streams import make_stream
from ..data.analysis.trial_table import TrialDesign
from ..model.sampling.knee_sampling import KneeDistributions, load_knee_distributions
from .trial_plan import find_knee_at, plan_subject, slow_narrowing
from .trial_statistics import LEVEL, compute_subjects_per_arm

TRIALS = 200
# Subjects from which the trials are drawn. They differ from those of the trial.
_POOL = 2000
_FIRST_OF_POOL = 10**6
_STREAM = 200
TRUE = "true joint space"
COLUMNS = [
    *("view", "reader", "subjects_per_arm", "trials"),
    *("power", "power_low", "power_high", "false_positives", "false_positives_low", "false_positives_high"),
]


def check_power(
    design: TrialDesign, measures: pd.DataFrame, *, trials: int = TRIALS, pool: int = _POOL, workers: int = 1
) -> pd.DataFrame:
    """Check the planned number of subjects per arm by trials of knees with known course.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    measures : DataFrame
        Result of `trial_statistics.summarise_measures`, which contains the error of each view and reader.
    trials : int
        Number of trials with the treatment, and number without an effect.
    pool : int
        Number of subjects from which the trials are drawn with replacement.
    workers : int
        Number of processes.

    Returns
    -------
    DataFrame
        Columns `COLUMNS`, with exact 95 % intervals. The first row is that of the true joint space of the knees. Empty
        if the design has one visit, or a treatment without effect.
    """
    if len(design.visits_months) < 2 or not design.treatment.fraction:
        return pd.DataFrame(columns=COLUMNS)
    side = "lateral" if design.treatment.compartment == "lateral" else "medial"
    numbers = range(_FIRST_OF_POOL, _FIRST_OF_POOL + pool)
    shared = {
        "design": design,
        "distributions": load_knee_distributions(design.population.grade_table),
        "name": f"jsw_{side}_mm",
    }
    natural, treated = np.array(map_in_parallel(compute_changes, numbers, shared=shared, workers=workers)).T
    errors = {(TRUE, TRUE): 0.0}
    of_side = measures[measures["measure"] == f"{side}_mm"]
    errors |= {
        (str(row["view"]), str(row["reader"])): float(np.sqrt(2) * row["sem"])
        for row in of_side.to_dict("records")
        if np.isfinite(row["sem"])
    }
    rows: list[dict[str, Any]] = []
    for place, ((view, reader), error_sd) in enumerate(errors.items()):
        rng = make_stream(design.seed, _STREAM, place)
        spreads = [float(np.hypot(arm.std(ddof=1), error_sd)) for arm in (natural, treated)]
        needed = compute_subjects_per_arm(float(natural.mean() - treated.mean()), *spreads)
        if not np.isfinite(needed):
            continue
        size = max(2, int(needed))
        counts = {
            name: sum(_is_significant(natural, arm, size, error_sd, rng) for _ in range(trials))
            for name, arm in (("power", treated), ("false_positives", natural))
        }
        rows.append(
            {"view": view, "reader": reader, "subjects_per_arm": size, "trials": trials}
            | {
                key: value
                for name, count in counts.items()
                for key, value in _describe_share(name, count, trials).items()
            }
        )
    return pd.DataFrame(rows, columns=COLUMNS)


def compute_changes(
    number: int, *, design: TrialDesign, distributions: KneeDistributions, name: str
) -> tuple[float, float]:
    """Compute the change of the joint space of a subject until the last visit, untreated and treated.

    Parameters
    ----------
    number : int
        Number of the subject.
    design : TrialDesign
        Design of the trial.
    distributions : KneeDistributions
        Distributions of the grade table.
    name : str
        Field of the knee.

    Returns
    -------
    tuple of float
        Change without and with the treatment, in mm.
    """
    subject = replace(plan_subject(design, distributions, number), treated=False)
    first = subject.knees[0]
    later = find_knee_at(subject, 0, design.visits_months[-1], design)
    treated = slow_narrowing(first, later, design.treatment)
    before = getattr(first, name)
    return getattr(later, name) - before, getattr(treated, name) - before


def _is_significant(natural: Array, treated: Array, size: int, error_sd: float, rng: np.random.Generator) -> bool:
    """Draw a trial, and test the difference between its arms."""
    arms = [rng.choice(pool, size) + error_sd * rng.standard_normal(size) for pool in (natural, treated)]
    return bool(stats.ttest_ind(*arms, equal_var=False).pvalue < LEVEL)


def _describe_share(name: str, count: int, trials: int) -> dict[str, float]:
    """Return a share of the trials with its exact 95 % interval (Clopper and Pearson 1934)."""
    interval = stats.binomtest(count, trials).proportion_ci(method="exact")
    return {name: count / trials, f"{name}_low": float(interval.low), f"{name}_high": float(interval.high)}
