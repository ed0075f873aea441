"""Response curves: features, their ICC, the threshold of a model and its AUC at every step of a protocol parameter.

Statistics of features use all knees with response curves, with intervals over the knees. Statistics of models use
the splits, with the intervals of `confidence_intervals`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ....core.checks import Array
from ..features.degenerate_features import is_degenerate
from ..features.icc_by_subject import compute_icc_interval, compute_weighted_icc, sample_knee_weights
from ..features.reliability import icc, is_complete
from ..scores.confidence_intervals import estimate_mean, estimate_proportion
from ..scores.metrics import mean_with_interval, percentile_interval
from ..scores.tested_subjects import TEST_COUNT_COLUMNS

# Measure: change of a feature in SD of the cohort's knees.
SHIFT = "feature, SD"
# Measure: ICC(2,1) of a feature with its value in the cohort.
ICC = "ICC(2,1)"
# Measure: median of the ICC(2,1) over the features.
MEDIAN_ICC = "median ICC(2,1)"
# Measure: change of the log odds, by which a threshold would have to move.
ODDS = "threshold shift, log odds"
# Measure: AUC of the model.
AUC = "AUC"
# Measure: AUC in the cohort minus AUC at the step.
LOSS = "loss of AUC"
COLUMNS = ["axis", "turn", "step", "measure", "feature", "knees", "rarest", "value", "low", "high"]
# Function from an axis and the number of a step, counted from 1, to the value of the step.
StepLookup = Callable[[str, int], float]


@dataclass(frozen=True)
class FeatureCurves:
    """Response curves of features.

    Attributes
    ----------
    table : DataFrame
        Rows with the columns `COLUMNS`.
    median_icc_samples : dict of tuple to (1 + replicates,) float array
        Median ICC of each axis and step: of all knees, then of each bootstrap sample.
    """

    table: pd.DataFrame
    median_icc_samples: dict[tuple[str, int], Array]


def compute_feature_curves(
    base: pd.DataFrame, steps: pd.DataFrame, names: list[str], step: StepLookup, *, replicates: int, seed: int
) -> FeatureCurves:
    """Compute the shift and the ICC(2,1) of every feature at every step.

    The shift is in SD of the cohort's knees. The ICC compares with the value in the cohort.

    Parameters
    ----------
    base : DataFrame
        Radiographs of the cohort under the reference protocol, with a located region: knee, subject and features.
    steps : DataFrame
        Radiographs along the axes, with a located region: knee, subject, kind (axis), turn and features.
    names : list of str
        Names of the features.
    step : callable
        Function from an axis and the number of a step to its value.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the study.

    Returns
    -------
    FeatureCurves
        Rows of all features, and the median ICC in the bootstrap samples.
    """
    spread = base[names].std(ddof=1).to_numpy(np.float64)
    varies = [index for index, name in enumerate(names) if not is_degenerate(base[name].to_numpy())]
    own = base.drop_duplicates("knee").set_index("knee")[names]
    steps = steps[steps["knee"].isin(own.index)]
    curved = steps.drop_duplicates("knee").sort_values("knee")
    # The bootstrap is sampled once, so that a sample has the same subjects at every step, even if a region is missing.
    weights = sample_knee_weights(curved["subject"].to_numpy(), replicates=replicates, seed=seed)
    rows, medians = [], {}
    for (axis, turn), part in steps.groupby(["kind", "turn"], sort=False):
        part = part.sort_values("knee")
        values = np.stack([own.loc[part["knee"]].to_numpy(np.float64), part[names].to_numpy(np.float64)], axis=1)
        label = {"axis": axis, "turn": int(turn), "step": step(str(axis), int(turn)), "knees": len(part)}
        there, samples = curved["knee"].isin(part["knee"]).to_numpy(), []
        for index in varies:
            one, whole = values[:, :, index], is_complete(values[:, :, index])
            rows.append(
                label | {"measure": SHIFT, "feature": names[index]} | _estimate_shift(one[whole] / spread[index])
            )
            agreement, drawn = _estimate_agreement(
                one[whole], weights[:, there][:, whole], part["subject"].to_numpy()[whole]
            )
            if drawn is not None:
                rows.append(label | {"measure": ICC, "feature": names[index]} | agreement)
                samples.append(np.concatenate([[agreement["value"]], drawn]))
        if samples:
            medians[str(axis), int(turn)] = median = np.nanmedian(samples, axis=0)
            low, high = percentile_interval(median[1:])
            bounds = {"value": float(median[0]), "low": low, "high": high}
            rows.append(label | {"measure": MEDIAN_ICC, "feature": ""} | bounds)
    return FeatureCurves(pd.DataFrame(rows, columns=COLUMNS), medians)


def _estimate_agreement(values: Array, weights: Array, subjects: NDArray[Any]) -> tuple[dict[str, float], Array | None]:
    """Compute the ICC(2,1) of values (knees, 2) with its interval, and the ICC of each bootstrap sample.

    Return an empty dict and None if there is no ICC.
    """
    value = icc(values)[0]
    if not np.isfinite(value):
        return {}, None
    drawn = compute_weighted_icc(values, weights)[0]
    low, high = compute_icc_interval(value, drawn, conditions=2, subjects=len(set(subjects.tolist())))
    return {"value": value, "low": low, "high": high}, drawn


def _estimate_shift(values: Array) -> dict[str, float]:
    """Compute the mean change of values (knees, 2) in SD, with the interval of a paired t test."""
    return dict(zip(("value", "low", "high"), mean_with_interval(values[:, 1] - values[:, 0]), strict=True))


def compute_model_curves(splits: pd.DataFrame, step: StepLookup) -> pd.DataFrame:
    """Compute threshold shift, AUC and loss of AUC of a model at every step.

    The loss is relative to the cohort's radiographs of the same knees.

    Parameters
    ----------
    splits : DataFrame
        Results of `learn.response_curves.evaluate_response_curves`.
    step : callable
        Function from an axis and the number of a step to its value.

    Returns
    -------
    DataFrame
        Columns `COLUMNS`; knees is the number of test subjects per split, rarest that of the rarest class.
    """
    rows = []
    for (axis, turn), part in splits.groupby(["axis", "turn"], sort=False):
        label = {"axis": axis, "turn": int(turn), "step": step(str(axis), int(turn)), "feature": ""}
        label |= {
            name: int(part[count].median()) for name, count in zip(("knees", "rarest"), TEST_COUNT_COLUMNS, strict=True)
        }
        ratio, scores = _compute_correlation_ratio(part), part["auc"].to_numpy(np.float64)
        estimates = {
            ODDS: estimate_mean(part["shift"].to_numpy(np.float64), ratio, -np.inf, np.inf),
            AUC: estimate_proportion(scores, ratio),
            LOSS: estimate_mean(part["auc_own"].to_numpy(np.float64) - scores, ratio),
        }
        for measure, of_splits in estimates.items():
            bounds = {"value": of_splits.value, "low": of_splits.low, "high": of_splits.high}
            rows.append(label | {"measure": measure} | bounds)
    return pd.DataFrame(rows, columns=COLUMNS)


def _compute_correlation_ratio(part: pd.DataFrame) -> float:
    """Compute the ratio of Nadeau and Bengio for splits that test one half of the subjects with response curves.

    Two halves share half of their subjects, so their scores correlate by tested / curved, whoever trains. The ratio is
    that correlation divided by 1 minus it.
    """
    return float((part["test_subjects"] / (part["curved"] - part["test_subjects"])).mean())


def find_first_crossing(positions: Array, margin: Array) -> float:
    """Find where a margin first falls below 0, by linear interpolation between steps.

    Parameters
    ----------
    positions : (steps,) float array, any unit
        Positions of the steps from the first on, rising or falling.
    margin : (steps,) float array, any unit
        Margin at each step; a step without a number counts as below 0.

    Returns
    -------
    float
        Position of the crossing; infinite if the margin never falls below 0.
    """
    broken = np.flatnonzero(~(margin >= 0))
    if not len(broken):
        return float(np.sign(positions[-1] - positions[0]) * np.inf)
    first = int(broken[0])
    if not first or not np.isfinite(margin[first]):
        return float(positions[max(0, first - 1)])
    share = margin[first - 1] / (margin[first - 1] - margin[first])
    return float(positions[first - 1] + share * (positions[first] - positions[first - 1]))
