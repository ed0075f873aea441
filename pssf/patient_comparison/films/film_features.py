"""Measure features of radiographs after joint localisation, normalisation and contour tracing."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.checks import Array, InputError
from ...core.processes.execution import Execution
from ...core.processes.parallel_map import map_in_parallel
from ...core.stage_timer import make_interval_check
from ...data.analysis.localisation_table import LocalisationSettings
from ...data.code_hash import compute_code_hashes, require_same_code
from ...data.imaging.display_table import DisplayProcessing
from ...io.patients.patient_radiographs import Film, read_film
from ...radiomics.features.feature_table import SAVE_INTERVAL_S
from ...radiomics.localisation.pixel_aspect import locate_joint_in_film, resample_to_square_pixels
from ...radiomics.localisation.templates import Template
from ..checkpoint import compute_key
from .edge_features import measure_edges
from .film_normalisation import (
    PITCH_MM,
    PLATEAU_MM,
    JointPosition,
    bin_film,
    joint_centre_px,
    resample_joint_field,
    stretch_contrast,
)
from .film_outline import trace_outline
from .grey_features import measure_grey_features
from .outline_features import Features, find_plateau_edges, measure_shape_features
from .tone_features import measure_fine_texture, measure_tone

Record = dict[str, Any]
# Code on which a record depends; the record key contains the hashes of this code.
CODE_PATHS = (
    *("anatomy/labels/radiograph_labels.py", "core", "data", "detector", "io"),
    *("radiomics", "patient_comparison"),
)
# Feature groups that are reported but not used for training; `TOLD` lists all three.
TONE, FINE, EDGES = TOLD = ("tone", "fine texture", "edges")
# Separator between group and feature in a column name.
GROUP_SEPARATOR = "|"
# Distance from the localised medial joint line to the joint centre, as a fraction of the plateau width.
_JOINT_CENTRE_OFFSET = 0.25
# Scale factors of the image in successive iterations of centring; a smaller factor shows a wider field of view.
_ZOOMS = (0.8, 0.9, 1.0)
# Maximum change of the image scale as a factor, both per iteration and in total.
_MAX_RESIZING = 1.25


class FilmTables(NamedTuple):
    """Settings of the radiograph comparison.

    Attributes
    ----------
    localisation : LocalisationSettings
        Settings of the joint localisation.
    looks : DisplayProcessing
        Display processing of simulated radiographs.
    """

    localisation: LocalisationSettings
    looks: DisplayProcessing


@dataclass(frozen=True, kw_only=True)
class FilmSource:
    """Radiographs of one source.

    Parameters
    ----------
    name : str
        Name of the source.
    folder : Path
        Folder with the radiographs; file names are relative to this folder.
    films : tuple of Film
        Radiographs of the source.
    """

    name: str
    folder: Path
    films: tuple[Film, ...]


def measure_films(
    sources: Sequence[FilmSource],
    templates: Sequence[Template],
    table: LocalisationSettings,
    execution: Execution,
    *,
    previous_records: Mapping[str, Mapping[str, Record]],
    save: Callable[[str, list[Record]], None],
) -> dict[str, list[Record]]:
    """Measure every radiograph of several sources.

    Records of an earlier run are reused if code and templates have not changed.

    Parameters
    ----------
    sources : sequence of FilmSource
        Sources to measure.
    templates : sequence of Template
        Templates of the joint localisation.
    table : LocalisationSettings
        Settings of the joint localisation.
    execution : Execution
        Worker processes, timer and progress display.
    previous_records : mapping of str to mapping
        Records of an earlier run, keyed by source name and by file SHA-256.
    save : callable
        Function that receives a source name and all available records of this source. It is called at intervals and at
        the end, so that an interrupted run can resume.

    Returns
    -------
    dict of str to list of dict
        One record per radiograph in input order, keyed by source name.
    """
    code = compute_code_hashes(CODE_PATHS)
    key = compute_key(
        code, repr([template.scalar_values for template in templates]).encode(), *(one.pixel_bytes for one in templates)
    )
    records = {source.name: _select_reusable_records(source, key, previous_records[source.name]) for source in sources}
    missing = [(source, n) for source in sources for n, one in enumerate(records[source.name]) if one is None]
    count = sum(len(source.films) for source in sources)
    with execution.stage(f"radiographs: {', '.join(records)}", "radiographs", count) as stage:
        stage.add_already_done(count - len(missing))
        due = make_interval_check(SAVE_INTERVAL_S)

        def saved() -> dict[str, list[Record]]:
            done = {source.name: _add_source_columns(records[source.name], source) for source in sources}
            for name, of in done.items():
                save(name, of)
            return done

        def arrived(nth: int, record: Record) -> None:
            source, n = missing[nth]
            records[source.name][n] = {"key": _compute_display_key(key, source.films[n]), **record}
            stage.advance()
            if due():
                saved()

        map_in_parallel(
            measure_film,
            [(source.folder, source.films[n]) for source, n in missing],
            shared={"templates": templates, "table": table, "code": code},
            workers=execution.workers,
            scheduler=execution.scheduler,
            on_result=arrived,
        )
        return saved()


def _select_reusable_records(
    source: FilmSource, key: str, previous_records: Mapping[str, Record]
) -> list[Record | None]:
    """Select the record of every radiograph from an earlier run, or None if the record is missing or outdated."""
    of_films = ((film, previous_records.get(film.sha256)) for film in source.films)
    return [
        record if record and record["key"] == _compute_display_key(key, film) else None for film, record in of_films
    ]


def _add_source_columns(records: Sequence[Record | None], source: FilmSource) -> list[Record]:
    """Add source, file, subject and grade to every record."""
    return [
        {**record, **_make_source_columns(film, source.name)}
        for film, record in zip(source.films, records, strict=True)
        if record
    ]


def measure_film(
    folder_and_film: tuple[Path, Film],
    *,
    templates: Sequence[Template],
    table: LocalisationSettings,
    code: Mapping[str, str],
) -> Record:
    """Localise the joint on one radiograph and measure the features of the radiograph.

    Parameters
    ----------
    folder_and_film : tuple of (Path, Film)
        Folder, and entry of a radiograph whose file name is relative to this folder.
    templates : sequence of Template
        Templates of the joint localisation.
    table : LocalisationSettings
        Settings of the joint localisation.
    code : mapping of str to str
        Code hashes computed at the start of the run.

    Returns
    -------
    dict
        Status, joint position, side and pixel pitch. If the joint was localised, the record also contains features,
        named ``group|feature``.

    Raises
    ------
    InputError
        The code of the worker process differs from `code`.
    """
    require_same_code(code)
    folder, film = folder_and_film
    record: Record = {"sha256": film.sha256, "side": film.side or "", "reason": ""}
    try:
        image = read_film(folder / film.file, film.processing)
    except InputError as error:
        return {**record, "status": "unreadable", "reason": str(error)}
    side, pixel_mm = film.side or image.side, film.pixel_mm or image.pixel_mm
    joint = locate_joint_in_film(image.pixels, templates, table, side=side, pixel_mm=pixel_mm)
    record |= {
        "status": joint.status, "side": joint.side, "polarity": joint.polarity, "score": joint.score,
        "row_px": joint.row, "col_px": joint.col, "pixel_mm": joint.pixel_mm, "pixel_from": joint.pixel_mm_source,
        "scale": joint.scale, "pixel_height": joint.pixel_height,
    }  # fmt: skip
    if joint.status != "found":
        return record
    square = resample_to_square_pixels(image.pixels, joint.pixel_height)
    bright = square if joint.polarity == "bone bright" else 1 - square
    plateau_mm = templates[0].known_plateau_mm * joint.scale
    lateral = -1 if joint.side == "right" else 1
    middle = joint.col + lateral * _JOINT_CENTRE_OFFSET * plateau_mm / joint.pixel_mm
    pitch_mm = joint.pixel_mm * PLATEAU_MM / plateau_mm
    place = JointPosition(row=joint.square_pixel_row, col=middle, side=joint.side, pitch_mm=pitch_mm)
    binned = 1.0 if film.resampled_pixel_mm is None else max(1.0, film.resampled_pixel_mm / pitch_mm)
    return record | {"binned": binned} | measure_located_film(bright, place, joint.pixel_mm, binned)


def measure_located_film(
    film: Array, approximate_position: JointPosition, pixel_mm: float, binning: float = 1
) -> Record:
    """Measure the features of a radiograph around a localised joint.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Radiograph in display values with bright bone.
    approximate_position : JointPosition
        Approximate position of the joint centre.
    pixel_mm : float
        Pixel pitch of the radiograph, in mm.
    binning : float, default 1
        Width of a binned pixel in original pixels. Fine texture is measured without binning.

    Returns
    -------
    dict of str to float
        Features, named ``group|feature``, joint position and pixel pitch.
    """
    shown, approximate_position = bin_film(film, approximate_position, binning)
    place = centre_on_joint(shown, approximate_position)
    field = resample_joint_field(shown, place)
    form = stretch_contrast(field)
    outline = trace_outline(form)
    groups = measure_shape_features(outline) | measure_grey_features(form, outline)
    own = place.rebin(1 / binning)
    groups |= {
        TONE: measure_tone(shown, field, outline, place) | _measure_acquisition(film, field, own),
        FINE: measure_fine_texture(film, outline, own, pixel_mm),
        EDGES: measure_edges(field),
    }
    values: Record = {"joint_row_px": own.row, "joint_col_px": own.col, "pitch_mm": own.pitch_mm}
    return values | {
        f"{group}{GROUP_SEPARATOR}{name}": value for group, of in groups.items() for name, value in of.items()
    }


def _measure_acquisition(film: Array, field: Array, place: JointPosition) -> Features:
    """Measure the offset of the joint from the image centre, and the mean grey value around the joint."""
    down, aside = (
        (at - (size - 1) / 2) * place.pitch_mm for at, size in zip((place.row, place.col), film.shape, strict=True)
    )
    return {"joint_offset_down_mm": down, "joint_offset_right_mm": aside, "mean_grey": float(field.mean())}


def centre_on_joint(film: Array, approximate_position: JointPosition) -> JointPosition:
    """Refine the joint position and the pixel pitch, so that the plateau is PLATEAU_MM wide and the joint centred.

    The first iterations use a wider field of view, which contains both plateau edges.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Radiograph in display values with bright bone.
    approximate_position : JointPosition
        Approximate position of the joint centre.

    Returns
    -------
    JointPosition
        Refined joint position and pixel pitch.
    """
    place = approximate_position
    for zoom in _ZOOMS:
        wide = replace(place, pitch_mm=place.pitch_mm * zoom)
        row, col = joint_centre_px()
        outline = trace_outline(
            stretch_contrast(resample_joint_field(film, wide)),
            PLATEAU_MM * wide.pitch_mm / approximate_position.pitch_mm,
        )
        lateral, medial = find_plateau_edges(outline)
        middle = float(np.mean([np.median(outline.tibia), np.median(outline.femur)]))
        moved = wide.shift_by_pixels(middle - row, (lateral + medial) / 2 - col)
        size = np.clip(PLATEAU_MM / ((medial - lateral) * PITCH_MM), 1 / _MAX_RESIZING, _MAX_RESIZING)
        pitch_mm = float(
            np.clip(
                wide.pitch_mm * size,
                approximate_position.pitch_mm / _MAX_RESIZING,
                approximate_position.pitch_mm * _MAX_RESIZING,
            )
        )
        place = replace(moved, pitch_mm=pitch_mm)
    return place


def _compute_display_key(key: str, film: Film) -> str:
    """Compute a record key from the common key, the display processing and the resampled pixel size."""
    shown = f"{key} {film.processing!r} {film.resampled_pixel_mm}"
    return (
        key
        if film.processing is None and film.resampled_pixel_mm is None
        else hashlib.sha256(shown.encode()).hexdigest()[:16]
    )


def _make_source_columns(film: Film, source: str) -> Record:
    """Make the columns that identify a radiograph: source, file, subject and grade."""
    grade = -1 if film.grade is None else film.grade
    return {"source": source, "file": film.file, "subject": film.subject, "grade": grade}
