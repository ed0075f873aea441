"""Result tables of a study, built from its predictions and features."""

from collections.abc import Sequence

import pandas as pd

from ...radiomics.features.feature_families import feature_family
from ...radiomics.features.ibsi_tags import IbsiTags, find_ibsi_departure, find_ibsi_tag
from ..design.study_settings import StudySettings
from ..predictions import ARM_COLUMNS, SplitOutcome, concatenate_tables
from ..study_data import StudyData, Tables
from .analyses.knee_parameters import correlate_with_parameters, summarise_morphology
from .features import localisation_error
from .features.degenerate_features import is_degenerate
from .features.feature_importance import average_by_feature
from .features.reliability import compute_reliability, compute_repeatability
from .scores.calibration import compute_calibration, compute_calibration_curve, count_confusions
from .scores.confidence_intervals import compare_arms, compute_arm_intervals, compute_test_train_ratio
from .scores.split_scores import score_splits, summarise_scores
from .scores.subgroups import score_subgroups


def build_model_tables(outcomes: Sequence[SplitOutcome], settings: StudySettings) -> Tables:
    """Build the tables that describe the models.

    Parameters
    ----------
    outcomes : sequence of SplitOutcome
        Predictions and tables of each split.
    settings : StudySettings
        Settings of the study.

    Returns
    -------
    dict of str to DataFrame
        Tables by name: subjects (training, validation or test, for each subject and split), splits, scores (with
        intervals), differences, confusion, calibration, calibration_curve, importance and permutation.
    """
    predictions = concatenate_tables([outcome.predictions for outcome in outcomes])
    importances = concatenate_tables([outcome.importances for outcome in outcomes])
    permutation = concatenate_tables([outcome.permutation for outcome in outcomes])
    splits = score_splits(predictions)
    subjects = concatenate_tables([outcome.subjects for outcome in outcomes])
    ratio = compute_test_train_ratio(subjects)
    within = importances[(importances["task"] == "0 vs 2") & (importances["trained_on"] == settings.reference)]
    return {
        "subjects": subjects,
        "splits": splits,
        "scores": summarise_scores(splits).merge(
            compute_arm_intervals(splits, ratio), on=ARM_COLUMNS, how="left", validate="one_to_one"
        ),
        "differences": compare_arms(splits, ratio),
        "confusion": count_confusions(predictions),
        "calibration": compute_calibration(predictions),
        "calibration_curve": compute_calibration_curve(predictions),
        "importance": average_by_feature(within, settings.repeats),
        "permutation": average_by_feature(permutation, settings.repeats, "drop"),
    }


def build_feature_tables(study: StudyData) -> Tables:
    """Build the tables that describe the features.

    Parameters
    ----------
    study : StudyData
        Study with measured features.

    Returns
    -------
    dict of str to DataFrame
        Tables by name: localisation, dictionary, and reliability (across protocols and repeat radiographs).
    """
    usable, names, settings = study.usable, study.names, study.settings
    chance = {"replicates": settings.replicates, "seed": settings.seed}
    across = compute_reliability(usable, names, settings.reference, **chance)
    if len(study.repeated):
        repeated = compute_repeatability(usable, study.repeated, names, settings.reference, **chance)
        across = concatenate_tables([across, repeated]) if len(across) else repeated
    return {
        "localisation": localisation_error.summarise_localisation(study.located),
        "dictionary": build_feature_dictionary(usable, names, study.run.tables.radiomics.tags),
        "reliability": across,
    }


def build_feature_dictionary(usable: pd.DataFrame, names: list[str], tags: IbsiTags) -> pd.DataFrame:
    """Build a table that describes each feature.

    Parameters
    ----------
    usable : DataFrame
        Radiographs with a located region.
    names : list of str
        Names of the features.
    tags : dict of str to dict
        IBSI tags of the features.

    Returns
    -------
    DataFrame
        Columns: feature, family, ibsi (IBSI tag), departure (deviation from the IBSI definition), degenerate ("yes" or
        "no"), minimum, median, maximum.
    """
    rows = []
    for name in names:
        values = usable[name]
        named = {
            "feature": name,
            "family": feature_family(name),
            "ibsi": find_ibsi_tag(name, tags),
            "departure": find_ibsi_departure(name, tags),
        }
        constant = "yes" if is_degenerate(values.to_numpy()) else "no"
        spread = {"minimum": values.min(), "median": values.median(), "maximum": values.max()}
        rows.append({**named, "degenerate": constant, **spread})
    return pd.DataFrame(rows)


def build_truth_tables(study: StudyData) -> Tables:
    """Build the tables that compare features and predictions with the true parameters of the knees.

    Parameters
    ----------
    study : StudyData
        Study with predictions and the table ``subjects``.

    Returns
    -------
    dict of str to DataFrame
        Tables by name: morphology, feature_parameter_correlations and subgroups.
    """
    parameters, settings = study.parameters, study.settings
    ratio = compute_test_train_ratio(study.tables["subjects"])
    return {
        "morphology": summarise_morphology(parameters, None if study.laws is None else study.laws.grades),
        "feature_parameter_correlations": correlate_with_parameters(
            study.usable, study.names, parameters, settings.reference
        ),
        "subgroups": score_subgroups(study.predictions, parameters, settings, ratio),
    }
