"""Reliability of features across protocols, noise and positioning: intraclass correlation (ICC)."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ....core.checks import Array
from .degenerate_features import is_degenerate
from .icc_by_subject import Interval, compute_icc_form_intervals, sample_knee_weights

# Forms of the ICC for a single measurement: absolute agreement and consistency.
ICC_FORMS = ("ICC(2,1)", "ICC(3,1)")
# Smallest ICC of a stable feature ("excellent" in Koo and Li 2016); arXiv 2601.11642 uses the same threshold.
ICC_THRESHOLD = 0.90
# Classes of reliability and their lower bounds (Koo and Li 2016).
_BANDS = ((0.90, "excellent"), (0.75, "good"), (0.50, "moderate"))
_COLUMNS = ["feature", "conditions", "knees", "subjects"]
_COLUMNS += [f"{form}{end}" for form in ICC_FORMS for end in ("", " low", " high")]
_COLUMNS += ["class", "variance_fraction_knee", "variance_fraction_condition", "variance_fraction_residual"]
_UNDEFINED_INTERVALS: tuple[Interval, ...] = ((float("nan"),) * 2,) * 2
# Kind of repeat radiograph -> label in reports.
REPEAT_LABELS = {"noise": "repeated noise", "perturbation": "small perturbations"}


@dataclass(frozen=True)
class MeanSquares:
    """Mean squares of a two-way analysis of variance with one standardised value per knee and condition.

    Attributes
    ----------
    knees : int
        Number of knees.
    conditions : int
        Number of conditions.
    between_knees : float
        Mean square between knees, dimensionless.
    between_conditions : float
        Mean square between conditions, dimensionless.
    residual : float
        Residual mean square, dimensionless.
    """

    knees: int
    conditions: int
    between_knees: float
    between_conditions: float
    residual: float


def compute_mean_squares(values: Array) -> MeanSquares | None:
    """Compute the mean squares of a two-way analysis of variance.

    Parameters
    ----------
    values : (knees, conditions) float array, any unit
        One value per knee and condition.

    Returns
    -------
    MeanSquares or None
        Mean squares; None if all knees have the same value under every condition.
    """
    knees, conditions = values.shape
    if knees < 2 or conditions < 2 or all(is_degenerate(of_one) for of_one in values.T):
        return None
    # Standardising avoids a loss of precision in the squares of large values.
    values = (values - values.mean()) / values.std()
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    rest = values - rows[:, None] - columns[None, :]
    return MeanSquares(
        knees=knees,
        conditions=conditions,
        between_knees=conditions * float((rows**2).sum()) / (knees - 1),
        between_conditions=knees * float((columns**2).sum()) / (conditions - 1),
        residual=float((rest**2).sum()) / ((knees - 1) * (conditions - 1)),
    )


def icc(values: Array) -> tuple[float, float]:
    """Compute ICC(2,1) (absolute agreement) and ICC(3,1) (consistency) of single measures (Shrout and Fleiss 1979).

    Parameters
    ----------
    values : (knees, conditions) float array, any unit
        One value per knee and condition.

    Returns
    -------
    tuple of float
        ICC(2,1) and ICC(3,1); NaN if all knees have the same value, because the ICC is then undefined.
    """
    s = compute_mean_squares(values)
    return (float("nan"), float("nan")) if s is None else _compute_icc_forms(s)


def compute_variance_fractions(values: Array) -> tuple[float, float, float]:
    """Compute the fractions of variance due to knee, condition and residual for a single measurement.

    The variance components are those of the two-way random-effects model; negative estimates are set to 0 (Searle
    1992). The residual includes noise and the interaction of knee and condition.

    Parameters
    ----------
    values : (knees, conditions) float array, any unit
        One value per knee and condition.

    Returns
    -------
    tuple of float
        Variance fractions due to knee, condition and residual, which sum to 1; NaN if all knees have the same value.
    """
    s = compute_mean_squares(values)
    if s is None:
        return (float("nan"),) * 3
    of_knee = max(0.0, (s.between_knees - s.residual) / s.conditions)
    of_condition = max(0.0, (s.between_conditions - s.residual) / s.knees)
    total = of_knee + of_condition + s.residual
    return of_knee / total, of_condition / total, s.residual / total


def pivot_features(
    table: pd.DataFrame, names: list[str], condition_column: str, conditions: list[str]
) -> tuple[Array, NDArray[Any]]:
    """Arrange features by knee and condition; knees that lack a radiograph under any condition are omitted.

    Parameters
    ----------
    table : DataFrame
        Radiographs: knee, subject, `condition_column` and features.
    names : list of str
        Names of the features.
    condition_column : str
        Column that contains the condition of each radiograph.
    conditions : list of str
        Conditions, in the order of the second axis of the returned `values`.

    Returns
    -------
    values : (knees, conditions, features) float64 array
        Values of the features.
    subjects : (knees,) array
        Subject identifier of each knee, as number or text.
    """
    wide = table[table[condition_column].isin(conditions)].pivot(index="knee", columns=condition_column, values=names)
    cells = np.stack([wide[name].reindex(columns=conditions).to_numpy(np.float64) for name in names], axis=2)
    counts = (
        table[table[condition_column].isin(conditions)].groupby("knee")[condition_column].nunique().reindex(wide.index)
    )
    whole = (counts == len(conditions)).to_numpy()
    subjects = table.groupby("knee")["subject"].first().reindex(wide.index)[whole]
    return cells[whole], subjects.to_numpy()


def compute_reliability(
    table: pd.DataFrame, names: list[str], reference: str, *, replicates: int = 2000, seed: int = 0
) -> pd.DataFrame:
    """Compute the ICC of every feature across all protocols and across pairs of the reference and another protocol.

    The intervals are computed from a bootstrap of subjects with all their knees; the protocols are fixed. Intervals
    from the F distribution (McGraw and Wong 1996) are not used: for ICC(2,1), these intervals assume that the protocols
    are a random sample of a population, and two or three protocols are too few.

    Parameters
    ----------
    table : DataFrame
        One row per radiograph: knee, subject, protocol and features. Knees that were not imaged under every protocol
        are omitted.
    names : list of str
        Names of the features.
    reference : str
        Reference protocol.
    replicates : int, default 2000
        Number of bootstrap samples.
    seed : int, default 0
        Seed of the study.

    Returns
    -------
    DataFrame
        One row per feature and set of protocols: feature, conditions, knees, subjects, each ICC with its interval,
        class (reliability class of Koo and Li 2016, from the lower bound of ICC(2,1)), variance_fraction_knee,
        variance_fraction_condition, variance_fraction_residual.
    """
    protocols = list_protocols(table, reference)
    sets = [protocols] if len(protocols) == 2 else [protocols, *([a, b] for a, b in combinations(protocols, 2))]
    rows = []
    for chosen in sets:
        if len(chosen) >= 2 and reference in chosen:
            label = "all protocols" if chosen == protocols else f"{chosen[0]} and {chosen[1]}"
            values, subjects = pivot_features(table, names, "protocol", chosen)
            rows += _compute_icc_rows(values, names, label, subjects, replicates=replicates, seed=seed)
    return pd.DataFrame(rows, columns=_COLUMNS)


def compute_repeatability(
    table: pd.DataFrame,
    retest: pd.DataFrame,
    names: list[str],
    reference: str,
    *,
    replicates: int = 2000,
    seed: int = 0,
) -> pd.DataFrame:
    """Compute the ICC of every feature across repeat radiographs of the same knees under the reference protocol.

    Parameters
    ----------
    table : DataFrame
        Radiographs as for `compute_reliability`, including the first radiograph of every knee.
    retest : DataFrame
        Repeat radiographs: knee, kind ("noise" or "perturbation"), repeat_index and features.
    names : list of str
        Names of the features.
    reference : str
        Reference protocol.
    replicates : int, default 2000
        Number of bootstrap samples.
    seed : int, default 0
        Seed of the study.

    Returns
    -------
    DataFrame
        Table with the columns of `compute_reliability`, one row per feature and kind of repeat radiograph.
    """
    rows = []
    for kind, label in REPEAT_LABELS.items():
        part = retest[retest["kind"] == kind]
        first = table[(table["protocol"] == reference) & table["knee"].isin(part["knee"])]
        both = pd.concat(
            [first.assign(repeat_index="first"), part.assign(repeat_index=part["repeat_index"].astype(str))]
        )
        turns = ["first", *sorted(set(part["repeat_index"].astype(str)))]
        if len(turns) > 1 and len(first):
            values, subjects = pivot_features(both, names, "repeat_index", turns)
            rows += _compute_icc_rows(values, names, label, subjects, replicates=replicates, seed=seed)
    return pd.DataFrame(rows, columns=_COLUMNS)


def count_stable_features(table: pd.DataFrame) -> pd.DataFrame:
    """Count the features whose ICC, or whose lower ICC bound, reaches the threshold, for each set of conditions.

    Parameters
    ----------
    table : DataFrame
        Table from `compute_reliability` or `compute_repeatability`.

    Returns
    -------
    DataFrame
        One row per set of conditions: conditions; knees; degenerate (number of features without an ICC). For each
        form of the ICC: <form> (number with an ICC of at least 0.90), <form> low (number with a lower bound of at least
        0.90) and <form> of (number with an ICC). Medians of
        variance_fraction_knee, variance_fraction_condition and variance_fraction_residual.
    """
    rows = []
    for label, part in table.groupby("conditions", sort=False):
        undefined = int(part[ICC_FORMS[0]].isna().sum())
        row = {"conditions": label, "knees": int(part["knees"].max()), "degenerate": undefined}
        for form in ICC_FORMS:
            row[form] = int((part[form] >= ICC_THRESHOLD).sum())
            row[f"{form} low"] = int((part[f"{form} low"] >= ICC_THRESHOLD).sum())
            row[f"{form} of"] = int(part[form].notna().sum())
        components = ("variance_fraction_knee", "variance_fraction_condition", "variance_fraction_residual")
        rows.append(row | {name: float(part[name].median()) for name in components})
    return pd.DataFrame(rows)


def is_complete(values: Array) -> NDArray[np.bool_]:
    """Check for each knee whether a feature has a finite value under every condition.

    Parameters
    ----------
    values : (knees, conditions) float array, any unit
        Values of one feature.

    Returns
    -------
    (knees,) bool array
        True if all values of the knee are finite.
    """
    return np.asarray(np.isfinite(values).all(axis=1))


def list_protocols(table: pd.DataFrame, reference: str) -> list[str]:
    """List the protocols of a table: the reference first, the others in order of appearance.

    Parameters
    ----------
    table : DataFrame
        Table with a column ``protocol``.
    reference : str
        Reference protocol.

    Returns
    -------
    list of str
        Names of the protocols.
    """
    return sorted(table["protocol"].unique(), key=lambda name: name != reference)


def _compute_icc_rows(
    values: Array, names: list[str], label: str, subjects: NDArray[Any], *, replicates: int, seed: int
) -> list[dict[str, object]]:
    """Compute the table rows of all features for one set of conditions."""
    weights, rows = sample_knee_weights(subjects, replicates=replicates, seed=seed), []
    for index, name in enumerate(names):
        whole = is_complete(values[:, :, index])
        one = values[whole, :, index]
        forms, bounds, tested = icc(one), _UNDEFINED_INTERVALS, len(set(subjects[whole].tolist()))
        if np.isfinite(forms[0]):
            bounds = compute_icc_form_intervals(forms, one, weights[:, whole], tested)
        row: dict[str, object] = {"feature": name, "conditions": label, "knees": len(one), "subjects": tested}
        for form, value, (low, high) in zip(ICC_FORMS, forms, bounds, strict=True):
            row |= {form: value, f"{form} low": low, f"{form} high": high}
        row["class"] = _classify_icc(bounds[0][0])
        fractions = zip(
            ("variance_fraction_knee", "variance_fraction_condition", "variance_fraction_residual"),
            compute_variance_fractions(one),
            strict=True,
        )
        rows.append(row | dict(fractions))
    return rows


def _classify_icc(low: float) -> str:
    """Classify an ICC by its lower bound (Koo and Li 2016)."""
    if np.isnan(low):
        return "undefined"
    return next((name for bound, name in _BANDS if low >= bound), "poor")


def _compute_icc_forms(mean_squares: MeanSquares) -> tuple[float, float]:
    """Compute ICC(2,1) and ICC(3,1) from mean squares."""
    between = mean_squares.between_knees - mean_squares.residual
    consistency = mean_squares.between_knees + (mean_squares.conditions - 1) * mean_squares.residual
    agreement = (
        consistency
        + mean_squares.conditions * (mean_squares.between_conditions - mean_squares.residual) / mean_squares.knees
    )
    return _divide_or_nan(between, agreement), _divide_or_nan(between, consistency)


def _divide_or_nan(above: float, below: float) -> float:
    """Divide two numbers; NaN if the denominator is not positive."""
    return above / below if below > 0 else float("nan")
