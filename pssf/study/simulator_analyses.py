"""Analyses that need simulated data: incremental value, learning curves, response curves, sensitivity, confounding."""

from dataclasses import dataclass

import pandas as pd

from ..model.sampling.knee_sampling import KneeDistributions
from .design.classification_tasks import select_contrast
from .design.response_curve_design import PROTOCOL_AXES
from .design.study_settings import StudySettings
from .learn.confounded_training import CLASSES, CONFOUNDERS, evaluate_confounding
from .learn.grade_separability import DEFAULT_KNEE_COUNT, estimate_separability
from .learn.incremental_value import build_predictor_table, evaluate_predictor_sets, find_predictor_sets
from .learn.response_curves import evaluate_response_curves
from .learn.subject_split import select_splittable_grades, split_subjects
from .measurement import measure_designed_features
from .predictions import concatenate_tables
from .report.report_elements import Picture, Section
from .report.report_sections import (
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
from .statistics.features.feature_importance import select_leading_features
from .statistics.scores.tested_subjects import TEST_COUNT_COLUMNS, count_test_subjects, has_enough_test_subjects
from .study_data import StudyContext, StudyData

# Fractions of the training subjects in the learning curves, in addition to fraction 1 (all training subjects).
_TRAINING_FRACTIONS = (0.2, 0.4, 0.6, 0.8)
# Number of knees for the first estimate of the best possible AUC; it is sufficient if the grades do not overlap.
_INITIAL_KNEE_COUNT = 1_000
# Predictor sets for which a learning curve is computed.
_LEARNING_CURVE_SETS = ("measured", "radiomics", "both")


@dataclass(frozen=True)
class SimulatorAnalyses:
    """Tables and report sections of the analyses that need simulated data.

    Attributes
    ----------
    tables : dict of str to DataFrame
        Tables, keyed by name; the table name is also the CSV file name without suffix.
    sections : list of Section
        Sections of the report, in order.
    """

    tables: dict[str, pd.DataFrame]
    sections: list[Section]

    def pictures(self) -> dict[str, Picture]:
        """Collect the figures of all report sections.

        Returns
        -------
        dict of str to Picture
            Figures by name.
        """
        return {picture.name: picture for section in self.sections for picture in section.pictures}


def run_simulator_analyses(study: StudyData) -> SimulatorAnalyses:
    """Run every analysis whose input data are available.

    Parameters
    ----------
    study : StudyData
        Study data that include the tables ``importance`` and ``feature_parameter_correlations``.

    Returns
    -------
    SimulatorAnalyses
        All tables and report sections.
    """
    designed = study.designed
    parts = [_analyse_incremental_value(study), _analyse_confounders(study)]
    if designed.response_curves is not None:
        parts.append(_analyse_response_curves(study, designed.response_curves))
    if designed.sobol_samples is not None or designed.sensitivity_pairs is not None:
        parts.append(_analyse_sensitivity(study))
    answers = {name: table for part in parts for name, table in part.tables.items()}
    return SimulatorAnalyses(answers, [section for part in parts for section in part.sections])


def _analyse_incremental_value(study: StudyData) -> SimulatorAnalyses:
    """Estimate incremental value, learning curves and power.

    Return no tables if the manifest has no joint space widths or the test sets have too few subjects. Grades with too
    few subjects for a split are omitted.
    """
    settings, execution, names = study.settings, study.run.execution, study.names
    known = select_splittable_grades(build_predictor_table(study.usable, names, study.parameters, settings))
    if len(find_predictor_sets(known, names)) < 2 or not _is_decidable(known, settings):
        return SimulatorAnalyses({}, [])
    splits = evaluate_predictor_sets(known, names, settings, execution)
    predictor_sets, differences = (
        incremental_value_scores.summarise_predictor_sets(splits),
        incremental_value_scores.compare_predictor_sets(splits),
    )
    if study.laws is not None:
        with execution.timer.stage("best possible AUC"):
            best = _estimate_best_possible_auc(study.laws, study.run)
        predictor_sets = concatenate_tables([predictor_sets, best[best["grades"].isin(predictor_sets["grades"])]])
        predictor_sets = predictor_sets.astype(
            dict.fromkeys(("training_subjects", *TEST_COUNT_COLUMNS, "splits", "knees"), "Int64")
        )
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
        concatenate_tables([fewer, splits[splits["predictor_set"].isin(_LEARNING_CURVE_SETS)]])
    )
    power = learning_curves.tabulate_power(splits, _count_subjects(known), settings.difference)
    tables = {
        "incremental_value": predictor_sets,
        "incremental_value_differences": differences,
        "learning": curves,
        "power": power,
    }
    sections = [
        make_incremental_value_section(predictor_sets, differences, int(known["subject"].nunique())),
        make_learning_section(curves, power),
    ]
    return SimulatorAnalyses(tables, sections)


def _estimate_best_possible_auc(laws: KneeDistributions, run: StudyContext) -> pd.DataFrame:
    """Estimate the best possible AUC of each pair of grades.

    Start with 1000 knees, and sample more knees only if the grades overlap.
    """
    for knees in (_INITIAL_KNEE_COUNT, DEFAULT_KNEE_COUNT):
        drawn = estimate_separability(laws, run.tables.gap_alone_auc, knees=knees, seed=run.settings.seed)
        best = incremental_value_scores.select_best_possible(drawn)
        if (best["auc"] == 1.0).all():
            break
    return best


def _analyse_confounders(study: StudyData) -> SimulatorAnalyses:
    """Estimate the confounding effect of age, BMI and imaging site on a classifier.

    Use age and BMI if they are in the manifest, and the site if there are several protocols. Return no tables if the
    test sets have too few subjects.
    """
    settings, names = study.settings, study.names
    columns = [name for name in CONFOUNDERS if name in study.parameters]
    known = study.usable[["knee", "subject", "grade", "protocol", *names]]
    known = known.merge(study.parameters[["knee", *columns]], on="knee", how="left")
    wanted = columns + (["site"] if known["protocol"].nunique() > 1 else [])
    if not wanted or not _is_decidable(
        select_splittable_grades(known[known["grade"].isin(sum(CLASSES, ()))]), settings
    ):
        return SimulatorAnalyses({}, [])
    table = confounding_effects.estimate_confounding(
        evaluate_confounding(known, names, wanted, settings, study.run.execution)
    )
    if table.empty:
        return SimulatorAnalyses({}, [])
    return SimulatorAnalyses({"confounders": table}, [make_confounders_section(table)])


def _is_decidable(predictor_table: pd.DataFrame, settings: StudySettings) -> bool:
    """Report whether the first test set has enough subjects of the lowest grade and of at least one other grade."""
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


def _measure_located(study: StudyData, radiographs: pd.DataFrame, name: str) -> pd.DataFrame:
    """Measure designed radiographs and return the rows with a located region."""
    measured = measure_designed_features(study.run, radiographs, name, float(study.base["pixel_mm"].iloc[0]))
    return measured[measured["status"] == "found"]


def _analyse_sensitivity(study: StudyData) -> SimulatorAnalyses:
    """Compute Sobol indices and slopes of the features and merge them with the feature-parameter correlations."""
    settings, designed, names = study.settings, study.designed, study.names
    of_shares, of_slopes = (
        pd.DataFrame(columns=sensitivity_analysis.SOBOL_COLUMNS),
        pd.DataFrame(columns=sensitivity_analysis.SLOPE_COLUMNS),
    )
    if designed.sobol_samples is not None:
        table = _measure_located(study, designed.sobol_samples, "sobol_samples")
        with study.run.execution.timer.stage("Sobol indices"):
            of_shares = sensitivity_analysis.compute_sobol_indices(
                table, names, designed.bounds, designed.sobol_sample_count, settings.seed
            )
    if designed.sensitivity_pairs is not None:
        table = _measure_located(study, designed.sensitivity_pairs, "sensitivity_pairs")
        before = study.manifest[study.manifest["protocol"] == settings.reference]
        of_slopes = sensitivity_analysis.compute_slopes(study.base, table, before, names, designed.bounds)
    correlations = study.tables["feature_parameter_correlations"]
    both = sensitivity_analysis.merge_sensitivity_tables(correlations, of_slopes, of_shares)
    leading_features = select_leading_features(study.tables["importance"], settings)
    section = make_sensitivity_section(of_shares, both, leading_features, designed.bounds)
    return SimulatorAnalyses(
        {"sobol_indices": of_shares, "slopes": of_slopes, "feature_parameter_correlations": both}, [section]
    )


def _analyse_response_curves(study: StudyData, curves: pd.DataFrame) -> SimulatorAnalyses:
    """Compute response curves of features and models along all axes, and the breakpoints of the curves."""
    settings, base, names = study.settings, study.base, study.names
    steps = _measure_located(study, curves, "response_curves")
    axes = {name: axis for name, axis in PROTOCOL_AXES.items() if name in set(curves["kind"])}

    def step(axis: str, turn: int) -> float:
        """Return the parameter value at a step of an axis; `turn` is the step number, starting at 1."""
        return axes[axis].steps[turn - 1]

    with study.run.execution.timer.stage("feature response curves"):
        chance = {"replicates": settings.replicates, "seed": settings.seed}
        of_features = response_curve_statistics.compute_feature_curves(base, steps, names, step, **chance)
    of_models = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, names, settings, study.run.execution), step
    )
    places = breakpoints.find_breakpoints(of_features, of_models, axes, settings.difference)
    whole = concatenate_tables([of_features.table, of_models])
    tables = {f"curve_{name}": whole[whole["axis"] == name].reset_index(drop=True) for name in axes}
    knees, task = int(curves["knee"].nunique()), select_contrast(curves["grade"])
    leading_features = select_leading_features(study.tables["importance"], settings)
    section = make_response_curves_section(tables, places, axes, leading_features, knees, task)
    return SimulatorAnalyses(tables | {"breakpoints": places}, [section])


def _count_subjects(predictor_table: pd.DataFrame) -> pd.Series:
    """Count the subjects in each pair of grades; the index is the pair label, such as "0 vs 2"."""
    of_grade = predictor_table.groupby("grade")["subject"].nunique()
    first, *others = sorted(of_grade.index)
    return pd.Series({f"{first} vs {grade}": int(of_grade[first] + of_grade[grade]) for grade in others})
