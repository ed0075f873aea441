"""What may help a model across protocols; learnt from training subjects alone, and from no label.

Both look at the training subjects' radiographs under the protocol that is tested, so they know the protocol (they are
transductive in it) and no test subject.
"""

import numpy as np
import pandas as pd

from ..statistics.degenerate import is_degenerate
from ..statistics.reliability import THRESHOLD, grid, icc, is_whole


def stable_features(training: pd.DataFrame, names: list[str], protocols: list[str]) -> list[str]:
    """Names of the features whose ICC(2,1) across the protocols is 0.90 or more in the training subjects.

    Knees of which a feature is not known under each of them are left out of its ICC.
    """
    values, _ = grid(training, names, "protocol", protocols)
    of_feature = ((name, values[:, :, index]) for index, name in enumerate(names))
    return [name for name, one in of_feature if icc(one[is_whole(one)])[0] >= THRESHOLD]


def harmonise(features: pd.DataFrame, of: pd.DataFrame, onto: pd.DataFrame) -> pd.DataFrame:
    """Features shifted and scaled so that `of` would get the mean and spread of `onto`.

    This is ComBat (Johnson 2007) with a reference batch (Stein 2015), without empirical Bayes, which would shrink the
    shifts of features towards each other: with a hundred knees a protocol there is little to shrink. No covariate is
    kept, since every knee is taken under every protocol, and grades and protocols are orthogonal.

    features   (rows, features) of radiographs under one protocol
    of, onto   those of the training subjects under the same protocol, and under the one to be matched
    """
    factor = pd.Series(
        [_factor(of[name].dropna().to_numpy(), onto[name].dropna().to_numpy()) for name in features],
        index=features.columns,
    )
    return (features - of.mean()) * factor + onto.mean()


def _factor(of: np.ndarray, onto: np.ndarray) -> float:
    """Ratio of spreads; 1 for a feature that does not vary, where the ratio would be that of rounding."""
    return 1.0 if is_degenerate(of) or is_degenerate(onto) else float(onto.std() / of.std())
