"""Check the claims of the study on random labels, for which no claim is true."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from pssf.study.predictions import concatenate_tables
from pssf.study.statistics.features.reliability import compute_reliability
from pssf.study.statistics.scores.claims import _evaluate_grade_order, _evaluate_stability
from pssf.validation.study_methods.random_label_test import (
    FEATURE_NAMES,
    SETTINGS,
    count_false_claims,
    sample_random_label_cohort,
)


@pytest.mark.slow
def test_claims_of_the_study_rarely_hold_for_random_labels():
    # Each measure supports a false claim in 2.5 % of cohorts; a claim has two to four, mostly correlated measures.
    rows = count_false_claims(1, cohorts=1)
    found = np.array([row["held"] for row in rows])
    assert len(found) == 13
    assert found.sum() <= binom.ppf(0.999, len(found), 0.05)
    # Refuted and undecided claims are counted separately: random labels refute a high AUC, but rarely a trend.
    refuted = {str(row["claim"]): row["refuted"] for row in rows}
    assert refuted["Models discriminate grades 0 and 2 well within a protocol"] == 1
    assert sum(of for claim, of in refuted.items() if " with grade" in claim) < 6 / 2


@pytest.mark.slow
def test_each_claim_holds_for_at_most_1_in_20_cohorts_of_random_labels():
    assert all(row["held"] <= 1 for row in count_false_claims(1))


def test_random_predictions_show_no_grade_order_in_19_of_20_cohorts():
    found = 0
    for seed in range(20):
        rng, parts = np.random.default_rng(seed), []
        truth = rng.permutation(np.arange(90) % 3)
        for repeat in range(10):
            test = rng.permutation(90)[:24]
            p = rng.dirichlet(np.ones(3), len(test))
            table = pd.DataFrame(p, columns=["p0", "p1", "p2"]).assign(subject=test, truth=truth[test], repeat=repeat)
            parts.append(table)
        arm = {"task": "0/1/2", "scenario": "within", "model": "lr", "selection": "l1"}
        rows = _evaluate_grade_order(concatenate_tables(parts).assign(**arm), SETTINGS, 15 / 70)
        found += rows[-1]["verdict"] == "holds"
    assert found <= 1


def test_no_feature_of_pure_noise_is_stable():
    table = sample_random_label_cohort(0)
    rng = np.random.default_rng(1)
    noise = table.assign(**{name: rng.normal(size=len(table)) for name in FEATURE_NAMES})
    (row,) = _evaluate_stability(compute_reliability(noise, FEATURE_NAMES, "reference", replicates=200))
    assert row["verdict"] == "does not hold"
