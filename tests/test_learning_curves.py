"""Check learning curves and power: planned sample sizes are compared with the power of simulated cohorts."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_rel
from statsmodels.stats.power import TTestPower

from pssf.study.learn.subject_split import split_subjects
from pssf.study.statistics.analyses import learning_curves
from pssf.study.statistics.scores.confidence_intervals import estimate_mean
from pssf.study.statistics.scores.metrics import auc

SPLITS = 12


def make_splits(subjects: int, seed: int) -> pd.DataFrame:
    """Make the splits of a cohort with two markers that have AUCs of 0.84 and 0.64."""
    rng = np.random.default_rng([7, seed])
    grade = 2 * (np.arange(subjects) % 2)
    markers = {"both": 1.4, "measured": 0.5}
    values = {name: shift * (grade == 2) + rng.normal(size=subjects) for name, shift in markers.items()}
    rows = []
    for repeat in range(SPLITS):
        split = split_subjects(np.arange(subjects), grade, seed=seed, repeat=repeat)
        test = split.test
        for name, value in values.items():
            row = {
                "grades": "0 vs 2",
                "predictor_set": name,
                "repeat": repeat,
                "training_subjects": len(split.training),
                "training_fraction": 1.0,
            }
            row |= {"test_subjects": len(test), "test_rarest": len(test) // 2}
            rows.append(row | {"auc": auc(grade[test] == 2, value[test])})
    return pd.DataFrame(rows)


def estimate_power(subjects: int, cohorts: int) -> float:
    """Estimate the fraction of cohorts in which the two markers differ significantly."""
    found = 0
    for seed in range(cohorts):
        table = learning_curves.pair_auc_differences(make_splits(subjects, 1000 + seed), "both", "measured")
        found += estimate_mean(table["difference"].to_numpy(), learning_curves.average_test_train_ratio(table)).p < 0.05
    return found / cohorts


def plan_power(subjects: int, cohorts: int, difference: float) -> pd.DataFrame:
    rows = [
        learning_curves.tabulate_power(make_splits(subjects, seed), pd.Series({"0 vs 2": subjects}), difference)
        for seed in range(cohorts)
    ]
    return pd.concat(rows)


def test_power_of_independent_splits_equals_that_of_a_paired_t_test():
    expected = TTestPower().power(effect_size=0.7, nobs=12, alpha=0.05)
    assert learning_curves.compute_power(1 / np.sqrt(12), 0.7, 12) == pytest.approx(expected, abs=1e-6)
    rng = np.random.default_rng(0)
    p = [ttest_rel(rng.normal(0.7, 1, 12), np.zeros(12)).pvalue for _ in range(400)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(expected, abs=0.1)


def test_a_cohort_of_the_required_size_has_the_target_power():
    error = 0.05
    needed = learning_curves.subjects_needed(error, 0.1, 20, 100)
    assert learning_curves.compute_power(error * np.sqrt(100 / needed), 0.1, 20) == pytest.approx(
        learning_curves.TARGET_POWER, abs=1e-6
    )
    assert learning_curves.subjects_needed(error, 0.05, 20, 100) == pytest.approx(4 * needed)
    row = pd.Series({"standard_error": error, "subjects": 100, "difference": 0.1, "splits": 20})
    curve = learning_curves.compute_power_curve(row, np.array([needed / 4, needed, 4 * needed]))
    assert curve[0] < 0.5 < curve[1] < curve[2]
    assert curve[1] == pytest.approx(learning_curves.TARGET_POWER, abs=1e-6)


def test_cohorts_of_the_planned_size_reach_the_planned_power():
    # Difference between the AUCs Phi(shift / sqrt(2)) of normal distributions with shifts of 1.4 and 0.5 SD.
    difference = 0.8389 - 0.6382
    needed = plan_power(80, 20, difference)["required_subjects"].median()
    # The variance correction is conservative, so the power may exceed 0.8; the lower bound allows for sampling error.
    assert 0.68 <= estimate_power(2 * round(needed / 2), 120) <= 0.97
    assert estimate_power(2 * round(needed / 8), 120) < 0.6


def test_the_variance_interval_of_the_required_size_has_95_percent_cover():
    rng = np.random.default_rng(1)
    variances = rng.normal(size=(4000, 10)).var(axis=1, ddof=1)
    low, high = learning_curves.variance_interval_factors(10)
    assert np.mean((variances * low <= 1) & (variances * high >= 1)) == pytest.approx(0.95, abs=0.015)


def test_learning_curve_gains_are_computed_on_the_same_test_subjects():
    rng = np.random.default_rng(2)
    rows = []
    for repeat in range(8):
        split_effect = 0.02 * rng.normal()
        for fraction, rise in ((0.5, 0.0), (1.0, 0.1)):
            label = {"grades": "0 vs 2", "predictor_set": "radiomics", "repeat": repeat, "training_fraction": fraction}
            label |= {"training_subjects": int(80 * fraction), "test_subjects": 20, "test_rarest": 10}
            rows.append(label | {"auc": 0.7 + rise + split_effect + 0.001 * rng.normal()})
    table = learning_curves.compute_learning_curves(pd.DataFrame(rows)).set_index("training_subjects")
    assert np.isnan(table.loc[40, "gain"])
    assert table.loc[80, "gain"] == pytest.approx(0.1, abs=0.002)
    # The variance is corrected by the ratio of the smaller fraction: 20 test subjects over 40 training subjects.
    auc_of = pd.DataFrame(rows).pivot(index="repeat", columns="training_fraction", values="auc")
    expected = estimate_mean((auc_of[1.0] - auc_of[0.5]).to_numpy(), 20 / 40)
    assert table.loc[80, ["gain_low", "gain_high"]].tolist() == pytest.approx([expected.low, expected.high])
    # Variation between splits is common to both training fractions and cancels in the gain.
    assert table.loc[80, "gain_high"] - table.loc[80, "gain_low"] < table.loc[80, "high"] - table.loc[80, "low"]


def test_splits_without_variance_give_no_sample_size():
    same = make_splits(60, 0).assign(auc=0.8)
    assert learning_curves.tabulate_power(same, pd.Series({"0 vs 2": 60}), 0.05).empty


def test_no_power_is_computed_for_an_auc_above_one():
    table = make_splits(60, 0)
    nearly = table.assign(auc=np.where(table["predictor_set"] == "both", 1.0, 0.96 + 0.001 * (table["repeat"] % 2)))
    subjects = pd.Series({"0 vs 2": 60})
    assert learning_curves.tabulate_power(nearly, subjects, 0.05).empty
    assert len(learning_curves.tabulate_power(nearly, subjects, 0.03)) == 1
