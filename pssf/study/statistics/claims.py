"""What the paper says of its own cohort, asked of this one: holds, does not hold, or cannot be decided from it.

Alzubaidi and Al-Bayaty, arXiv 2601.11642, sections 3.2 to 3.4. A claim holds when the whole 95 per cent interval of its
number lies on the claimed side of the bound, does not hold when all of it lies on the other, and is not decidable else;
nor is it where the interval has no width, or splits do not test `enough` subjects. Differences between arms are
decided only where they stay after Holm's correction for the arms compared, since a claim is asked of many.
"""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import t as t_distribution

from ...core.checks import Array
from ..predictions import truth_and_probability
from ..settings import MODELS, SELECTIONS, StudySettings
from ..tasks import TASKS
from .intervals import estimate, estimate_share, share_tested
from .metrics import METRICS, confusion, percentiles
from .reliability import ICC_FORMS, THRESHOLD
from .subjects import draws, worst_grades
from .tested import LEAST_TESTED, TESTED, count_tested, enough

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
_STREAM = 2**31 + 1  # key under a study's seed, as `external`'s of films, and beside that of `icc_by_subject`
UNDECIDED = "not decidable"
_LEVEL = 0.05  # of p after Holm
# Of an interval of 95 per cent, and the greatest correlation that has a finite z.
_TAIL, _SURE = 0.025, 1 - 1e-12


def claims(
    usable: pd.DataFrame,
    predictions: pd.DataFrame,
    importances: pd.DataFrame,
    offered: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    settings: StudySettings,
) -> pd.DataFrame:
    """One row a claim and way to measure it: COLUMNS.

    usable       radiographs with a region found: subject, grade, protocol, features
    predictions  of all splits, see `predictions`
    importances  of the same: task, trained_on, model, selection, repeat, feature, share
    offered      of the same: task, trained_on, selection, repeat, feature
    tables       scores, differences, reliability, subjects
    """
    ratio = share_tested(tables["subjects"])
    rows = [
        *_trends(usable, settings),
        *_stable(tables["reliability"]),
        *_families(importances, offered, tables["scores"], settings, ratio),
        *_between(predictions, settings, ratio),
        *_performance(tables["scores"], settings),
        *_changes(tables["differences"], settings),
    ]
    order = {claim: place for place, claim in enumerate(dict.fromkeys(str(row["claim"]) for row in rows))}
    return pd.DataFrame(sorted(rows, key=lambda row: order[str(row["claim"])]), columns=COLUMNS)


def verdict(low: float, high: float, bound: float, side: int = +1) -> str:
    """Whether an interval lies beyond a bound; side +1: above it is claimed, -1: below it."""
    if not np.isfinite([low, high]).all() or high <= low:
        return UNDECIDED
    beyond, short = (low > bound, high < bound) if side > 0 else (high < bound, low > bound)
    return "holds" if beyond else "does not hold" if short else UNDECIDED


def _row(
    claim: str, measure: str, estimate: Estimate, bound: float, side: int = +1, *, decidable: bool
) -> dict[str, object]:
    value, low, high = estimate
    decided = verdict(low, high, bound, side) if decidable else UNDECIDED
    row = {"claim": claim, "measure": measure, "value": value, "low": low, "high": high}
    return row | {"bound": bound, "verdict": decided}


def _trends(usable: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = usable[usable["protocol"] == settings.reference]
    if part["grade"].nunique() < 2:
        return []
    weights, rows = _weights(part, settings), []
    known = enough(count_tested(part["subject"], part["grade"], set(part["grade"])))
    for claim, feature, side in _TRENDS:
        if feature in part:
            rho = spearman(part["grade"].to_numpy(float), part[feature].to_numpy(float), weights)
            measure = f"Spearman's ρ of grade and {feature}, {settings.reference}"
            rows.append(_row(claim, measure, _interval(rho), 0.0, side, decidable=known))
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
    """The greatest ICC of all features, between the greatest of their lower and of their upper bounds, and THRESHOLD.

    A feature is stable where its lower bound is above, none where no upper bound is. One of a hundred lower bounds
    is above by chance: here they hold together (`_together`). The share that is would not do: its interval ends at 0
    and 1, and where it has no width nothing could refute the claim.
    """
    rows = []
    form = ICC_FORMS[0]
    for across, part in reliability.dropna(subset=form).groupby("across", sort=False):
        columns = (form, f"{form} low", f"{form} high")
        stable = [int((part[column] >= THRESHOLD).sum()) for column in columns]
        value, high = (float(part[column].max()) for column in (columns[0], columns[2]))
        subjects = int(part["subjects"].median())
        values, lows = part[[*columns[:2]]].to_numpy(np.float64).T
        low = float(pd.Series(_together(values, lows, subjects)).max())
        share = f"{stable[0]} of {len(part)} features are ≥ {THRESHOLD:.2f}, {stable[1]} by their lower bound"
        measure = f"greatest {form}, {across}; {share} (paper: 43 of 107)"
        numbers, decidable = (value, low, high), subjects >= LEAST_TESTED  # of knees, whatever their grade
        rows.append(_row("A subset of features is stable", measure, numbers, THRESHOLD, decidable=decidable))
    return rows


def _together(values: Array, lows: Array, subjects: int) -> Array:
    """(n,)  lower bounds that hold all at once, from values and lower bounds, each (n,), of which each alone holds

    Bonferroni's level on Fisher's z, in which an ICC is about normal, by t as of `icc_interval`.
    """
    z, z_low = (np.arctanh(np.clip(ends, -_SURE, _SURE)) for ends in (values, lows))
    one, all_of_them = t_distribution.isf([_TAIL, _TAIL / len(values)], max(1, subjects - 1))
    return np.where(lows < values, np.tanh(z - (z - z_low) * all_of_them / one), lows)


def _families(
    importances: pd.DataFrame, offered: pd.DataFrame, scores: pd.DataFrame, settings: StudySettings, ratio: float
) -> list[dict[str, object]]:
    """Their share in the importance, against a half, or what a draw from the features offered would give if more."""
    part, given = (
        table[(table["task"] == "0 vs 2") & (table["trained_on"] == settings.reference)]
        for table in (importances, offered)
    )
    rows = []
    decidable = len(part) > 0 and enough(_within(scores)[TESTED].max())
    for (model, selection), of_model in part.groupby(["model", "selection"], sort=False):
        shares = (of_model["share"] * _of_families(of_model)).groupby(of_model["repeat"]).sum()
        of_selection = given[given["selection"] == selection]
        by_chance = float(_of_families(of_selection).groupby(of_selection["repeat"]).mean().mean())
        of_splits = estimate_share(shares.to_numpy(), ratio)
        measure = f"share of GLCM and GLSZM in the importance of {_arm(model, selection)}; {by_chance:.2f} by chance"
        claim = "The most important features are of GLCM and GLSZM"
        numbers, bound = (of_splits.value, of_splits.low, of_splits.high), max(0.5, by_chance)
        rows.append(_row(claim, measure, numbers, bound, decidable=decidable))
    return rows


def _of_families(table: pd.DataFrame) -> pd.Series:
    return table["feature"].str.split("_").str[0].isin(_FAMILIES)


def _between(predictions: pd.DataFrame, settings: StudySettings, ratio: float) -> list[dict[str, object]]:
    part = predictions[(predictions["task"] == "0/1/2") & (predictions["scenario"] == "within")]
    part = part[(part["model"] == settings.models[0]) & (part["selection"] == settings.selections[0])]
    if part.empty:
        return []
    arm, steps, spared = _arm(settings.models[0], settings.selections[0]), [], []
    for _, split in part.groupby("repeat", sort=False):
        truth, probability = truth_and_probability(split)
        if len(set(truth)) == 3:
            score = probability @ np.arange(3)
            steps.append(np.diff([score[truth == grade].mean() for grade in range(3)]))
            spared.append(_spared(confusion(truth, probability)))
    by_split = np.array(steps).reshape(-1, 2)
    counts = pd.DataFrame([count_tested(one["subject"], one["truth"], range(3)) for _, one in part.groupby("repeat")])
    decidable, rows = enough(counts.median()), []
    for upper in (1, 2):
        of_splits = estimate(by_split[:, upper - 1], ratio, -2.0, 2.0)
        measure = f"predicted grade of grade {upper} less that of {upper - 1}, {arm}"
        estimated = of_splits.value, of_splits.low, of_splits.high
        rows.append(_row("Grade 1 lies in between", measure, estimated, 0.0, decidable=decidable))
    of_splits = estimate(np.array(spared), ratio)
    measure = f"share that chance would confuse by two grades, with the same calls, less the share confused, {arm}"
    estimated = of_splits.value, of_splits.low, of_splits.high
    rows.append(_row("The extreme grades are seldom confused", measure, estimated, 0.0, decidable=decidable))
    return rows


def _spared(counts: NDArray[np.int64]) -> float:
    """Share of rows confused between the first and last class that chance gives, less the share that is.

    By chance: calls as often as they are, spread over the rows without regard to the class. A comparison with the share
    confused by one grade would not do: there are twice as many ways to it, so that random calls have it larger.

    counts  (3, 3) of `confusion`
    """
    true, called, rows = counts.sum(axis=1), counts.sum(axis=0), counts.sum()
    by_chance = (true[0] * called[2] + true[2] * called[0]) / rows**2
    return float(by_chance - (counts[0, 2] + counts[2, 0]) / rows)


def _within(scores: pd.DataFrame) -> pd.DataFrame:
    return scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")]


def _performance(scores: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    part = _within(scores)
    part = part[part["selection"].isin(settings.selections) & part["model"].isin(settings.models)]
    rows = []
    for line in part.to_dict("records"):
        claim = "Within a protocol, grades 0 and 2 are told apart well"
        if line["model"] == "lr":
            claim = f"Logistic regression is strong with few features (at most {settings.most_features})"
        for metric in _ASKED:
            numbers = (line[metric], line[f"{metric}_low"], line[f"{metric}_high"])
            measure = f"{METRICS[metric]}, 0 vs 2, {_arm(line['model'], line['selection'])} (paper: 0.92)"
            rows.append(_row(claim, measure, numbers, _HIGH, decidable=enough(line)))
    return rows


def _changes(differences: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    claimed = (
        ("cross minus within", "Another protocol lowers the performance", -1),
        ("multi minus cross", "Training on all protocols brings it back", +1),
        ("mixed minus cross", "Training on all protocols brings it back", +1),
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
            decidable = line["p_holm"] < _LEVEL and enough(line)
            numbers = (line["difference"], line["low"], line["high"])
            rows.append(_row(claim, measure, numbers, 0.0, side, decidable=decidable))
    return rows


def _arm(model: str, selection: str) -> str:
    return f"{MODELS[model]}, {SELECTIONS[selection]}"
