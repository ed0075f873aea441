"""Intervals of ICCs by a bootstrap of subjects, each drawn with all its knees; the conditions are held fixed.

Percentiles of the samples' ICCs run short: of 10 to 60 subjects with two knees they hold a true ICC of 0.3 to 0.99 in
87 to 95 %. Fisher's z (1925, Statistical Methods, section 38), in which an ICC is about normal, with the SD of the
samples' and quantiles of t holds it in 93 to 96. Of features as skewed as a lognormal one neither does.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as t_distribution

from ...core.checks import Array

_STREAM = 2**31 + 2  # key under a study's seed, beside that of `claims`
_EDGE = 1e-12  # by how much less than its ends an ICC has a finite z
Interval = tuple[float, float]


def knee_weights(subjects: NDArray[Any], *, replicates: int, seed: int) -> Array:
    """(replicates, knees)  how often each knee is in a sample of as many subjects, drawn with replacement

    subjects  (knees,) whose each knee is, by number or as text
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    known, place = np.unique(subjects, return_inverse=True)
    drawn = rng.multinomial(len(known), np.full(len(known), 1 / len(known)), replicates)
    return drawn[:, place].astype(np.float64)


def icc_intervals_by_weights(
    forms: tuple[float, float], values: Array, weights: Array, subjects: int
) -> tuple[Interval, ...]:
    """`icc_interval` of ICC(2,1) and ICC(3,1).

    forms    both, of all knees
    values   (knees, conditions) of any unit, finite, not all the same
    weights  (replicates, knees) counts
    """
    own = {"conditions": values.shape[1], "subjects": subjects}
    return tuple(
        icc_interval(form, drawn, **own) for form, drawn in zip(forms, icc_by_weights(values, weights), strict=True)
    )


def icc_interval(value: float, drawn: Array, *, conditions: int, subjects: int) -> Interval:
    """The 95 % interval of an ICC; NaN where no sample has one.

    value  the ICC of all
    drawn  (replicates,) of samples of the subjects, dimensionless
    """
    known = drawn[np.isfinite(drawn)]
    if not len(known) or not np.isfinite(value):
        return float("nan"), float("nan")
    z = _fisher(np.array([value, *known]), conditions)
    if not np.ptp(z[1:]):  # rounding would give it a width, and a claim would be decided from that
        return value, value
    half = t_distribution.ppf(0.975, max(1, subjects - 1)) * z[1:].std()
    low, high = _back(z[0] + half * np.array([-1.0, 1.0]), conditions)
    # What the clipping of an ICC of 1 takes away is not the interval's.
    return float(min(low, value)), float(max(high, value))


def _fisher(icc: Array, conditions: int) -> Array:
    clipped = np.clip(icc, -1 / (conditions - 1) + _EDGE, 1 - _EDGE)
    return 0.5 * np.log((1 + (conditions - 1) * clipped) / (1 - clipped))


def _back(z: Array, conditions: int) -> Array:
    # Of e^2z through its inverse, which does not overflow.
    less = np.exp(-2 * z)
    return np.asarray((1 - less) / (1 + (conditions - 1) * less))


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
