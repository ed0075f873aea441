"""How many patients: learning curves, and power against what cohorts of that size in fact show."""

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


def studied(subjects: int, seed: int) -> pd.DataFrame:
    """Splits of a cohort in which one marker tells the grades with AUC 0.84 and another with 0.64."""
    rng = np.random.default_rng([7, seed])
    grade = 2 * (np.arange(subjects) % 2)
    markers = {"both": 1.4, "measured": 0.5}
    values = {name: shift * (grade == 2) + rng.normal(size=subjects) for name, shift in markers.items()}
    rows = []
    for repeat in range(SPLITS):
        split = split_subjects(np.arange(subjects), grade, seed=seed, repeat=repeat)
        test = split.test
        for name, value in values.items():
            row = {"grades": "0 vs 2", "rung": name, "repeat": repeat, "trained": len(split.training), "share": 1.0}
            row |= {"test_subjects": len(test), "test_rarest": len(test) // 2}
            rows.append(row | {"auc": auc(grade[test] == 2, value[test])})
    return pd.DataFrame(rows)


def shown(subjects: int, cohorts: int) -> float:
    """Share of cohorts in which the difference of the two markers is shown."""
    found = 0
    for seed in range(cohorts):
        table = learning_curves.pair_auc_differences(studied(subjects, 1000 + seed), "both", "measured")
        found += estimate_mean(table["difference"].to_numpy(), learning_curves.average_test_train_ratio(table)).p < 0.05
    return found / cohorts


def planned(subjects: int, cohorts: int, difference: float) -> pd.DataFrame:
    rows = [
        learning_curves.tabulate_power(studied(subjects, seed), pd.Series({"0 vs 2": subjects}), difference)
        for seed in range(cohorts)
    ]
    return pd.concat(rows)


def test_power_of_independent_splits_is_that_of_a_paired_t_test():
    expected = TTestPower().power(effect_size=0.7, nobs=12, alpha=0.05)
    assert learning_curves.compute_power(1 / np.sqrt(12), 0.7, 12) == pytest.approx(expected, abs=1e-6)
    rng = np.random.default_rng(0)
    p = [ttest_rel(rng.normal(0.7, 1, 12), np.zeros(12)).pvalue for _ in range(400)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(expected, abs=0.1)


def test_a_cohort_of_the_needed_size_has_the_wanted_power_and_another_size_follows():
    error = 0.05
    needed = learning_curves.subjects_needed(error, 0.1, 20, 100)
    assert learning_curves.compute_power(error * np.sqrt(100 / needed), 0.1, 20) == pytest.approx(
        learning_curves.TARGET_POWER, abs=1e-6
    )
    assert learning_curves.subjects_needed(error, 0.05, 20, 100) == pytest.approx(4 * needed)
    row = pd.Series({"error": error, "subjects": 100, "difference": 0.1, "splits": 20})
    curve = learning_curves.compute_power_curve(row, np.array([needed / 4, needed, 4 * needed]))
    assert curve[0] < 0.5 < curve[1] < curve[2]
    assert curve[1] == pytest.approx(learning_curves.TARGET_POWER, abs=1e-6)


def test_cohorts_show_a_difference_as_often_as_was_planned_from_smaller_ones():
    # AUC of two normal laws: Phi(shift / sqrt(2)).
    difference = 0.8389 - 0.6382
    needed = planned(80, 20, difference)["needed"].median()
    # The correction errs to the safe side, so that more is shown than planned, and never less than chance allows.
    assert 0.68 <= shown(2 * round(needed / 2), 120) <= 0.97
    assert shown(2 * round(needed / 8), 120) < 0.6


def test_the_spread_of_the_needed_number_is_the_chi_square_interval_of_a_variance():
    rng = np.random.default_rng(1)
    variances = rng.normal(size=(4000, 10)).var(axis=1, ddof=1)
    low, high = learning_curves.variance_interval_factors(10)
    assert np.mean((variances * low <= 1) & (variances * high >= 1)) == pytest.approx(0.95, abs=0.015)


def test_a_curve_has_the_gain_of_each_step_on_the_same_tested_subjects():
    rng = np.random.default_rng(2)
    rows = []
    for repeat in range(8):
        chance = 0.02 * rng.normal()
        for share, rise in ((0.5, 0.0), (1.0, 0.1)):
            label = {"grades": "0 vs 2", "rung": "radiomics", "repeat": repeat, "share": share}
            label |= {"trained": int(80 * share), "test_subjects": 20, "test_rarest": 10}
            rows.append(label | {"auc": 0.7 + rise + chance + 0.001 * rng.normal()})
    table = learning_curves.compute_learning_curves(pd.DataFrame(rows)).set_index("trained")
    assert np.isnan(table.loc[40, "gain"])
    assert table.loc[80, "gain"] == pytest.approx(0.1, abs=0.002)
    # With the variance of the smaller share: 20 tested over 40 learnt from.
    auc_of = pd.DataFrame(rows).pivot(index="repeat", columns="share", values="auc")
    expected = estimate_mean((auc_of[1.0] - auc_of[0.5]).to_numpy(), 20 / 40)
    assert table.loc[80, ["gain_low", "gain_high"]].tolist() == pytest.approx([expected.low, expected.high])
    # What both shares have in common is not in the interval of the gain.
    assert table.loc[80, "gain_high"] - table.loc[80, "gain_low"] < table.loc[80, "high"] - table.loc[80, "low"]


def test_splits_that_do_not_differ_plan_nothing():
    same = studied(60, 0).assign(auc=0.8)
    assert learning_curves.tabulate_power(same, pd.Series({"0 vs 2": 60}), 0.05).empty


def test_no_power_is_planned_for_an_auc_above_1():
    table = studied(60, 0)
    nearly = table.assign(auc=np.where(table["rung"] == "both", 1.0, 0.96 + 0.001 * (table["repeat"] % 2)))
    subjects = pd.Series({"0 vs 2": 60})
    assert learning_curves.tabulate_power(nearly, subjects, 0.05).empty
    assert len(learning_curves.tabulate_power(nearly, subjects, 0.03)) == 1
