"""Data tables of the package that a study reads; they are loaded once and kept in the study context."""

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from ...core.checks import InputError
from ...data.analysis.landmark_table import load_landmark_reference
from ...data.analysis.reporting_table import Guideline, load_reporting_guidelines
from ...data.table_records import Triple
from ...model.sampling.knee_sampling import KneeDistributions, load_knee_distributions
from ...radiomics.radiomics_tables import RadiomicsTables, radiomics_tables


@dataclass(frozen=True, kw_only=True)
class StudyTables:
    """Data tables that a study reads.

    Attributes
    ----------
    radiomics : RadiomicsTables
        Limits of joint localisation and IBSI tags of features.
    gap_alone_auc : mapping of str to tuple of float
        AUC, and its interval, of the smaller joint gap on patient radiographs; see `LandmarkReference`.
    guidelines : mapping of str to Guideline
        Items of each reporting guideline.
    """

    radiomics: RadiomicsTables
    gap_alone_auc: Mapping[str, Triple]
    guidelines: Mapping[str, Guideline]


def load_study_tables() -> StudyTables:
    """Load the data tables of the package.

    Returns
    -------
    StudyTables
        All tables that a study reads.
    """
    return StudyTables(
        radiomics=radiomics_tables(),
        gap_alone_auc=load_landmark_reference().gap_alone_auc,
        guidelines=load_reporting_guidelines(),
    )


def resolve_sampling_laws(manifest: pd.DataFrame) -> KneeDistributions | None:
    """Load the distributions from which the knees of a cohort were sampled.

    Parameters
    ----------
    manifest : DataFrame
        Manifest of the cohort; its column ``grade_table`` names the distributions.

    Returns
    -------
    KneeDistributions or None
        Distributions; None if the manifest does not name exactly one table, or the file of the table is missing.
    """
    names = set(manifest["grade_table"]) if "grade_table" in manifest else set()
    if len(names) != 1:
        return None
    (name,) = map(str, names)
    try:
        return load_knee_distributions(name)
    except InputError:
        return None
