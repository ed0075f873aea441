"""Check classifiers that are tuned on the validation subjects."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from synthetic_features import NAMES, make_features

from pssf.study.design.study_settings import SELECTIONS
from pssf.study.learn.models.classifiers import tune_classifier
from pssf.study.learn.models.feature_selection import build_feature_pipeline


@pytest.mark.parametrize("selection", list(SELECTIONS))
def test_constant_features_give_a_probability_of_one_half(selection):
    table = pd.DataFrame({"a": np.ones(12), "b": np.zeros(12)})
    y = np.arange(12) % 2
    prepared = build_feature_pipeline(selection, rho=0.9, max_features=4, seed=0).fit(table, y)
    fitted = tune_classifier(prepared, "lr", (table, y), (table, y), seed=0)
    assert_allclose(fitted.pipeline.predict_proba(table), 0.5, atol=1e-6)


@pytest.mark.parametrize("model", ["lr", "rf", "xgb"])
def test_importances_sum_to_one_and_favour_the_informative_feature(model):
    table = make_features(20, noise=0.2)
    X, y = table[NAMES], table["grade"].to_numpy()
    fitted = tune_classifier(
        build_feature_pipeline("l1", rho=0.9, max_features=5, seed=0).fit(X, y), model, (X, y), (X, y), seed=0
    )
    assert sum(fitted.importance.values()) == pytest.approx(1)
    # Of the equivalent features `copy` and `signal`, the selection retains the first by name.
    assert max(fitted.importance, key=fitted.importance.get) == "copy"


def test_without_validation_rows_the_strongest_regularisation_is_used():
    table = make_features(10)
    X, y = table[NAMES], table["grade"].to_numpy()
    fitted = tune_classifier(
        build_feature_pipeline("l1", rho=0.9, max_features=5, seed=0).fit(X, y), "lr", (X, y), (X[:0], y[:0]), seed=0
    )
    assert fitted.parameters == {"C": 0.01}
