"""Upper limit of the AUC between grades, estimated from the parameters of sampled knees without an image.

A radiograph of a simulated knee cannot contain more information on the grade than the knee parameters. The
distributions of the grades overlap, so the AUC has an upper limit. The estimate is the higher AUC of two classifiers,
which is a lower bound of the upper limit. With twice the default number of knees, the AUC stays within its interval.
Boosted trees also use values at which a distribution is truncated; these values reveal the grade but are hardly visible
in an image.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

from ...core.checks import Array, require_integer, require_seed
from ...data.table_records import Triple
from ...model.knee import OSTEOPHYTE_SITES, Knee
from ...model.sampling.knee_sampling import KneeDistributions, sample_knees
from ..statistics.scores.metrics import auc_with_interval

# Default number of knees; with five grades, a pair of grades has 12,000 knees. For KL 0 vs 1 in grade table
# `population`, the AUC of boosted trees is 0.84 with 1,600 knees, 0.88 with 3,200, 0.89 with 6,400, and 0.897 with
# 12,000 or 24,000. The 95 % interval with 12,000 knees is +-0.006. Sampling takes half a minute.
DEFAULT_KNEE_COUNT = 30_000
# Number of folds of the cross-validation.
_FOLDS = 5
# Joint space width columns.
_JSW_COLUMNS = ("jsw_medial_mm", "jsw_lateral_mm", "jsw_least_mm")
# Numeric fields of `Knee` from which the grade is predicted.
_SCALAR_PARAMETERS = (
    "jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg", "flexion_deg", "rotation_deg", "bone_scale",
    "cortex_scale", "tibial_slope_deg", "lean_deg", "fibular_tip_mm", "insall_salvati", "patellar_shift_mm",
    "patellar_tilt_deg", "fabella_mm", "bmi", "limb_ap_mm", "fat_mm", "stature_mm", "age_years", "bone_density",
    "subluxation_mm", "notch_growth_mm", "effusion_mm", "skin_folds",
)  # fmt: skip


def estimate_separability(
    laws: KneeDistributions, patient_auc: Mapping[str, Triple], *, knees: int = DEFAULT_KNEE_COUNT, seed: int = 0
) -> pd.DataFrame:
    """Estimate the AUC between grade 0 and each other grade from parameters of sampled knees.

    Parameters
    ----------
    laws : KneeDistributions
        Distributions from which the knees are sampled.
    patient_auc : mapping of str to tuple of float
        AUC and its interval on patient radiographs, keyed by grade pair; from `LandmarkReference.gap_alone_auc`.
    knees : int, default 30000
        Total number of knees, at least ten per grade, with equal numbers per grade. Knee k is independent of the total
        number.
    seed : int, default 0
        Seed of sampling and model fits.

    Returns
    -------
    DataFrame
        One row per pair of grades, set of parameters and method. Columns: grades; parameters ("smaller JSW", "JSW" or
        "all parameters"); method ("by rank", "logistic" or "boosted trees"); knees; auc, low and high (95 %, Hanley and
        McNeil 1982); patient_auc, patient_auc_low and patient_auc_high. The patient_auc columns are the AUC of the
        smaller joint gap on patient radiographs, with its interval; NaN except for "smaller JSW".

    Raises
    ------
    InputError
        There are fewer than ten knees per grade, or the seed is not allowed.

    Notes
    -----
    The AUC is computed on the held-out folds of a cross-validation, so that the true limit is at least as high. With
    far fewer knees than `DEFAULT_KNEE_COUNT`, the AUC is much lower.
    """
    grades = laws.grades.grades
    require_integer("knees", knees, 2 * _FOLDS * len(grades), 1_000_000, "")
    require_seed(seed)
    drawn = sample_knees(laws, knees, seed)
    parameters = build_parameter_table(drawn, laws.mode_count)
    of = np.array([knee.grade for knee in drawn])
    first, *others = grades
    rows = []
    for grade in others:
        chosen = (of == first) | (of == grade)
        rows += _estimate_grade_pair(
            parameters[chosen].reset_index(drop=True), of[chosen] == grade, (first, grade), patient_auc, seed
        )
    return pd.DataFrame(rows)


def build_parameter_table(knees: Sequence[Knee], modes: int) -> pd.DataFrame:
    """Build a table of all numeric knee parameters, without side, texture seed and grades.

    Parameters
    ----------
    knees : sequence of Knee
        Knees in the order of the table rows.
    modes : int
        Number of bone shape modes; each mode is a column.

    Returns
    -------
    DataFrame
        Numeric parameters, one row per knee.
    """
    rows = []
    for knee in knees:
        row: dict[str, float] = {name: float(getattr(knee, name)) for name in _SCALAR_PARAMETERS}
        row["jsw_least_mm"] = min(knee.jsw_medial_mm, knee.jsw_lateral_mm)
        row["female"] = float(knee.sex == "female")
        row |= {f"osteophyte_{site}_mm": 0.0 for site in OSTEOPHYTE_SITES}
        for one in knee.osteophytes:
            row[f"osteophyte_{one.site}_mm"] = max(row[f"osteophyte_{one.site}_mm"], one.size_mm)
        row["osteophytes"] = float(len(knee.osteophytes))
        row["cysts"] = float(len(knee.cysts))
        row["largest_cyst_mm"] = max((one.diameter_mm for one in knee.cysts), default=0.0)
        scores = (*knee.shape, *(0.0 for _ in range(modes - len(knee.shape))))
        row |= {f"shape_{mode + 1}": score for mode, score in enumerate(scores)}
        rows.append(row)
    return pd.DataFrame(rows)


def _estimate_grade_pair(
    parameters: pd.DataFrame,
    is_worse: NDArray[np.bool_],
    pair: tuple[int, int],
    patient_auc: Mapping[str, Triple],
    seed: int,
) -> list[dict[str, Any]]:
    """Estimate the AUC between two grades for each set of parameters and each method."""
    label: dict[str, Any] = {"grades": f"{pair[0]} vs {pair[1]}"}
    least = -parameters["jsw_least_mm"].to_numpy()
    of_patients = patient_auc.get(f"kl{pair[1]}") if pair[0] == 0 else None
    beside = dict(
        zip(("patient_auc", "patient_auc_low", "patient_auc_high"), of_patients or (np.nan,) * 3, strict=True)
    )
    nothing = dict.fromkeys(beside, float("nan"))
    rows = [label | {"parameters": "smaller JSW", "method": "by rank"} | _estimate_auc(least, is_worse) | beside]
    for known, names in (("JSW", list(_JSW_COLUMNS)), ("all parameters", list(parameters))):
        for method in ("logistic", "boosted trees"):
            probability = _predict_held_out(parameters[names].to_numpy(), is_worse, method, seed)
            rows.append(
                label | {"parameters": known, "method": method} | _estimate_auc(probability, is_worse) | nothing
            )
    return rows


def _predict_held_out(values: Array, is_worse: NDArray[np.bool_], classifier: str, seed: int) -> Array:
    """Predict the probability of the higher grade for held-out knees by cross-validation, as a (rows,) array."""
    folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=seed % 2**32)
    model = {
        "logistic": make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000)),
        "boosted trees": HistGradientBoostingClassifier(
            max_iter=150, learning_rate=0.06, max_leaf_nodes=8, random_state=seed % 2**32
        ),
    }[classifier]
    # One thread is used, because fits of few rows are not faster with several threads.
    with threadpool_limits(limits=1):
        return np.asarray(
            cross_val_predict(model, values, is_worse, cv=folds, method="predict_proba")[:, 1], np.float64
        )


def _estimate_auc(value: Array, is_worse: NDArray[np.bool_]) -> dict[str, float]:
    """Compute the number of knees, the AUC and its 95 % interval."""
    return {"knees": len(value)} | auc_with_interval(is_worse, value)
