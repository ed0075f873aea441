"""External test: models trained on cohort radiographs that are rendered for display are tested on patient radiographs.

Simulated pixels are linear in the signal, but a patient radiograph is processed for display with an unknown tone curve.
The cohort radiographs are therefore rendered for display. Joint localisation and feature measurement are then the same
for cohort and patient radiographs; see `radiomics.displayed_radiograph`.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...core.checks import InputError, require_choice
from ...core.processes.execution import Execution
from ...data.analysis.localisation_table import LocalisationSettings
from ...io import study_results
from ...io.patients.patient_radiographs import Film
from ...radiomics.displayed_radiograph import (
    FILM_FAMILIES,
    DisplayExtractionSettings,
    locate_joint_in_display,
    measure_display,
    require_plateau_width,
)
from ...radiomics.features.feature_table import (
    NON_FEATURE_COLUMNS,
    TEXT_COLUMNS,
    MeasurementJob,
    Record,
    make_measurement_jobs,
    measure_radiographs,
)
from ...radiomics.localisation.crop_template import crop_template
from ...radiomics.localisation.templates import Template
from ...radiomics.radiomics_tables import RadiomicsTables
from ..design.classification_tasks import MULTICLASS_TASKS, class_names
from ..design.patient_sets import REGION_RANGE_MM, FilmSet
from ..design.study_settings import StudySettings
from ..learn.models.final_models import RefittedModel, refit_models
from ..learn.models.model_file import TrainingProtocol, pack_model
from ..predictions import concatenate_tables
from ..statistics.scores.patient_scores import (
    CONTRASTS,
    count_films_by_grade,
    score_films,
    score_grades,
)
from .film_measures import score_film_measures

# Largest number of patient radiographs from which pixel pitch and region size are estimated (assumed sufficient).
_MAX_SAMPLED_FILMS = 15
# Training-set label in the names of the models for patient radiographs.
FILM_MODEL_LABEL = "films"
# Measurement stage -> stem of the CSV file in which its records are saved; a resumed run reuses the records.
_FEATURE_TABLES = {"cohort as displayed": "displays", "patient radiographs": "films_features"}
_REPORTED_COLUMNS = (
    "status",
    "film_side",
    "film_knees",
    "film_polarity",
    "film_pixel_mm",
    "film_pixel_from",
    "row_px",
    "col_px",
)


@dataclass(frozen=True, kw_only=True)
class FilmTestResult:
    """Results of the test on patient radiographs.

    Attributes
    ----------
    tables : dict of str to DataFrame
        Tables by name. ``films``: one row per patient radiograph with its probabilities; ``films_scores``: result of
        `score_films`; ``films_grades``: result of `score_grades`; ``films_measures``: result of `score_film_measures`.
    counts : DataFrame
        Number of radiographs per grade and status, from `count_films_by_grade`.
    display_settings : DisplayExtractionSettings
        Pixel pitch and region size used for the patient radiographs and the cohort.
    protocol : str
        Protocol of the cohort radiographs used for training.
    training_radiographs : tuple of int
        Number of radiographs used for training, and total number of cohort radiographs under the protocol.
    models : dict of str to bytes
        Content of each model file, by model name.
    """

    tables: dict[str, pd.DataFrame]
    counts: pd.DataFrame
    display_settings: DisplayExtractionSettings
    protocol: str
    training_radiographs: tuple[int, int]
    models: dict[str, bytes]


@dataclass(frozen=True)
class MeasurementContext:
    """Templates, settings and execution for the feature measurement of patient and cohort radiographs.

    Parameters
    ----------
    templates : sequence of Template
        Radiographs of standard knees, in order of decreasing joint space width.
    settings : StudySettings
        Settings of the study.
    out : Path
        Folder of the study.
    execution : Execution
        Workers, scheduler, timer and progress bar.
    tables : RadiomicsTables
        Limits of joint localisation and IBSI tags.
    """

    templates: Sequence[Template]
    settings: StudySettings
    out: Path
    execution: Execution
    tables: RadiomicsTables


def check_films(films: FilmSet, manifest: pd.DataFrame, settings: StudySettings, templates: Sequence[Template]) -> None:
    """Check that models trained on a cohort can be tested on patient radiographs.

    Parameters
    ----------
    films : FilmSet
        Patient radiographs.
    manifest : DataFrame
        Manifest of the cohort.
    settings : StudySettings
        Settings of the study.
    templates : sequence of Template
        Radiographs of standard knees.

    Raises
    ------
    InputError
        The manifest does not contain the protocol, no selected feature family is independent of the tone curve, or the
        tibial plateau width of a template is unknown.
    """
    require_plateau_width(templates)
    require_choice("films_protocol", films.protocol, sorted(set(manifest["protocol"])))
    if not set(settings.families) & set(FILM_FAMILIES):
        raise InputError(
            f"families must include at least one of {', '.join(FILM_FAMILIES)} with films, got "
            f"{', '.join(settings.families)}: other families depend on the tone curve of the display"
        )


def evaluate_on_films(bench: MeasurementContext, films: FilmSet, manifest: pd.DataFrame) -> FilmTestResult:
    """Train models on all radiographs of the cohort under one protocol and score them on patient radiographs.

    Parameters
    ----------
    bench : MeasurementContext
        Templates, settings, output folder and execution.
    films : FilmSet
        Patient radiographs, protocol of the training radiographs, pixel pitch and region side length.
    manifest : DataFrame
        Manifest of the cohort: one row per radiograph, as for `study.run`.

    Returns
    -------
    FilmTestResult
        Tables, counts and models.

    Raises
    ------
    InputError
        The joint is located in no displayed cohort radiograph with grade 0 or 2, so no model can be trained.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    settings = bench.settings
    cohort = manifest[manifest["protocol"] == films.protocol]
    pitch_mm = float(cohort["pixel_mm"].iloc[0])
    largest_mm = settings.region_px * pitch_mm
    reach_mm, law = max(largest_mm, films.region_mm or 0.0), bench.tables.localisation
    templates = tuple(crop_template(template, reach_mm, law) for template in bench.templates)
    bench = replace(bench, templates=templates)
    with bench.execution.timer.stage("pixel pitch and region of patient radiographs"):
        pixel_mm, region_mm = _resolve_pitch_and_region_mm(films, templates, law, pitch_mm, largest_mm)
    how = _make_display_settings(settings, pixel_mm, region_mm)
    jobs = make_measurement_jobs(cohort.to_dict("records"))
    own = _measure_jobs(bench, how, jobs, films.load_cohort, "cohort as displayed")
    own = cohort.merge(own.drop(columns="sha256"), on="radiograph", validate="one_to_one")
    usable = own[own["status"] == "found"]
    _require_grades(usable, films.protocol)
    names = [name for name in usable.columns if name not in NON_FEATURE_COLUMNS and name not in cohort.columns]
    given = _measure_jobs(bench, how, [make_film_job(film) for film in films.films], films.load, "patient radiographs")
    listed = _join_films(films.films, given)
    with bench.execution.timer.stage("models for patient radiographs"):
        kept = list(refit_models(usable, names, settings, {FILM_MODEL_LABEL: (films.protocol,)}))
        models = {one.name: _pack_film_model(one, how, templates, cohort, settings) for one in kept}
    table, of_two, of_grades = _predict_films(listed, names, kept)
    bootstrap = {"replicates": settings.replicates, "seed": settings.seed}
    with bench.execution.timer.stage("measures of patient radiographs"):
        graded = listed[(listed["status"] == "found") & listed["grade"].notna()]
        measures = score_film_measures(usable, graded, names, **bootstrap)
    return FilmTestResult(
        tables={
            "films": table,
            "films_scores": score_films(of_two, **bootstrap),
            "films_grades": score_grades(of_grades, **bootstrap),
            "films_measures": measures,
        },
        counts=count_films_by_grade(listed),
        display_settings=how,
        protocol=films.protocol,
        training_radiographs=(len(usable), len(own)),
        models=models,
    )


def _make_display_settings(settings: StudySettings, pixel_mm: float, region_mm: float) -> DisplayExtractionSettings:
    """Make the settings for displayed radiographs from those of the study."""
    return DisplayExtractionSettings(
        pixel_mm=pixel_mm,
        region_px=round(region_mm / pixel_mm),
        bins=settings.bins,
        families=tuple(family for family in settings.families if family in FILM_FAMILIES),
        backend=settings.backend,
        regions=settings.film_regions,
        areas=settings.areas,
    )


def make_film_job(film: Film) -> MeasurementJob:
    """Make the measurement job of a patient radiograph.

    Parameters
    ----------
    film : Film
        Patient radiograph, with knee side and pixel pitch if the user specified them.

    Returns
    -------
    MeasurementJob
        Job whose hash depends on the file, the knee side and the pixel pitch.
    """
    said = hashlib.sha256(f"{film.sha256} {film.side} {film.pixel_mm}".encode()).hexdigest()
    return MeasurementJob(radiograph=film.file, file=film.file, sha256=said, side=film.side, pixel_mm=film.pixel_mm)


def _resolve_pitch_and_region_mm(
    films: FilmSet,
    templates: Sequence[Template],
    localisation: LocalisationSettings,
    least_mm: float,
    largest_mm: float,
) -> tuple[float, float]:
    """Return pixel pitch and region side length in mm, as specified or estimated from a sample of radiographs.

    The estimated pitch is the median over the sampled patient radiographs, rounded to 0.01 mm, but at least `least_mm`,
    the pitch of the protocol. The estimated side length is the largest whole number of mm for which a region centred on
    the joint line fits in 90 % of the radiographs, but at most `largest_mm`.
    """
    if films.pixel_mm is not None and films.region_mm is not None:
        return films.pixel_mm, films.region_mm
    pitches, fields = [], []
    for film in films.films[:: max(1, len(films.films) // _MAX_SAMPLED_FILMS)][:_MAX_SAMPLED_FILMS]:
        try:
            image = films.load(film.file)
            side, pixel_mm = film.side or image.side, film.pixel_mm or image.pixel_mm
            joint = locate_joint_in_display(image.pixels, templates, localisation, side, pixel_mm)
        except InputError:
            continue  # Unreadable radiographs are reported when they are measured, so this estimate skips them.
        if joint.status == "found":
            rows, cols = image.pixels.shape[0] * joint.pixel_height, image.pixels.shape[1]
            around = min(joint.square_pixel_row, joint.col, rows - 1 - joint.square_pixel_row, cols - 1 - joint.col)
            pitches.append(joint.pixel_mm)
            fields.append(2 * around * joint.pixel_mm)
    pixel_mm, region_mm = least_mm, largest_mm
    if pitches:
        pixel_mm = max(least_mm, round(float(np.median(pitches)), 2))
        held_mm = float(np.floor(np.percentile(fields, 10)))
        region_mm = min(largest_mm, max(held_mm, REGION_RANGE_MM[0]))
    return films.pixel_mm or pixel_mm, films.region_mm or region_mm


def _measure_jobs(
    bench: MeasurementContext,
    display_settings: DisplayExtractionSettings,
    jobs: list[MeasurementJob],
    load: Any,
    stage_name: str,
) -> pd.DataFrame:
    """Measure displayed radiographs, reuse the records in a CSV file, and save all records in the file."""
    path = bench.out / f"{_FEATURE_TABLES[stage_name]}.csv"
    earlier = study_results.load_table(path, TEXT_COLUMNS)
    known: dict[str, Record] = {}
    if earlier is not None and "sha256" in earlier:
        known = {row["sha256"]: row for row in earlier.to_dict("records")}
    records, _ = measure_radiographs(
        jobs,
        load_pixels=load,
        templates=bench.templates,
        settings=display_settings,
        tables=bench.tables,
        execution=bench.execution,
        known_records=known,
        save=lambda records: study_results.save_table(path, pd.DataFrame(records)),
        measure_job=measure_display,
        stage_name=stage_name,
    )
    return pd.DataFrame(records)


def _require_grades(usable: pd.DataFrame, protocol: str) -> None:
    """Raise InputError unless the joint was located in radiographs with grades 0 and 2."""
    grades = sorted({int(grade) for grade in usable["grade"]})
    if not {0, 2} <= set(grades):
        raise InputError(
            f"the joint must be located in cohort radiographs with grades 0 and 2, but under {protocol} it is located "
            f"only in radiographs with grades {grades}: add knees or choose another films_protocol"
        )


def _join_films(films: Sequence[Film], records: pd.DataFrame) -> pd.DataFrame:
    """Join file, subject and grade of the patient radiographs with their measurement records."""
    said = pd.DataFrame(
        [{"file": f.file, "subject": f.subject, "grade": np.nan if f.grade is None else f.grade} for f in films]
    )
    columns = [name for name in records.columns if name not in ("radiograph", "sha256")]
    return pd.concat([said, records[columns].reset_index(drop=True)], axis=1)


def _pack_film_model(
    kept: RefittedModel,
    display_settings: DisplayExtractionSettings,
    templates: Sequence[Template],
    cohort: pd.DataFrame,
    settings: StudySettings,
) -> bytes:
    """Pack a model trained on displayed radiographs into the bytes of a model file."""
    return pack_model(
        kept,
        templates,
        reads="display",
        grade_names=class_names(kept.task),
        families=display_settings.families,
        backend=display_settings.backend,
        regions=display_settings.regions,
        areas=display_settings.areas,
        bins=display_settings.bins,
        pixel_mm=display_settings.pixel_mm,
        region_px=display_settings.region_px,
        trained_on=list_training_protocols(cohort),
        seed=settings.seed,
    )


def list_training_protocols(manifest: pd.DataFrame) -> tuple[TrainingProtocol, ...]:
    """List the protocols of a manifest in order of appearance.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: protocol, pixel_mm, sdd_mm, sod_mm.

    Returns
    -------
    tuple of TrainingProtocol
        Name, pixel pitch, source-detector distance and source-object distance of each protocol.
    """
    first = manifest.drop_duplicates("protocol")
    lengths = ("pixel_mm", "sdd_mm", "sod_mm")
    return tuple(
        TrainingProtocol(protocol=row["protocol"], **{name: float(row[name]) for name in lengths})
        for row in first[["protocol", *lengths]].to_dict("records")
    )


def _predict_films(
    films: pd.DataFrame, names: list[str], kept: Sequence[RefittedModel]
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Predict the class probabilities of all patient radiographs with all models.

    Return the table ``films``, the predictions of two-class models and the predictions of multiclass models. The two
    prediction tables contain only radiographs with a located joint and a known grade.
    """
    is_found = films["status"] == "found"
    table = films.reindex(columns=["file", "subject", "grade", *_REPORTED_COLUMNS]).copy()
    of_two, of_grades = [], []
    for one in kept:
        probability = np.full((len(films), len(one.grades)), np.nan)
        if is_found.any():
            probability[is_found] = one.fitted.pipeline.predict_proba(films.loc[is_found, names])
        for place, grade in enumerate(one.grades):
            table[f"{one.name} grade {grade}"] = probability[:, place]
        rows = films.loc[is_found & films["grade"].notna(), ["subject", "grade"]]
        rows = rows.assign(task=one.task, model=one.model, selection=one.selection)
        if one.task in CONTRASTS:
            of_two.append(rows.assign(p=probability[rows.index, 1]))
        if one.task in MULTICLASS_TASKS:
            of_grades.append(
                rows.assign(**{f"p{place}": probability[rows.index, place] for place in range(len(one.grades))})
            )
    none = pd.DataFrame(columns=["subject", "grade", "task", "model", "selection", "p"])
    return table, *(concatenate_tables(rows) if rows else none for rows in (of_two, of_grades))
