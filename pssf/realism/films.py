"""Films measured one by one: found, brought to the standard form, outlined, their features told."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..core.checks import InputError
from ..core.execution import Execution
from ..core.parallel import ordered_map
from ..data.code import code_digest, require_code
from ..io.films import Film, read_film
from ..radiomics.locate import locate
from ..radiomics.patches import Template
from .domains import Films
from .form import Place, field_of, joint_pixel, stretched
from .grey_features import grey_groups
from .outline import trace_outline
from .shape_features import plateau_edges, shape_groups
from .tone import fine_texture, tone

Record = dict[str, Any]
# What a record depends on beside the film and the templates.
CODE = ("anatomy/truth.py", "core", "data", "detector", "io", "radiomics", "realism")
# Group and feature make the name of a column; these two groups are told, and not learnt from.
TONE, FINE = "tone", "fine texture"
_BETWEEN = "|"
_TO_MIDDLE = 0.25  # of the plateau's width, from the medial joint line


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
    source: Source,
    templates: Sequence[Template],
    execution: Execution,
    *,
    known: Mapping[str, Record],
    save: Callable[[list[Record]], None],
) -> list[Record]:
    """One record a film, in their order; those of an earlier run are kept where neither code nor templates changed.

    known  sha256 -> record
    save   is given all records so far when they are there
    """
    code = code_digest(CODE)
    key = _key(templates, code)
    records: list[Record | None] = []
    for film in source.films:
        record = known.get(film.sha256)
        records.append(record if record is not None and record["key"] == key else None)
    missing = [index for index, record in enumerate(records) if record is None]
    with execution.stage(f"films: {source.name}", "films", len(records)) as stage:
        stage.keep(len(records) - len(missing))

        def arrived(nth: int, record: Record) -> None:
            records[missing[nth]] = {"key": key, **record}
            stage.advance()

        ordered_map(
            measure_film,
            [source.films[index] for index in missing],
            shared={"folder": source.folder, "templates": templates, "code": code},
            workers=execution.workers,
            scheduler=execution.scheduler,
            arrived=arrived,
        )
    done = [{**record, **_said(film, source.name)} for film, record in zip(source.films, records, strict=True) if record]
    save(done)
    return done


def measure_film(film: Film, *, folder: Path, templates: Sequence[Template], code: Mapping[str, str]) -> Record:
    """What one film measures: status, place, side, pitch, and group|feature -> value where a joint was found.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    record: Record = {"sha256": film.sha256, "side": film.side or "", "reason": ""}
    try:
        image = read_film(folder / film.file)
    except InputError as error:
        return {**record, "status": "unreadable", "reason": str(error)}
    side, pixel_mm = film.side or image.side, film.pixel_mm or image.pixel_mm
    found = locate(image.pixels, templates, side=side, pixel_mm=pixel_mm)
    record |= {
        "status": found.status, "side": found.side, "polarity": found.polarity, "score": found.score,
        "row_px": found.row, "col_px": found.col, "pixel_mm": found.pixel_mm, "pixel_from": found.pixel_from,
        "scale": found.scale,
    }  # fmt: skip
    if found.status != "found":
        return record
    film_bright = image.pixels if found.polarity == "bone bright" else 1 - image.pixels
    lateral = -1 if found.side == "right" else 1
    width_px = templates[0].plateau_mm * found.scale / found.pixel_mm
    middle = found.col + lateral * _TO_MIDDLE * width_px
    place = Place(row=found.row, col=middle, side=found.side, pixel_mm=found.pixel_mm)
    return record | measured(film_bright, place)


def measured(film: np.ndarray, place: Place) -> Record:
    """group|feature -> value of a film, bone bright, about a place that is near the joint's middle."""
    place = centred(film, place)
    field = field_of(film, place)
    form = stretched(field)
    outline = trace_outline(form)
    groups = shape_groups(outline) | grey_groups(form, outline)
    groups |= {TONE: tone(film, field, outline, place), FINE: fine_texture(film, outline, place)}
    values: Record = {"joint_row_px": place.row, "joint_col_px": place.col}
    return values | {f"{group}{_BETWEEN}{name}": value for group, of in groups.items() for name, value in of.items()}


def centred(film: np.ndarray, place: Place) -> Place:
    """The place moved to the middle between the plateau's edges and onto the joint line, by the film's own outline."""
    row, col = joint_pixel()
    outline = trace_outline(stretched(field_of(film, place)))
    middle = float(np.mean([np.median(outline.tibia), np.median(outline.femur)]))
    return place.moved(middle - row, float(np.mean(plateau_edges(outline))) - col)


def learnable(name: str, records: Sequence[Record]) -> Films:
    """The films with a joint found, and the features that may be learnt from."""
    table = pd.DataFrame([record for record in records if record["status"] == "found"])
    columns = [name for name in table if _BETWEEN in name and name.split(_BETWEEN)[0] not in (TONE, FINE)]
    features = table[columns].astype(float)
    features.columns = pd.MultiIndex.from_tuples([tuple(name.split(_BETWEEN)) for name in columns])
    return Films(
        name=name,
        features=features.reset_index(drop=True),
        grades=table["grade"].fillna(-1).astype(int).to_numpy(),
        subjects=table["subject"].astype(str).to_numpy(),
    )


def _said(film: Film, source: str) -> Record:
    grade = -1 if film.grade is None else film.grade
    return {"source": source, "file": film.file, "subject": film.subject, "grade": grade}


def _key(templates: Sequence[Template], code: Mapping[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(dict(code)).encode())
    for template in templates:
        digest.update(np.ascontiguousarray(template.pixels).tobytes())
    return digest.hexdigest()[:16]
