"""Intervals of ICCs by a bootstrap of subjects, each drawn with all its knees; the conditions are held fixed."""

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from .metrics import percentiles

_STREAM = 2**31 + 2  # beside those of `intervals` and `claims`
Interval = tuple[float, float]


def knee_weights(subjects: NDArray[np.int64], *, replicates: int, seed: int) -> Array:
    """(replicates, knees)  how often each knee is in a sample of as many subjects, drawn with replacement

    subjects  (knees,) whose each knee is
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    known, place = np.unique(subjects, return_inverse=True)
    drawn = rng.multinomial(len(known), np.full(len(known), 1 / len(known)), replicates)
    return drawn[:, place].astype(np.float64)


def icc_intervals_by_weights(values: Array, weights: Array) -> tuple[Interval, Interval]:
    """The 2.5th and 97.5th percentile of ICC(2,1) and ICC(3,1) over samples of knees.

    values   (knees, conditions) of any unit, finite, not all the same
    weights  (replicates, knees) counts
    returns  NaN where no sample has an ICC
    """
    agreement, consistency = icc_by_weights(values, weights)
    return percentiles(agreement), percentiles(consistency)


def icc_by_weights(values: Array, weights: Array) -> tuple[Array, Array]:
    """(replicates,) ICC(2,1) and (replicates,) ICC(3,1) of samples of knees.

    values   (knees, conditions) of any unit, finite, not all the same
    weights  (replicates, knees) counts
    """
    conditions = values.shape[1]
    z = (values - values.mean()) / values.std()
    rows = z.mean(axis=1)
    count = weights.sum(axis=1)
    mean = weights @ rows / count
    of_knees = conditions * (weights @ rows**2 - count * mean**2)
    of_conditions = count * ((weights @ z / count[:, None] - mean[:, None]) ** 2).sum(axis=1)
    rest = np.maximum(weights @ (z**2).sum(axis=1) - conditions * count * mean**2 - of_knees - of_conditions, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        knee, condition = of_knees / (count - 1), of_conditions / (conditions - 1)
        noise = rest / ((count - 1) * (conditions - 1))
        consistency = knee + (conditions - 1) * noise
        agreement = consistency + conditions * (condition - noise) / count
        return (knee - noise) / agreement, (knee - noise) / consistency
