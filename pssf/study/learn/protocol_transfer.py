"""Methods for transfer of a model to another protocol: stable features and harmonisation.

Both methods are fitted to radiographs of the training subjects under the test protocol, without grades. The methods are
therefore transductive with respect to the protocol, but they use no test subjects.
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

    The ICC uses only knees that have a value of the feature under every protocol.

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
    """Shift and scale features so that their training mean and SD match the values under another protocol.

    Parameters
    ----------
    features : DataFrame
        Features (rows, features) of radiographs under one protocol.
    source : DataFrame
        Features of the training subjects under the same protocol as `features`.
    target : DataFrame
        Features of the training subjects under the target protocol.

    Returns
    -------
    DataFrame
        Harmonised features.

    Notes
    -----
    The method is ComBat (Johnson 2007) with a reference batch (Stein 2015) and without empirical Bayes. Empirical Bayes
    shrinks the feature shifts towards each other, which has little effect with a hundred knees per protocol. No
    covariate is needed: every knee is imaged under every protocol, so grade and protocol are orthogonal.
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
    """Compute the ratio of target SD to source SD; 1 for a constant feature, whose SD is only a rounding error."""
    return 1.0 if is_degenerate(source) or is_degenerate(target) else float(target.std() / source.std())
