"""Run all stages of a study in order, and write the result files with `pssf.io`."""

import platform
from dataclasses import asdict, replace
from importlib.metadata import version

import pandas as pd

from ..core.checks import InputError
from ..io import study_results
from ..radiomics.features.feature_backends import BACKENDS
from ..radiomics.features.image_processing import describe_processing
from ..radiomics.localisation.crop_template import crop_template
from .design.classification_tasks import class_names
from .design.manifest_checks import require_designed
from .design.patient_sets import FilmSet
from .design.response_curve_design import DesignedManifests
from .design.study_settings import StudySettings
from .design.study_tables import resolve_sampling_laws
from .learn.models.final_models import refit_models
from .learn.models.model_file import MODEL_SUFFIX, pack_model
from .learn.training import train_all_splits
from .libraries import XGBOOST
from .measurement import check_manifest, measure_features
from .prediction.patient_test import (
    MeasurementContext,
    check_films,
    evaluate_on_films,
    list_training_protocols,
)
from .report.figures.figure_gallery import make_gallery
from .report.figures.patient_figures import make_film_pictures
from .report.report_elements import Picture
from .report.report_page import Findings, render_page
from .report.report_sections import make_segmentation_section
from .report.reporting_checklist import fill_checklist
from .report.run_cost import summarise_cost
from .report.software_environment import describe_environment
from .segmentation_accuracy import evaluate_segmentation
from .simulator_analyses import run_simulator_analyses
from .statistics.analyses.knee_parameters import (
    add_sex_indicator,
    extract_knee_parameters,
    summarise_composition,
)
from .statistics.analyses.leakage_checks import find_leakage_notes, find_leakage_warnings
from .statistics.features import localisation_error
from .statistics.features.degenerate_features import is_degenerate
from .statistics.features.dimensions import count_dimensions, count_tuned_values
from .statistics.features.feature_importance import sum_by_family
from .statistics.features.reliability import count_stable_features, list_protocols
from .statistics.result_tables import (
    build_feature_tables,
    build_model_tables,
    build_truth_tables,
)
from .statistics.scores.claims import evaluate_claims
from .study_data import StudyContext, StudyData, Tables
from .study_result import StudyResult

_PACKAGES = (
    *("pssf", "scikit-learn", XGBOOST, "feature-engine", "scikit-image", "skops"),
    *("scipy", "numpy", "pandas"),
)
_COUNTED_COLUMNS = {"subjects": "subject", "knees": "knee", "protocols": "protocol", "radiographs": "radiograph"}


def run_study(
    run: StudyContext,
    manifest: pd.DataFrame,
    retest: pd.DataFrame | None,
    films: FilmSet | None = None,
    designed: DesignedManifests | None = None,
) -> StudyResult:
    """Run all stages of a study; see `pssf.study.run`.

    Parameters
    ----------
    run : StudyContext
        Inputs, settings, output folder and execution.
    manifest : DataFrame
        One row per radiograph.
    retest : DataFrame or None
        Repeat radiographs of some knees.
    films : FilmSet, optional
        Patient radiographs used as an external test set.
    designed : DesignedManifests, optional
        Manifests of response curves, Sobol samples and sensitivity pairs.

    Returns
    -------
    StudyResult
        Paths of all output files, and the main tables.

    Raises
    ------
    InputError
        An input is not valid, or no split has grades 0 and 2 in the training set.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    designed = require_designed(designed or DesignedManifests())
    manifest = check_manifest(manifest, run.settings)
    if films is not None:
        check_films(films, manifest, run.settings, run.templates)
    study, work_seconds = _measure_cohort(run, manifest, retest, designed)
    study = replace(study, outcomes=train_all_splits(study.usable, study.names, study.settings, run.execution))
    if study.predictions.empty:
        located_in = f"the joint was located in {len(study.usable)} radiographs"
        raise InputError(f"grades 0 and 2 must be in the training set of a split, got no such split: {located_in}")
    study, pictures = _evaluate_models(study)
    study = study.add_tables({"segmentation": evaluate_segmentation(study.repeated, retest, run)})
    with run.execution.timer.stage("models refitted"):
        models = _pack_models(study)
    answers, external = run_simulator_analyses(study), None
    study, pictures = study.add_tables(answers.tables), pictures | answers.pictures()
    if films is not None:
        bench = MeasurementContext(run.templates, run.settings, run.out, run.execution, run.tables.radiomics)
        external = evaluate_on_films(bench, films, study.manifest)
        study = study.add_tables(external.tables)
        models |= external.models
        pictures |= make_film_pictures(external, run.settings)
    findings = _collect_findings(study, pictures, work_seconds)
    sections = [*make_segmentation_section(study.tables["segmentation"]), *answers.sections]
    findings = replace(findings, models=sorted(models), external=external, sections=sections)
    return _write_results(run, findings, study.tables | {"predictions": study.predictions}, models)


def _measure_cohort(
    run: StudyContext, manifest: pd.DataFrame, retest: pd.DataFrame | None, designed: DesignedManifests
) -> tuple[StudyData, dict[str, float]]:
    """Measure the features of cohort and repeat radiographs; return the study data and the time of each step in s."""
    table, names, work_seconds = measure_features(run, manifest, retest)
    study = StudyData(
        run=run,
        manifest=manifest,
        parameters=extract_knee_parameters(manifest),
        located=localisation_error.add_localisation_errors(add_sex_indicator(table[table["kind"] == ""])),
        repeated=table[(table["kind"] != "") & (table["status"] == "found")],
        names=names,
        laws=resolve_sampling_laws(manifest),
        designed=designed,
    )
    _require_grades(study.usable, run.settings)
    return study, work_seconds


def _evaluate_models(study: StudyData) -> tuple[StudyData, dict[str, Picture]]:
    """Add the tables of models, features, true parameters and claims; return the study data and its figures."""
    timer = study.run.execution.timer
    with timer.stage("intervals and differences"):
        models = build_model_tables(study.outcomes, study.settings)
    with timer.stage("reliability and figures"):
        study = study.add_tables(build_feature_tables(study) | models)
        study = study.add_tables({"composition": summarise_composition(study.located)} | build_truth_tables(study))
        pictures = make_gallery(study)
    with timer.stage("claims"):
        return study.add_tables(_build_claim_tables(study)), pictures


def _build_claim_tables(study: StudyData) -> Tables:
    """Build the tables ``claims``, ``dimensions`` and ``tuning``."""
    usable, tables = study.usable, study.tables
    importances, offered = study.stack("importances"), study.stack("selection_candidates")
    return {
        "claims": evaluate_claims(usable, study.predictions, importances, offered, tables, study.settings),
        "dimensions": count_dimensions(importances, offered, tables["subjects"], usable, len(study.names)),
        "tuning": count_tuned_values(study.stack("tuning")),
    }


def _pack_models(study: StudyData) -> dict[str, bytes]:
    """Fit each model to all subjects and pack it as a model file.

    Train on the reference protocol and, if there are several protocols, also on all protocols. Return the file content
    by model name.
    """
    settings, law = study.settings, study.run.tables.radiomics.localisation
    protocols = list_protocols(study.usable, settings.reference)
    sets = {settings.reference: protocols[:1]} | ({"all": protocols} if len(protocols) > 1 else {})
    learnt = {protocol.protocol: protocol for protocol in list_training_protocols(study.manifest)}
    pixel_mm = learnt[settings.reference].pixel_mm
    templates = [crop_template(template, settings.region_px * pixel_mm, law) for template in study.run.templates]
    return {
        kept.name: pack_model(
            kept,
            templates,
            reads="linear",
            grade_names=class_names(kept.task),
            families=settings.families,
            backend=settings.backend,
            regions=settings.film_regions,
            areas=settings.areas,
            bins=settings.bins,
            pixel_mm=pixel_mm,
            region_px=settings.region_px,
            trained_on=tuple(learnt[protocol] for protocol in kept.trained_on),
            seed=settings.seed,
        )
        for kept in refit_models(study.usable, study.names, settings, sets)
    }


def _require_grades(usable: pd.DataFrame, settings: StudySettings) -> None:
    """Raise InputError unless regions of grades 0 and 2 are located under the reference protocol."""
    of_reference = usable[usable["protocol"] == settings.reference]
    grades = sorted({int(grade) for grade in of_reference["grade"]})
    if not {0, 2} <= set(grades):
        raise InputError(
            f"grades with a located region under {settings.reference} must include 0 and 2, each with three subjects "
            f"or more, got {grades}"
        )


def _collect_findings(study: StudyData, pictures: dict[str, Picture], work_seconds: dict[str, float]) -> Findings:
    """Collect all data for the report."""
    run, located, usable, tables, settings = study.run, study.located, study.usable, study.tables, study.settings
    keys = ["model", "selection", "feature"]
    importance = tables["importance"].merge(tables["permutation"][[*keys, "drop"]], on=keys, how="left")
    shown = importance[importance["selection"] == settings.selections[0]]
    counts = {name: int(located[column].nunique()) for name, column in _COUNTED_COLUMNS.items()}
    within = tables["splits"][tables["splits"]["scenario"] == "within"]
    tested = within["test_subjects"]
    packages = (*_PACKAGES, *BACKENDS[settings.backend].libraries)
    return Findings(
        counts=counts | {"regions rejected": len(located) - len(usable)},
        composition=tables["composition"],
        warnings=find_leakage_warnings(located),
        notes=find_leakage_notes(located),
        localisation=tables["localisation"],
        morphology=tables["morphology"],
        subgroups=tables["subgroups"],
        scores=tables["scores"],
        differences=tables["differences"],
        claims=tables["claims"],
        calibration=tables["calibration"],
        families=sum_by_family(shown).join(sum_by_family(shown, "drop").add_suffix(" drop")),
        stable_counts_by_split=[
            outcome.stable_feature_count for outcome in study.outcomes if outcome.stable_feature_count is not None
        ],
        stable_counts=count_stable_features(tables["reliability"]),
        leading=shown.groupby("model", sort=False).head(5),
        degenerate=[name for name in study.names if is_degenerate(usable[name].to_numpy())],
        pictures=pictures,
        settings=asdict(settings),
        processing=describe_processing(settings.region_px, settings.bins, settings.families),
        versions={"python": platform.python_version()} | {name: version(name) for name in packages},
        cost=summarise_cost(run.execution.timer),
        work_seconds=work_seconds,
        workers=run.execution.workers,
        features=len(study.names),
        test_subjects=(int(tested.min()), int(tested.max())),
        test_rarest=int(within["test_rarest"].min()),
    )


def _write_results(run: StudyContext, findings: Findings, tables: Tables, files: dict[str, bytes]) -> StudyResult:
    """Write tables, figures, models, JSON files and the report.

    With the same cohort and settings, the files of two runs differ only in run times.
    """
    out, pictures = run.out, {}
    for name, picture in findings.pictures.items():
        pictures[name] = out / "pictures" / f"{name}.png"
        study_results.save_bytes(pictures[name], picture.png)
    written = {name: out / f"{name}.csv" for name in tables}
    for name, table in tables.items():
        study_results.save_table(written[name], table)
    models = {name: out / "models" / f"{name}{MODEL_SUFFIX}" for name in sorted(files)}
    for name, path in models.items():
        study_results.save_bytes(path, files[name])
    facts = ["counts", "warnings", "notes", "features", "degenerate"]
    facts += ["settings", "processing", "versions", "cost", "workers"]
    study_results.save_json(out / "study.json", {name: getattr(findings, name) for name in facts})
    study_results.save_json(out / "environment.json", describe_environment())
    study_results.save_text(out / "report.html", render_page(findings))
    study_results.save_json(out / "checklist.json", fill_checklist(out, run.tables.guidelines))
    return StudyResult(
        report=out / "report.html",
        pictures=pictures,
        tables={"features": out / "features.csv", **written},
        models=models,
        scores=tables["scores"],
        differences=tables["differences"],
        reliability=tables["reliability"],
        localisation=tables["localisation"],
        seconds={row["stage"]: row["seconds"] for row in findings.cost},
    )
