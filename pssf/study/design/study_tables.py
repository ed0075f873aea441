"""Data tables of the package that a study needs; they are loaded once and stored in the study context."""

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
    """Data tables that a study needs.

    Attributes
    ----------
    radiomics : RadiomicsTables
        Joint localisation limits, and IBSI tags of features.
    gap_alone_auc : mapping of str to tuple of float
        AUC of the smaller joint gap on patient radiographs, with its interval; see `LandmarkReference`.
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
        All tables that a study needs.
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
        Cohort manifest; its column ``grade_table`` contains the name of the distributions.

    Returns
    -------
    KneeDistributions or None
        Distributions; None if the manifest does not name exactly one grade table, or the table file is missing.
    """
    names = set(manifest["grade_table"]) if "grade_table" in manifest else set()
    if len(names) != 1:
        return None
    (name,) = map(str, names)
    try:
        return load_knee_distributions(name)
    except InputError:
        return None
