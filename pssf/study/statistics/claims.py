"""What the paper says of its own cohort, asked of this one: holds, does not hold, or cannot be decided from it.

Alzubaidi and Al-Bayaty, arXiv 2601.11642, sections 3.2 to 3.4. A claim holds when the whole 95 per cent interval of its
number lies on the claimed side of the bound, does not hold when all of it lies on the other, and is not decidable else.
"""

import numpy as np
import pandas as pd

from ...core.checks import Array
from ..predictions import TASKS
from ..settings import MODELS, SELECTIONS, StudySettings
from .metrics import METRICS, percentiles
from .reliability import ICC_FORMS, THRESHOLD
from .subjects import draws, worst_grades

Estimate = tuple[float, float, float]  # value, and the ends of its interval
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
# An AUC from which on discrimination is called excellent (Hosmer, Lemeshow and Sturdivant 2013); here for both measures
# that the paper gives.
_HIGH = 0.80
_ASKED = ("auc", "balanced_accuracy")
_FAMILIES = ("glcm", "glszm")
_STREAM = 2**31 + 1  # beside that of `intervals`
LEAST_TESTED = 6


def claims(
    usable: pd.DataFrame,
    predictions: pd.DataFrame,
    importances: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    settings: StudySettings,
) -> pd.DataFrame:
    """One row a claim and way to measure it: COLUMNS.

    usable       radiographs with a region found: subject, grade, protocol, features
    predictions  of all splits, see `predictions`
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
    order = {claim: place for place, claim in enumerate(dict.fromkeys(str(row["claim"]) for row in rows))}
    return pd.DataFrame(sorted(rows, key=lambda row: order[str(row["claim"])]), columns=COLUMNS)


def verdict(low: float, high: float, bound: float, side: int = +1) -> str:
    """Whether an interval lies beyond a bound; side +1: above it is claimed, -1: below it."""
    if not np.isfinite([low, high]).all():
        return "not decidable"
    beyond, short = (low > bound, high < bound) if side > 0 else (high < bound, low > bound)
    return "holds" if beyond else "does not hold" if short else "not decidable"


def _row(claim: str, measure: str, estimate: Estimate, bound: float, side: int = +1) -> dict[str, object]:
    value, low, high = estimate
    decided = {"bound": bound, "verdict": verdict(low, high, bound, side)}
    return {"claim": claim, "measure": measure, "value": value, "low": low, "high": high, **decided}


def _trends(usable: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = usable[usable["protocol"] == settings.reference]
    if part["grade"].nunique() < 2:
        return []
    weights, rows = _weights(part, settings), []
    for claim, feature, side in _TRENDS:
        if feature in part:
            rho = spearman(part["grade"].to_numpy(float), part[feature].to_numpy(float), weights)
            measure = f"Spearman's ρ of grade and {feature}, {settings.reference}"
            rows.append(_row(claim, measure, _interval(rho), 0.0, side))
    return rows


def _weights(table: pd.DataFrame, settings: StudySettings) -> Array:
    """(1 + replicates, rows)  counts: how often each row is in a sample of the subjects; in the first each is once"""
    worst = worst_grades(table["subject"], table["grade"])
    drawn = draws(worst, replicates=settings.replicates, seed=settings.seed, stream=_STREAM)
    return drawn[worst.index.get_indexer(table["subject"])].T


def _interval(replicates: Array) -> Estimate:
    """The first of a statistic's replicates, and the 2.5th and 97.5th percentile of the others."""
    return float(replicates[0]), *percentiles(replicates[1:])


def spearman(one: Array, other: Array, weights: Array) -> Array:
    """(replicates,)  Spearman's rho of two variables in samples of their rows

    Pearson's correlation of mid-ranks, as `scipy.stats.spearmanr` of the rows written out.

    one, other  (rows,)  each in its own unit
    weights     (replicates, rows)  counts: how often each row is in a sample
    """
    whole = weights.sum(axis=1, keepdims=True)
    ranks = []
    for values in (one, other):
        place = np.unique(values, return_inverse=True)[1]
        counts = weights @ (place[:, None] == np.arange(place.max() + 1))
        middle = (np.cumsum(counts, axis=1) - counts / 2)[:, place]
        ranks.append(middle - (weights * middle).sum(axis=1, keepdims=True) / whole)
    products = [(weights * a * b).sum(axis=1) for a, b in ((ranks[0], ranks[1]), (ranks[0],) * 2, (ranks[1],) * 2)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(products[0] / np.sqrt(products[1] * products[2]))


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
    part = importances[(importances["task"] == "0 vs 2") & (importances["trained_on"] == settings.reference)]
    rows = []
    for (model, selection), of_model in part.groupby(["model", "selection"], sort=False):
        ours = of_model["feature"].str.split("_").str[0].isin(_FAMILIES)
        shares = (of_model["share"] * ours).groupby(of_model["repeat"]).sum()
        low, high = np.percentile(shares, (2.5, 97.5))
        estimate = float(shares.mean()), float(low), float(high)
        measure = f"share of GLCM and GLSZM in the importance of {_arm(model, selection)}; interval over the splits"
        rows.append(_row("The most important features are of GLCM and GLSZM", measure, estimate, 0.5))
    return rows


def _between(predictions: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = predictions[(predictions["task"] == "0/1/2") & (predictions["scenario"] == "within")]
    part = part[(part["model"] == settings.models[0]) & (part["selection"] == settings.selections[0])]
    if part.empty:
        return []
    arm, grade = _arm(settings.models[0], settings.selections[0]), part["truth"].to_numpy(int)
    weights = _weights(part.assign(grade=grade), settings)
    score = (part["p1"] + 2 * part["p2"]).to_numpy(float)
    with np.errstate(invalid="ignore"):
        means = [(weights @ (score * (grade == k))) / (weights @ (grade == k)) for k in range(3)]
    rows = []
    for upper in (1, 2):
        measure = f"predicted grade of grade {upper} less that of {upper - 1}, {arm}"
        rows.append(_row("Grade 1 lies in between", measure, _interval(means[upper] - means[upper - 1]), 0.0))
    off = np.abs(part[["p0", "p1", "p2"]].to_numpy().argmax(axis=1) - grade)
    spared = (weights @ ((off == 1) * 1.0 - (off == 2))) / weights.sum(axis=1)
    measure = f"share confused by one grade less share confused by two, {arm}"
    rows.append(_row("The extreme grades are seldom confused", measure, _interval(spared), 0.0))
    return rows


def _performance(scores: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")]
    part = part[part["selection"].isin(settings.selections) & part["model"].isin(settings.models)]
    rows = []
    for line in part.to_dict("records"):
        claim = "Within a protocol, grades 0 and 2 are told apart well"
        if line["model"] == "lr":
            claim = f"Logistic regression is strong with few features (at most {settings.most_features})"
        for metric in _ASKED:
            estimate = (line[metric], line[f"{metric}_low"], line[f"{metric}_high"])
            arm = _arm(line["model"], line["selection"])
            rows.append(_row(claim, f"{METRICS[metric]}, 0 vs 2, {arm} (paper: 0.92)", estimate, _HIGH))
    return rows


def _changes(differences: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    claimed = (
        ("cross minus within", "Another protocol lowers the performance", -1),
        ("multi minus cross", "Training on all protocols brings it back", +1),
    )
    rows = []
    for comparison, claim, side in claimed:
        part = differences[
            (differences["comparison"] == comparison)
            & (differences["task"] == next(iter(TASKS)))
            & differences["metric"].isin(_ASKED)
            & differences["selection"].isin(settings.selections)
        ]
        for line in part.to_dict("records"):
            on = line["tested_on"].replace("_", " ")
            arm = _arm(line["model"], line["selection"])
            measure = f"{METRICS[line['metric']]}, {comparison}, {arm}, {on}"
            rows.append(_row(claim, measure, (line["difference"], line["low"], line["high"]), 0.0, side))
    return rows


def _arm(model: str, selection: str) -> str:
    return f"{MODELS[model]}, {SELECTIONS[selection]}"
