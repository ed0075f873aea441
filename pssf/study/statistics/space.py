"""What a feature measures: shares of its variance by groups of parameters, and local slopes with the noise held."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from SALib.analyze import sobol

from ..space import SPACE, problem_of
from .degenerate import is_degenerate
from .metrics import mean_interval
from .parameters import parameters_of

SHARES = ["feature", "group", "samples", "first", "first_low", "first_high", "total", "total_low", "total_high"]
SLOPES = ["feature", "parameter", "knees", "slope", "slope_low", "slope_high"]
_RESAMPLES = 400
_LEAST_WHOLE = 32  # samples; of as many drawn, intervals hold 95 %, of fewer not
_LEVEL = 0.95


def shares(
    table: pd.DataFrame, names: list[str], bounds: Mapping[str, tuple[float, float]], samples: int, seed: int
) -> pd.DataFrame:
    """Sobol's first-order and total share of every group of parameters in the variance of every feature.

    The first is what a group gives alone, the total with all that it does together with others (Saltelli 2010; Jansen
    1999); intervals are SALib's, by a bootstrap of the samples. An estimate may lie outside 0 to 1, and far so where
    one radiograph makes most of a feature's variance: intervals of such features hold less.

    table    radiographs of `space.plan_shares` with a region found: turn, features
    returns  SHARES; samples of which a radiograph was refused are left out, and features of too few samples
    """
    problem = problem_of(bounds)
    groups = list(dict.fromkeys(problem["groups"]))
    values = np.full((samples * (len(groups) + 2), len(names)), np.nan)
    values[table["turn"].to_numpy(np.int64) - 1] = table[names].to_numpy(np.float64)
    blocks = values.reshape(samples, len(groups) + 2, len(names))
    rows: list[dict[str, Any]] = []
    for index, name in enumerate(names):
        whole = blocks[np.isfinite(blocks[:, :, index]).all(axis=1), :, index]
        if len(whole) < _LEAST_WHOLE or is_degenerate(whole.ravel()):
            continue
        indices = sobol.analyze(
            problem,
            whole.ravel(),
            calc_second_order=False,
            num_resamples=_RESAMPLES,
            conf_level=_LEVEL,
            seed=1 + seed % 2**32,  # SALib takes 0 for none
        )
        for place, group in enumerate(groups):
            row: dict[str, Any] = {"feature": name, "group": group, "samples": len(whole)}
            for form, key in (("first", "S1"), ("total", "ST")):
                value, half = float(indices[key][place]), float(indices[f"{key}_conf"][place])
                row |= {form: value, f"{form}_low": value - half, f"{form}_high": value + half}
            rows.append(row)
    return pd.DataFrame(rows, columns=SHARES)


def slopes(
    base: pd.DataFrame,
    pairs: pd.DataFrame,
    manifest: pd.DataFrame,
    names: list[str],
    bounds: Mapping[str, tuple[float, float]],
) -> pd.DataFrame:
    """Change of every feature, in SD of the cohort's knees, by a change of one parameter of one SD of its span.

    Mean over the knees with the interval of a t test; a span's SD is that of a uniform law.

    base      radiographs of the cohort under the reference, with a region: knee, features
    pairs     of `space.plan_pairs`, with a region: of_knee, kind (parameter), what a manifest has, features
    manifest  of the cohort, under the reference
    """
    before = _values(manifest).drop_duplicates("knee").set_index("knee")
    own = base.drop_duplicates("knee").set_index("knee")[names]
    spread = own.std(ddof=1).to_numpy(np.float64)
    after = _values(pairs)
    rows: list[dict[str, Any]] = []
    for parameter, part in after[after["of_knee"].isin(own.index)].groupby("kind", sort=False):
        span = bounds[str(parameter)][1] - bounds[str(parameter)][0]
        step = part[str(parameter)].to_numpy(np.float64) - before.loc[part["of_knee"], str(parameter)].to_numpy(float)
        change = part[names].to_numpy(np.float64) - own.loc[part["of_knee"]].to_numpy(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = change / step[:, None] * span / np.sqrt(12) / spread
        for index, name in enumerate(names):
            values = slope[np.isfinite(slope[:, index]), index]
            label = {"feature": name, "parameter": SPACE[str(parameter)].label, "knees": len(values)}
            rows.append(label | dict(zip(("slope", "slope_low", "slope_high"), mean_interval(values), strict=True)))
    return pd.DataFrame(rows, columns=SLOPES)


def _values(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the largest osteophyte of each of its rows."""
    largest = parameters_of(table.assign(knee=range(len(table)))).get("largest_osteophyte_mm")
    return table.assign(largest_osteophyte_mm=0.0 if largest is None else largest.to_numpy())


def beside(follows: pd.DataFrame, of_slopes: pd.DataFrame, of_shares: pd.DataFrame) -> pd.DataFrame:
    """`parameters.follows` with the slope of each pair, and the total share of the parameter's group beside it.

    A parameter that only the space has, as one of the protocol, has no correlation.

    of_slopes, of_shares  of `slopes` and `shares`; either may be empty
    """
    groups = {parameter.label: parameter.group for parameter in SPACE.values()}
    table = follows.merge(of_slopes.drop(columns="knees"), on=["feature", "parameter"], how="outer", sort=False)
    order = {name: place for place, name in enumerate(dict.fromkeys([*follows["feature"], *table["feature"]]))}
    table = table.assign(group=table["parameter"].map(groups))
    totals = of_shares[["feature", "group", "total", "total_low", "total_high"]]
    table = table.merge(totals, on=["feature", "group"], how="left", sort=False)
    return table.sort_values("feature", key=lambda names: names.map(order), kind="stable", ignore_index=True)
