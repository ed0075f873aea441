"""What the paper says of its own cohort, asked of this one: holds, does not hold, or cannot be decided from it.

Alzubaidi and Al-Bayaty, arXiv 2601.11642, sections 3.2 to 3.4. A claim holds when the whole 95 per cent interval of its
number lies on the claimed side of the bound, does not hold when all of it lies on the other, and is not decidable else.
"""

from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from . import StudySettings
from .reliability import ICC_FORMS, THRESHOLD
from .scenarios import TASKS

Found = tuple[float, float, float]  # value, and the ends of its interval
COLUMNS = ["claim", "measure", "value", "low", "high", "bound", "verdict"]
# Of a linear signal: where bone is denser less arrives, so what is brighter to the eye is a smaller number.
_TRENDS = (
    ("First-order mean rises with grade (bone bright)", "firstorder_linear_Mean", -1),
    ("First-order energy rises with grade (bone bright)", "firstorder_linear_Energy", -1),
    ("GLCM contrast rises with grade", "glcm_Contrast", +1),
    ("GLCM entropy rises with grade", "glcm_JointEntropy", +1),
    ("GLCM dissimilarity rises with grade", "glcm_DifferenceAverage", +1),
    ("GLCM homogeneity falls with grade", "glcm_Id", -1),
)
# An AUC from which on discrimination is called excellent (Hosmer, Lemeshow and Sturdivant 2013).
_HIGH_AUC = 0.80
_FAMILIES = ("glcm", "glszm")
_STREAM = 2**31 + 1  # beside that of `intervals`


def claims(
    usable: pd.DataFrame,
    predictions: pd.DataFrame,
    importances: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    settings: StudySettings,
) -> pd.DataFrame:
    """One row a claim and way to measure it: COLUMNS.

    usable       radiographs with a region found: subject, grade, protocol, features
    predictions  of `scenarios.one_split`, all splits
    importances  of the same: task, trained_on, model, selection, repeat, feature, share
    tables       scores, differences, reliability
    """
    rows = [
        *_trends(usable, settings),
        *_stable(tables["reliability"]),
        *_families(importances, settings),
        *_between(predictions, settings),
        *_performance(tables["scores"], settings),
        *_changes(tables["differences"], settings),
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def verdict(low: float, high: float, bound: float, side: int = +1) -> str:
    """Whether an interval lies beyond a bound; side +1: above it is claimed, -1: below it."""
    if not np.isfinite([low, high]).all():
        return "not decidable"
    beyond, short = (low > bound, high < bound) if side > 0 else (high < bound, low > bound)
    return "holds" if beyond else "does not hold" if short else "not decidable"


def _row(claim: str, measure: str, found: Found, bound: float, side: int = +1) -> dict[str, object]:
    value, low, high = found
    told = {"value": value, "low": low, "high": high, "bound": bound, "verdict": verdict(low, high, bound, side)}
    return {"claim": claim, "measure": measure, **told}


def _trends(usable: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = usable[usable["protocol"] == settings.reference]
    rows = []
    for claim, feature, side in _TRENDS:
        if feature not in part or part["grade"].nunique() < 2:
            continue

        def rho(rows: pd.DataFrame, feature: str = feature) -> float:
            return float(spearmanr(rows["grade"], rows[feature]).statistic)

        measure = f"Spearman's ρ of grade and {feature}, {settings.reference}"
        rows.append(_row(claim, measure, _bootstrap(part, rho, settings), 0.0, side))
    return rows


def _bootstrap(table: pd.DataFrame, statistic: Callable[[pd.DataFrame], float], settings: StudySettings) -> Found:
    """A statistic of the rows, and its percentile interval when subjects are drawn anew within their grades."""
    drawn = [statistic(rows) for rows in _drawn(table, settings)]
    low, high = np.nanpercentile(drawn, (2.5, 97.5))
    return statistic(table), float(low), float(high)


def _drawn(table: pd.DataFrame, settings: StudySettings) -> Iterator[pd.DataFrame]:
    """The rows of as many subjects of each grade, the highest of their knees, as there are, drawn with replacement."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(_STREAM,)))
    places = {subject: np.flatnonzero(table["subject"] == subject) for subject in table["subject"].unique()}
    worst = table.groupby("subject")["grade"].max()
    groups = [worst.index[worst == grade] for grade in sorted(set(worst))]
    for _ in range(settings.replicates):
        chosen = [subject for members in groups for subject in rng.choice(members, len(members))]
        yield table.iloc[np.concatenate([places[subject] for subject in chosen])]


def _stable(reliability: pd.DataFrame) -> list[dict[str, object]]:
    """The share of features that are stable, and its interval: by the bounds of each feature's own ICC."""
    rows = []
    form = ICC_FORMS[0]
    for across, part in reliability.dropna(subset=form).groupby("across", sort=False):
        share = [float((part[column] >= THRESHOLD).mean()) for column in (form, f"{form} low", f"{form} high")]
        measure = f"share of {len(part)} features with {form} ≥ {THRESHOLD:.2f}, {across} (paper: 43 of 107)"
        rows.append(_row("A subset of features is stable", measure, (share[0], share[1], share[2]), 0.0))
    return rows


def _families(importances: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = importances[
        (importances["task"] == "0 vs 2")
        & (importances["trained_on"] == settings.reference)
        & (importances["selection"] == settings.selections[0])
    ]
    rows = []
    for model, of_model in part.groupby("model", sort=False):
        ours = of_model["feature"].str.split("_").str[0].isin(_FAMILIES)
        shares = (of_model["share"] * ours).groupby(of_model["repeat"]).sum()
        low, high = np.percentile(shares, (2.5, 97.5))
        found = float(shares.mean()), float(low), float(high)
        measure = f"share of GLCM and GLSZM in the importance of {model}; interval over the splits"
        rows.append(_row("The most important features are of GLCM and GLSZM", measure, found, 0.5))
    return rows


def _between(predictions: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = predictions[(predictions["task"] == "0/1/2") & (predictions["scenario"] == "within")]
    part = part[(part["model"] == settings.models[0]) & (part["selection"] == settings.selections[0])]
    if part.empty:
        return []
    scored = part.assign(grade=part["truth"], score=part["p1"] + 2 * part["p2"])
    model = settings.models[0]
    rows = []
    for upper in (1, 2):

        def step(rows: pd.DataFrame, upper: int = upper) -> float:
            means = rows.groupby("grade")["score"].mean()
            return float(means.get(upper, np.nan) - means.get(upper - 1, np.nan))

        measure = f"predicted grade of grade {upper} less that of {upper - 1}, {model}"
        rows.append(_row("Grade 1 lies in between", measure, _bootstrap(scored, step, settings), 0.0))

    def spared(rows: pd.DataFrame) -> float:
        chosen = rows[["p0", "p1", "p2"]].to_numpy().argmax(axis=1)
        off = np.abs(chosen - rows["grade"].to_numpy())
        return float((off == 1).mean() - (off == 2).mean())

    measure = f"share confused by one grade less share confused by two, {model}"
    rows.append(_row("The extreme grades are seldom confused", measure, _bootstrap(scored, spared, settings), 0.0))
    return rows


def _performance(scores: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")]
    part = part[(part["selection"] == settings.selections[0]) & part["model"].isin(settings.models)]
    rows = []
    for line in part.to_dict("records"):
        claim = "Within a protocol, grades 0 and 2 are told apart well"
        if line["model"] == "lr":
            claim = f"Logistic regression is strong with few features (at most {settings.most_features})"
        found = (line["auc"], line["auc_low"], line["auc_high"])
        rows.append(_row(claim, f"AUC of {line['model']}, 0 vs 2 (paper: 0.92)", found, _HIGH_AUC))
    return rows


def _changes(differences: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    told = (
        ("cross minus within", "Another protocol lowers the performance", -1),
        ("multi minus cross", "Training on all protocols brings it back", +1),
    )
    rows = []
    for comparison, claim, side in told:
        part = differences[
            (differences["comparison"] == comparison)
            & (differences["task"] == next(iter(TASKS)))
            & (differences["metric"] == "auc")
            & (differences["selection"] == settings.selections[0])
        ]
        for line in part.to_dict("records"):
            measure = f"AUC, {comparison}, {line['model']}, {line['tested_on'].replace('_', ' ')}"
            rows.append(_row(claim, measure, (line["difference"], line["low"], line["high"]), 0.0, side))
    return rows
