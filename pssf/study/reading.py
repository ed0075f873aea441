"""Films read by a saved model: grade probabilities, features, and where the region was."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.checks import InputError
from ..core.execution import Execution
from ..detector import present
from ..io import images
from ..io.films import Film, FilmImage, read_film
from ..io.pictures import framed
from ..io.stored_pixels import read_linear, says_what_pixels_are
from ..model.radiograph import Radiograph
from ..radiomics.display import UNREADABLE, DisplayHow, measure_display, measure_linear, require_plateau
from ..radiomics.table import Job, Measured, extract_all
from ..radiomics.tables import RadiomicsTables, radiomics_tables
from .external import job_of
from .learn.modelfile import SavedModel, backend_here

# Of linear radiographs, in which a joint of a known size is looked for on one side.
BOTH_KNEES, NO_SIDE, NO_PITCH = "both knees", "side not given", "pixel_mm not given"
# Columns of what was found, before the probabilities and features.
_SHOWN = (
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
class ReadFilms:
    """What a model says of films.

    table     one row a film: file, subject, grade (as it is given), warning, _SHOWN, "p grade <g>" of each class,
              features
    warnings  a line each: those of the table, after the name of their file, and why films are unreadable
    """

    table: pd.DataFrame
    warnings: tuple[str, ...]


def read_films(
    model: SavedModel, films: Sequence[Film], folder: Path, execution: Execution | None = None, *, linear: bool = False
) -> ReadFilms:
    """Find, measure and judge each film; what is refused has a status and no probability.

    A file of this package says whether its pixels are linear, and so does a DICOM. Of any other it is not known: it is
    taken for a display and its result has a warning, unless `linear` says what it is. A model that has learnt from
    linear pixels reads displays by the histogram of the standard knee, with a warning.

    folder  that the films' files are called from
    linear  whether the pixels of all files that this package has not written are linear in the signal, air bright;
            their side and pitch must be known then
    raises  InputError without a film, for displays where the model's templates cannot give a pitch, or for a backend
            of features that is not here;
            WorkersLostError when workers keep being killed
    """
    if not films:
        raise InputError("films = none; allowed: one or more")
    card, execution = model.card, execution or Execution()
    how = DisplayHow(
        pixel_mm=card.pixel_mm,
        region_px=card.region_px,
        bins=card.bins,
        families=card.families,
        backend=backend_here(card),
    )
    jobs = [replace(job_of(film), radiograph=str(place)) for place, film in enumerate(films)]
    sorted_jobs = {job.radiograph: _as_pixels(folder, job, linear, card.reads == "display") for job in jobs}
    as_linear = [job for job in sorted_jobs.values() if isinstance(job, Job)]
    refused = {name: {"radiograph": name, "status": why} for name, why in sorted_jobs.items() if isinstance(why, str)}
    shown = [job for job in jobs if sorted_jobs[job.radiograph] is None]
    if shown:
        require_plateau(model.templates)
    measured = partial(_measured, model, how, radiomics_tables(), execution)
    records = measured(as_linear, measure_linear, partial(_signal, folder))
    pitch_of = {job.file: _pitch_mm(folder, job) for job in shown if linear and not _is_ours(folder, job.file)}
    records |= measured(shown, measure_display, partial(_display, folder, pitch_of)) | refused
    table = pd.DataFrame([{"status": "", **records[job.radiograph]} for job in jobs])
    is_shown = {job.radiograph for job in shown}
    warned = [
        _warning(card.reads, folder / film.file, record, job.radiograph in is_shown, linear)
        for film, job, record in zip(films, jobs, table.to_dict("records"), strict=True)
    ]
    lines = [f"{film.file}: {warning}" for film, warning in zip(films, warned, strict=True) if warning]
    table = _table(model, films, table.assign(warning=warned))
    return ReadFilms(table=table, warnings=(*_unreadable(films, table["status"], folder, linear), *lines))


def _warning(reads: str, path: Path, record: Mapping[str, Any], is_shown: bool, linear: bool) -> str:
    """Say of one film what may make its result wrong; "" of one that is refused, and where nothing does."""
    if record["status"] != "found":
        return ""
    notes: list[str] = []
    unsaid = is_shown and not linear and not says_what_pixels_are(path)
    if unsaid:
        notes.append(
            "the file does not say what its pixels are, and is taken for a display; linear pixels give a wrong result "
            "so; say that they are linear (--linear)"
        )
    if is_shown and reads == "linear":
        notes.append(
            "a display is read by a model that has learnt from linear pixels; its grey values get the histogram of a "
            "standard knee; a model of a study with --films has learnt from displays"
        )
    if record.get("film_knees") == "two":
        notes.append(
            f"the film shows two knees; only the {record['film_side']} one is read; cut the film in two to read both"
        )
    return " | ".join(notes)


def picture(model: SavedModel, row: pd.Series, folder: Path, *, linear: bool = False) -> NDArray[np.uint8]:
    """(rows, cols, 3)  a film with its region: yellow where it was found, orange where it was refused

    row     of `ReadFilms.table`
    linear  as for `read_films`
    """
    is_others = linear and not _is_ours(folder, row["file"])
    image = _display(folder, {row["file"]: row["film_pixel_mm"]} if is_others else {}, row["file"])
    dark = row["film_polarity"] == "bone dark"
    shown = np.rint(255 * (1 - image.pixels if dark else image.pixels)).astype(np.uint8)
    side_px = model.card.region_px * model.card.pixel_mm / row["film_pixel_mm"]
    is_found = row["status"] == "found"
    chances = ", ".join(f"grade {g}: {row[f'p grade {g}']:.2f}" for g in model.card.grades)
    caption = chances if is_found else str(row["status"])
    return framed(
        shown, (row["row_px"], row["col_px"]), side_px, colour="#F0E442" if is_found else "#D55E00", caption=caption
    )


def _measured(
    model: SavedModel,
    how: DisplayHow,
    tables: RadiomicsTables,
    execution: Execution,
    jobs: list[Job],
    by: Callable[..., Measured],
    load: Callable[[str], object],
) -> dict[str, dict]:
    records, _ = extract_all(
        jobs,
        load_pixels=load,
        templates=model.templates,
        how=how,
        tables=tables,
        execution=execution,
        by=by,
        stage_name="films" if by is measure_display else "linear radiographs",
    )
    return {record["radiograph"]: record for record in records}


def _as_pixels(folder: Path, job: Job, linear: bool, by_display: bool) -> Job | str | None:
    """The job of linear pixels, with what its file says, or why it is refused; None where it is read as a display.

    linear      whether files that are not of this package are linear
    by_display  whether the model reads displays, as which linear pixels are rendered
    """
    try:
        radiograph = _loaded(folder, job.file)
    except InputError:
        return _others(folder, job, by_display) if linear else None
    if by_display:
        return None
    if radiograph.knees:
        return BOTH_KNEES
    side = job.side or (None if radiograph.knee is None else radiograph.knee.side)
    if side is None:
        return NO_SIDE
    return replace(job, side=side, pixel_mm=job.pixel_mm or radiograph.protocol.pixel_mm)


def _others(folder: Path, job: Job, by_display: bool) -> Job | str | None:
    """`_as_pixels` of a file of another source whose pixels are linear."""
    try:
        own = read_linear(folder / job.file)
    except InputError:
        return UNREADABLE
    side, pixel_mm = job.side or own.side, job.pixel_mm or own.pixel_mm
    if pixel_mm is None:
        return NO_PITCH
    if by_display:
        return None
    return NO_SIDE if side is None else replace(job, side=side, pixel_mm=pixel_mm)


def _loaded(folder: Path, file: str) -> Radiograph:
    return images.load(folder / file)


def _signal(folder: Path, file: str) -> NDArray[np.uint16]:
    try:
        return _loaded(folder, file).pixels
    except InputError:
        return read_linear(folder / file).pixels


def _display(folder: Path, pitch_of: Mapping[str, float], file: str) -> FilmImage:
    """A film as it is displayed; linear pixels of others are rendered.

    pitch_of  file -> pitch, mm, of those
    """
    if file not in pitch_of:
        return read_film(folder / file)
    own, pixel_mm = read_linear(folder / file), pitch_of[file]
    shown = present(own.pixels, bits=16, look="processed", pixel_mm=pixel_mm)
    return FilmImage(pixels=shown / 65535.0, pixel_mm=pixel_mm, side=own.side)


def _pitch_mm(folder: Path, job: Job) -> float:
    pixel_mm = job.pixel_mm or read_linear(folder / job.file).pixel_mm
    assert pixel_mm is not None  # else the film was refused
    return pixel_mm


def _is_ours(folder: Path, file: str) -> bool:
    """Whether a file holds a linear radiograph of this package."""
    try:
        _loaded(folder, file)
    except InputError:
        return False
    return True


def _unreadable(films: Sequence[Film], status: pd.Series, folder: Path, linear: bool) -> list[str]:
    lines = []
    for film in [film for film, said in zip(films, status, strict=True) if said == UNREADABLE]:
        try:
            read_film(folder / film.file)
            if linear:
                read_linear(folder / film.file)
        except InputError as error:
            lines.append(str(error))
    return lines


def _table(model: SavedModel, films: Sequence[Film], records: pd.DataFrame) -> pd.DataFrame:
    card = model.card
    said = pd.DataFrame([{"file": f.file, "subject": f.subject, "grade": f.grade} for f in films])
    is_found = (records["status"] == "found").to_numpy()
    probability = np.full((len(films), len(card.grades)), np.nan)
    known = {*_SHOWN, "warning", "radiograph", "sha256", "settings", "checksum"}
    features = [name for name in records if name not in known and "_" in name and name.split("_")[0] in card.families]
    if is_found.any():
        probability[is_found] = model.probabilities(records.loc[is_found])
    chances = {f"p grade {grade}": probability[:, place] for place, grade in enumerate(card.grades)}
    return pd.concat(
        [said, records.reindex(columns=("warning", *_SHOWN)), pd.DataFrame(chances), records[features]], axis=1
    )
