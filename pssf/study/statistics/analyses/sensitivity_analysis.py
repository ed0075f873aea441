"""Sensitivity analysis of features: Sobol indices of parameter groups, and local slopes at constant noise."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from SALib.analyze import sobol

from ....core.checks import Array
from ...design.sensitivity_plan import PARAMETER_SPACE, build_salib_problem
from ..features.degenerate_features import is_degenerate
from ..scores.metrics import mean_with_interval
from .knee_parameters import extract_knee_parameters

SOBOL_COLUMNS = ["feature", "group", "samples", "first", "first_low", "first_high", "total", "total_low", "total_high"]
SLOPE_COLUMNS = ["feature", "parameter", "knees", "slope", "slope_low", "slope_high"]
# Number of bootstrap samples for the intervals of Sobol indices.
_BOOTSTRAP_RESAMPLES = 400
# Smallest number of complete samples; with fewer samples, the coverage of the 95 % intervals is too low.
_MIN_COMPLETE_SAMPLES = 32
# Confidence level of the intervals.
_CONFIDENCE_LEVEL = 0.95


def compute_sobol_indices(
    table: pd.DataFrame, names: list[str], bounds: Mapping[str, tuple[float, float]], samples: int, seed: int
) -> pd.DataFrame:
    """Compute the first-order and total Sobol index of every parameter group for every feature.

    The first-order index is the fraction of variance that a group explains alone. The total index includes its
    interactions with other groups (Saltelli 2010; Jansen 1999). SALib computes the intervals from a bootstrap of the
    samples. If one radiograph causes most of the variance of a feature, an estimate may be far below 0 or above 1. The
    coverage of the intervals of these features is below 95 %.

    Parameters
    ----------
    table : DataFrame
        Radiographs planned by `sensitivity_plan.plan_sobol_samples`, with a located region: repeat_index and features.
    names : list of str
        Names of the features.
    bounds : mapping of str to tuple of float
        Lower and upper bound of each parameter, in the unit of the parameter.
    samples : int
        Number of samples N of the design.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    DataFrame
        Columns `SOBOL_COLUMNS`. Samples with a missing radiograph and features with too few samples are omitted.
    """
    problem = build_salib_problem(bounds)
    values = np.full((samples * (len(dict.fromkeys(problem["groups"])) + 2), len(names)), np.nan)
    values[table["repeat_index"].to_numpy(np.int64) - 1] = table[names].to_numpy(np.float64)
    return analyse_sobol_design(problem, values, names, seed)


def analyse_sobol_design(problem: dict[str, Any], values: Array, names: list[str], seed: int) -> pd.DataFrame:
    """Compute the Sobol indices of every parameter group from the features at the points of a design.

    Parameters
    ----------
    problem : dict of str to Any
        Problem definition of SALib, with groups (`sensitivity_plan.build_salib_problem`).
    values : (points, features) float array, any unit
        Features at the points of the design, in the order of the design; NaN if a radiograph is missing.
    names : list of str
        Names of the features.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    DataFrame
        Columns `SOBOL_COLUMNS`, as in `compute_sobol_indices`.
    """
    groups = list(dict.fromkeys(problem["groups"]))
    blocks = values.reshape(-1, len(groups) + 2, len(names))
    rows: list[dict[str, Any]] = []
    for index, name in enumerate(names):
        whole = blocks[np.isfinite(blocks[:, :, index]).all(axis=1), :, index]
        if len(whole) < _MIN_COMPLETE_SAMPLES or is_degenerate(whole.ravel()):
            continue
        indices = sobol.analyze(
            problem,
            whole.ravel(),
            calc_second_order=False,
            num_resamples=_BOOTSTRAP_RESAMPLES,
            conf_level=_CONFIDENCE_LEVEL,
            seed=1 + seed % 2**32,  # SALib ignores a seed of 0.
        )
        for place, group in enumerate(groups):
            row: dict[str, Any] = {"feature": name, "group": group, "samples": len(whole)}
            for form, key in (("first", "S1"), ("total", "ST")):
                value, half = float(indices[key][place]), float(indices[f"{key}_conf"][place])
                row |= {form: value, f"{form}_low": value - half, f"{form}_high": value + half}
            rows.append(row)
    return pd.DataFrame(rows, columns=SOBOL_COLUMNS)


def compute_slopes(
    base: pd.DataFrame,
    pairs: pd.DataFrame,
    manifest: pd.DataFrame,
    names: list[str],
    bounds: Mapping[str, tuple[float, float]],
) -> pd.DataFrame:
    """Compute the slope of every feature against each parameter, in feature SD per parameter SD.

    The slope is the mean over the knees, with the interval of a t test. The SD of a feature is over the knees of the
    cohort. The SD of a parameter is the SD of a uniform distribution between its bounds.

    Parameters
    ----------
    base : DataFrame
        Radiographs of the cohort under the reference protocol, with a located region: knee and features.
    pairs : DataFrame
        Radiographs planned by `sensitivity_plan.plan_sensitivity_pairs`, with a located region: source_knee, kind
        (parameter), columns of a manifest and features.
    manifest : DataFrame
        Manifest of the cohort under the reference protocol.
    names : list of str
        Names of the features.
    bounds : mapping of str to tuple of float
        Lower and upper bound of each parameter, in the unit of the parameter.

    Returns
    -------
    DataFrame
        Columns `SLOPE_COLUMNS`.
    """
    before = _add_largest_osteophyte(manifest).drop_duplicates("knee").set_index("knee")
    own = base.drop_duplicates("knee").set_index("knee")[names]
    spread = own.std(ddof=1).to_numpy(np.float64)
    after = _add_largest_osteophyte(pairs)
    rows: list[dict[str, Any]] = []
    for parameter, part in after[after["source_knee"].isin(own.index)].groupby("kind", sort=False):
        span = bounds[str(parameter)][1] - bounds[str(parameter)][0]
        values, knees = part[str(parameter)].to_numpy(np.float64), part["source_knee"]
        step = values - before.loc[knees, str(parameter)].to_numpy(float)
        change = part[names].to_numpy(np.float64) - own.loc[knees].to_numpy(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = change / step[:, None] * span / np.sqrt(12) / spread
        for index, name in enumerate(names):
            values = slope[np.isfinite(slope[:, index]), index]
            label = {"feature": name, "parameter": PARAMETER_SPACE[str(parameter)].label, "knees": len(values)}
            rows.append(
                label | dict(zip(("slope", "slope_low", "slope_high"), mean_with_interval(values), strict=True))
            )
    return pd.DataFrame(rows, columns=SLOPE_COLUMNS)


def _add_largest_osteophyte(table: pd.DataFrame) -> pd.DataFrame:
    """Add the column ``largest_osteophyte_mm`` to a manifest."""
    largest = extract_knee_parameters(table.assign(knee=range(len(table)))).get("largest_osteophyte_mm")
    return table.assign(largest_osteophyte_mm=0.0 if largest is None else largest.to_numpy())


def merge_sensitivity_tables(
    correlations: pd.DataFrame, slope_table: pd.DataFrame, sobol_table: pd.DataFrame
) -> pd.DataFrame:
    """Merge correlations, slopes and total Sobol indices of each feature and parameter.

    The total Sobol index is that of the parameter group to which the parameter belongs. Protocol parameters have no
    correlation.

    Parameters
    ----------
    correlations : DataFrame
        Table from `knee_parameters.correlate_with_parameters`.
    slope_table : DataFrame
        Table from `compute_slopes`; it may be empty.
    sobol_table : DataFrame
        Table from `compute_sobol_indices`; it may be empty.

    Returns
    -------
    DataFrame
        One row per feature and parameter, with correlations, slope and total Sobol index.
    """
    groups = {parameter.label: parameter.group for parameter in PARAMETER_SPACE.values()}
    table = correlations.merge(slope_table.drop(columns="knees"), on=["feature", "parameter"], how="outer", sort=False)
    order = {name: place for place, name in enumerate(dict.fromkeys([*correlations["feature"], *table["feature"]]))}
    table = table.assign(group=table["parameter"].map(groups))
    totals = sobol_table[["feature", "group", "total", "total_low", "total_high"]]
    table = table.merge(totals, on=["feature", "group"], how="left", sort=False)
    return table.sort_values("feature", key=lambda names: names.map(order), kind="stable", ignore_index=True)
