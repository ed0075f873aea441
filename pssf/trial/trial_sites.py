"""Differences between the sites of a trial, with and without harmonisation."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import StratifiedGroupKFold

from ..core.checks import Array
from ..data.analysis.trial_table import TrialDesign
from ..study.learn.protocol_transfer import harmonise_features
from .image_appearance import APPEARANCE
from .trial_statistics import TRUE_MEASURES, estimate_with_interval

HARMONISATIONS = ("none", "combat")
IMAGE = "image"
_FOLDS = 5
# A linear model would not recognise sites with equal means, although their distributions may differ.
_TREES = 100
# Smallest number of subjects of a site from which its difference from other sites is estimated (assumed).
_MIN_SUBJECTS = 10
SITE_COLUMNS = [
    *("view", "reader", "measure", "harmonisation", "knees"),
    *("difference", "difference_low", "difference_high"),
    *("site_share", "site_share_low", "site_share_high"),
]
RECOGNITION_COLUMNS = [
    *("view", "predictors", "harmonisation", "knees", "sites"),
    *("balanced_accuracy", "balanced_accuracy_low", "balanced_accuracy_high", "chance"),
]


def summarise_sites(radiographs: pd.DataFrame, design: TrialDesign) -> pd.DataFrame:
    """Summarise the differences of the measured joint space between sites.

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    DataFrame
        Columns `SITE_COLUMNS`. ``difference`` is the largest difference between sites of the mean error, against the
        joint space of the knee, in mm. ``site_share`` is the fraction of the variance of the error between sites.
        Values are from the first radiograph of each knee. Harmonisation makes mean and standard deviation of each
        site those of the first site. Intervals are from a bootstrap of subjects; both quantities are above 0 by chance
        alone.
    """
    rows: list[dict[str, Any]] = []
    for view, first in _select_first_radiographs(radiographs).groupby("view", sort=False):
        for reader in design.readers:
            for measure, truth in TRUE_MEASURES.items():
                known = first.dropna(subset=[f"{reader}_{measure}"])
                for harmonisation in HARMONISATIONS:
                    label = {"view": view, "reader": reader, "measure": measure, "harmonisation": harmonisation}
                    estimates = _compare_sites(known, f"{reader}_{measure}", truth, harmonisation)
                    rows.append(label | {"knees": len(known)} | estimates)
    return pd.DataFrame(rows, columns=SITE_COLUMNS)


def recognise_sites(radiographs: pd.DataFrame, design: TrialDesign) -> pd.DataFrame:
    """Measure how well the site of a radiograph is recognised.

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    DataFrame
        Columns `RECOGNITION_COLUMNS`: balanced accuracy of a random forest in cross-validation by subject, from the
        appearance of the image or from the joint spaces of a reader. Harmonisation is fitted to the training subjects.
        The interval is from a bootstrap of the tested subjects.
    """
    rows: list[dict[str, Any]] = []
    for view, first in _select_first_radiographs(radiographs).groupby("view", sort=False):
        sets = {reader: [f"{reader}_{name}" for name in ("medial_mm", "lateral_mm")] for reader in design.readers}
        if APPEARANCE[0] in first:
            sets = {IMAGE: list(APPEARANCE)} | sets
        for predictors, names in sets.items():
            known = first.dropna(subset=names)
            for harmonisation in HARMONISATIONS:
                label = {"view": view, "predictors": predictors, "harmonisation": harmonisation}
                rows.append(label | _recognise(known, names, harmonisation))
    return pd.DataFrame(rows, columns=RECOGNITION_COLUMNS)


def _select_first_radiographs(radiographs: pd.DataFrame) -> pd.DataFrame:
    """Select the first radiograph of each knee in each view."""
    return radiographs[(radiographs["without"] == "") & (radiographs["repeat"] == 0) & (radiographs["month"] == 0)]


def _has_enough_sites(first: pd.DataFrame) -> bool:
    """Return whether there are two sites, and each has enough subjects."""
    counts = first.groupby("site")["subject"].nunique()
    return len(counts) > 1 and counts.min() >= _MIN_SUBJECTS


def _harmonise(features: pd.DataFrame, sites: pd.Series, fitted: NDArray[np.bool_], harmonisation: str) -> pd.DataFrame:
    """Harmonise features (knees, features) of all sites with the first site, fitted to a part of the knees."""
    if harmonisation == "none":
        return features
    reference = features[fitted & (sites == sites.min())]
    parts = [
        harmonise_features(features[sites == site], features[fitted & (sites == site)], reference)
        for site in sorted(sites.unique())
    ]
    return pd.concat(parts).loc[features.index]


def _compare_sites(first: pd.DataFrame, column: str, truth: str, harmonisation: str) -> dict[str, float]:
    """Compare the errors of a measure between sites."""
    if not _has_enough_sites(first):
        return {}
    every = np.ones(len(first), bool)
    values = _harmonise(first[[column]], first["site"], every, harmonisation)[column]
    table = _number_sites(values - first[truth], first)
    return estimate_with_interval("difference", table, lambda values: float(np.ptp(_average_sites(values)[0]))) | (
        estimate_with_interval("site_share", table, _compute_site_share)
    )


def _recognise(first: pd.DataFrame, names: list[str], harmonisation: str) -> dict[str, Any]:
    """Predict the site of each radiograph in cross-validation by subject and score the predictions."""
    sites, subjects = first["site"], first["subject"].to_numpy()
    row: dict[str, Any] = {"knees": len(first), "sites": sites.nunique(), "chance": 1 / max(1, sites.nunique())}
    if not _has_enough_sites(first):
        return row
    right = np.zeros(len(first))
    folds = StratifiedGroupKFold(_FOLDS, shuffle=True, random_state=0)
    for training, tested in folds.split(first, sites, subjects):
        fitted = np.isin(np.arange(len(first)), training)
        features = _harmonise(first[names], sites, fitted, harmonisation).to_numpy()
        model = RandomForestClassifier(_TREES, class_weight="balanced", random_state=0)
        model.fit(features[training], sites.iloc[training])
        right[tested] = model.predict(features[tested]) == sites.iloc[tested].to_numpy()

    # Balanced accuracy is the mean over sites of the fraction that is recognised.
    table = _number_sites(pd.Series(right, first.index), first)
    return row | estimate_with_interval(
        "balanced_accuracy", table, lambda values: float(_average_sites(values)[0].mean())
    )


def _number_sites(values: pd.Series, first: pd.DataFrame) -> pd.DataFrame:
    """Return a table of values and numbers of sites, indexed by subject."""
    numbers = pd.Series(pd.factorize(first["site"], sort=True)[0], first.index)
    return pd.DataFrame({"value": values, "site": numbers}).set_index(first["subject"])


def _average_sites(values: Array) -> tuple[Array, Array]:
    """Return mean and number of the values of each site, from (knees, 2): value, and number of the site."""
    sites = values[:, 1].astype(int)
    counts = np.bincount(sites)
    seen = counts > 0
    return np.bincount(sites, values[:, 0])[seen] / counts[seen], counts[seen].astype(np.float64)


def _compute_site_share(values: Array) -> float:
    """Return the fraction of the variance that is between sites, from (knees, 2): value, and number of the site."""
    means, counts = _average_sites(values)
    centre = values[:, 0].mean()
    total = ((values[:, 0] - centre) ** 2).sum()
    return float(counts @ (means - centre) ** 2 / total) if total > 0 else float("nan")
