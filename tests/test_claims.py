"""Check the verdicts of the study on the claims of the paper."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from numpy.testing import assert_allclose

from pssf.study import StudySettings
from pssf.study.statistics.scores.claims import (
    COLUMNS,
    UNDECIDED,
    _compute_avoided_confusion,
    _compute_simultaneous_bounds,
    _evaluate_grade_order,
    compute_spearman,
    decide_verdict,
    evaluate_claims,
)
from pssf.study.statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS

SETTINGS = StudySettings(replicates=200, models=("lr",), selections=("l1",))
GLCM_AND_GLSZM = ["glcm_Contrast", "glcm_Id", "glszm_a", "glszm_b"]


def make_radiograph_table(rise, seed=3, subjects=90):
    """Return a table of subjects with one knee each; features increase by `rise` standard deviations per grade."""
    rng = np.random.default_rng(seed)
    grade = np.repeat([0, 1, 2], subjects // 3)
    names = ("firstorder_linear_Mean", "firstorder_linear_Energy", "glcm_Contrast", "glcm_JointEntropy")
    values = {name: rise * grade + rng.standard_normal(subjects) for name in names}
    return pd.DataFrame({"subject": np.arange(subjects), "grade": grade, "protocol": "reference", **values})


def evaluate_synthetic_claims(
    rise, score_step=0.0, *, tested=30, rarest=3, p_holm=0.01, texture=(0.8, 0.7), icc=(0.92, 0.97), other_families=2
):
    table = make_radiograph_table(rise)
    rng = np.random.default_rng(4)
    middle = table["grade"] * score_step + 0.3 * rng.standard_normal(len(table))
    p = np.stack([np.exp(-((middle - k) ** 2)) for k in range(3)], axis=1)
    p /= p.sum(axis=1, keepdims=True)
    predictions = pd.DataFrame({
        "task": "0/1/2", "scenario": "within", "model": "lr", "selection": "l1", "subject": table["subject"],
        "repeat": table["subject"] % 5, "truth": table["grade"], "p0": p[:, 0], "p1": p[:, 1], "p2": p[:, 2],
    })  # fmt: skip
    importances = pd.DataFrame({
        "task": "0 vs 2", "trained_on": "reference", "model": "lr", "selection": "l1",
        "repeat": np.repeat(np.arange(10), 2), "feature": ["glcm_Contrast", "shape2D_Sphericity"] * 10,
        "importance": [value for fraction in texture for value in (fraction, 1 - fraction)] * 5,
    })  # fmt: skip
    offered = pd.DataFrame({
        "task": "0 vs 2", "trained_on": "reference", "selection": "l1",
        "repeat": np.repeat(np.arange(10), 4),
        "feature": 10 * (GLCM_AND_GLSZM[other_families:] + other_families * ["gldm_a"]),
    })  # fmt: skip
    subjects = pd.DataFrame({"repeat": 0, "subject": range(6), "part": ["training"] * 4 + ["validation", "test"]})
    scores = pd.DataFrame([{
        "task": "0 vs 2", "scenario": "within", "trained_on": "reference", "tested_on": "reference", "model": "lr",
        "selection": "l1", "test_subjects": tested, "test_rarest": rarest,
        "auc": 0.9, "auc_low": 0.85, "auc_high": 0.95,
        "balanced_accuracy": 0.7, "balanced_accuracy_low": 0.6, "balanced_accuracy_high": 0.78,
    }])  # fmt: skip
    differences = pd.DataFrame([
        {"comparison": name, "task": "0 vs 2", "metric": metric, "selection": "l1", "model": "lr",
         "tested_on": "low_dose", "difference": d, "low": low, "high": high, "p_holm": p, "test_subjects": tested,
         "test_rarest": rarest}
        for name, d, low, high, p in (
            ("cross minus within", -0.1, -0.2, -0.05, p_holm), ("multi minus cross", 0.02, -0.1, 0.1, 0.5))
        for metric in ("auc", "balanced_accuracy", "macro_f1")
    ])  # fmt: skip
    reliability = pd.DataFrame({
        "feature": ["a", "b"], "conditions": "all protocols", "subjects": tested,
        "ICC(2,1)": [np.mean(icc), 0.5], "ICC(2,1) low": [icc[0], 0.3], "ICC(2,1) high": [icc[1], 0.7],
    })  # fmt: skip
    tables = {"subjects": subjects, "scores": scores, "differences": differences, "reliability": reliability}
    found = evaluate_claims(table, predictions, importances, offered, tables, SETTINGS)
    assert list(found.columns) == COLUMNS
    return found


def select_verdicts(found, start):
    """Return the verdicts on the claims whose text begins with `start`."""
    return set(found[found["claim"].str.startswith(start)]["verdict"])


def test_a_claim_is_undecided_when_the_interval_crosses_the_bound():
    assert decide_verdict(0.1, 0.2, 0.0) == "holds"
    assert decide_verdict(-0.2, -0.1, 0.0) == "does not hold"
    assert decide_verdict(-0.2, -0.1, 0.0, -1) == "holds"
    assert decide_verdict(-0.1, 0.1, 0.0) == "not decidable"
    assert decide_verdict(float("nan"), 0.1, 0.0) == "not decidable"


def test_a_claim_is_undecided_when_the_interval_has_no_width():
    assert decide_verdict(1.0, 1.0, 0.8) == "not decidable"


def test_claims_are_undecided_with_too_few_test_subjects():
    starts = (
        *("Models discriminate", "Logistic regression performs well", "Testing on another protocol", "GLCM and GLSZM"),
        "A subset of features is stable",
    )
    for tested, expected in (
        (MIN_TEST_SUBJECTS, {"holds", "does not hold"}),
        (MIN_TEST_SUBJECTS - 1, {"not decidable"}),
    ):
        found = evaluate_synthetic_claims(rise=1.0, tested=tested)
        decided = {one for start in starts for one in select_verdicts(found, start)}
        assert decided == expected


def test_claims_are_undecided_with_too_few_subjects_of_the_rarer_grade():
    starts = (
        "Models discriminate",
        "Logistic regression performs well",
        "Testing on another protocol",
        "GLCM and GLSZM",
    )
    for rarest, expected in (
        (MIN_TEST_SUBJECTS_PER_CLASS, {"holds", "does not hold"}),
        (MIN_TEST_SUBJECTS_PER_CLASS - 1, {UNDECIDED}),
    ):
        found = evaluate_synthetic_claims(rise=1.0, tested=30, rarest=rarest)
        assert {one for start in starts for one in select_verdicts(found, start)} == expected


@pytest.mark.parametrize(
    ("rarest", "decided"), [(MIN_TEST_SUBJECTS_PER_CLASS, True), (MIN_TEST_SUBJECTS_PER_CLASS - 1, False)]
)
def test_grade_order_is_decided_only_with_enough_subjects_of_each_grade(rarest, decided):
    truth = np.repeat([0, 1, 2], [12, 12, rarest])
    p = np.exp(-((truth[:, None] - np.arange(3)) ** 2) + 0.01 * np.arange(len(truth))[:, None])
    arm = {"task": "0/1/2", "scenario": "within", "model": "lr", "selection": "l1"}
    one = pd.DataFrame(p / p.sum(axis=1, keepdims=True), columns=["p0", "p1", "p2"])
    one = one.assign(subject=range(len(truth)), truth=truth, **arm)
    splits = [one.iloc[k:].assign(repeat=k) for k in range(3)]
    rows = _evaluate_grade_order(pd.concat(splits, ignore_index=True), SETTINGS, 0.2)
    assert {row["verdict"] == UNDECIDED for row in rows if "extreme" in str(row["claim"])} == {not decided}


@pytest.mark.parametrize(
    ("icc", "expected"),
    [
        ((0.92, 0.97), "holds"),
        ((0.88, 0.97), "not decidable"),
        ((0.80, 0.89), "does not hold"),
        ((1.0, 1.0), "not decidable"),
    ],
    ids=["above", "across", "below", "no width"],
)
def test_feature_stability_is_decided_by_the_most_stable_feature(icc, expected):
    row = evaluate_synthetic_claims(rise=1.0, icc=icc).set_index("claim").loc["A subset of features is stable"]
    assert (row["verdict"], row["bound"]) == (expected, 0.9)
    assert row["high"] == icc[1]
    # The lower bound is simultaneous for all features.
    assert icc[0] - 0.02 < row["low"] <= icc[0]


def test_a_claim_is_undecided_without_significance_after_holm():
    assert select_verdicts(evaluate_synthetic_claims(rise=1.0, p_holm=0.06), "Testing on another protocol") == {
        "not decidable"
    }


def test_importance_is_compared_with_the_fraction_of_available_features():
    found = evaluate_synthetic_claims(rise=1.0, texture=(0.45, 0.40))
    row = found[found["claim"].str.startswith("GLCM and GLSZM")].iloc[0]
    assert (row["bound"], row["verdict"]) == (0.5, "does not hold")
    # Three of four features belong to the two families, so the importance expected by chance is 0.75.
    for texture, expected in (((0.8, 0.9), "holds"), ((0.7, 0.6), "does not hold"), ((0.8, 0.7), UNDECIDED)):
        found = evaluate_synthetic_claims(rise=1.0, texture=texture, other_families=1)
        row = found[found["claim"].str.startswith("GLCM and GLSZM")].iloc[0]
        assert (row["bound"], row["verdict"]) == (0.75, expected)


def test_random_predictions_do_not_avoid_confusing_extreme_grades():
    counts = np.outer([30, 20, 50], [10, 60, 30])
    assert _compute_avoided_confusion(counts) == pytest.approx(0)
    assert _compute_avoided_confusion(np.diag([30, 20, 50])) == pytest.approx(2 * 30 * 50 / 100**2)


def test_verdicts_match_a_strong_synthetic_signal():
    found = evaluate_synthetic_claims(rise=1.0, score_step=1.0)
    assert select_verdicts(found, "GLCM contrast") == {"holds"}
    # The feature is the mean of the linear signal, which decreases as the displayed brightness increases.
    assert select_verdicts(found, "First-order mean") == {"does not hold"}
    assert select_verdicts(found, "Predicted grades of knees with grade 1") == {"holds"}
    assert select_verdicts(found, "The extreme grades") == {"holds"}
    assert select_verdicts(found, "A subset") == {"holds"}
    assert select_verdicts(found, "GLCM and GLSZM") == {"holds"}
    performance = found[found["claim"].str.startswith("Logistic regression performs well")].set_index("measure")[
        "verdict"
    ]
    assert performance.to_dict() == {
        "AUC, 0 vs 2, Logistic regression, L1 (published: 0.92)": "holds",
        "Balanced accuracy, 0 vs 2, Logistic regression, L1 (published: 0.92)": "does not hold",
    }
    assert len(found[found["claim"].str.startswith("Testing on another protocol")]) == 2
    assert select_verdicts(found, "Testing on another protocol") == {"holds"}
    assert select_verdicts(found, "Training on all") == {"not decidable"}


def test_weighted_spearman_equals_spearman_of_repeated_rows():
    rng = np.random.default_rng(5)
    grade, value = rng.integers(0, 3, 40).astype(float), np.round(rng.standard_normal(40), 1)
    weights = rng.integers(0, 4, (20, 40)).astype(float)
    for found, times in zip(compute_spearman(grade, value, weights), weights.astype(int), strict=True):
        expected = scipy.stats.spearmanr(np.repeat(grade, times), np.repeat(value, times)).statistic
        assert found == pytest.approx(expected, abs=1e-12)


def test_trends_are_undecided_when_grades_do_not_differ():
    found = evaluate_synthetic_claims(rise=0.0)
    trends = found[found["measure"].str.startswith("Spearman")]
    assert len(trends) == 4
    # One of the four 95 % intervals may exclude zero by chance.
    assert (trends["verdict"] == "not decidable").sum() >= 3
    assert select_verdicts(found, "Predicted grades of knees with grade 1") == {"not decidable"}


def test_the_interval_width_of_a_trend_matches_fishers_z():
    found = evaluate_synthetic_claims(rise=1.0).set_index("claim").loc["GLCM contrast rises with grade"]
    # The standard error of Fisher's z is 1.03 / sqrt(n - 3) with n = 90 subjects.
    z = np.arctanh([found["low"], found["high"]])
    assert np.ptp(z) == pytest.approx(2 * 1.96 * 1.03 / np.sqrt(87), rel=0.35)


def test_simultaneous_bounds_keep_their_joint_coverage():
    rng, features, cohorts, error = np.random.default_rng(3), 100, 400, 0.2
    alone = together = 0
    for _ in range(cohorts):
        z = np.arctanh(0.9) + error * rng.standard_normal(features)
        lows = np.tanh(z - 1.959964 * error)
        alone += lows.max() >= 0.9
        together += _compute_simultaneous_bounds(np.tanh(z), lows, 10**6).max() >= 0.9
    assert together <= scipy.stats.binom.isf(1e-3, cohorts, 0.025)
    assert alone > cohorts / 2
    assert_allclose(_compute_simultaneous_bounds(np.array([0.8]), np.array([0.6]), 20), [0.6])
    assert_allclose(_compute_simultaneous_bounds(np.array([0.8, 1.0]), np.array([np.nan, 1.0]), 20), [np.nan, 1.0])
