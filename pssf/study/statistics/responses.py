"""Response curves: how features, their ICC, a model's threshold and its AUC go with one thing of a protocol.

What is of features is of all knees with curves, with intervals over the knees; what is of models is of splits, with the
intervals of `intervals`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import Array
from .degenerate import is_degenerate
from .icc_by_subject import icc_by_weights, icc_interval, knee_weights
from .intervals import estimate, estimate_share
from .metrics import mean_interval, percentiles
from .reliability import icc, is_whole
from .tested import TESTED

SHIFT, ICC, MEDIAN_ICC, ODDS, AUC, LOSS = (
    "feature, SD",
    "ICC(2,1)",
    "median ICC(2,1)",
    "threshold shift, log odds",
    "AUC",
    "loss of AUC",
)
COLUMNS = ["axis", "turn", "step", "measure", "feature", "knees", "rarest", "value", "low", "high"]
# axis, number of a step from 1 -> the step
Step = Callable[[str, int], float]


@dataclass(frozen=True)
class Curves:
    """Rows of COLUMNS, and of each axis and step the median ICC in samples of the knees, of all first."""

    table: pd.DataFrame
    medians: dict[tuple[str, int], Array]


def curves_of_features(
    base: pd.DataFrame, steps: pd.DataFrame, names: list[str], step: Step, *, replicates: int, seed: int
) -> Curves:
    """Of every axis, step and feature: its shift in SD of the cohort's knees, and its ICC(2,1) with the cohort's value.

    base    radiographs of the cohort under the reference, with a region: knee, subject, features
    steps   radiographs along the axes, with a region: knee, subject, kind (axis), turn, features
    """
    spread = base[names].std(ddof=1).to_numpy(np.float64)
    varies = [index for index, name in enumerate(names) if not is_degenerate(base[name].to_numpy())]
    own = base.drop_duplicates("knee").set_index("knee")[names]
    steps = steps[steps["knee"].isin(own.index)]
    curved = steps.drop_duplicates("knee").sort_values("knee")
    # Drawn once, so that a sample is of the same subjects at every step, whoever lacks a region at one.
    weights = knee_weights(curved["subject"].to_numpy(), replicates=replicates, seed=seed)
    rows, medians = [], {}
    for (axis, turn), part in steps.groupby(["kind", "turn"], sort=False):
        part = part.sort_values("knee")
        values = np.stack([own.loc[part["knee"]].to_numpy(np.float64), part[names].to_numpy(np.float64)], axis=1)
        label = {"axis": axis, "turn": int(turn), "step": step(str(axis), int(turn)), "knees": len(part)}
        there, samples = curved["knee"].isin(part["knee"]).to_numpy(), []
        for index in varies:
            one, whole = values[:, :, index], is_whole(values[:, :, index])
            rows.append(label | {"measure": SHIFT, "feature": names[index]} | _shift(one[whole] / spread[index]))
            agreement, drawn = _agreement(one[whole], weights[:, there][:, whole], part["subject"].to_numpy()[whole])
            if drawn is not None:
                rows.append(label | {"measure": ICC, "feature": names[index]} | agreement)
                samples.append(np.concatenate([[agreement["value"]], drawn]))
        if samples:
            medians[str(axis), int(turn)] = median = np.nanmedian(samples, axis=0)
            low, high = percentiles(median[1:])
            bounds = {"value": float(median[0]), "low": low, "high": high}
            rows.append(label | {"measure": MEDIAN_ICC, "feature": ""} | bounds)
    return Curves(pd.DataFrame(rows, columns=COLUMNS), medians)


def _agreement(values: Array, weights: Array, subjects: NDArray[Any]) -> tuple[dict[str, float], Array | None]:
    """ICC(2,1) of knees (knees, 2) with its interval, and that of samples of subjects; None where there is none."""
    value = icc(values)[0]
    if not np.isfinite(value):
        return {}, None
    drawn = icc_by_weights(values, weights)[0]
    low, high = icc_interval(value, drawn, conditions=2, subjects=len(set(subjects.tolist())))
    return {"value": value, "low": low, "high": high}, drawn


def _shift(values: Array) -> dict[str, float]:
    """Mean change of knees (knees, 2) in SD, with the interval of a paired t test."""
    return dict(zip(("value", "low", "high"), mean_interval(values[:, 1] - values[:, 0]), strict=True))


def curves_of_models(splits: pd.DataFrame, step: Step) -> pd.DataFrame:
    """Of every axis and step: threshold shift, AUC, loss of AUC from the cohort's own radiographs of the same knees.

    splits   of `learn.responses.respond`
    returns  COLUMNS; knees is how many subjects a split tests, rarest of the class that has the fewest
    """
    rows = []
    for (axis, turn), part in splits.groupby(["axis", "turn"], sort=False):
        label = {"axis": axis, "turn": int(turn), "step": step(str(axis), int(turn)), "feature": ""}
        label |= {name: int(part[count].median()) for name, count in zip(("knees", "rarest"), TESTED, strict=True)}
        ratio, scores = _ratio_of(part), part["auc"].to_numpy(np.float64)
        estimates = {
            ODDS: estimate(part["shift"].to_numpy(np.float64), ratio, -np.inf, np.inf),
            AUC: estimate_share(scores, ratio),
            LOSS: estimate(part["auc_own"].to_numpy(np.float64) - scores, ratio),
        }
        for measure, of_splits in estimates.items():
            bounds = {"value": of_splits.value, "low": of_splits.low, "high": of_splits.high}
            rows.append(label | {"measure": measure} | bounds)
    return pd.DataFrame(rows, columns=COLUMNS)


def _ratio_of(part: pd.DataFrame) -> float:
    """Of `intervals.share_tested`, where halves of few subjects with curves are tested and most others learnt from.

    Two halves share half of their subjects, so their scores correlate by tested / curved, whoever is learnt from;
    Nadeau and Bengio's ratio is that correlation over what it lacks of 1.
    """
    return float((part["test_subjects"] / (part["curved"] - part["test_subjects"])).mean())


def first_crossing(at: Array, margin: Array) -> float:
    """Where a margin first falls below 0 along a way, between two steps by a line; infinite where it never does.

    at      (steps,) places from the first on, rising or falling, of any unit
    margin  (steps,) at each, of its own unit; a step without a number breaks
    """
    broken = np.flatnonzero(~(margin >= 0))
    if not len(broken):
        return float(np.sign(at[-1] - at[0]) * np.inf)
    first = int(broken[0])
    if not first or not np.isfinite(margin[first]):
        return float(at[max(0, first - 1)])
    share = margin[first - 1] / (margin[first - 1] - margin[first])
    return float(at[first - 1] + share * (at[first] - at[first - 1]))
