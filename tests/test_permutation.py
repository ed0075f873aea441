"""What a fitted model loses without a feature."""

import numpy as np
from made_up import fitted, measured_cohort

from pssf.study.learn.permutation import permuted


def test_shuffling_what_a_model_leans_on_costs_auc_and_shuffling_noise_does_not():
    table = measured_cohort(per_grade=20)
    model, X, y = fitted("lr", table)
    drops = permuted(model.pipeline, X, y, seed=2**40)
    assert max(drops, key=drops.get) == "signal"
    assert drops["signal"] > 0.2
    assert all(abs(drop) < 0.1 for name, drop in drops.items() if name != "signal")
    assert permuted(model.pipeline, X, np.zeros(len(X), int), seed=0) == {}
