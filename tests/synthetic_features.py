"""Synthetic feature tables for tests of the study: one row per radiograph, features with known relations."""

import numpy as np
import pandas as pd

from pssf.study import StudySettings
from pssf.study.learn.models.classifiers import FittedModel, tune_classifier
from pssf.study.learn.models.feature_selection import build_feature_pipeline

PROTOCOLS = ("reference", "low_dose", "geometry_shift")
NAMES = ["signal", "copy", *[f"n{i}" for i in range(12)]]


def make_features(per_grade: int, *, noise: float = 1.0, seed: int = 0, extra: int = 12) -> pd.DataFrame:
    """Make one row per radiograph: `signal` depends on the grade, `copy` on `signal`; n0, n1, ... are noise."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(3 * per_grade):
        grade = subject % 3
        own = rng.normal(size=extra)
        signal = grade + noise * rng.normal()
        for protocol in PROTOCOLS:
            jitter = 0.1 * rng.normal(size=extra)
            row = {"radiograph": f"{subject}_{protocol}", "knee": subject, "subject": subject, "grade": grade}
            row |= {"protocol": protocol, "signal": signal + 0.1 * rng.normal()}
            rows.append(row | {f"n{i}": own[i] + jitter[i] for i in range(extra)})
    table = pd.DataFrame(rows)
    return table.assign(copy=2 * table["signal"] + 3)


UNSTABLE_NAMES = ["signal", "unstable", *[f"n{i}" for i in range(4)]]


def make_measured_cohort(per_grade: int = 12, *, shift: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """Make one row per radiograph: `signal` depends on the grade, `unstable` is noise; protocol `b` shifts the rest."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(3 * per_grade):
        own, signal = rng.normal(size=4), subject % 3 + 0.3 * rng.normal()
        for protocol in ("a", "b"):
            off = shift if protocol == "b" else 0.0
            row = {"radiograph": f"{subject}_{protocol}", "knee": subject, "subject": subject, "grade": subject % 3}
            row |= {"protocol": protocol, "signal": signal + off + 0.02 * rng.normal(), "unstable": 2.0 * rng.normal()}
            rows.append(row | {f"n{i}": own[i] + off + 0.02 * rng.normal() for i in range(4)})
    table = pd.DataFrame(rows)
    return table.assign(
        sex=np.where(table["subject"] % 2, "female", "male"),
        age_years=50.0 + table["subject"] % 7,
        stature_mm=1700.0 + table["subject"] % 11,
        nominal_jsw_medial_mm=5.0 - table["grade"],
    )


def make_settings(**more) -> StudySettings:
    return StudySettings(**({"selections": ("l1",), "models": ("lr",), "reference": "a"} | more))


def fit_model(model: str, table: pd.DataFrame) -> tuple[FittedModel, pd.DataFrame, np.ndarray]:
    """Tune a classifier of grade 2 against the rest on a table of `make_measured_cohort`; return features and truth."""
    X, y = table[UNSTABLE_NAMES], (table["grade"] == 2).astype(int).to_numpy()
    return (
        tune_classifier(
            build_feature_pipeline("l1", rho=0.9, max_features=5, seed=0).fit(X, y), model, (X, y), (X, y), seed=0
        ),
        X,
        y,
    )
