"""Models as files."""

import numpy as np
import pytest
from made_up import fitted, measured_cohort

from pssf.study.learn.models.model_bytes import dumps, loads


@pytest.mark.parametrize("model", ["lr", "rf", "xgb"])
def test_a_saved_model_gives_the_same_probabilities_to_the_last_bit_and_the_same_bytes(model):
    table = measured_cohort()
    kept, X, _ = fitted(model, table)
    content = dumps(kept.pipeline)
    assert content == dumps(fitted(model, table)[0].pipeline)
    again = loads(content)
    holes = X.copy()
    holes.iloc[:3] = np.nan
    for features in (X, holes):
        probability = again.predict_proba(features[list(again[0].feature_names_in_)])
        np.testing.assert_array_equal(probability, kept.pipeline.predict_proba(features))
    assert b"pickle" not in content


def test_a_file_with_another_type_in_it_is_not_loaded():
    import skops.io

    class Other:
        pass

    with pytest.raises(TypeError, match="Other"):
        loads(skops.io.dumps(Other()))
