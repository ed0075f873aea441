"""Test of a published ranking: the variance orientation transform is the most robust fractal method.

Wolski et al. 2009 (PubMed 19278198) compare directional fractal methods under noise, blur, exposure, magnification,
projection angle and translation of the region. They find that the variance orientation transform performs best.
"""

import numpy as np

from ...core.checks import Array
from ...study.statistics.features.icc_by_subject import compute_weighted_icc, sample_knee_weights
from ...study.statistics.features.reliability import icc
from ...study.statistics.scores.claims import decide_verdict
from ...study.statistics.scores.metrics import percentile_interval
from ..raycasting.raycast_engines import Row
from .texture_conditions import RESAMPLES, measure_knees

# Condition of `measure_texture_conditions` that represents each condition of the publication.
_CONDITIONS = {
    "noise": "dose_quarter",
    "blur": "focal_spot_double",
    "exposure": "kv_plus_10",
    "magnification": "magnification",
    "projection angle": "beam_plus_5",
    "translation": "translation",
}
# Features whose mean is the fractal dimension of a method.
_METHODS = {
    "fractal_signature": ("fsa_HorizontalDimension", "fsa_VerticalDimension"),
    "hot": ("hot_MeanDimension",),
    "vot": ("vot_MeanDimension",),
}


def measure_texture_ranking(knees: int, workers: int = 1) -> list[Row]:
    """Compare how well the fractal dimensions of three methods agree between a reference and a changed condition.

    Parameters
    ----------
    knees : int
        Number of sampled knees, with KL 0 to 4 in turn.
    workers : int, default 1
        Number of processes.

    Returns
    -------
    list of dict
        One row per condition: ICC(2,1) of each method, difference ``margin`` between the variance orientation transform
        and the better of the other methods with its 95 % interval ``margin_low`` to ``margin_high`` over bootstrap
        samples of the knees, and whether the ranking holds (``verdict``).
    """
    measured = measure_knees(knees, workers)
    weights = sample_knee_weights(np.arange(knees), replicates=RESAMPLES, seed=0)
    rows: list[Row] = []
    for label, condition in _CONDITIONS.items():
        pairs = {
            method: np.array(
                [
                    [np.mean([values[name][feature] for feature in features]) for name in ("reference", condition)]
                    for values in measured
                ]
            )
            for method, features in _METHODS.items()
        }
        rows.append({"condition": label, "knees": knees, **_rank_methods(pairs, weights)})
    return rows


def _rank_methods(pairs: dict[str, Array], weights: Array) -> dict[str, float | str]:
    """Compare the ICC of the variance orientation transform with those of the other methods."""
    values = {method: icc(of_method)[0] for method, of_method in pairs.items()}
    drawn = {method: compute_weighted_icc(of_method, weights)[0] for method, of_method in pairs.items()}
    others = [method for method in pairs if method != "vot"]
    low, high = percentile_interval(drawn["vot"] - np.max([drawn[method] for method in others], axis=0))
    return {
        **values,
        "margin": values["vot"] - max(values[method] for method in others),
        "margin_low": low,
        "margin_high": high,
        "verdict": decide_verdict(low, high, 0.0),
    }
