"""Do grades act alike: what differs between grades on real films, and on simulated ones."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..study.statistics.metrics import percentiles
from .domains import Films, Row, groups_of, times_drawn

# Halvings of the subjects that reliability is the mean over, and of the chance that they are drawn by.
_HALVINGS, _HALVES = 200, 78


def effects(
    real: Films, simulated: Films, *, low: int, high: Sequence[int], replicates: int, seed: int
) -> tuple[list[Row], list[Row]]:
    """Standardised difference of each feature between grades, real and simulated; and a row a group to sum them up.

    r, same_sign  correlation over the features, and the share of them that go the same way; with 95 per cent intervals
                  of a bootstrap of subjects, real and simulated
    most          the correlation that could be seen at most if grades acted alike, since so many films tell an effect
                  only so well: root of the product of both reliabilities (Spearman 1904)
    """
    highest = [grade for grade in high if grade in simulated.grades] or [int(simulated.grades.max())]
    ours = _standardised(simulated, low, highest, replicates, seed)
    theirs = _standardised(real, low, high, replicates, seed + 1)
    halves = [_of_halves(films, low, of, seed) for films, of in ((real, high), (simulated, highest))]
    task = f"{low} v {'+'.join(map(str, high))}"
    label = {"source": real.name, "task": task}
    rows = [
        label | {"group": group, "feature": name, "real": float(one), "simulated": float(other)}
        for (group, name), one, other in zip(real.features.columns, theirs[0].round(4), ours[0].round(4), strict=True)
    ]
    summary = []
    for group, columns in groups_of(real.features).items():
        of_group = real.features.columns.isin(columns)
        alike = np.array([_alike(one[of_group], other[of_group]) for one, other in zip(theirs, ours, strict=True)])
        row = label | {"group": group, "features": int(np.isfinite(theirs[0] + ours[0])[of_group].sum())}
        for name, values in zip(("r", "same_sign"), alike.T, strict=True):
            ends = percentiles(values[1:][np.isfinite(values[1:])]) if np.isfinite(values).sum() > 2 else (np.nan,) * 2
            row |= {name: _rounded(values[0]), f"{name}_low": _rounded(ends[0]), f"{name}_high": _rounded(ends[1])}
        reliable = [_reliability(of[:, :, of_group]) for of in halves]
        row["most"] = _rounded(np.sqrt(np.prod(reliable)))
        summary.append(row)
    return rows, summary


def _of_halves(films: Films, low: int, high: Sequence[int], seed: int) -> Array:
    """(halvings, 2, features)  effects in either half of the subjects, halved at random again and again"""
    of_grades = films.of_grades([low, *high])
    values, without = of_grades.features.to_numpy(np.float64), of_grades.grades == low
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_HALVES,)))
    _, of_film = np.unique(of_grades.subjects, return_inverse=True)
    effects_of = []
    for _ in range(_HALVINGS):
        first = rng.permutation(of_film.max() + 1)[of_film] % 2 == 0
        effects_of.append([_difference(values[half], without[half]) for half in (first, ~first)])
    return np.array(effects_of)


def _reliability(halves: Array) -> float:
    """Of effects told by all films, from those (halvings, 2, features) told by halves (Brown 1910); 0 to 1, or NaN."""
    r = np.array([_alike(one, other)[0] for one, other in halves])
    if not np.isfinite(r).any():
        return np.nan
    mean = max(0.0, float(np.nanmean(r)))
    return 2 * mean / (1 + mean)


def _alike(real: Array, simulated: Array) -> tuple[float, float]:
    """Correlation of two effects (features,), and share of equal signs; NaN where there is none."""
    there = np.isfinite(real + simulated)
    one, other = real[there], simulated[there]
    if not len(one):
        return np.nan, np.nan
    spread = len(one) > 2 and min(one.std(), other.std()) > 0
    r = float(np.corrcoef(one, other)[0, 1]) if spread else np.nan
    return r, float((np.sign(one) == np.sign(other)).mean())


def _rounded(value: float) -> float:
    return round(float(value), 3)


def _standardised(films: Films, low: int, high: Sequence[int], replicates: int, seed: int) -> Array:
    """(1 + replicates, features)  difference of the means of grades over the standard deviation within them

    Of the films as they are, and of subjects drawn again; NaN where a grade has fewer than two films or all are equal.
    """
    of_grades = films.of_grades([low, *high])
    values, without = of_grades.features.to_numpy(np.float64), of_grades.grades == low
    rng = np.random.default_rng(seed)
    _, of_film = np.unique(of_grades.subjects, return_inverse=True)
    times = [np.ones(len(values), np.int64), *(times_drawn(of_film, rng) for _ in range(replicates))]
    draws = [np.repeat(np.arange(len(values)), of) for of in times]
    return np.array([_difference(values[draw], without[draw]) for draw in draws])


def _difference(values: Array, without: NDArray[Any]) -> Array:
    (mean, variance), (other_mean, other_variance) = _moments(values[without]), _moments(values[~without])
    spread = np.sqrt((variance + other_variance) / 2)
    return (other_mean - mean) / np.where(spread > 0, spread, np.nan)


def _moments(values: Array) -> tuple[Array, Array]:
    """Means and variances (features,) of films (films, features), of those that have a feature."""
    there = np.isfinite(values)
    count = there.sum(axis=0)
    known = np.where(there, values, 0.0)
    mean = known.sum(axis=0) / np.where(count > 0, count, np.nan)
    about = np.where(there, values - mean, 0.0)
    return mean, (about**2).sum(axis=0) / np.where(count > 1, count - 1, np.nan)
