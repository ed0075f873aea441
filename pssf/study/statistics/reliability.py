"""How far a feature keeps its value when the protocol, the noise or the position changes: intraclass correlation."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import Array
from .degenerate import is_degenerate
from .icc_by_subject import Interval, icc_intervals_by_weights, knee_weights

ICC_FORMS = ("ICC(2,1)", "ICC(3,1)")
THRESHOLD = 0.90  # "excellent" in Koo & Li 2016, and what the paper counts
_BANDS = ((0.90, "excellent"), (0.75, "good"), (0.50, "moderate"))
_COLUMNS = ["feature", "across", "knees", "subjects"]
_COLUMNS += [f"{form}{end}" for form in ICC_FORMS for end in ("", " low", " high")]
_COLUMNS += ["class", "share_knee", "share_condition", "share_residual"]
_UNKNOWN: tuple[Interval, ...] = ((float("nan"),) * 2,) * 2
REPEATS = {"noise": "repeated noise", "perturbation": "small perturbations"}


@dataclass(frozen=True)
class Squares:
    """Mean squares of a two-way analysis of variance of standardised values: (knees, conditions), one in a cell."""

    knees: int
    conditions: int
    of_knees: float
    of_conditions: float
    rest: float


def squares(values: Array) -> Squares | None:
    """Mean squares, or None where no knee differs from another under any condition.

    values  (knees, conditions) of any unit
    """
    knees, conditions = values.shape
    if knees < 2 or conditions < 2 or all(is_degenerate(of_one) for of_one in values.T):
        return None
    values = (values - values.mean()) / values.std()  # keeps squares of large features within the digits of a float
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    rest = values - rows[:, None] - columns[None, :]
    return Squares(
        knees=knees,
        conditions=conditions,
        of_knees=conditions * float((rows**2).sum()) / (knees - 1),
        of_conditions=knees * float((columns**2).sum()) / (conditions - 1),
        rest=float((rest**2).sum()) / ((knees - 1) * (conditions - 1)),
    )


def icc(values: Array) -> tuple[float, float]:
    """ICC(2,1), absolute agreement, and ICC(3,1), consistency; single measure (Shrout & Fleiss 1979).

    values   (knees, conditions) of any unit
    returns  NaN, NaN where knees do not differ, whatever conditions do: there is nothing to agree on
    """
    s = squares(values)
    return (float("nan"), float("nan")) if s is None else _forms(s)


def variance_shares(values: Array) -> tuple[float, float, float]:
    """Shares of the variance of one radiograph: knee, condition, rest (their interaction and noise); they sum to 1.

    Components of the two-way random model from its mean squares; a negative estimate is set to 0 (Searle 1992).

    values  (knees, conditions) of any unit
    """
    s = squares(values)
    if s is None:
        return (float("nan"),) * 3
    of_knee = max(0.0, (s.of_knees - s.rest) / s.conditions)
    of_condition = max(0.0, (s.of_conditions - s.rest) / s.knees)
    total = of_knee + of_condition + s.rest
    return of_knee / total, of_condition / total, s.rest / total


def grid(table: pd.DataFrame, names: list[str], by: str, conditions: list[str]) -> tuple[Array, NDArray[Any]]:
    """(knees, conditions, features) of the knees that have every condition; (knees,) their subjects, number or text."""
    wide = table[table[by].isin(conditions)].pivot(index="knee", columns=by, values=names)
    cells = np.stack([wide[name].reindex(columns=conditions).to_numpy(np.float64) for name in names], axis=2)
    counts = table[table[by].isin(conditions)].groupby("knee")[by].nunique().reindex(wide.index)
    whole = (counts == len(conditions)).to_numpy()
    subjects = table.groupby("knee")["subject"].first().reindex(wide.index)[whole]
    return cells[whole], subjects.to_numpy()


def reliability(
    table: pd.DataFrame, names: list[str], reference: str, *, replicates: int = 2000, seed: int = 0
) -> pd.DataFrame:
    """ICC of every feature across all protocols, and across the reference and each other one.

    Intervals are by a bootstrap of subjects, each with all its knees: they are of these protocols, held fixed, and hold
    the chance of who is radiographed. Those by the F distribution (McGraw and Wong 1996) would be, for ICC(2,1), of
    protocols drawn from a population, of which two or three say next to nothing.

    table    one row a radiograph: knee, subject, protocol, features; knees that lack a protocol are left out
    returns  a row a feature and set: feature, across, knees, their subjects, each form with its interval, class (of
             Koo & Li 2016, by the lower bound of ICC(2,1)), share_knee, share_condition, share_residual
    """
    protocols = protocols_of(table, reference)
    sets = [protocols] if len(protocols) == 2 else [protocols, *([a, b] for a, b in combinations(protocols, 2))]
    rows = []
    for chosen in sets:
        if len(chosen) >= 2 and reference in chosen:
            label = "all protocols" if chosen == protocols else f"{chosen[0]} and {chosen[1]}"
            values, subjects = grid(table, names, "protocol", chosen)
            rows += _rows(values, names, label, subjects, replicates=replicates, seed=seed)
    return pd.DataFrame(rows, columns=_COLUMNS)


def repeatability(
    table: pd.DataFrame,
    retest: pd.DataFrame,
    names: list[str],
    reference: str,
    *,
    replicates: int = 2000,
    seed: int = 0,
) -> pd.DataFrame:
    """`reliability` across repeats of the same knees under the reference protocol.

    table   of `reliability`; it has the first radiograph of every knee
    retest  radiographs of some knees taken again: knee (as in the table), kind (noise | perturbation), turn, features
    """
    rows = []
    for kind, label in REPEATS.items():
        part = retest[retest["kind"] == kind]
        first = table[(table["protocol"] == reference) & table["knee"].isin(part["knee"])]
        both = pd.concat([first.assign(turn="first"), part.assign(turn=part["turn"].astype(str))])
        turns = ["first", *sorted(set(part["turn"].astype(str)))]
        if len(turns) > 1 and len(first):
            values, subjects = grid(both, names, "turn", turns)
            rows += _rows(values, names, label, subjects, replicates=replicates, seed=seed)
    return pd.DataFrame(rows, columns=_COLUMNS)


def count_stable(table: pd.DataFrame) -> pd.DataFrame:
    """For each set of conditions: features with an ICC of 0.90 or more, by estimate and by lower bound; how many vary.

    returns  across, knees, degenerate; <form>, <form> low, <form> of; share_knee, share_condition, share_residual
             (medians)
    """
    rows = []
    for label, part in table.groupby("across", sort=False):
        undefined = int(part[ICC_FORMS[0]].isna().sum())
        row = {"across": label, "knees": int(part["knees"].max()), "degenerate": undefined}
        for form in ICC_FORMS:
            row[form] = int((part[form] >= THRESHOLD).sum())
            row[f"{form} low"] = int((part[f"{form} low"] >= THRESHOLD).sum())
            row[f"{form} of"] = int(part[form].notna().sum())
        shares = ("share_knee", "share_condition", "share_residual")
        rows.append(row | {name: float(part[name].median()) for name in shares})
    return pd.DataFrame(rows)


def is_whole(values: Array) -> NDArray[np.bool_]:
    """(knees,) whether a feature is known of a knee under every condition

    values  (knees, conditions) of any unit
    """
    return np.asarray(np.isfinite(values).all(axis=1))


def protocols_of(table: pd.DataFrame, reference: str) -> list[str]:
    """The protocols of a table: the reference first, then as they come."""
    return sorted(table["protocol"].unique(), key=lambda name: name != reference)


def _rows(
    values: Array, names: list[str], label: str, subjects: NDArray[Any], *, replicates: int, seed: int
) -> list[dict[str, object]]:
    weights, rows = knee_weights(subjects, replicates=replicates, seed=seed), []
    for index, name in enumerate(names):
        whole = is_whole(values[:, :, index])
        one = values[whole, :, index]
        forms, bounds, tested = icc(one), _UNKNOWN, len(set(subjects[whole].tolist()))
        if np.isfinite(forms[0]):
            bounds = icc_intervals_by_weights(forms, one, weights[:, whole], tested)
        row: dict[str, object] = {"feature": name, "across": label, "knees": len(one), "subjects": tested}
        for form, value, (low, high) in zip(ICC_FORMS, forms, bounds, strict=True):
            row |= {form: value, f"{form} low": low, f"{form} high": high}
        row["class"] = _band(bounds[0][0])
        shares = zip(("share_knee", "share_condition", "share_residual"), variance_shares(one), strict=True)
        rows.append(row | dict(shares))
    return rows


def _band(low: float) -> str:
    if np.isnan(low):
        return "undefined"
    return next((name for bound, name in _BANDS if low >= bound), "poor")


def _forms(s: Squares) -> tuple[float, float]:
    between = s.of_knees - s.rest
    consistency = s.of_knees + (s.conditions - 1) * s.rest
    agreement = consistency + s.conditions * (s.of_conditions - s.rest) / s.knees
    return _ratio(between, agreement), _ratio(between, consistency)


def _ratio(above: float, below: float) -> float:
    return above / below if below > 0 else float("nan")
