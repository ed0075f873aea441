"""Check reliability: ICC with intervals, variance components and repeated radiographs."""

import numpy as np
import pandas as pd
import pingouin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from synthetic_features import make_features

from pssf.study.statistics.features.icc_by_subject import (
    compute_icc_form_intervals,
    compute_icc_interval,
    compute_weighted_icc,
    sample_knee_weights,
)
from pssf.study.statistics.features.reliability import (
    compute_reliability,
    compute_repeatability,
    compute_variance_fractions,
    count_stable_features,
    icc,
    pivot_features,
)
from pssf.study.statistics.scores.metrics import percentile_interval


def sample_values(knees: int, conditions: int, *, condition_sd: float, noise: float, seed: int) -> np.ndarray:
    """Sample values (knees, conditions) with variance 1 between knees, an offset per condition and noise."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(knees, 1)) + condition_sd * rng.normal(size=conditions)
    return values + noise * rng.normal(size=(knees, conditions))


def test_identical_conditions_have_an_icc_of_one_with_zero_width():
    values = np.repeat(np.arange(6.0)[:, None], 3, axis=1)
    assert icc(values) == (1.0, 1.0)
    found = compute_bounds(values, np.arange(6), replicates=50)
    assert_allclose(found, 1.0)
    assert all(low == high for low, high in found)


@pytest.mark.parametrize("offset", [0.0, 1.0, 1e6])
def test_a_feature_that_is_constant_within_conditions_has_no_icc(offset):
    values = np.tile([3.0, 3.0 + offset], (12, 1))
    values[4, 1] += 1e-13 * values[4, 1]
    assert np.isnan(icc(values)).all()
    assert np.isnan(compute_variance_fractions(values)).all()
    row = compute_reliability(make_table(values, ["reference", "other"]), ["a"], "reference").iloc[0]
    assert row["class"] == "undefined"
    assert np.isnan(row[["ICC(2,1) low", "ICC(2,1) high", "ICC(3,1) low", "ICC(3,1) high"]].astype(float)).all()
    assert (
        count_stable_features(compute_reliability(make_table(values, ["reference", "other"]), ["a"], "reference"))[
            "ICC(2,1)"
        ].item()
        == 0
    )


def test_a_constant_feature_has_no_variance_components():
    assert np.isnan(compute_variance_fractions(np.full((5, 3), 2.0))).all()


def test_variance_components_equal_the_simulated_ones():
    # Variances are 1, 0.5 and 0.25. The SD of the second is sqrt(2/39) = 23 % for 40 conditions; the bound is 4 SD.
    fractions = compute_variance_fractions(sample_values(400, 40, condition_sd=np.sqrt(0.5), noise=0.5, seed=1))
    assert sum(fractions) == pytest.approx(1)
    assert_allclose(fractions, np.array([1, 0.5, 0.25]) / 1.75, atol=4 * 0.23 * 0.5 / 1.75)
    assert fractions[0] / fractions[2] == pytest.approx(4, rel=4 * np.sqrt(2 / 399))


def test_a_negative_component_is_set_to_zero():
    values = sample_values(10, 3, condition_sd=0.0, noise=1.0, seed=0)
    # Conditions differ by less than the noise, so the unbiased variance component is negative.
    values -= values.mean(axis=0)
    assert compute_variance_fractions(values)[1] == 0.0


def make_table(values: np.ndarray, conditions: list[str]) -> pd.DataFrame:
    rows = []
    for knee, line in enumerate(values):
        for name, value in zip(conditions, line, strict=True):
            row = {"radiograph": f"{knee}_{name}", "subject": knee, "knee": knee, "protocol": name}
            rows.append(row | {"a": value, "b": 3.0})
    return pd.DataFrame(rows)


def test_identifiers_of_subjects_and_knees_may_be_strings():
    table = make_table(sample_values(12, 2, condition_sd=0.3, noise=0.4, seed=2), ["reference", "other"])
    # Two knees per subject; the string identifiers have the same order as the numbers.
    table["subject"] = table["knee"] // 2
    named = table.assign(**{name: table[name].map("P{:02d}".format) for name in ("subject", "knee")})
    again = [given[given["protocol"] == "other"].assign(kind="noise", repeat_index=1) for given in (table, named)]
    of_protocols = [compute_reliability(given, ["a"], "reference", replicates=50) for given in (table, named)]
    of_repeats = [compute_repeatability(*both, ["a"], "reference") for both in zip((table, named), again, strict=True)]
    pd.testing.assert_frame_equal(*of_protocols)
    pd.testing.assert_frame_equal(*of_repeats)


def test_the_reliability_class_uses_the_lower_bound():
    values = sample_values(12, 2, condition_sd=0.0, noise=0.15, seed=4)
    row = (
        compute_reliability(make_table(values, ["reference", "other"]), ["a", "b"], "reference")
        .set_index("feature")
        .loc["a"]
    )
    assert row["ICC(2,1)"] >= 0.90
    assert row["ICC(2,1) low"] < 0.90
    assert row["class"] == "good"


def test_a_missing_value_excludes_its_knee_only_for_its_feature():
    table = make_table(sample_values(12, 2, condition_sd=0.1, noise=0.2, seed=4), ["reference", "other"])
    whole = compute_reliability(table.assign(c=table["a"]), ["a", "c"], "reference").set_index("feature")
    table = table.assign(c=table["a"].where(table["radiograph"] != "3_other"))
    found = compute_reliability(table, ["a", "c"], "reference").set_index("feature")
    assert found.loc["a", "ICC(2,1)"] == whole.loc["a", "ICC(2,1)"]
    assert (found.loc["a", "knees"], found.loc["c", "knees"]) == (12, 11)
    assert np.isfinite(found.loc["c", "ICC(2,1)"])


def test_both_knees_of_a_subject_count_as_one_subject():
    table = make_table(sample_values(12, 2, condition_sd=0.1, noise=0.2, seed=4), ["reference", "other"])
    row = compute_reliability(table.assign(subject=table["knee"] // 2), ["a"], "reference").iloc[0]
    assert (row["knees"], row["subjects"]) == (12, 6)


def test_a_knee_that_lacks_a_protocol_is_excluded():
    table = make_table(sample_values(5, 2, condition_sd=0, noise=0.2, seed=0), ["reference", "other"])
    values, subjects = pivot_features(
        table[table["radiograph"] != "2_other"], ["a"], "protocol", ["reference", "other"]
    )
    assert values.shape == (4, 2, 1)
    assert subjects.tolist() == [0, 1, 3, 4]


def test_repeats_are_paired_with_the_first_radiograph_of_their_knee():
    first = make_table(sample_values(9, 2, condition_sd=3.0, noise=0.1, seed=2), ["reference", "other"])
    of_reference = first[first["protocol"] == "reference"]
    parts = []
    for kind, noise in (("noise", 0.01), ("perturbation", 1.0)):
        for turn in ("1", "2"):
            rng = np.random.default_rng(int(turn))
            moved = of_reference["a"] + noise * rng.normal(size=len(of_reference))
            parts.append(of_reference.assign(kind=kind, repeat_index=turn, a=moved).head(6))
    found = compute_repeatability(first, pd.concat(parts, ignore_index=True), ["a", "b"], "reference")
    stable = count_stable_features(found).set_index("conditions")
    assert list(stable.index) == ["repeated noise", "small perturbations"]
    assert (stable["knees"] == 6).all()
    assert stable.loc["repeated noise", "ICC(2,1)"] == 1
    assert stable.loc["small perturbations", "ICC(2,1)"] == 0
    assert (stable["ICC(2,1) of"] == 1).all()


def sample_knee_pairs(subjects: int, seed: int) -> np.ndarray:
    """Sample values (2 x subjects, 3) with variance 1, half of it common to both knees, and noise of variance 0.25."""
    rng = np.random.default_rng(seed)
    shared = np.repeat(rng.normal(size=subjects), 2) * np.sqrt(0.5)
    knees = shared + np.sqrt(0.5) * rng.normal(size=2 * subjects)
    return knees[:, None] + 0.5 * rng.normal(size=(2 * subjects, 3))


def compute_bounds(values: np.ndarray, subjects: np.ndarray, *, replicates: int = 500, seed: int = 0) -> tuple:
    """Compute the intervals of both forms of the ICC."""
    weights = sample_knee_weights(subjects, replicates=replicates, seed=seed)
    return compute_icc_form_intervals(icc(values), values, weights, len(set(subjects)))


@pytest.mark.parametrize("subjects", [10, 60])
def test_subject_bootstrap_intervals_have_nominal_coverage(subjects):
    missed = by_percentiles = 0
    owners = np.repeat(np.arange(subjects), 2)
    for seed in range(300):
        values = sample_knee_pairs(subjects, seed)
        low, high = compute_bounds(values, owners, replicates=300, seed=seed)[1]
        missed += not low <= 0.8 <= high
        resampled = compute_weighted_icc(values, sample_knee_weights(owners, replicates=300, seed=seed))[1]
        by_percentiles += not percentile_interval(resampled)[0] <= 0.8 <= percentile_interval(resampled)[1]
    # Of 300 intervals with 95 % coverage, 15 +- 3.8 miss the true value.
    assert missed <= 15 + 4 * 3.8
    assert missed < by_percentiles


@pytest.mark.parametrize("value", [1.0, 0.9, 0.0, -0.4])
@pytest.mark.parametrize("conditions", [2, 3, 7])
def test_an_icc_interval_contains_the_icc_within_the_possible_range(value, conditions):
    resampled = np.clip(value + 0.3 * np.random.default_rng(0).normal(size=200), -1, 1)
    low, high = compute_icc_interval(value, resampled, conditions=conditions, subjects=12)
    assert min(value, -1 / (conditions - 1)) <= low <= value <= high <= 1


def test_duplicate_knees_of_a_subject_do_not_narrow_the_interval():
    once = sample_values(60, 3, condition_sd=0.3, noise=0.5, seed=1)
    twice, subjects = np.repeat(once, 2, axis=0), np.repeat(np.arange(60), 2)
    alone = compute_bounds(once, np.arange(60))
    both = compute_bounds(twice, subjects)
    # Both results differ only by the degrees of freedom, because one data set has twice as many knees.
    assert_allclose(both, alone, atol=0.01)
    wrong = compute_bounds(twice, np.arange(120))[1]
    assert wrong[1] - wrong[0] < 0.8 * (both[1][1] - both[1][0])


def test_a_bootstrap_sample_identical_to_the_cohort_has_the_same_icc():
    values = sample_values(30, 3, condition_sd=0.5, noise=0.4, seed=2)
    found = compute_icc_form_intervals(icc(values), values, np.ones((1, 30)), 30)
    for (low, high), known in zip(found, icc(values), strict=True):
        assert low == high == pytest.approx(known, abs=1e-12)
    assert_allclose(np.ravel(compute_weighted_icc(values, np.ones((1, 30)))), icc(values), atol=1e-12)


def test_icc_intervals_are_comparable_for_one_or_two_knees_per_subject():
    # The second protocol has a large offset; the interval stays finite, because protocols are fixed effects.
    table = make_table(sample_knee_pairs(20, 5)[:, :2] + np.array([0.0, 2.0]), ["reference", "other"])
    alone = compute_reliability(table, ["a", "b"], "reference", replicates=300).set_index("feature").loc["a"]
    two = compute_reliability(table.assign(subject=table["knee"] // 2), ["a", "b"], "reference", replicates=300)
    paired = two.set_index("feature").loc["a"]
    assert alone["ICC(2,1)"] == paired["ICC(2,1)"]
    for row in (alone, paired):
        assert row["ICC(2,1) low"] < row["ICC(2,1)"] < row["ICC(2,1) high"]
    widths = [row["ICC(2,1) high"] - row["ICC(2,1) low"] for row in (alone, paired)]
    assert widths[0] == pytest.approx(widths[1], rel=0.5)
    assert alone["ICC(2,1) low"] != paired["ICC(2,1) low"]
    assert np.isnan(two.set_index("feature").loc["b", "ICC(2,1) low"])


@settings(max_examples=15)
@given(
    knees=st.integers(4, 20),
    protocols=st.integers(2, 4),
    noise=st.floats(0.05, 3),
    size=st.sampled_from([1e-6, 1.0, 1e9]),
    seed=st.integers(0, 1000),
)
def test_icc_equals_that_of_pingouin(knees, protocols, noise, size, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(knees, 1)) + noise * rng.normal(size=(knees, protocols)) + rng.normal(size=protocols)
    table = pd.DataFrame(values).rename_axis(index="knee", columns="protocol").stack().rename("value").reset_index()
    theirs = pingouin.intraclass_corr(table, "knee", "protocol", "value").set_index("Type")["ICC"]
    assert_allclose(icc(size * values), [theirs["ICC(A,1)"], theirs["ICC(C,1)"]], rtol=1e-9, atol=1e-12)


def test_an_offset_between_protocols_lowers_agreement_and_not_consistency():
    values = np.arange(10.0)[:, None] + np.array([0.0, 5.0])
    agreement, consistency = icc(values)
    assert consistency == pytest.approx(1)
    assert 0 < agreement < 0.5


def test_a_constant_feature_without_an_icc_is_counted_separately():
    assert np.isnan(icc(np.full((5, 3), 7.0))).all()
    assert np.isnan(icc(1 + 1e-15 * np.arange(15.0).reshape(5, 3))).all()
    table = make_features(8).assign(constant=1.0)
    stable = count_stable_features(compute_reliability(table, ["signal", "constant"], "reference"))
    assert list(stable["conditions"]) == [
        "all protocols",
        "reference and low_dose",
        "reference and geometry_shift",
    ]
    assert (stable["degenerate"] == 1).all()
    assert (stable["ICC(2,1) of"] == 1).all()
