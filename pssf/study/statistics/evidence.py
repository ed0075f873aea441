"""From predictions and features to the tables of the study."""

import pandas as pd

from ...radiomics.families import family
from ...radiomics.ibsi import Tags, departure_of, tag_of
from ..predictions import ARM, Outcome, joined
from ..settings import StudySettings
from . import localisation
from .calibration import calibration, confusions, reliability_curve
from .degenerate import is_degenerate
from .importance import by_feature
from .intervals import differences, intervals, share_tested
from .parameters import follows, parameters_of
from .reliability import reliability, repeatability
from .scores import score_splits, summarise
from .subgroups import subgroups

Tables = dict[str, pd.DataFrame]


def tables_of_models(outcomes: list[Outcome], settings: StudySettings) -> Tables:
    """subjects (part of each in each split), splits, scores (with intervals), differences, confusion, calibration,
    calibration_curve, importance, permutation.

    outcomes  one a split
    """
    predictions = joined([outcome.predictions for outcome in outcomes])
    importances = joined([outcome.importances for outcome in outcomes])
    permutation = joined([outcome.permutation for outcome in outcomes])
    splits = score_splits(predictions)
    subjects = joined([outcome.subjects for outcome in outcomes])
    ratio = share_tested(subjects)
    within = importances[(importances["task"] == "0 vs 2") & (importances["trained_on"] == settings.reference)]
    return {
        "subjects": subjects,
        "splits": splits,
        "scores": summarise(splits).merge(intervals(splits, ratio), on=ARM, how="left", validate="one_to_one"),
        "differences": differences(splits, ratio),
        "confusion": confusions(predictions),
        "calibration": calibration(predictions),
        "calibration_curve": reliability_curve(predictions),
        "importance": by_feature(within, settings.repeats),
        "permutation": by_feature(permutation, settings.repeats, "drop"),
    }


def tables_of_features(
    located: pd.DataFrame, retest: pd.DataFrame, names: list[str], tags: Tags, settings: StudySettings
) -> Tables:
    """localisation, dictionary, reliability (across protocols, and across repeats where there are any).

    located  of `localisation.errors`
    retest   radiographs taken again, with a region found: kind, turn, knee, features
    tags     of `data.ibsi.ibsi_tags`
    """
    usable = located[located["status"] == "found"]
    chance = {"replicates": settings.replicates, "seed": settings.seed}
    across = reliability(usable, names, settings.reference, **chance)
    if len(retest):
        repeated = repeatability(usable, retest, names, settings.reference, **chance)
        across = joined([across, repeated]) if len(across) else repeated
    return {
        "localisation": localisation.summarise(located),
        "dictionary": dictionary(usable, names, tags),
        "reliability": across,
    }


def dictionary(usable: pd.DataFrame, names: list[str], tags: Tags) -> pd.DataFrame:
    """feature, family, ibsi (its tag there), departure, degenerate (yes | no), least, median, most of each feature

    tags  of `data.ibsi.ibsi_tags`
    """
    rows = []
    for name in names:
        values = usable[name]
        named = {
            "feature": name,
            "family": family(name),
            "ibsi": tag_of(name, tags),
            "departure": departure_of(name, tags),
        }
        constant = "yes" if is_degenerate(values.to_numpy()) else "no"
        spread = {"least": values.min(), "median": values.median(), "most": values.max()}
        rows.append({**named, "degenerate": constant, **spread})
    return pd.DataFrame(rows)


def tables_of_truth(
    manifest: pd.DataFrame,
    usable: pd.DataFrame,
    names: list[str],
    predictions: pd.DataFrame,
    subjects: pd.DataFrame,
    settings: StudySettings,
) -> Tables:
    """follows (features against what the knees were built with), subgroups.

    subjects  of `tables_of_models`
    """
    parameters = parameters_of(manifest)
    return {
        "follows": follows(usable, names, parameters, settings.reference),
        "subgroups": subgroups(predictions, parameters, settings, share_tested(subjects)),
    }
