"""Check the permutation importance of features in a fitted model."""

import numpy as np
import pytest
from sklearn.inspection import permutation_importance
from synthetic_features import fit_model, make_measured_cohort

from pssf.study.learn.models.permutation_importance import compute_permutation_importance


def test_shuffling_the_informative_feature_reduces_the_auc():
    table = make_measured_cohort(per_grade=20)
    model, X, y = fit_model("lr", table)
    drops = compute_permutation_importance(model.pipeline, X, y, seed=2**40)
    assert max(drops, key=drops.get) == "signal"
    assert drops["signal"] > 0.2
    assert all(abs(drop) < 0.1 for name, drop in drops.items() if name != "signal")
    assert compute_permutation_importance(model.pipeline, X, np.zeros(len(X), int), seed=0) == {}


@pytest.mark.parametrize("name", ["lr", "rf", "xgb"])
def test_permutation_importance_equals_that_of_scikit_learn(name):
    model, X, y = fit_model(name, make_measured_cohort(per_grade=8))
    kept = model.pipeline[:-1].transform(X)
    known = permutation_importance(model.pipeline[-1], kept, y, scoring="roc_auc", n_repeats=5, random_state=7)
    assert (
        list(compute_permutation_importance(model.pipeline, X, y, seed=7).values())
        == known["importances_mean"].tolist()
    )
