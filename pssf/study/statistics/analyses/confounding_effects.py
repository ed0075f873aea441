"""Effects of a confounder: AUC gain and cost of a naive model, and AUC recovery by adjustment."""

from typing import Any

import numpy as np
import pandas as pd

from ..scores.confidence_intervals import estimate_mean, estimate_proportion
from .incremental_value_scores import average_test_train_ratio

# Measure: AUC of the naive model on test subjects with the association.
TIED = "naive model, confounded test set"
# Measure: AUC of the naive model on test subjects without the association.
UNTIED = "naive model, balanced test set"
# Measure: AUC of the adjusted model on test subjects without the association.
ADJUSTED = "adjusted model, balanced test set"
# Measure: AUC of the naive model on the confounded test set minus its AUC on the balanced test set.
GAIN = "gain: confounded minus balanced test set"
# Measure: AUC of the naive model trained at strength 0 minus its AUC trained at the strength of the row, both on the
# balanced test set.
COST = "cost: strength 0 minus this strength, balanced test set"
# Measure: AUC of the adjusted model minus AUC of the naive model, both on the balanced test set.
BACK = "recovery: adjusted minus naive model, balanced test set"
COLUMNS = [
    *("confounder", "strength", "measure", "training_subjects", "test_subjects", "splits"),
    *("value", "low", "high", "p"),
]


def estimate_confounding(splits: pd.DataFrame) -> pd.DataFrame:
    """Estimate the effects of each confounder at each strength.

    Parameters
    ----------
    splits : DataFrame
        Table from `learn.confounded_training.evaluate_confounding`.

    Returns
    -------
    DataFrame
        One row per confounder, strength and measure, with the columns `COLUMNS`. p is the p-value of the hypothesis
        that a difference is 0, without correction for multiple tests; NaN for an AUC.
    """
    rows: list[dict[str, Any]] = []
    for confounder, of_one in splits.groupby("confounder", sort=False):
        naive = of_one[of_one["model"] == "naive"].set_index(["strength", "repeat"])
        adjusted = of_one[of_one["model"] == "adjusted"].set_index(["strength", "repeat"])
        for strength, part in naive.groupby(level="strength"):
            own, other = part.droplevel("strength"), adjusted.loc[strength]
            free = naive.loc[0.0, "untied"].reindex(own.index)
            ratio = average_test_train_ratio(own)
            counts = {name: int(own[name].median()) for name in ("training_subjects", "test_subjects")}
            label = {"confounder": confounder, "strength": strength, **counts}
            for measure, values in ((TIED, own["tied"]), (UNTIED, own["untied"]), (ADJUSTED, other["untied"])):
                rows.append(label | {"measure": measure} | _estimate_row(values, ratio, estimate_proportion))
            differences = (
                (GAIN, own["tied"] - own["untied"]),
                (COST, free - own["untied"]),
                (BACK, other["untied"] - own["untied"]),
            )
            for measure, values in differences:
                rows.append(label | {"measure": measure} | _estimate_row(values, ratio, estimate_mean))
    return pd.DataFrame(rows, columns=COLUMNS)


def _estimate_row(values: pd.Series, ratio: float, estimator: Any) -> dict[str, Any]:
    """Estimate the mean and interval of one measure from its values on the splits."""
    of_splits = estimator(values.to_numpy(np.float64), ratio)
    row = {"splits": int(values.notna().sum()), "value": of_splits.value, "low": of_splits.low, "high": of_splits.high}
    return row | {"p": of_splits.p if estimator is estimate_mean else np.nan}
