"""Response curves of features, ICC, decision threshold and AUC along the steps of a protocol parameter.

Feature statistics and their intervals are computed over all knees with response curves. Model
statistics are averaged over the splits, with intervals from `confidence_intervals`.
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

# Measure: feature value at the step minus the value in the cohort, in SD over the knees of the cohort.
SHIFT = "feature, SD"
# Measure: ICC(2,1) between the feature values at the step and in the cohort.
ICC = "ICC(2,1)"
# Measure: median of the ICC(2,1) over the features.
MEDIAN_ICC = "median ICC(2,1)"
# Measure: mean change of the log odds, which equals the compensating shift of the decision threshold.
ODDS = "threshold shift, log odds"
# Measure: AUC of the model.
AUC = "AUC"
# Measure: AUC in the cohort minus AUC at the step.
LOSS = "loss of AUC"
COLUMNS = ["axis", "step_index", "step", "measure", "feature", "knees", "rarest", "value", "low", "high"]
# Function that returns the parameter value of a step from the name of the axis and the number of the step (from 1).
StepLookup = Callable[[str, int], float]


@dataclass(frozen=True)
class FeatureCurves:
    """Response curves of features.

    Attributes
    ----------
    table : DataFrame
        Response curves, with the columns `COLUMNS`.
    median_icc_samples : dict of tuple to (1 + replicates,) float array
        Median ICC over the features for each axis and step: the first value is for all knees, the others for the
        bootstrap samples.
    """

    table: pd.DataFrame
    median_icc_samples: dict[tuple[str, int], Array]


def compute_feature_curves(
    base: pd.DataFrame, steps: pd.DataFrame, names: list[str], step: StepLookup, *, replicates: int, seed: int
) -> FeatureCurves:
    """Compute the shift and the ICC(2,1) of every feature at every step.

    The shift is the feature change from cohort to step, in SD over the knees of the cohort. The ICC is computed between
    the radiographs at the step and in the cohort.

    Parameters
    ----------
    base : DataFrame
        Radiographs of the cohort under the reference protocol, with a located region: knee, subject and features.
    steps : DataFrame
        Radiographs along the axes, with a located region: knee, subject, kind (axis), repeat_index and features.
    names : list of str
        Names of the features.
    step : callable
        Function that returns the parameter value of a step from the name of the axis and the number of the step.
    replicates : int
        Number of bootstrap samples.
    seed : int
        Seed of the study.

    Returns
    -------
    FeatureCurves
        Curves of all features, and the median ICC in the bootstrap samples.
    """
    spread = base[names].std(ddof=1).to_numpy(np.float64)
    varies = [index for index, name in enumerate(names) if not is_degenerate(base[name].to_numpy())]
    own = base.drop_duplicates("knee").set_index("knee")[names]
    steps = steps[steps["knee"].isin(own.index)]
    curved = steps.drop_duplicates("knee").sort_values("knee")
    # Weights are sampled once, so that each bootstrap sample has the same subjects at every step, even if regions are
    # missing.
    weights = sample_knee_weights(curved["subject"].to_numpy(), replicates=replicates, seed=seed)
    rows, medians = [], {}
    for (axis, step_index), part in steps.groupby(["kind", "repeat_index"], sort=False):
        part = part.sort_values("knee")
        values = np.stack([own.loc[part["knee"]].to_numpy(np.float64), part[names].to_numpy(np.float64)], axis=1)
        value = step(str(axis), int(step_index))
        label = {"axis": axis, "step_index": int(step_index), "step": value, "knees": len(part)}
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
            medians[str(axis), int(step_index)] = median = np.nanmedian(samples, axis=0)
            low, high = percentile_interval(median[1:])
            bounds = {"value": float(median[0]), "low": low, "high": high}
            rows.append(label | {"measure": MEDIAN_ICC, "feature": ""} | bounds)
    return FeatureCurves(pd.DataFrame(rows, columns=COLUMNS), medians)


def _estimate_agreement(values: Array, weights: Array, subjects: NDArray[Any]) -> tuple[dict[str, float], Array | None]:
    """Compute ICC(2,1) of values (knees, 2) with its interval, and ICC(2,1) of each bootstrap sample.

    Return an empty dict and None if the ICC is undefined.
    """
    value = icc(values)[0]
    if not np.isfinite(value):
        return {}, None
    drawn = compute_weighted_icc(values, weights)[0]
    low, high = compute_icc_interval(value, drawn, conditions=2, subjects=len(set(subjects.tolist())))
    return {"value": value, "low": low, "high": high}, drawn


def _estimate_shift(values: Array) -> dict[str, float]:
    """Compute the mean column difference of `values` (knees, 2), with the interval of a paired t test."""
    return dict(zip(("value", "low", "high"), mean_with_interval(values[:, 1] - values[:, 0]), strict=True))


def compute_model_curves(splits: pd.DataFrame, step: StepLookup) -> pd.DataFrame:
    """Compute threshold shift, AUC and loss of AUC of a model at every step.

    The loss is the AUC on the cohort radiographs of the same knees minus the AUC at the step.

    Parameters
    ----------
    splits : DataFrame
        Table from `learn.response_curves.evaluate_response_curves`.
    step : callable
        Function that returns the parameter value of a step from the name of the axis and the number of the step.

    Returns
    -------
    DataFrame
        Columns `COLUMNS`. The column knees is the number of test subjects per split, and rarest is the number of test
        subjects of the rarest class.
    """
    rows = []
    for (axis, step_index), part in splits.groupby(["axis", "step_index"], sort=False):
        label = {"axis": axis, "step_index": int(step_index), "step": step(str(axis), int(step_index)), "feature": ""}
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
    """Compute the variance correction ratio of Nadeau and Bengio for response curves.

    Each split tests half of the subjects with response curves, so the test sets of two splits overlap. The correlation
    between two scores is r = tested subjects / subjects with curves. The ratio is r / (1 - r).
    """
    return float((part["test_subjects"] / (part["curved"] - part["test_subjects"])).mean())


def find_first_crossing(positions: Array, margin: Array) -> float:
    """Find the position at which a margin first falls below 0, by linear interpolation between steps.

    Parameters
    ----------
    positions : (steps,) float array, any unit
        Positions of the steps, in ascending or descending order.
    margin : (steps,) float array, any unit
        Margin at each step; NaN is treated as below 0.

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
