"""What a fitted model loses without a feature."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.inspection import permutation_importance
from sklearn.pipeline import Pipeline

_SHUFFLES = 5


def permuted(pipeline: Pipeline, features: pd.DataFrame, truth: NDArray[np.int64], *, seed: int) -> dict[str, float]:
    """Feature -> by how much the AUC of a test part falls when the feature is shuffled between radiographs.

    Mean of five shuffles (Breiman 2001); of the features that the model was given, the others change nothing.

    features  (rows, features) of the test part
    truth     (rows,) 0 or 1; without both, nothing is given
    """
    if len(set(truth)) < 2:
        return {}
    kept = pipeline[:-1].transform(features)
    falls = permutation_importance(
        pipeline[-1], kept, truth, scoring="roc_auc", n_repeats=_SHUFFLES, random_state=seed % 2**32, n_jobs=1
    )
    return dict(zip(pipeline.named_steps["select"].kept_, falls["importances_mean"].tolist(), strict=True))
