"""How well grades could be told at best: from what knees are built with, without an image.

No model of an image can know a knee better than its parameters say. What they leave is the overlap that a table of
grades draws, so that an AUC of a study has a ceiling beside it: at least that of the better of two fits, of so many
knees that twice as many give the same within its interval. Ends where laws cut their values are among what trees
learn: a value on the end of one grade's law tells that grade, which hardly any image could.
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

from ...core.checks import Array, require_seed, require_whole
from ...data.records import Triple
from ...model.draw import DrawLaws, draw_knees
from ...model.knee import SITES, Knee
from ..statistics.metrics import auc_with_interval

# Of five grades 12,000 a pair: KL 0 against 1 of people is told with 0.84 from 1,600, 0.88 from 3,200, 0.89 from 6,400,
# 0.897 from 12,000 and from 24,000 (boosted trees; intervals of 12,000 are of +-0.006). Drawing takes half a minute.
KNEES = 30_000
_FOLDS = 5
_SPACES = ("jsw_medial_mm", "jsw_lateral_mm", "jsw_least_mm")
_PLAIN = (
    "jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg", "flexion_deg", "rotation_deg", "bone_scale",
    "cortex_scale", "tibial_slope_deg", "lean_deg", "fibular_tip_mm", "insall_salvati", "patellar_shift_mm",
    "patellar_tilt_deg", "fabella_mm", "bmi", "limb_ap_mm", "fat_mm", "stature_mm", "age_years", "bone_density",
    "subluxation_mm", "notch_growth_mm", "effusion_mm", "skin_folds",
)  # fmt: skip


def separability(laws: DrawLaws, people: Mapping[str, Triple], *, knees: int = KNEES, seed: int = 0) -> pd.DataFrame:
    """AUCs of grade 0 against each other grade of a table, of drawn knees, by what is known of them.

    laws     that knees are drawn by
    people   `LandmarkReference.gap_alone_auc`
    knees    that are drawn, the grades alike; knee k is as in any count
    returns  grades, known (smaller space | spaces | all parameters), how (by rank | logistic | boosted trees), knees,
             auc, low, high (Hanley and McNeil 1982, 95 %), people, people_low, people_high: of the smaller gap on
             people's films (NaN elsewhere). Fitted ones are of held-out fifths, so that the best is at least as good;
             a fit of fewer knees than KNEES is far below it
    raises   InputError for fewer than ten knees a grade
    """
    grades = laws.grades.grades
    require_whole("knees", knees, 2 * _FOLDS * len(grades), 1_000_000, "")
    require_seed(seed)
    drawn = draw_knees(laws, knees, seed)
    parameters = parameter_table(drawn, laws.modes)
    of = np.array([knee.grade for knee in drawn])
    first, *others = grades
    rows = []
    for grade in others:
        chosen = (of == first) | (of == grade)
        rows += _rows(parameters[chosen].reset_index(drop=True), of[chosen] == grade, (first, grade), people, seed)
    return pd.DataFrame(rows)


def parameter_table(knees: Sequence[Knee], modes: int) -> pd.DataFrame:
    """A row a knee: all that it is built with as numbers, but for its side, its texture and its grades.

    modes  of the shape, each a column
    """
    rows = []
    for knee in knees:
        row: dict[str, float] = {name: float(getattr(knee, name)) for name in _PLAIN}
        row["jsw_least_mm"] = min(knee.jsw_medial_mm, knee.jsw_lateral_mm)
        row["female"] = float(knee.sex == "female")
        row |= {f"osteophyte_{site}_mm": 0.0 for site in SITES}
        for one in knee.osteophytes:
            row[f"osteophyte_{one.site}_mm"] = max(row[f"osteophyte_{one.site}_mm"], one.size_mm)
        row["osteophytes"] = float(len(knee.osteophytes))
        row["cysts"] = float(len(knee.cysts))
        row["largest_cyst_mm"] = max((one.diameter_mm for one in knee.cysts), default=0.0)
        scores = (*knee.shape, *(0.0 for _ in range(modes - len(knee.shape))))
        row |= {f"shape_{mode + 1}": score for mode, score in enumerate(scores)}
        rows.append(row)
    return pd.DataFrame(rows)


def _rows(
    parameters: pd.DataFrame,
    worse: NDArray[np.bool_],
    pair: tuple[int, int],
    gap_alone: Mapping[str, Triple],
    seed: int,
) -> list[dict[str, Any]]:
    label: dict[str, Any] = {"grades": f"{pair[0]} vs {pair[1]}"}
    least = -parameters["jsw_least_mm"].to_numpy()
    people = gap_alone.get(f"kl{pair[1]}") if pair[0] == 0 else None
    beside = dict(zip(("people", "people_low", "people_high"), people or (np.nan,) * 3, strict=True))
    nothing = dict.fromkeys(beside, float("nan"))
    rows = [label | {"known": "smaller space", "how": "by rank"} | _estimate(least, worse) | beside]
    for known, names in (("spaces", list(_SPACES)), ("all parameters", list(parameters))):
        for how in ("logistic", "boosted trees"):
            probability = _held_out(parameters[names].to_numpy(), worse, how, seed)
            rows.append(label | {"known": known, "how": how} | _estimate(probability, worse) | nothing)
    return rows


def _held_out(values: Array, worse: NDArray[np.bool_], how: str, seed: int) -> Array:
    """(rows,) probability of the worse grade, of models that have not seen the row"""
    folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=seed % 2**32)
    model = {
        "logistic": make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000)),
        "boosted trees": HistGradientBoostingClassifier(
            max_iter=150, learning_rate=0.06, max_leaf_nodes=8, random_state=seed % 2**32
        ),
    }[how]
    # Fits of so few rows gain nothing from threads, which wait for one another.
    with threadpool_limits(limits=1):
        return np.asarray(cross_val_predict(model, values, worse, cv=folds, method="predict_proba")[:, 1], np.float64)


def _estimate(value: Array, worse: NDArray[np.bool_]) -> dict[str, float]:
    """Number of knees, AUC and its 95 per cent interval."""
    return {"knees": len(value)} | auc_with_interval(worse, value)
