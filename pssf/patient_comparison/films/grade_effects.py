"""Compare grade effects (feature differences between grades) of patient and simulated radiographs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...study.statistics.scores.metrics import percentile_interval
from .domain_shift import (
    FilmFeatures,
    Row,
    group_features,
    sample_bootstrap_counts,
)

# Number of random splits of the subjects into halves; reliability is averaged over all splits.
_HALVINGS = 200
# Key of the random stream for the splits of the subjects.
_HALVES = 78


def compare_grade_effects(
    real: FilmFeatures, simulated: FilmFeatures, *, low: int, high: Sequence[int], replicates: int, seed: int
) -> tuple[list[Row], list[Row]]:
    """Compare standardised feature differences between grades of patient and simulated radiographs.

    Parameters
    ----------
    real : FilmFeatures
        Features of patient radiographs.
    simulated : FilmFeatures
        Features of simulated radiographs. If no simulated radiograph has a grade in `high`, the highest simulated grade
        is used.
    low : int
        Reference grade, which is subtracted.
    high : sequence of int
        Higher grades, whose radiographs are pooled.
    replicates : int
        Number of bootstrap replicates.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    rows : list of dict
        One row per feature, with the standardised difference of patient radiographs (``patient_effect``) and of
        simulated radiographs (``simulated_effect``).
    summary : list of dict
        One row per feature group. ``r`` is the correlation of effects over the features, and ``same_sign`` is the
        fraction of features with equal sign. Both have a 95 % bootstrap interval over subjects. ``max_r`` is the
        expected correlation for equal true effects: the square root of the product of the patient and simulated
        reliabilities (Spearman 1904).
    """
    highest = [grade for grade in high if grade in simulated.grades] or [int(simulated.grades.max())]
    ours = _bootstrap_effects(simulated, low, highest, replicates, seed)
    theirs = _bootstrap_effects(real, low, high, replicates, seed + 1)
    halves = [_compute_half_sample_effects(films, low, of, seed) for films, of in ((real, high), (simulated, highest))]
    task = f"{low} v {'+'.join(map(str, high))}"
    label = {"source": real.name, "task": task}
    rows = [
        label | {"group": group, "feature": name, "patient_effect": float(one), "simulated_effect": float(other)}
        for (group, name), one, other in zip(real.features.columns, theirs[0].round(4), ours[0].round(4), strict=True)
    ]
    summary = []
    for group, columns in group_features(real.features).items():
        of_group = real.features.columns.isin(columns)
        alike = np.array(
            [_effect_agreement(one[of_group], other[of_group]) for one, other in zip(theirs, ours, strict=True)]
        )
        row = label | {"group": group, "features": int(np.isfinite(theirs[0] + ours[0])[of_group].sum())}
        for name, values in zip(("r", "same_sign"), alike.T, strict=True):
            ends = (
                percentile_interval(values[1:][np.isfinite(values[1:])])
                if np.isfinite(values).sum() > 2
                else (np.nan,) * 2
            )
            row |= {
                name: _round_to_three_digits(values[0]),
                f"{name}_low": _round_to_three_digits(ends[0]),
                f"{name}_high": _round_to_three_digits(ends[1]),
            }
        reliable = [_split_half_reliability(of[:, :, of_group]) for of in halves]
        row["max_r"] = _round_to_three_digits(np.sqrt(np.prod(reliable)))
        summary.append(row)
    return rows, summary


def _compute_half_sample_effects(films: FilmFeatures, low: int, high: Sequence[int], seed: int) -> Array:
    """Compute the grade effects in both halves of randomly split subjects, shape (splits, 2, features)."""
    of_grades = films.select_grades([low, *high])
    values, without = of_grades.features.to_numpy(np.float64), of_grades.grades == low
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_HALVES,)))
    _, of_film = np.unique(of_grades.subjects, return_inverse=True)
    effects_of = []
    for _ in range(_HALVINGS):
        first = rng.permutation(of_film.max() + 1)[of_film] % 2 == 0
        effects_of.append([_standardised_difference(values[half], without[half]) for half in (first, ~first)])
    return np.array(effects_of)


def _split_half_reliability(halves: Array) -> float:
    """Estimate the split-half reliability of grade effects, 0 to 1 or NaN (Brown 1910).

    `halves` has shape (splits, 2, features).
    """
    r = np.array([_effect_agreement(one, other)[0] for one, other in halves])
    if not np.isfinite(r).any():
        return np.nan
    mean = max(0.0, float(np.nanmean(r)))
    return 2 * mean / (1 + mean)


def _effect_agreement(real: Array, simulated: Array) -> tuple[float, float]:
    """Compute the correlation between two arrays of effects (features,), and the fraction of equal signs."""
    there = np.isfinite(real + simulated)
    one, other = real[there], simulated[there]
    if not len(one):
        return np.nan, np.nan
    spread = len(one) > 2 and min(one.std(), other.std()) > 0
    r = float(np.corrcoef(one, other)[0, 1]) if spread else np.nan
    return r, float((np.sign(one) == np.sign(other)).mean())


def _round_to_three_digits(value: float) -> float:
    """Round a value to three decimal places."""
    return round(float(value), 3)


def _bootstrap_effects(films: FilmFeatures, low: int, high: Sequence[int], replicates: int, seed: int) -> Array:
    """Compute standardised differences, shape (1 + replicates, features).

    The first row uses all radiographs; the other rows use bootstrap samples. A difference is NaN if a grade has
    fewer than two radiographs, or if all values are equal.
    """
    of_grades = films.select_grades([low, *high])
    values, without = of_grades.features.to_numpy(np.float64), of_grades.grades == low
    rng = np.random.default_rng(seed)
    _, of_film = np.unique(of_grades.subjects, return_inverse=True)
    times = [np.ones(len(values), np.int64), *(sample_bootstrap_counts(of_film, rng) for _ in range(replicates))]
    draws = [np.repeat(np.arange(len(values)), of) for of in times]
    return np.array([_standardised_difference(values[draw], without[draw]) for draw in draws])


def _standardised_difference(values: Array, is_low_grade: NDArray[Any]) -> Array:
    """Compute differences (features,) between two grade means, divided by the pooled standard deviation."""
    (mean, variance), (other_mean, other_variance) = _moments(values[is_low_grade]), _moments(values[~is_low_grade])
    spread = np.sqrt((variance + other_variance) / 2)
    return (other_mean - mean) / np.where(spread > 0, spread, np.nan)


def _moments(values: Array) -> tuple[Array, Array]:
    """Compute means and variances (features,) of the finite values in each column of a (films, features) array."""
    there = np.isfinite(values)
    count = there.sum(axis=0)
    known = np.where(there, values, 0.0)
    mean = known.sum(axis=0) / np.where(count > 0, count, np.nan)
    about = np.where(there, values - mean, 0.0)
    return mean, (about**2).sum(axis=0) / np.where(count > 1, count - 1, np.nan)
