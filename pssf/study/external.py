"""Models of a cohort as displayed, tested on films: both are read in the same way, from finding the joint on.

Simulated pixels are linear in the signal, a film is a display of unknown tone. So the cohort's radiographs are rendered
for eyes, and what is read is the rendering; see `radiomics.display`.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..core.checks import InputError, require_choice
from ..core.execution import Execution
from ..data.localisation import Localisation
from ..io import results
from ..io.films import Film
from ..radiomics.compact import compact
from ..radiomics.display import TONELESS, DisplayHow, find_in_display, measure_display, require_plateau
from ..radiomics.patches import Template
from ..radiomics.table import NOT_FEATURES, TEXT, Job, Record, extract_all
from ..radiomics.tables import RadiomicsTables
from .films import REGION_MM, FilmSet
from .learn.modelfile import TrainedOn, pack
from .learn.refit import Kept, refitted
from .predictions import joined
from .settings import StudySettings
from .statistics.external import CONTRASTS, counted, score_films, score_grades
from .tasks import GRADED, class_names

# Films that pitch and region are taken from, where they are not given.
_SAMPLE = 15
LABEL = "films"
# What is measured -> its table, from which a later run goes on.
_FILES = {"cohort as displayed": "displays", "films": "films_features"}
_SHOWN = ("status", "film_side", "film_knees", "film_polarity", "film_pixel_mm", "film_pixel_from", "row_px", "col_px")


@dataclass(frozen=True, kw_only=True)
class External:
    """What films gave.

    tables    films: one row a film, with its probabilities; films_scores: of `external.score_films`; films_grades: of
              `external.score_grades`
    found     of `external.counted`
    how       pitch and region that films and cohort were read by
    protocol  that the models have learnt from, by so many radiographs of so many
    models    name -> file
    """

    tables: dict[str, pd.DataFrame]
    counts: pd.DataFrame
    how: DisplayHow
    protocol: str
    learnt_from: tuple[int, int]
    models: dict[str, bytes]


@dataclass(frozen=True)
class Bench:
    """What measuring needs, beside what is measured; `out` is the study's folder."""

    templates: Sequence[Template]
    settings: StudySettings
    out: Path
    execution: Execution
    tables: RadiomicsTables


def check_films(films: FilmSet, manifest: pd.DataFrame, settings: StudySettings, templates: Sequence[Template]) -> None:
    """Refuse films that this cohort cannot be tested on.

    raises  InputError for a protocol that the manifest has not, families of features without one that films have, or
            templates without the width of their plateau
    """
    require_plateau(templates)
    require_choice("films-protocol", films.protocol, sorted(set(manifest["protocol"])))
    if not set(settings.families) & set(TONELESS):
        raise InputError(
            f"families = {', '.join(settings.families)}; allowed with films: one or more of {', '.join(TONELESS)}"
        )


def tested_on_films(bench: Bench, films: FilmSet, manifest: pd.DataFrame) -> External:
    """Both measured, models trained on all of the cohort under one protocol, and scored on the films.

    manifest  of the cohort, as for `study.run`
    raises    InputError where too few radiographs of the cohort can be read as films
    """
    settings = bench.settings
    cohort = manifest[manifest["protocol"] == films.protocol]
    pitch_mm = float(cohort["pixel_mm"].iloc[0])
    largest_mm = settings.region_px * pitch_mm
    reach_mm, law = max(largest_mm, films.region_mm or 0.0), bench.tables.localisation
    templates = tuple(compact(template, reach_mm, law) for template in bench.templates)
    bench = replace(bench, templates=templates)
    with bench.execution.timer.stage("pitch and field of the films"):
        pixel_mm, region_mm = _pitch_and_region_mm(films, templates, law, pitch_mm, largest_mm)
    families = tuple(family for family in settings.families if family in TONELESS)
    how = DisplayHow(
        pixel_mm=pixel_mm,
        region_px=round(region_mm / pixel_mm),
        bins=settings.bins,
        families=families,
        backend=settings.backend,
    )
    own = _measured(bench, how, _jobs_of_cohort(cohort), films.load_cohort, "cohort as displayed")
    own = cohort.merge(own.drop(columns="sha256"), on="radiograph", validate="one_to_one")
    usable = own[own["status"] == "found"]
    _require_enough(usable, films.protocol)
    names = [name for name in usable.columns if name not in NOT_FEATURES and name not in cohort.columns]
    given = _measured(bench, how, [job_of(film) for film in films.films], films.load, "films")
    listed = _with_films(films.films, given)
    with bench.execution.timer.stage("models for films"):
        kept = list(refitted(usable, names, settings, {LABEL: (films.protocol,)}))
        models = {one.name: _file(one, how, templates, cohort, settings) for one in kept}
    table, of_two, of_grades = _predicted(listed, names, kept)
    bootstrap = {"replicates": settings.replicates, "seed": settings.seed}
    scores = {"films_scores": score_films(of_two, **bootstrap), "films_grades": score_grades(of_grades, **bootstrap)}
    return External(
        tables={"films": table, **scores},
        counts=counted(listed),
        how=how,
        protocol=films.protocol,
        learnt_from=(len(usable), len(own)),
        models=models,
    )


def job_of(film: Film) -> Job:
    """What there is to measure of a film; its hash changes with what is said of it, too."""
    said = hashlib.sha256(f"{film.sha256} {film.side} {film.pixel_mm}".encode()).hexdigest()
    return Job(radiograph=film.file, file=film.file, sha256=said, side=film.side, pixel_mm=film.pixel_mm)


def _jobs_of_cohort(cohort: pd.DataFrame) -> list[Job]:
    columns = ["radiograph", "file", "sha256", "side", "pixel_mm"]
    return [Job(**{name: row[name] for name in columns}) for row in cohort[columns].to_dict("records")]


def _pitch_and_region_mm(
    films: FilmSet, templates: Sequence[Template], law: Localisation, least_mm: float, largest_mm: float
) -> tuple[float, float]:
    """As they are given, else from some of the films.

    Their median pitch, to a hundredth of a mm and no finer than the protocol's; and the side, in whole mm, of a region
    about the joint line that nine of ten hold, no larger than the study's.
    """
    if films.pixel_mm is not None and films.region_mm is not None:
        return films.pixel_mm, films.region_mm
    pitches, fields = [], []
    for film in films.films[:: max(1, len(films.films) // _SAMPLE)][:_SAMPLE]:
        try:
            image = films.load(film.file)
            side, pixel_mm = film.side or image.side, film.pixel_mm or image.pixel_mm
            joint = find_in_display(image.pixels, templates, law, side, pixel_mm)
        except InputError:
            continue  # it will be counted as refused
        if joint.status == "found":
            rows, cols = image.pixels.shape[0] * joint.pixel_height, image.pixels.shape[1]
            around = min(joint.square_row, joint.col, rows - 1 - joint.square_row, cols - 1 - joint.col)
            pitches.append(joint.pixel_mm)
            fields.append(2 * around * joint.pixel_mm)
    pixel_mm, region_mm = least_mm, largest_mm
    if pitches:
        pixel_mm = max(least_mm, round(float(np.median(pitches)), 2))
        held_mm = float(np.floor(np.percentile(fields, 10)))
        region_mm = min(largest_mm, max(held_mm, REGION_MM[0]))
    return films.pixel_mm or pixel_mm, films.region_mm or region_mm


def _measured(bench: Bench, how: DisplayHow, jobs: list[Job], load: Any, what: str) -> pd.DataFrame:
    path = bench.out / f"{_FILES[what]}.csv"
    earlier = results.load_table(path, TEXT)
    known: dict[str, Record] = {}
    if earlier is not None and "sha256" in earlier:
        known = {row["sha256"]: row for row in earlier.to_dict("records")}
    records, _ = extract_all(
        jobs,
        load_pixels=load,
        templates=bench.templates,
        how=how,
        tables=bench.tables,
        execution=bench.execution,
        known=known,
        save=lambda records: results.save_table(path, pd.DataFrame(records)),
        by=measure_display,
        stage_name=what,
    )
    return pd.DataFrame(records)


def _require_enough(usable: pd.DataFrame, protocol: str) -> None:
    grades = sorted({int(grade) for grade in usable["grade"]})
    if not {0, 2} <= set(grades):
        raise InputError(
            f"grades of the cohort with a region found as films under {protocol} = {grades}; allowed: 0 and 2 among "
            "them"
        )


def _with_films(films: Sequence[Film], records: pd.DataFrame) -> pd.DataFrame:
    said = pd.DataFrame(
        [{"file": f.file, "subject": f.subject, "grade": np.nan if f.grade is None else f.grade} for f in films]
    )
    columns = [name for name in records.columns if name not in ("radiograph", "sha256")]
    return pd.concat([said, records[columns].reset_index(drop=True)], axis=1)


def _file(
    kept: Kept, how: DisplayHow, templates: Sequence[Template], cohort: pd.DataFrame, settings: StudySettings
) -> bytes:
    return pack(
        kept,
        templates,
        reads="display",
        grade_names=class_names(kept.task),
        families=how.families,
        backend=how.backend,
        bins=how.bins,
        pixel_mm=how.pixel_mm,
        region_px=how.region_px,
        trained_on=trained_on(cohort),
        seed=settings.seed,
    )


def trained_on(manifest: pd.DataFrame) -> tuple[TrainedOn, ...]:
    """The protocols of a manifest, in its order."""
    first = manifest.drop_duplicates("protocol")
    lengths = ("pixel_mm", "sdd_mm", "sod_mm")
    return tuple(
        TrainedOn(protocol=row["protocol"], **{name: float(row[name]) for name in lengths})
        for row in first[["protocol", *lengths]].to_dict("records")
    )


def _predicted(
    films: pd.DataFrame, names: list[str], kept: Sequence[Kept]
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """films.csv, and the predictions of models of CONTRASTS and of GRADED of films whose grade is known."""
    is_found = films["status"] == "found"
    table = films.reindex(columns=["file", "subject", "grade", *_SHOWN]).copy()
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
        if one.task in GRADED:
            of_grades.append(
                rows.assign(**{f"p{place}": probability[rows.index, place] for place in range(len(one.grades))})
            )
    none = pd.DataFrame(columns=["subject", "grade", "task", "model", "selection", "p"])
    return table, *(joined(rows) if rows else none for rows in (of_two, of_grades))
