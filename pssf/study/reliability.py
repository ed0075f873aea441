"""How far a feature keeps its value when the protocol changes: intraclass correlation."""

from itertools import combinations

import pandas as pd

from ..checks import Array
from .scenarios import protocols_of
from .selection import is_degenerate

ICC_FORMS = ("ICC(2,1)", "ICC(3,1)")
THRESHOLD = 0.90  # "excellent" in Koo & Li 2016, and what the paper counts


def icc(values: Array) -> tuple[float, float]:
    """ICC(2,1), absolute agreement, and ICC(3,1), consistency; single measure (Shrout & Fleiss 1979).

    values   (knees, protocols)
    returns  NaN, NaN where nothing varies: 0/0
    """
    knees, protocols = values.shape
    if knees < 2 or protocols < 2 or is_degenerate(values.ravel()):
        return float("nan"), float("nan")
    values = (values - values.mean()) / values.std()  # keeps squares of large features within the digits of a float
    of_knees, of_protocols = values.mean(axis=1), values.mean(axis=0)
    ms_knees = protocols * float((of_knees**2).sum()) / (knees - 1)
    ms_protocols = knees * float((of_protocols**2).sum()) / (protocols - 1)
    rest = values - of_knees[:, None] - of_protocols[None, :]
    ms_rest = float((rest**2).sum()) / ((knees - 1) * (protocols - 1))
    between = ms_knees - ms_rest
    consistency = ms_knees + (protocols - 1) * ms_rest
    agreement = consistency + protocols * (ms_protocols - ms_rest) / knees
    return _ratio(between, agreement), _ratio(between, consistency)


def reliability(table: pd.DataFrame, names: list[str], reference: str) -> pd.DataFrame:
    """ICC of every feature across all protocols, and across the reference and each other one.

    table    one row a radiograph: knee, protocol, features; knees that lack a protocol are left out
    returns  feature, protocols, knees, ICC(2,1), ICC(3,1)
    """
    protocols = protocols_of(table, reference)
    sets = [protocols] if len(protocols) == 2 else [protocols, *([a, b] for a, b in combinations(protocols, 2))]
    rows = []
    for chosen in sets:
        if len(chosen) < 2 or reference not in chosen:
            continue
        part = table[table["protocol"].isin(chosen)]
        for name in names:
            grid = part.pivot(index="knee", columns="protocol", values=name)[chosen].dropna().to_numpy()
            forms = dict(zip(ICC_FORMS, icc(grid), strict=True))
            label = "all protocols" if chosen == protocols else f"{chosen[0]} and {chosen[1]}"
            rows.append({"feature": name, "protocols": label, "knees": len(grid), **forms})
    return pd.DataFrame(rows, columns=["feature", "protocols", "knees", *ICC_FORMS])


def count_stable(table: pd.DataFrame) -> pd.DataFrame:
    """For each set of protocols: features with an ICC of 0.90 or more, of how many that vary."""
    rows = []
    for label, part in table.groupby("protocols", sort=False):
        undefined = int(part[ICC_FORMS[0]].isna().sum())
        row = {"protocols": label, "knees": int(part["knees"].max()), "degenerate": undefined}
        for form in ICC_FORMS:
            row[form] = int((part[form] >= THRESHOLD).sum())
            row[f"{form} of"] = int(part[form].notna().sum())
        rows.append(row)
    return pd.DataFrame(rows)


def _ratio(above: float, below: float) -> float:
    return above / below if below > 0 else float("nan")
