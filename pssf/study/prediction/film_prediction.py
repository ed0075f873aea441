"""Predictions of a saved model for patient radiographs: grade probabilities, features and region location."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...core.checks import InputError
from ...core.processes.execution import Execution
from ...detector import render_for_display
from ...io import radiograph_files
from ...io.patients.patient_radiographs import Film, FilmImage, read_film
from ...io.patients.stored_pixels import has_declared_pixel_meaning, read_linear_pixels
from ...io.pictures import draw_region
from ...model.radiograph import Radiograph
from ...radiomics.displayed_radiograph import (
    UNREADABLE,
    DisplayExtractionSettings,
    measure_display,
    measure_linear,
    require_plateau_width,
)
from ...radiomics.features.feature_table import Measurement, MeasurementJob, measure_radiographs
from ...radiomics.radiomics_tables import RadiomicsTables, radiomics_tables
from ..learn.models.model_file import SavedModel, resolve_backend
from .patient_test import make_film_job

# Statuses of unused linear radiographs. Localisation needs a single knee of known side and a known pixel pitch.
BOTH_KNEES = "both knees"
NO_SIDE = "side not given"
NO_PITCH = "pixel_mm not given"
# Columns of the prediction table that describe the localisation result.
_REPORTED_COLUMNS = (
    "status",
    "film_side",
    "film_knees",
    "film_polarity",
    "film_pixel_mm",
    "film_pixel_from",
    "row_px",
    "col_px",
    "score",
)


@dataclass(frozen=True, kw_only=True)
class FilmPredictions:
    """Predictions of a model for patient radiographs.

    Attributes
    ----------
    table : DataFrame
        One row per patient radiograph: file, subject, grade (as specified by the user), warning, `_REPORTED_COLUMNS`,
        ``p grade <g>`` of each class, and the features.
    warnings : tuple of str
        Error message of each unreadable file, then each warning in the table, prefixed with the file name.
    """

    table: pd.DataFrame
    warnings: tuple[str, ...]


def predict_films(
    model: SavedModel, films: Sequence[Film], folder: Path, execution: Execution | None = None, *, linear: bool = False
) -> FilmPredictions:
    """Locate the joint, measure the features and predict the grade of each patient radiograph.

    For a radiograph that cannot be used, the status is the reason and the probabilities are NaN. Files written by this
    package and DICOM files state whether their pixels are linear. The pixels of any other file are interpreted as
    displayed pixels, with a warning, unless `linear` is True. If the model was trained on linear pixels, the histogram
    of displayed pixels is matched to that of the standard knee, with a warning.

    Parameters
    ----------
    model : SavedModel
        Model, model card and templates.
    films : sequence of Film
        Patient radiographs.
    folder : Path
        Folder to which the file names are relative.
    execution : Execution, optional
        Workers, scheduler, timer and progress bar.
    linear : bool, default False
        If True, the pixels of files that this package did not write are interpreted as linear in the signal, with air
        bright. The knee side and pixel pitch of these files must then be known.

    Returns
    -------
    FilmPredictions
        Table of predictions and the warnings.

    Raises
    ------
    InputError
        There is no patient radiograph, the model lacks the tibial plateau width that is needed to estimate the pixel
        pitch of displayed pixels, or no installed radiomics backend computes the features of the model.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    if not films:
        raise InputError(f"films must contain at least one patient radiograph, got {len(films)}")
    card, execution = model.card, execution or Execution()
    how = DisplayExtractionSettings(
        pixel_mm=card.pixel_mm,
        region_px=card.region_px,
        bins=card.bins,
        families=card.families,
        backend=resolve_backend(card),
        regions=card.regions,
        areas=card.areas,
    )
    jobs = [replace(make_film_job(film), radiograph=str(place)) for place, film in enumerate(films)]
    sorted_jobs = {job.radiograph: _resolve_linear_job(folder, job, linear, card.reads == "display") for job in jobs}
    as_linear = [job for job in sorted_jobs.values() if isinstance(job, MeasurementJob)]
    refused = {name: {"radiograph": name, "status": why} for name, why in sorted_jobs.items() if isinstance(why, str)}
    shown = [job for job in jobs if sorted_jobs[job.radiograph] is None]
    if shown:
        require_plateau_width(model.templates)
    measured = partial(_measure_jobs, model, how, radiomics_tables(), execution)
    records = measured(as_linear, measure_linear, partial(_load_linear_pixels, folder))
    pitch_of = {
        job.file: _resolve_pitch_mm(folder, job)
        for job in shown
        if linear and not _is_package_radiograph(folder, job.file)
    }
    records |= measured(shown, measure_display, partial(_load_display, folder, pitch_of)) | refused
    table = pd.DataFrame([{"status": "", **records[job.radiograph]} for job in jobs])
    is_shown = {job.radiograph for job in shown}
    warned = [
        _compose_warning(card.reads, folder / film.file, record, job.radiograph in is_shown, linear)
        for film, job, record in zip(films, jobs, table.to_dict("records"), strict=True)
    ]
    lines = [f"{film.file}: {warning}" for film, warning in zip(films, warned, strict=True) if warning]
    table = _build_prediction_table(model, films, table.assign(warning=warned))
    return FilmPredictions(table=table, warnings=(*_explain_unreadable(films, table["status"], folder, linear), *lines))


def _compose_warning(pixel_kind: str, path: Path, record: Mapping[str, Any], is_display: bool, linear: bool) -> str:
    """Compose the warning of one radiograph from all reasons why its result may be wrong.

    Return an empty string if no joint was located or no reason applies.
    """
    if record["status"] != "found":
        return ""
    notes: list[str] = []
    unsaid = is_display and not linear and not has_declared_pixel_meaning(path)
    if unsaid:
        notes.append(
            "the file does not state whether its pixels are linear, so they are interpreted as displayed pixels, "
            "and the result is wrong if the pixels are linear; use --linear for linear pixels"
        )
    if is_display and pixel_kind == "linear":
        notes.append(
            "the image has displayed pixels, but the model was trained on linear pixels, so the grey values are "
            "matched to the histogram of a standard knee; for a model trained on displayed pixels, use a model file "
            "from a study with --films"
        )
    if record.get("film_knees") == "two":
        notes.append(
            f"the image shows two knees, but only the {record['film_side']} knee is analysed; split the image to "
            "analyse both knees"
        )
    return " | ".join(notes)


def draw_film_region(model: SavedModel, row: pd.Series, folder: Path, *, linear: bool = False) -> NDArray[np.uint8]:
    """Draw the region of a patient radiograph: yellow if the joint was located, orange if not.

    Parameters
    ----------
    model : SavedModel
        Model whose card states the side length of the region and the grades.
    row : Series
        Row of `FilmPredictions.table`.
    folder : Path
        Folder to which the file name is relative.
    linear : bool, default False
        If True, the pixels are interpreted as linear in the signal; see `predict_films`.

    Returns
    -------
    (rows, cols, 3) uint8 array
        RGB image of the radiograph with the region and a caption.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    is_others = linear and not _is_package_radiograph(folder, row["file"])
    image = _load_display(folder, {row["file"]: row["film_pixel_mm"]} if is_others else {}, row["file"])
    dark = row["film_polarity"] == "bone dark"
    shown = np.rint(255 * (1 - image.pixels if dark else image.pixels)).astype(np.uint8)
    side_px = model.card.region_px * model.card.pixel_mm / row["film_pixel_mm"]
    is_found = row["status"] == "found"
    chances = ", ".join(f"grade {g}: {row[f'p grade {g}']:.2f}" for g in model.card.grades)
    caption = chances if is_found else str(row["status"])
    return draw_region(
        shown, (row["row_px"], row["col_px"]), side_px, colour="#F0E442" if is_found else "#D55E00", caption=caption
    )


def _measure_jobs(
    model: SavedModel,
    display_settings: DisplayExtractionSettings,
    tables: RadiomicsTables,
    execution: Execution,
    jobs: list[MeasurementJob],
    measure: Callable[..., Measurement],
    load: Callable[[str], object],
) -> dict[str, dict]:
    """Measure radiographs with one measurement function and return their records by radiograph name."""
    records, _ = measure_radiographs(
        jobs,
        load_pixels=load,
        templates=model.templates,
        settings=display_settings,
        tables=tables,
        execution=execution,
        measure_job=measure,
        stage_name="patient radiographs" if measure is measure_display else "linear radiographs",
    )
    return {record["radiograph"]: record for record in records}


def _resolve_linear_job(
    folder: Path, job: MeasurementJob, linear: bool, reads_displays: bool
) -> MeasurementJob | str | None:
    """Decide whether the pixels of a file are interpreted as linear or as displayed pixels.

    Return a job with side and pixel pitch for linear pixels, None for displayed pixels, or the reason why the file
    cannot be used. If `linear` is True, files that this package did not write have linear pixels. If `reads_displays`
    is True, the model was trained on displayed pixels, so linear pixels are rendered for display first.
    """
    try:
        radiograph = _load_radiograph(folder, job.file)
    except InputError:
        return _resolve_foreign_job(folder, job, reads_displays) if linear else None
    if reads_displays:
        return None
    if radiograph.knees:
        return BOTH_KNEES
    side = job.side or (None if radiograph.knee is None else radiograph.knee.side)
    if side is None:
        return NO_SIDE
    return replace(job, side=side, pixel_mm=job.pixel_mm or radiograph.protocol.pixel_mm)


def _resolve_foreign_job(folder: Path, job: MeasurementJob, reads_displays: bool) -> MeasurementJob | str | None:
    """Decide how to use the linear pixels of a file that this package did not write; see `_resolve_linear_job`."""
    try:
        own = read_linear_pixels(folder / job.file)
    except InputError:
        return UNREADABLE
    side, pixel_mm = job.side or own.side, job.pixel_mm or own.pixel_mm
    if pixel_mm is None:
        return NO_PITCH
    if reads_displays:
        return None
    return NO_SIDE if side is None else replace(job, side=side, pixel_mm=pixel_mm)


def _load_radiograph(folder: Path, file: str) -> Radiograph:
    """Load a radiograph written by this package."""
    return radiograph_files.load(folder / file)


def _load_linear_pixels(folder: Path, file: str) -> NDArray[np.uint16]:
    """Load the linear pixels (rows, cols) of a file from any source."""
    try:
        return _load_radiograph(folder, file).pixels
    except InputError:
        return read_linear_pixels(folder / file).pixels


def _load_display(folder: Path, pitch_mm_by_file: Mapping[str, float], file: str) -> FilmImage:
    """Load the displayed pixels of a patient radiograph.

    Linear pixels of files in `pitch_mm_by_file` are rendered for display with the given pixel pitch, in mm.
    """
    if file not in pitch_mm_by_file:
        return read_film(folder / file)
    own, pixel_mm = read_linear_pixels(folder / file), pitch_mm_by_file[file]
    shown = render_for_display(own.pixels, bits=16, processing="processed", pixel_mm=pixel_mm)
    return FilmImage(pixels=shown / 65535.0, pixel_mm=pixel_mm, side=own.side)


def _resolve_pitch_mm(folder: Path, job: MeasurementJob) -> float:
    """Return the pixel pitch, in mm, of a linear radiograph that this package did not write."""
    pixel_mm = job.pixel_mm or read_linear_pixels(folder / job.file).pixel_mm
    assert pixel_mm is not None  # `_resolve_foreign_job` has rejected files without a pixel pitch.
    return pixel_mm


def _is_package_radiograph(folder: Path, file: str) -> bool:
    """Check whether a file is a linear radiograph written by this package."""
    try:
        _load_radiograph(folder, file)
    except InputError:
        return False
    return True


def _explain_unreadable(films: Sequence[Film], status: pd.Series, folder: Path, linear: bool) -> list[str]:
    """Collect the error message of each unreadable file."""
    lines = []
    for film in [film for film, said in zip(films, status, strict=True) if said == UNREADABLE]:
        try:
            read_film(folder / film.file)
            if linear:
                read_linear_pixels(folder / film.file)
        except InputError as error:
            lines.append(str(error))
    return lines


def _build_prediction_table(model: SavedModel, films: Sequence[Film], records: pd.DataFrame) -> pd.DataFrame:
    """Build the table of predictions from the records of all radiographs."""
    card = model.card
    said = pd.DataFrame([{"file": f.file, "subject": f.subject, "grade": f.grade} for f in films])
    is_found = (records["status"] == "found").to_numpy()
    probability = np.full((len(films), len(card.grades)), np.nan)
    known = {*_REPORTED_COLUMNS, "warning", "radiograph", "sha256", "settings", "checksum"}
    features = [name for name in records if name not in known and "_" in name and name.split("_")[0] in card.families]
    if is_found.any():
        probability[is_found] = model.predict_probabilities(records.loc[is_found])
    chances = {f"p grade {grade}": probability[:, place] for place, grade in enumerate(card.grades)}
    return pd.concat(
        [said, records.reindex(columns=("warning", *_REPORTED_COLUMNS)), pd.DataFrame(chances), records[features]],
        axis=1,
    )
