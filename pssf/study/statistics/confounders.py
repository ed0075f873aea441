"""What a naive model gains by a confounder, what that costs elsewhere, and what adjustment gives back."""

from typing import Any

import numpy as np
import pandas as pd

from .intervals import estimate, estimate_share
from .ladder import ratio_of

TIED, UNTIED, ADJUSTED = "naive, where it is tied", "naive, where it is not", "adjusted, where it is not"
GAIN, COST, BACK = "gain: tied minus not", "cost: not tied, from strength 0", "given back by adjustment"
COLUMNS = ["confounder", "strength", "measure", "trained", "test_subjects", "splits", "value", "low", "high", "p"]


def confounding(splits: pd.DataFrame) -> pd.DataFrame:
    """A row a confounder, strength and measure: COLUMNS; p of a difference's being 0, uncorrected.

    splits  of `learn.confounders.confound`
    """
    rows: list[dict[str, Any]] = []
    for confounder, of_one in splits.groupby("confounder", sort=False):
        naive = of_one[of_one["model"] == "naive"].set_index(["strength", "repeat"])
        adjusted = of_one[of_one["model"] == "adjusted"].set_index(["strength", "repeat"])
        for strength, part in naive.groupby(level="strength"):
            own, other = part.droplevel("strength"), adjusted.loc[strength]
            free = naive.loc[0.0, "untied"].reindex(own.index)
            ratio = ratio_of(own)
            counts = {name: int(own[name].median()) for name in ("trained", "test_subjects")}
            label = {"confounder": confounder, "strength": strength, **counts}
            for measure, values in ((TIED, own["tied"]), (UNTIED, own["untied"]), (ADJUSTED, other["untied"])):
                rows.append(label | {"measure": measure} | _estimated(values, ratio, estimate_share))
            differences = (
                (GAIN, own["tied"] - own["untied"]),
                (COST, free - own["untied"]),
                (BACK, other["untied"] - own["untied"]),
            )
            for measure, values in differences:
                rows.append(label | {"measure": measure} | _estimated(values, ratio, estimate))
    return pd.DataFrame(rows, columns=COLUMNS)


def _estimated(values: pd.Series, ratio: float, how: Any) -> dict[str, Any]:
    of_splits = how(values.to_numpy(np.float64), ratio)
    row = {"splits": int(values.notna().sum()), "value": of_splits.value, "low": of_splits.low, "high": of_splits.high}
    return row | {"p": of_splits.p if how is estimate else np.nan}
