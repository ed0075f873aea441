"""Films measured one by one: found, brought to the standard form, outlined, their features told."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.checks import Array, InputError
from ..core.execution import Execution
from ..core.parallel import ordered_map
from ..core.timer import seldom
from ..data.code import code_digest, require_code
from ..data.localisation import Localisation
from ..data.looks import Looks
from ..io.films import Film, read_film
from ..radiomics.aspect import locate_film, with_square_pixels
from ..radiomics.patches import Template
from ..radiomics.table import SAVE_SECONDS
from .edge_features import edge_features
from .form import PITCH_MM, PLATEAU_MM, Place, field_of, joint_pixel, made_smaller, stretched
from .grey_features import grey_groups
from .kept import key_of
from .outline import trace_outline
from .shape_features import Features, plateau_edges, shape_groups
from .tone import fine_texture, tone

Record = dict[str, Any]
# What a record depends on beside the film and the templates.
CODE = ("anatomy/truth.py", "core", "data", "detector", "io", "radiomics", "realism")
# Group and feature make the name of a column; these groups are told, and not learnt from.
TONE, FINE, EDGES = TOLD = ("tone", "fine texture", "edges")
BETWEEN = "|"
_TO_MIDDLE = 0.25  # of the plateau's width, from the medial joint line
# How much wider a field the joint is centred in, turn by turn; and by how much a turn, or all, may change its size.
_ZOOMS = (0.8, 0.9, 1.0)
_RESIZED = 1.25


class FilmTables(NamedTuple):
    """By what joints are looked for on films, and what simulated films are shown with."""

    localisation: Localisation
    looks: Looks


@dataclass(frozen=True, kw_only=True)
class Source:
    """Films of one origin.

    name    what it is called
    folder  that the names of the files start from
    films   as they are listed
    """

    name: str
    folder: Path
    films: tuple[Film, ...]


def measure_films(
    sources: Sequence[Source],
    templates: Sequence[Template],
    table: Localisation,
    execution: Execution,
    *,
    known: Mapping[str, Mapping[str, Record]],
    save: Callable[[str, list[Record]], None],
) -> dict[str, list[Record]]:
    """Source -> one record a film, in their order; those of an earlier run are kept where neither code nor templates
    changed.

    table  by which the joint is looked for
    known  source -> sha256 -> record
    save   is given all records of each source so far, now and then and at the end, so that a run that breaks off can
           go on from there
    """
    code = code_digest(CODE)
    key = key_of(code, repr([template.facts for template in templates]).encode(), *(one.content for one in templates))
    records = {source.name: _kept(source, key, known[source.name]) for source in sources}
    missing = [(source, n) for source in sources for n, one in enumerate(records[source.name]) if one is None]
    count = sum(len(source.films) for source in sources)
    with execution.stage(f"films: {', '.join(records)}", "films", count) as stage:
        stage.keep(count - len(missing))
        due = seldom(SAVE_SECONDS)

        def saved() -> dict[str, list[Record]]:
            done = {source.name: _with_source(records[source.name], source) for source in sources}
            for name, of in done.items():
                save(name, of)
            return done

        def arrived(nth: int, record: Record) -> None:
            source, n = missing[nth]
            records[source.name][n] = {"key": _shown_key(key, source.films[n]), **record}
            stage.advance()
            if due():
                saved()

        ordered_map(
            measure_film,
            [(source.folder, source.films[n]) for source, n in missing],
            shared={"templates": templates, "table": table, "code": code},
            workers=execution.workers,
            scheduler=execution.scheduler,
            arrived=arrived,
        )
        return saved()


def _kept(source: Source, key: str, known: Mapping[str, Record]) -> list[Record | None]:
    """Of each film the record of an earlier run, where that still holds."""
    of_films = ((film, known.get(film.sha256)) for film in source.films)
    return [record if record and record["key"] == _shown_key(key, film) else None for film, record in of_films]


def _with_source(records: Sequence[Record | None], source: Source) -> list[Record]:
    return [
        {**record, **_said(film, source.name)} for film, record in zip(source.films, records, strict=True) if record
    ]


def measure_film(
    of_folder: tuple[Path, Film], *, templates: Sequence[Template], table: Localisation, code: Mapping[str, str]
) -> Record:
    """What one film measures: status, place, side, pitch, and group|feature -> value where a joint was found.

    of_folder  that the film's name starts from, and the film
    table   by which the joint is looked for
    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    folder, film = of_folder
    record: Record = {"sha256": film.sha256, "side": film.side or "", "reason": ""}
    try:
        image = read_film(folder / film.file, film.look)
    except InputError as error:
        return {**record, "status": "unreadable", "reason": str(error)}
    side, pixel_mm = film.side or image.side, film.pixel_mm or image.pixel_mm
    joint = locate_film(image.pixels, templates, table, side=side, pixel_mm=pixel_mm)
    record |= {
        "status": joint.status, "side": joint.side, "polarity": joint.polarity, "score": joint.score,
        "row_px": joint.row, "col_px": joint.col, "pixel_mm": joint.pixel_mm, "pixel_from": joint.pixel_from,
        "scale": joint.scale, "pixel_height": joint.pixel_height,
    }  # fmt: skip
    if joint.status != "found":
        return record
    square = with_square_pixels(image.pixels, joint.pixel_height)
    bright = square if joint.polarity == "bone bright" else 1 - square
    plateau_mm = templates[0].known_plateau_mm * joint.scale
    lateral = -1 if joint.side == "right" else 1
    middle = joint.col + lateral * _TO_MIDDLE * plateau_mm / joint.pixel_mm
    pitch_mm = joint.pixel_mm * PLATEAU_MM / plateau_mm
    place = Place(row=joint.square_row, col=middle, side=joint.side, pitch_mm=pitch_mm)
    binned = 1.0 if film.coarse_mm is None else max(1.0, film.coarse_mm / pitch_mm)
    return record | {"binned": binned} | measured(bright, place, joint.pixel_mm, binned)


def measured(film: Array, near: Place, pixel_mm: float, binned: float = 1) -> Record:
    """group|feature -> value of a film about its joint.

    film      (rows, cols) grey, a display value, bone bright
    near      about where the joint's middle is
    pixel_mm  pitch of the film
    binned    pixels of it that are taken as one, but for the texture that is told at its own pitch
    """
    shown, near = made_smaller(film, near, binned)
    place = centred(shown, near)
    field = field_of(shown, place)
    form = stretched(field)
    outline = trace_outline(form)
    groups = shape_groups(outline) | grey_groups(form, outline)
    own = place.binned(1 / binned)
    groups |= {
        TONE: tone(shown, field, outline, place) | _taking(film, field, own),
        FINE: fine_texture(film, outline, own, pixel_mm),
        EDGES: edge_features(field),
    }
    values: Record = {"joint_row_px": own.row, "joint_col_px": own.col, "pitch_mm": own.pitch_mm}
    return values | {f"{group}{BETWEEN}{name}": value for group, of in groups.items() for name, value in of.items()}


def _taking(film: Array, field: Array, place: Place) -> Features:
    """What a taking decides: where the joint is from the film's middle, and how bright the field about it is."""
    down, aside = (
        (at - (size - 1) / 2) * place.pitch_mm for at, size in zip((place.row, place.col), film.shape, strict=True)
    )
    return {"joint_down_mm": down, "joint_aside_mm": aside, "mean_grey": float(field.mean())}


def centred(film: Array, near: Place) -> Place:
    """The place and pitch that the film's own outline gives: its plateau PLATEAU_MM wide, its joint in the middle.

    Sought first in a wider field, in which both edges are sure to lie.
    film  (rows, cols)  grey, a display value, bone bright
    """
    place = near
    for zoom in _ZOOMS:
        wide = replace(place, pitch_mm=place.pitch_mm * zoom)
        row, col = joint_pixel()
        outline = trace_outline(stretched(field_of(film, wide)), PLATEAU_MM * wide.pitch_mm / near.pitch_mm)
        lateral, medial = plateau_edges(outline)
        middle = float(np.mean([np.median(outline.tibia), np.median(outline.femur)]))
        moved = wide.moved(middle - row, (lateral + medial) / 2 - col)
        size = np.clip(PLATEAU_MM / ((medial - lateral) * PITCH_MM), 1 / _RESIZED, _RESIZED)
        pitch_mm = float(np.clip(wide.pitch_mm * size, near.pitch_mm / _RESIZED, near.pitch_mm * _RESIZED))
        place = replace(moved, pitch_mm=pitch_mm)
    return place


def _shown_key(key: str, film: Film) -> str:
    """The key of a film's record, by what it was shown with."""
    shown = f"{key} {film.look!r} {film.coarse_mm}"
    return key if film.look is None and film.coarse_mm is None else hashlib.sha256(shown.encode()).hexdigest()[:16]


def _said(film: Film, source: str) -> Record:
    grade = -1 if film.grade is None else film.grade
    return {"source": source, "file": film.file, "subject": film.subject, "grade": grade}
