"""Evaluation of the claims of a published study on a cohort: holds, does not hold, or not decidable.

The claims are those of Alzubaidi and Al-Bayaty, arXiv 2601.11642, sections 3.2 to 3.4. A claim holds if the entire 95 %
interval of its measure is on the claimed side of a bound. It does not hold if the entire interval is on the other side.
Otherwise it is not decidable. A claim is also not decidable if the interval has no width or the test sets are too
small. A claim about differences between arms is decided only if the difference is significant after Holm's correction
over the compared arms.
"""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import t as t_distribution

from ....core.checks import Array
from ...design.classification_tasks import TASKS
from ...design.study_settings import MODELS, SELECTIONS, StudySettings
from ...predictions import extract_truth_and_probability
from ..features.reliability import ICC_FORMS, ICC_THRESHOLD
from .confidence_intervals import compute_test_train_ratio, estimate_mean, estimate_proportion
from .metrics import METRICS, confusion_matrix, percentile_interval
from .subject_resampling import sample_bootstrap_counts, worst_grades
from .tested_subjects import (
    MIN_TEST_SUBJECTS,
    TEST_COUNT_COLUMNS,
    count_test_subjects,
    has_enough_test_subjects,
)

# Value, and lower and upper limit of its 95 % interval.
ValueWithInterval = tuple[float, float, float]
COLUMNS = ["claim", "measure", "value", "low", "high", "bound", "verdict"]
# Claimed trends: claim, feature and expected sign for linear pixels. Denser bone transmits less radiation, so it is
# brighter in a displayed radiograph but has a lower linear signal.
_TRENDS = (
    ("First-order mean rises with grade (with bright bone)", "firstorder_linear_Mean", -1),
    ("First-order energy rises with grade (with bright bone)", "firstorder_linear_Energy", -1),
    ("GLCM contrast rises with grade", "glcm_Contrast", +1),
    ("GLCM entropy rises with grade", "glcm_JointEntropy", +1),
    ("GLCM dissimilarity rises with grade", "glcm_DifferenceAverage", +1),
    ("GLCM homogeneity falls with grade", "glcm_Id", -1),
)
# Smallest AUC of excellent discrimination (Hosmer, Lemeshow and Sturdivant 2013), also used for balanced accuracy,
# the other metric in the published study.
_EXCELLENT = 0.80
_CLAIMED_METRICS = ("auc", "balanced_accuracy")
_CLAIMED_FAMILIES = ("glcm", "glszm")
# Key of the bootstrap random stream, combined with the seed of the study; `icc_by_subject` uses another key.
_STREAM = 2**31 + 1
# Verdict if the data are insufficient for a decision about a claim.
UNDECIDED = "not decidable"
# Significance level of the p-value after Holm's correction, dimensionless.
_SIGNIFICANCE_LEVEL = 0.05
# Probability of each tail outside a 95 % interval.
_TAIL = 0.025
# Largest absolute correlation, dimensionless; clipping keeps Fisher's z finite.
_SURE = 1 - 1e-12


def evaluate_claims(
    usable: pd.DataFrame,
    predictions: pd.DataFrame,
    importances: pd.DataFrame,
    selection_candidates: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    settings: StudySettings,
) -> pd.DataFrame:
    """Evaluate every claim of the published study with each of its measures.

    Parameters
    ----------
    usable : DataFrame
        Radiographs with a located region: subject, grade, protocol and features.
    predictions : DataFrame
        Predictions of all splits.
    importances : DataFrame
        Importances of all splits: task, trained_on, model, selection, repeat, feature, importance.
    selection_candidates : DataFrame
        Features that remain after pruning, with the columns task, trained_on, selection, repeat and feature.
    tables : dict of str to DataFrame
        Tables scores, differences, reliability and subjects.
    settings : StudySettings
        Settings of the study.

    Returns
    -------
    DataFrame
        One row per claim and measure, with the columns `COLUMNS`.
    """
    ratio = compute_test_train_ratio(tables["subjects"])
    rows = [
        *_evaluate_trends(usable, settings),
        *_evaluate_stability(tables["reliability"]),
        *_evaluate_families(importances, selection_candidates, tables["scores"], settings, ratio),
        *_evaluate_grade_order(predictions, settings, ratio),
        *_evaluate_performance(tables["scores"], settings),
        *_evaluate_protocol_changes(tables["differences"], settings),
    ]
    order = {claim: place for place, claim in enumerate(dict.fromkeys(str(row["claim"]) for row in rows))}
    return pd.DataFrame(sorted(rows, key=lambda row: order[str(row["claim"])]), columns=COLUMNS)


def decide_verdict(low: float, high: float, bound: float, direction: int = +1) -> str:
    """Decide whether an entire interval is on the claimed side of a bound.

    Parameters
    ----------
    low : float
        Lower limit of the interval.
    high : float
        Upper limit of the interval.
    bound : float
        Bound of the claim.
    direction : int, default 1
        +1 if the claim is that the value is above the bound, -1 if it is that the value is below the bound.

    Returns
    -------
    str
        Verdict: "holds", "does not hold" or "not decidable".
    """
    if not np.isfinite([low, high]).all() or high <= low:
        return UNDECIDED
    beyond, short = (low > bound, high < bound) if direction > 0 else (high < bound, low > bound)
    return "holds" if beyond else "does not hold" if short else UNDECIDED


def _make_claim_row(
    claim: str, measure: str, estimate: ValueWithInterval, bound: float, direction: int = +1, *, decidable: bool
) -> dict[str, object]:
    """Make one row of the table of claims."""
    value, low, high = estimate
    decided = decide_verdict(low, high, bound, direction) if decidable else UNDECIDED
    row = {"claim": claim, "measure": measure, "value": value, "low": low, "high": high}
    return row | {"bound": bound, "verdict": decided}


def _evaluate_trends(usable: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    """Evaluate the claimed trends of features with grade using Spearman's rho."""
    part = usable[usable["protocol"] == settings.reference]
    if part["grade"].nunique() < 2:
        return []
    weights, rows = _sample_bootstrap_counts(part, settings), []
    known = has_enough_test_subjects(count_test_subjects(part["subject"], part["grade"], set(part["grade"])))
    for claim, feature, side in _TRENDS:
        if feature in part:
            rho = compute_spearman(part["grade"].to_numpy(float), part[feature].to_numpy(float), weights)
            measure = f"Spearman's ρ of grade and {feature}, {settings.reference}"
            rows.append(_make_claim_row(claim, measure, _compute_interval(rho), 0.0, side, decidable=known))
    return rows


def _sample_bootstrap_counts(table: pd.DataFrame, settings: StudySettings) -> Array:
    """Sample how often each row of a table occurs in each bootstrap sample of the subjects.

    Return counts (1 + replicates, rows); all counts in the first row are 1.
    """
    worst = worst_grades(table["subject"], table["grade"])
    drawn = sample_bootstrap_counts(worst, replicates=settings.replicates, seed=settings.seed, stream=_STREAM)
    return drawn[worst.index.get_indexer(table["subject"])].T


def _compute_interval(replicates: Array) -> ValueWithInterval:
    """Return the first value and the 95 % percentile interval of the other values, which are from bootstrap samples."""
    return float(replicates[0]), *percentile_interval(replicates[1:])


def compute_spearman(first: Array, second: Array, weights: Array) -> Array:
    """Compute Spearman's rho of two variables in weighted samples of their rows.

    The result is Pearson's correlation of mid-ranks. It equals the result of `scipy.stats.spearmanr` for a table in
    which each row is repeated `weights` times.

    Parameters
    ----------
    first : (rows,) float array, any unit
        First variable.
    second : (rows,) float array, any unit
        Second variable.
    weights : (replicates, rows) float array, counts
        Number of times that each row occurs in each sample.

    Returns
    -------
    (replicates,) float array
        Spearman's rho of each sample.
    """
    whole = weights.sum(axis=1, keepdims=True)
    ranks = []
    for values in (first, second):
        place = np.unique(values, return_inverse=True)[1]
        counts = weights @ (place[:, None] == np.arange(place.max() + 1))
        middle = (np.cumsum(counts, axis=1) - counts / 2)[:, place]
        ranks.append(middle - (weights * middle).sum(axis=1, keepdims=True) / whole)
    products = [(weights * a * b).sum(axis=1) for a, b in ((ranks[0], ranks[1]), (ranks[0],) * 2, (ranks[1],) * 2)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(products[0] / np.sqrt(products[1] * products[2]))


def _evaluate_stability(reliability: pd.DataFrame) -> list[dict[str, object]]:
    """Evaluate the claim that some features are stable, using the highest ICC over all features.

    The claim holds if the lower bound of at least one ICC is above the threshold. It does not hold if no upper bound is
    above the threshold. Among many features, some lower bounds are above the threshold by chance, so simultaneous lower
    bounds are used. The fraction of stable features is not used as the measure, because its interval has no width at a
    fraction of 0.
    """
    rows = []
    form = ICC_FORMS[0]
    for across, part in reliability.dropna(subset=form).groupby("conditions", sort=False):
        columns = (form, f"{form} low", f"{form} high")
        stable = [int((part[column] >= ICC_THRESHOLD).sum()) for column in columns]
        value, high = (float(part[column].max()) for column in (columns[0], columns[2]))
        subjects = int(part["subjects"].median())
        values, lows = part[[*columns[:2]]].to_numpy(np.float64).T
        low = float(pd.Series(_compute_simultaneous_bounds(values, lows, subjects)).max())
        counts = f"≥ {ICC_THRESHOLD:.2f} in {stable[0]} of {len(part)} features, lower bound in {stable[1]}"
        measure = f"highest {form}, {across}; {counts} (published: 43 of 107 features)"
        # The ICC does not use the grade, so the number of subjects per grade is not checked.
        numbers, decidable = (value, low, high), subjects >= MIN_TEST_SUBJECTS
        rows.append(
            _make_claim_row("A subset of features is stable", measure, numbers, ICC_THRESHOLD, decidable=decidable)
        )
    return rows


def _compute_simultaneous_bounds(values: Array, lows: Array, subjects: int) -> Array:
    """Convert individual lower bounds (n,) of ICCs into simultaneous lower bounds, which are lower.

    Bonferroni's correction is applied to Fisher's z, which is approximately normal, with the t distribution as in
    `icc_by_subject.compute_icc_interval`.
    """
    z, z_low = (np.arctanh(np.clip(ends, -_SURE, _SURE)) for ends in (values, lows))
    one, all_of_them = t_distribution.isf([_TAIL, _TAIL / len(values)], max(1, subjects - 1))
    return np.where(lows < values, np.tanh(z - (z - z_low) * all_of_them / one), lows)


def _evaluate_families(
    importances: pd.DataFrame,
    selection_candidates: pd.DataFrame,
    scores: pd.DataFrame,
    settings: StudySettings,
    ratio: float,
) -> list[dict[str, object]]:
    """Evaluate the claim about GLCM and GLSZM features, using their fraction of the total feature importance.

    The bound is the larger of 0.5 and the fraction of GLCM and GLSZM features among the candidates for selection.
    """
    part, given = (
        table[(table["task"] == "0 vs 2") & (table["trained_on"] == settings.reference)]
        for table in (importances, selection_candidates)
    )
    rows = []
    decidable = len(part) > 0 and has_enough_test_subjects(_select_within_protocol(scores)[TEST_COUNT_COLUMNS].max())
    for (model, selection), of_model in part.groupby(["model", "selection"], sort=False):
        fractions = (of_model["importance"] * _is_claimed_family(of_model)).groupby(of_model["repeat"]).sum()
        of_selection = given[given["selection"] == selection]
        by_chance = float(_is_claimed_family(of_selection).groupby(of_selection["repeat"]).mean().mean())
        of_splits = estimate_proportion(fractions.to_numpy(), ratio)
        measure = f"importance fraction of GLCM and GLSZM, {_format_arm(model, selection)} (by chance {by_chance:.2f})"
        claim = "GLCM and GLSZM features are the most important"
        numbers, bound = (of_splits.value, of_splits.low, of_splits.high), max(0.5, by_chance)
        rows.append(_make_claim_row(claim, measure, numbers, bound, decidable=decidable))
    return rows


def _is_claimed_family(table: pd.DataFrame) -> pd.Series:
    """Check for each row whether its feature belongs to the family GLCM or GLSZM."""
    return table["feature"].str.split("_").str[0].isin(_CLAIMED_FAMILIES)


def _evaluate_grade_order(predictions: pd.DataFrame, settings: StudySettings, ratio: float) -> list[dict[str, object]]:
    """Evaluate the claims that grade 1 lies between grades 0 and 2, and that grades 0 and 2 are seldom confused."""
    part = predictions[(predictions["task"] == "0/1/2") & (predictions["scenario"] == "within")]
    part = part[(part["model"] == settings.models[0]) & (part["selection"] == settings.selections[0])]
    if part.empty:
        return []
    arm, steps, spared = _format_arm(settings.models[0], settings.selections[0]), [], []
    for _, split in part.groupby("repeat", sort=False):
        truth, probability = extract_truth_and_probability(split)
        if len(set(truth)) == 3:
            score = probability @ np.arange(3)
            steps.append(np.diff([score[truth == grade].mean() for grade in range(3)]))
            spared.append(_compute_avoided_confusion(confusion_matrix(truth, probability)))
    by_split = np.array(steps).reshape(-1, 2)
    counts = pd.DataFrame(
        [count_test_subjects(one["subject"], one["truth"], range(3)) for _, one in part.groupby("repeat")]
    )
    decidable, rows = has_enough_test_subjects(counts.median()), []
    for upper in (1, 2):
        of_splits = estimate_mean(by_split[:, upper - 1], ratio, -2.0, 2.0)
        measure = f"mean predicted grade, knees with grade {upper} minus knees with grade {upper - 1}, {arm}"
        estimated = of_splits.value, of_splits.low, of_splits.high
        claim = "Predicted grades of knees with grade 1 lie between those with grades 0 and 2"
        rows.append(_make_claim_row(claim, measure, estimated, 0.0, decidable=decidable))
    of_splits = estimate_mean(np.array(spared), ratio)
    measure = f"fraction of two-grade errors, expected by chance minus observed, {arm}"
    estimated = of_splits.value, of_splits.low, of_splits.high
    rows.append(_make_claim_row("The extreme grades are seldom confused", measure, estimated, 0.0, decidable=decidable))
    return rows


def _compute_avoided_confusion(counts: NDArray[np.int64]) -> float:
    """Compute the fraction of confusions between first and last class expected by chance, minus the observed fraction.

    Chance means that the same predicted classes are assigned independently of the true classes. A comparison with
    one-grade errors is not used: random predictions also contain more one-grade than two-grade errors, because
    one-grade errors can occur in twice as many ways. `counts` is the (3, 3) confusion matrix.
    """
    true, called, rows = counts.sum(axis=1), counts.sum(axis=0), counts.sum()
    by_chance = (true[0] * called[2] + true[2] * called[0]) / rows**2
    return float(by_chance - (counts[0, 2] + counts[2, 0]) / rows)


def _select_within_protocol(scores: pd.DataFrame) -> pd.DataFrame:
    """Select the scores for grade 0 vs 2 in the within-protocol scenario."""
    return scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")]


def _evaluate_performance(scores: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    """Evaluate the claims of high performance in the within-protocol scenario."""
    part = _select_within_protocol(scores)
    part = part[part["selection"].isin(settings.selections) & part["model"].isin(settings.models)]
    rows = []
    for line in part.to_dict("records"):
        claim = "Models discriminate grades 0 and 2 well within a protocol"
        if line["model"] == "lr":
            claim = f"Logistic regression performs well with few features (at most {settings.most_features})"
        for metric in _CLAIMED_METRICS:
            numbers = (line[metric], line[f"{metric}_low"], line[f"{metric}_high"])
            measure = f"{METRICS[metric]}, 0 vs 2, {_format_arm(line['model'], line['selection'])} (published: 0.92)"
            rows.append(_make_claim_row(claim, measure, numbers, _EXCELLENT, decidable=has_enough_test_subjects(line)))
    return rows


def _evaluate_protocol_changes(differences: pd.DataFrame, settings: StudySettings) -> list[dict[str, object]]:
    """Evaluate the claims about performance changes across protocols."""
    claimed = (
        ("cross minus within", "Testing on another protocol lowers performance", -1),
        ("multi minus cross", "Training on all protocols restores performance", +1),
        ("mixed minus cross", "Training on all protocols restores performance", +1),
    )
    rows = []
    for comparison, claim, side in claimed:
        part = differences[
            (differences["comparison"] == comparison)
            & (differences["task"] == next(iter(TASKS)))
            & differences["metric"].isin(_CLAIMED_METRICS)
            & differences["selection"].isin(settings.selections)
        ]
        for line in part.to_dict("records"):
            on = line["tested_on"].replace("_", " ")
            arm = _format_arm(line["model"], line["selection"])
            measure = f"{METRICS[line['metric']]}, {comparison}, {arm}, {on}"
            decidable = line["p_holm"] < _SIGNIFICANCE_LEVEL and has_enough_test_subjects(line)
            numbers = (line["difference"], line["low"], line["high"])
            rows.append(_make_claim_row(claim, measure, numbers, 0.0, side, decidable=decidable))
    return rows


def _format_arm(model: str, selection: str) -> str:
    """Format classifier and feature selection as text."""
    return f"{MODELS[model]}, {SELECTIONS[selection]}"
