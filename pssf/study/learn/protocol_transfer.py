"""Methods that may help a model across protocols; they are fitted to training subjects and use no labels.

Both methods use the training subjects' radiographs under the test protocol. They know the test protocol (they are
transductive in it) but no test subject.
"""

import numpy as np
import pandas as pd

from ..statistics.features.degenerate_features import is_degenerate
from ..statistics.features.reliability import (
    ICC_THRESHOLD,
    icc,
    is_complete,
    pivot_features,
)


def find_stable_features(training: pd.DataFrame, names: list[str], protocols: list[str]) -> list[str]:
    """Find the features whose ICC(2,1) across the protocols is at least 0.90 in the training subjects.

    Knees with a missing value of a feature under any protocol are left out of its ICC.

    Parameters
    ----------
    training : DataFrame
        Radiographs of the training subjects: knee, subject, protocol and features.
    names : list of str
        Names of the features.
    protocols : list of str
        Protocols to compare.

    Returns
    -------
    list of str
        Names of the stable features.
    """
    values, _ = pivot_features(training, names, "protocol", protocols)
    of_feature = ((name, values[:, :, index]) for index, name in enumerate(names))
    return [name for name, one in of_feature if icc(one[is_complete(one)])[0] >= ICC_THRESHOLD]


def harmonise_features(features: pd.DataFrame, source: pd.DataFrame, target: pd.DataFrame) -> pd.DataFrame:
    """Shift and scale features so that the training features of one protocol get the mean and SD of another.

    Parameters
    ----------
    features : DataFrame
        Features (rows, features) of radiographs under one protocol.
    source : DataFrame
        Features of the training subjects under the same protocol.
    target : DataFrame
        Features of the training subjects under the protocol to match.

    Returns
    -------
    DataFrame
        Harmonised features.

    Notes
    -----
    This is ComBat (Johnson 2007) with a reference batch (Stein 2015) and without empirical Bayes. Empirical Bayes would
    shrink the shifts of features towards each other; with a hundred knees per protocol there is little to shrink. No
    covariate is kept: every knee is imaged under every protocol, so grade and protocol are orthogonal.
    """
    factor = pd.Series(
        [
            _compute_scale_factor(source[name].dropna().to_numpy(), target[name].dropna().to_numpy())
            for name in features
        ],
        index=features.columns,
    )
    return (features - source.mean()) * factor + target.mean()


def _compute_scale_factor(source: np.ndarray, target: np.ndarray) -> float:
    """Compute the ratio of SDs; 1 for a feature that does not vary, whose ratio would be rounding error."""
    return 1.0 if is_degenerate(source) or is_degenerate(target) else float(target.std() / source.std())
