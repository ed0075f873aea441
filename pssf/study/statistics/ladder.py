"""From the ladder's splits to its table: each rung with its interval, and what a rung adds to another one."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from .claims import UNDECIDED
from .intervals import estimate, estimate_share, holm_within
from .tested import TESTED, enough

CEILING = "best possible"
# Question -> a rung, and the one that is taken from it.
QUESTIONS = {
    "do features do better than a measured joint space?": ("radiomics", "measured"),
    "do features add to a measured joint space?": ("both", "measured"),
    "does texture add to a measured joint space?": ("texture", "measured"),
    "does the error of measuring matter?": ("jsw", "measured"),
    "do features do better than a true joint space?": ("radiomics", "jsw"),
    "do all parameters tell more than features and space?": ("parameters", "both"),
}
_LEVEL = 0.05  # of p after Holm


def rungs(splits: pd.DataFrame) -> pd.DataFrame:
    """grades, rung, share, trained, TESTED, splits, auc, low, high: one row a rung and share learnt from.

    splits  of `learn.ladder.climb`
    """
    rows = []
    for (grades, rung, share), part in splits.groupby(["grades", "rung", "share"], sort=False):
        of_splits = estimate_share(part["auc"].to_numpy(np.float64), ratio_of(part))
        counts = {name: int(part[name].median()) for name in ("trained", *TESTED)}
        row = {"grades": grades, "rung": rung, "share": share, **counts, "splits": int(part["auc"].notna().sum())}
        rows.append(row | {"auc": of_splits.value, "low": of_splits.low, "high": of_splits.high})
    return pd.DataFrame(rows, columns=["grades", "rung", "share", "trained", *TESTED, "splits", "auc", "low", "high"])


def ratio_of(part: pd.DataFrame) -> float:
    """Subjects tested over those that were learnt from, the mean of the splits; see `intervals.share_tested`."""
    return float((part["test_subjects"] / part["trained"]).mean())


def paired(splits: pd.DataFrame, one: str, other: str) -> pd.DataFrame:
    """repeat, trained, TESTED, difference of two rungs' AUC on the same splits of the same grades and share."""
    first, second = (splits[splits["rung"] == rung].set_index("repeat") for rung in (one, other))
    table = first.loc[first.index.intersection(second.index)]
    return table.assign(difference=table["auc"] - second["auc"]).reset_index()


def differences(splits: pd.DataFrame) -> pd.DataFrame:
    """What one rung does better than another: a row a question and pair of grades.

    splits   of `learn.ladder.climb`, learnt from all
    returns  question, grades, rung, minus, TESTED, splits, difference, low, high, p, p_holm (corrected within a
             question, over the grades), answer: yes | no | not decidable; no means that it does worse
    """
    rows = []
    for question, (one, other) in QUESTIONS.items():
        for grades, part in splits.groupby("grades", sort=False):
            table = paired(part, one, other)
            if table.empty:
                continue
            of_splits = estimate(table["difference"].to_numpy(np.float64), ratio_of(table))
            label = {"question": question, "grades": grades, "rung": one, "minus": other}
            label |= {name: int(table[name].median()) for name in TESTED} | {"splits": len(table)}
            values = {"difference": of_splits.value, "low": of_splits.low, "high": of_splits.high, "p": of_splits.p}
            rows.append({**label, **values})
    columns = ["question", "grades", "rung", "minus", *TESTED, "splits", "difference", "low", "high", "p"]
    table = pd.DataFrame(rows, columns=columns)
    table = table.assign(p_holm=holm_within(table, ["question"]))
    return table.assign(answer=[_answer(row) for row in table.to_dict("records")])


def _answer(row: Mapping[str, float]) -> str:
    if not enough(row) or not row["high"] > row["low"] or not row["p_holm"] < _LEVEL:
        return UNDECIDED
    return "yes" if row["difference"] > 0 else "no"


def ceiling(separability: pd.DataFrame) -> pd.DataFrame:
    """grades, rung, knees, auc, low, high: of the better fit to all parameters of drawn knees, at least the best.

    separability  of `learn.separability.separability`
    """
    part = separability[separability["known"] == "all parameters"].sort_values("auc", ascending=False, kind="stable")
    best = part.drop_duplicates("grades").sort_values("grades")
    return best.assign(rung=CEILING)[["grades", "rung", "knees", "auc", "low", "high"]].reset_index(drop=True)
