"""Analyses that need a simulator: incremental value, learning curves, response curves, sensitivity, confounding."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from ..model.sampling.knee_sampling import KneeDistributions
from .design.classification_tasks import select_contrast
from .design.response_curve_design import PROTOCOL_AXES, DesignedManifests
from .design.study_settings import StudySettings
from .learn.confounded_training import CLASSES, CONFOUNDERS, evaluate_confounding
from .learn.grade_separability import DEFAULT_KNEE_COUNT, estimate_separability
from .learn.incremental_value import build_predictor_table, evaluate_predictor_sets, find_predictor_sets
from .learn.response_curves import evaluate_response_curves
from .learn.subject_split import select_splittable_grades, split_subjects
from .measurement import StudyContext, measure_designed_features
from .predictions import concatenate_tables
from .report.report_page import Picture
from .report.report_sections import (
    Section,
    make_confounders_section,
    make_incremental_value_section,
    make_learning_section,
    make_response_curves_section,
    make_sensitivity_section,
)
from .statistics.analyses import (
    breakpoints,
    confounding_effects,
    incremental_value_scores,
    learning_curves,
    response_curve_statistics,
    sensitivity_analysis,
)
from .statistics.analyses.knee_parameters import extract_knee_parameters
from .statistics.features.feature_importance import select_leading_features
from .statistics.result_tables import Tables
from .statistics.scores.tested_subjects import TEST_COUNT_COLUMNS, count_test_subjects, has_enough_test_subjects

# Fractions of the training subjects that the learning curves use, besides all of them.
_TRAINING_FRACTIONS = (0.2, 0.4, 0.6, 0.8)
# Knees sampled for the first estimate of the best possible AUC; enough where grades do not overlap.
_INITIAL_KNEE_COUNT = 1_000
# Predictor sets that have a learning curve.
_LEARNING_CURVE_SETS = ("measured", "radiomics", "both")


@dataclass(frozen=True)
class SimulatorAnalyses:
    """Hold the tables of the analyses and the report sections that show them.

    Attributes
    ----------
    tables : dict of str to DataFrame
        Each table by its name, which is also the stem of its CSV file.
    sections : list of Section
        Sections of the report, in their order.
    """

    tables: dict[str, pd.DataFrame]
    sections: list[Section]

    def pictures(self) -> dict[str, Picture]:
        """Collect the figures of all sections.

        Returns
        -------
        dict of str to Picture
            Each figure by its name.
        """
        return {picture.name: picture for section in self.sections for picture in section.pictures}


def run_simulator_analyses(
    run: StudyContext,
    manifest: pd.DataFrame,
    usable: pd.DataFrame,
    names: list[str],
    tables: Tables,
    designed: DesignedManifests,
    laws: KneeDistributions | None,
) -> SimulatorAnalyses:
    """Run every analysis that the available data allow.

    Parameters
    ----------
    run : StudyContext
        Inputs, settings and execution of the study.
    manifest : DataFrame
        Manifest of the cohort, one row per radiograph.
    usable : DataFrame
        Radiographs with a located region: knee, subject, grade, protocol and features.
    names : list of str
        Names of the features.
    tables : dict of str to DataFrame
        Tables of the study so far; ``importance`` and ``feature_parameter_correlations`` are read.
    designed : DesignedManifests
        Manifests of the radiographs acquired by design; analyses of missing manifests are left out.
    laws : KneeDistributions or None
        Distributions from which the knees were sampled; None if they are unknown.

    Returns
    -------
    SimulatorAnalyses
        All tables and report sections.
    """
    parts = [_analyse_incremental_value(manifest, usable, names, run, laws)]
    base, most = (
        usable[usable["protocol"] == run.settings.reference],
        select_leading_features(tables["importance"], run.settings),
    )
    parts.append(_analyse_confounders(manifest, usable, names, run))
    if designed.response_curves is not None:
        parts.append(_analyse_response_curves(designed.response_curves, base, names, most, run))
    if designed.sobol_samples is not None or designed.sensitivity_pairs is not None:
        parts.append(
            _analyse_sensitivity(designed, manifest, base, names, most, tables["feature_parameter_correlations"], run)
        )
    answers = {name: table for part in parts for name, table in part.tables.items()}
    return SimulatorAnalyses(answers, [section for part in parts for section in part.sections])


def _analyse_incremental_value(
    manifest: pd.DataFrame, usable: pd.DataFrame, names: list[str], run: StudyContext, laws: KneeDistributions | None
) -> SimulatorAnalyses:
    """Estimate incremental value, learning curves and power.

    Return nothing if the manifest has no joint space widths or if the splits test too few subjects. Leave out a
    grade with too few subjects to split.
    """
    settings, execution = run.settings, run.execution
    known = select_splittable_grades(build_predictor_table(usable, names, extract_knee_parameters(manifest), settings))
    if len(find_predictor_sets(known, names)) < 2 or not _is_decidable(known, settings):
        return SimulatorAnalyses({}, [])
    splits = evaluate_predictor_sets(known, names, settings, execution)
    rungs, differences = (
        incremental_value_scores.summarise_predictor_sets(splits),
        incremental_value_scores.compare_predictor_sets(splits),
    )
    if laws is not None:
        with execution.timer.stage("best possible AUC"):
            best = _estimate_best_possible_auc(laws, run)
        rungs = concatenate_tables([rungs, best[best["grades"].isin(rungs["grades"])]])
        rungs = rungs.astype(dict.fromkeys(("trained", *TEST_COUNT_COLUMNS, "splits", "knees"), "Int64"))
    fewer = evaluate_predictor_sets(
        known,
        names,
        settings,
        execution,
        training_fractions=_TRAINING_FRACTIONS,
        predictor_set_names=_LEARNING_CURVE_SETS,
        stage="learning curves",
    )
    curves = learning_curves.compute_learning_curves(
        concatenate_tables([fewer, splits[splits["rung"].isin(_LEARNING_CURVE_SETS)]])
    )
    power = learning_curves.tabulate_power(splits, _count_subjects(known), settings.difference)
    tables = {"ladder": rungs, "ladder_differences": differences, "learning": curves, "power": power}
    sections = [
        make_incremental_value_section(rungs, differences, int(known["subject"].nunique())),
        make_learning_section(curves, power),
    ]
    return SimulatorAnalyses(tables, sections)


def _estimate_best_possible_auc(laws: KneeDistributions, run: StudyContext) -> pd.DataFrame:
    """Estimate the best possible AUC of each pair of grades.

    Start with few knees. Sample more only if the grades of the table overlap.
    """
    for knees in (_INITIAL_KNEE_COUNT, DEFAULT_KNEE_COUNT):
        drawn = estimate_separability(laws, run.tables.gap_alone_auc, knees=knees, seed=run.settings.seed)
        best = incremental_value_scores.select_best_possible(drawn)
        if (best["auc"] == 1.0).all():
            break
    return best


def _analyse_confounders(
    manifest: pd.DataFrame, usable: pd.DataFrame, names: list[str], run: StudyContext
) -> SimulatorAnalyses:
    """Estimate the effect of age, BMI and site on a classifier.

    Use age and BMI if the manifest has them, and the site if there are two protocols. Return nothing if the splits
    test too few subjects.
    """
    known_of_knees = extract_knee_parameters(manifest)
    columns = [name for name in CONFOUNDERS if name in known_of_knees]
    known = usable[["knee", "subject", "grade", "protocol", *names]]
    known = known.merge(known_of_knees[["knee", *columns]], on="knee", how="left")
    wanted = columns + (["site"] if known["protocol"].nunique() > 1 else [])
    if not wanted or not _is_decidable(
        select_splittable_grades(known[known["grade"].isin(sum(CLASSES, ()))]), run.settings
    ):
        return SimulatorAnalyses({}, [])
    table = confounding_effects.estimate_confounding(
        evaluate_confounding(known, names, wanted, run.settings, run.execution)
    )
    if table.empty:
        return SimulatorAnalyses({}, [])
    return SimulatorAnalyses({"confounders": table}, [make_confounders_section(table)])


def _is_decidable(predictor_table: pd.DataFrame, settings: StudySettings) -> bool:
    """Check that the first split tests enough subjects of the lowest grade and of any other grade."""
    if predictor_table.empty:
        return False
    test = predictor_table[
        predictor_table["subject"].isin(
            split_subjects(predictor_table["subject"], predictor_table["grade"], seed=settings.seed).test
        )
    ]
    first, *others = sorted(set(predictor_table["grade"]))
    pairs = ((first, grade) for grade in others)
    of_pairs = ((pair, test[test["grade"].isin(pair)]) for pair in pairs)
    return any(
        has_enough_test_subjects(count_test_subjects(part["subject"], part["grade"], pair)) for pair, part in of_pairs
    )


def _measure_located(radiographs: pd.DataFrame, name: str, base: pd.DataFrame, run: StudyContext) -> pd.DataFrame:
    """Measure designed radiographs and keep those with a located region."""
    measured = measure_designed_features(run, radiographs, name, float(base["pixel_mm"].iloc[0]))
    return measured[measured["status"] == "found"]


def _analyse_sensitivity(
    designed: DesignedManifests,
    manifest: pd.DataFrame,
    base: pd.DataFrame,
    names: list[str],
    leading_features: Sequence[str],
    correlations: pd.DataFrame,
    run: StudyContext,
) -> SimulatorAnalyses:
    """Compute Sobol indices and slopes of the features and merge them with the correlations."""
    of_shares, of_slopes = (
        pd.DataFrame(columns=sensitivity_analysis.SOBOL_COLUMNS),
        pd.DataFrame(columns=sensitivity_analysis.SLOPE_COLUMNS),
    )
    if designed.sobol_samples is not None:
        table = _measure_located(designed.sobol_samples, "sobol_samples", base, run)
        with run.execution.timer.stage("Sobol indices"):
            of_shares = sensitivity_analysis.compute_sobol_indices(
                table, names, designed.bounds, designed.sobol_sample_count, run.settings.seed
            )
    if designed.sensitivity_pairs is not None:
        table = _measure_located(designed.sensitivity_pairs, "sensitivity_pairs", base, run)
        before = manifest[manifest["protocol"] == run.settings.reference]
        of_slopes = sensitivity_analysis.compute_slopes(base, table, before, names, designed.bounds)
    both = sensitivity_analysis.merge_sensitivity_tables(correlations, of_slopes, of_shares)
    section = make_sensitivity_section(of_shares, both, leading_features, designed.bounds)
    return SimulatorAnalyses(
        {"sobol_indices": of_shares, "slopes": of_slopes, "feature_parameter_correlations": both}, [section]
    )


def _analyse_response_curves(
    curves: pd.DataFrame, base: pd.DataFrame, names: list[str], leading_features: Sequence[str], run: StudyContext
) -> SimulatorAnalyses:
    """Compute response curves of features and models along the axes, and their breakpoints."""
    settings = run.settings
    steps = _measure_located(curves, "response_curves", base, run)
    axes = {name: axis for name, axis in PROTOCOL_AXES.items() if name in set(curves["kind"])}

    def step(axis: str, turn: int) -> float:
        """Return the value of the given step (`turn` counts from 1) of an axis."""
        return axes[axis].steps[turn - 1]

    with run.execution.timer.stage("feature response curves"):
        chance = {"replicates": settings.replicates, "seed": settings.seed}
        of_features = response_curve_statistics.compute_feature_curves(base, steps, names, step, **chance)
    of_models = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, names, settings, run.execution), step
    )
    places = breakpoints.find_breakpoints(of_features, of_models, axes, settings.difference)
    whole = concatenate_tables([of_features.table, of_models])
    tables = {f"curve_{name}": whole[whole["axis"] == name].reset_index(drop=True) for name in axes}
    knees, task = int(curves["knee"].nunique()), select_contrast(curves["grade"])
    section = make_response_curves_section(tables, places, axes, leading_features, knees, task)
    return SimulatorAnalyses(tables | {"breakpoints": places}, [section])


def _count_subjects(predictor_table: pd.DataFrame) -> pd.Series:
    """Count the subjects of each pair of grades, by the pair's label such as "0 vs 2"."""
    of_grade = predictor_table.groupby("grade")["subject"].nunique()
    first, *others = sorted(of_grade.index)
    return pd.Series({f"{first} vs {grade}": int(of_grade[first] + of_grade[grade]) for grade in others})
