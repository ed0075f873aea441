"""Check saving and loading of models."""

import numpy as np
import pytest
from synthetic_features import fit_model, make_measured_cohort

from pssf.study.learn.models.model_bytes import dumps, loads


@pytest.mark.parametrize("model", ["lr", "rf", "xgb"])
def test_a_saved_model_gives_identical_probabilities_and_bytes(model):
    table = make_measured_cohort()
    fitted, X, _ = fit_model(model, table)
    content = dumps(fitted.pipeline)
    assert content == dumps(fit_model(model, table)[0].pipeline)
    again = loads(content)
    incomplete = X.copy()
    incomplete.iloc[:3] = np.nan
    for features in (X, incomplete):
        probability = again.predict_proba(features[list(again[0].feature_names_in_)])
        np.testing.assert_array_equal(probability, fitted.pipeline.predict_proba(features))
    assert b"pickle" not in content


def test_a_file_with_an_untrusted_type_is_not_loaded():
    import skops.io

    class Other:
        pass

    with pytest.raises(TypeError, match="Other"):
        loads(skops.io.dumps(Other()))
