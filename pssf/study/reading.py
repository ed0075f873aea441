"""Films read by a saved model: grade probabilities, features, and where the region was."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.checks import InputError
from ..core.execution import Execution
from ..io import images
from ..io.films import Film, read_film
from ..io.pictures import framed
from ..model.radiograph import Radiograph
from ..radiomics.display import UNREADABLE, DisplayHow, measure_display, measure_linear, require_plateau
from ..radiomics.table import Job, Measured, extract_all
from ..radiomics.tables import RadiomicsTables, radiomics_tables
from .external import job_of
from .learn.modelfile import SavedModel, backend_here

# Of linear radiographs, in which a joint is looked for on one side.
BOTH_KNEES, NO_SIDE = "both knees", "side not given"
# Columns of what was found, before the probabilities and features.
_SHOWN = ("status", "film_side", "film_polarity", "film_pixel_mm", "film_pixel_from", "row_px", "col_px", "score")


@dataclass(frozen=True, kw_only=True)
class ReadFilms:
    """What a model says of films.

    table     one row a film: file, subject, grade (as it is given), _SHOWN, "p grade <g>" of each class, features
    warnings  a line each
    """

    table: pd.DataFrame
    warnings: tuple[str, ...]


def read_films(model: SavedModel, films: Sequence[Film], folder: Path, execution: Execution | None = None) -> ReadFilms:
    """Find, measure and judge each film; what is refused has a status and no probability.

    A model that has learnt from linear pixels reads linear radiographs of this package as they are, and displays by the
    histogram of the standard knee, with a warning.

    folder  that the films' files are called from
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
    asked = {} if card.reads == "display" else {job.radiograph: _linear(folder, job) for job in jobs}
    linear = [job for job in asked.values() if isinstance(job, Job)]
    refused = {name: {"radiograph": name, "status": why} for name, why in asked.items() if isinstance(why, str)}
    shown = [job for job in jobs if asked.get(job.radiograph) is None]
    if shown:
        require_plateau(model.templates)
    measured = partial(_measured, model, how, radiomics_tables(), execution)
    records = measured(linear, measure_linear, partial(_signal, folder))
    records |= measured(shown, measure_display, partial(_display, folder)) | refused
    table = pd.DataFrame([{"status": "", **records[job.radiograph]} for job in jobs])
    warnings = list(_unreadable(films, table["status"], folder))
    if card.reads == "linear" and shown:
        warnings.append(
            f"{len(shown)} of {len(films)} films are displays, and the model has learnt from linear pixels: their grey "
            "values got the histogram of a standard knee; a model of a study with --films has learnt from displays"
        )
    return ReadFilms(table=_table(model, films, table), warnings=tuple(warnings))


def picture(model: SavedModel, row: pd.Series, folder: Path) -> NDArray[np.uint8]:
    """(rows, cols, 3)  a film with its region: yellow where it was found, orange where it was refused

    row  of `ReadFilms.table`
    """
    image = read_film(folder / row["file"])
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


def _linear(folder: Path, job: Job) -> Job | str | None:
    """The job with what its file says, or why it is refused; None where that is not of linear pixels."""
    try:
        radiograph = _loaded(folder, job.file)
    except InputError:
        return None
    if radiograph.knees:
        return BOTH_KNEES
    side = job.side or (None if radiograph.knee is None else radiograph.knee.side)
    if side is None:
        return NO_SIDE
    return replace(job, side=side, pixel_mm=job.pixel_mm or radiograph.protocol.pixel_mm)


def _loaded(folder: Path, file: str) -> Radiograph:
    return images.load(folder / file)


def _signal(folder: Path, file: str) -> NDArray[np.uint16]:
    return _loaded(folder, file).pixels


def _display(folder: Path, file: str) -> object:
    return read_film(folder / file)


def _unreadable(films: Sequence[Film], status: pd.Series, folder: Path) -> list[str]:
    lines = []
    for film in [film for film, said in zip(films, status, strict=True) if said == UNREADABLE]:
        try:
            read_film(folder / film.file)
        except InputError as error:
            lines.append(str(error))
    return lines


def _table(model: SavedModel, films: Sequence[Film], records: pd.DataFrame) -> pd.DataFrame:
    card = model.card
    said = pd.DataFrame([{"file": f.file, "subject": f.subject, "grade": f.grade} for f in films])
    is_found = (records["status"] == "found").to_numpy()
    probability = np.full((len(films), len(card.grades)), np.nan)
    known = {*_SHOWN, "radiograph", "sha256", "settings", "checksum"}
    features = [name for name in records if name not in known and "_" in name and name.split("_")[0] in card.families]
    if is_found.any():
        probability[is_found] = model.probabilities(records.loc[is_found])
    chances = {f"p grade {grade}": probability[:, place] for place, grade in enumerate(card.grades)}
    return pd.concat([said, records.reindex(columns=_SHOWN), pd.DataFrame(chances), records[features]], axis=1)
