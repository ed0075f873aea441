"""The meter: what is given is measured, and one page says how far simulated knees are from people's."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..anatomy.joint import defining_protocol
from ..cohort import Plan
from ..core.checks import Array, InputError, require_whole
from ..core.execution import Execution
from ..data.anatomy import AnatomyTables, anatomy_tables
from ..data.code import code_digest
from ..data.landmarks import LandmarkReference, landmark_reference
from ..data.localisation import Localisation, localisation
from ..data.looks import looks
from ..data.records import encoded
from ..experiment import standard_templates
from ..io import results
from ..io.atomic import folder
from ..io.bones import read_bones
from ..io.films import list_films, read_film
from ..io.image_kind import is_visible
from ..model.draw import DrawLaws, draw_knees, draw_laws
from ..model.exposure import draw_exposure
from ..model.knee import Knee
from ..model.protocol import load_protocol
from ..radiomics.compact import compact
from ..radiomics.patches import Template
from ..study.report.page import Picture
from . import bones, contours
from .cohort_landmarks import cohort_landmarks
from .films import FilmTables, Record, Source, measure_films
from .films_section import SIMULATED, films_section
from .kept import CODE, KeptPart, KeptRows, facts_of_bones, key_of, known_rows, save_rows
from .page import Row, Section, Table, render
from .simulated import films_plan, in_pixels_as_large, simulated_films

# Tables that the READMEs show, by what must be given for them.
SHOWN = {
    "contours": ("contours_outside", "contours_sizes", "contours_gap_alone"),
    "bones": ("bones", "bones_forms"),
    "films": ("films_found", "films_domains", "films_transfer", "films_effects"),
}
# The table of grades whose knees these are of, and the pictures; of knees by another one some are shown, under names of
# their own.
PICTURED = "population"
SHOWN_BESIDE = {"paper": ("films_domains", "films_transfer", "films_effects")}
_FILMS_FOLDER = "simulated"
# Read as text wherever films are listed.
_TEXT = ("sha256", "key", "file", "source", "subject", "status", "side", "polarity", "pixel_from", "reason")
_CONTOURS = (
    "Sixteen contour landmarks, labels of every knee, beside those that people set on 748 fixed-flexion films (Tiulpin "
    "et al. 2019): in shares of the plateau's width, so that size is taken out. A mean is inside within half a "
    "standard deviation of people's, a spread between 0.7 and 1.4 of theirs. Of each drawn knee a taking of the "
    "protocol given above is seen, or its radiographs of a cohort; people's films were PA in fixed flexion."
)
# Of drawn knees: so many as their spread is told by.
_MOST_BONES = 50
_BONES = (
    "Bones without osteophytes are laid onto one another by a similarity (rotation, translation, size), and distances "
    "taken from surface to surface, both ways, at people's size; the flat cut of the shafts is left out. Spread is "
    "that of each bone about its mean, by the same measure."
)


@dataclass(frozen=True, kw_only=True)
class Realism:
    """What `measure` gave.

    page   realism.html
    lines  one a part
    paths  of all files
    rows   table -> its rows
    """

    page: Path
    lines: tuple[str, ...]
    paths: tuple[Path, ...]
    rows: dict[str, list[Row]]


def shown_as(measured: Iterable[str], grades: str) -> dict[str, str]:
    """Name of a table of the READMEs -> the rows that it shows, of knees by a table of grades."""
    if grades == PICTURED:
        return {name: name for name in measured}
    return {f"{name}_{grades}": name for name in measured if name in SHOWN_BESIDE.get(grades, ())}


def measure(
    out: str | Path,
    execution: Execution,
    *,
    films: Path | None = None,
    bones_folder: Path | None = None,
    cohort: Path | None = None,
    protocol: str = "reference",
    knees: int = 200,
    grade_table: str = "population",
    seed: int = 0,
) -> Realism:
    """Measure simulated knees beside what is given, into a folder; goes on where an earlier run stopped, see `kept`.

    films         folder of real films, or of folders of them, one a source; see `io.films.list_films`
    bones_folder  of real bones; see `io.bones.read_bones`
    cohort        folder of a cohort, whose radiographs under `protocol` the contours are of; None: those that the films
                  are of, or without films of drawn knees
    protocol      that simulated knees are seen under, by name or path; films are takings of it (`draw_exposure`)
    knees         that are drawn, the grades alike
    grade_table   that they are sampled from; see `draw_knee`
    raises        InputError for a folder that holds none, a number out of range, a disk that cannot be written
    """
    laws, tables = draw_laws(grade_table), anatomy_tables()
    count = len(laws.grades.grades)
    require_whole("knees", knees, 2 * count, 100_000, "")
    seen_under = load_protocol(protocol)
    if not seen_under.posture.is_frontal or seen_under.apart_mm:
        raise InputError(f"protocol = {seen_under.name}; allowed: one knee seen from the front, which shows contours")
    given = read_bones(bones_folder) if bones_folder is not None else None
    sources = sources_of(films) if films is not None else ()
    out = folder(Path(out))
    # First, since a folder that holds another cohort is refused then, and not after minutes.
    of_films = []
    if sources:
        plan = films_plan(protocol, knees, grade_table, count, seed)
        of_films = [_films(out, sources, plan, FilmTables(localisation(), looks()), execution)]
        cohort = cohort or out / _FILMS_FOLDER
    with execution.timer.stage("contours", "knees", knees):
        if cohort is None:
            # Labels of a left knee mirror those of a right one. Readers took people's joint spaces.
            drawn = draw_knees(laws, knees, seed, side="right", jsw_as="read")
            by = defining_protocol(drawn[0])
            takings = contours.takings_of(drawn, partial(draw_exposure, seen_under, side="right"), seed)
            kept = KeptRows(path=out / "contours_knees.csv", code=code_digest(CODE))
            sample = contours.drawn_landmarks(takings, tables, by, execution.workers, kept)
        else:
            sample = cohort_landmarks(cohort, seen_under.name)
    sections = [_contours(sample, landmark_reference())]
    if given is not None:
        sections.append(_bones(out, given, laws, tables, min(knees, _MOST_BONES), seed, execution))
    sections += of_films
    facts: dict[str, Any] = {"protocol": seen_under.name, "knees": knees, "grade table": grade_table, "seed": seed}
    facts |= {} if cohort is None else {"cohort of the contours": cohort.name, "its radiographs": len(sample.grades)}
    facts |= {f"films of {source.name}": len(source.films) for source in sources}
    return _write(out, sections, facts)


def sources_of(given: Path) -> tuple[Source, ...]:
    """A folder of films as one source, or each of its folders with films as one.

    raises  InputError for a folder without films
    """
    if not given.is_dir():
        raise InputError(f"films = {given}; allowed: a folder of films, or of folders of them")
    try:
        return (Source(name=given.resolve().name, folder=given, films=list_films(given)),)
    except InputError as error:
        nothing = error
    sources = []
    for below in sorted(path for path in given.iterdir() if path.is_dir() and is_visible(path)):
        try:
            sources.append(Source(name=below.name, folder=below, films=list_films(below)))
        except InputError:
            continue
    if not sources:
        raise nothing
    if any(source.name == SIMULATED for source in sources):
        raise InputError(f"films = {given / SIMULATED}; allowed: any other name, which simulated films have here")
    return tuple(sources)


def _contours(sample: contours.LandmarkSample, people: LandmarkReference) -> Section:
    compared = contours.compare(sample, people)
    counts = [f"{row['outside']} of {row['of']} at grade {row['grade']}" for row in compared.outside]
    cosines = ", ".join(f"{row['cosine']:.2f}" for row in compared.modes[:3])
    return Section(
        name="Contours",
        line=f"heights and spreads outside people's: {'; '.join(counts)}; cosines of first modes {cosines or 'none'}",
        text=_CONTOURS,
        tables=(
            Table(name="contours_outside", rows=compared.outside, caption="Heights and their spreads outside."),
            Table(name="contours_landmarks", rows=compared.landmarks, caption="In shares of the width.", shown=32),
            Table(name="contours_sizes", rows=compared.sizes, caption="Plateau, gaps (mm on the film), convergence."),
            Table(name="contours_gap_alone", rows=compared.gap_alone, caption="AUC of the smaller gap, each v 0."),
            Table(name="contours_modes", rows=compared.modes, caption="First modes of variation, grades 0 and 1."),
        ),
        figures=(Picture(
            name="contours", png=compared.figure,
            alt="Mean contours of drawn knees and of people with ellipses of one SD",
            caption="Mean landmarks and ellipses of one standard deviation, drawn knees and people, by grade.",
        ),),
        facts={name: getattr(compared, name) for name in ("outside", "sizes", "gap_alone", "modes")},
    )  # fmt: skip


def _bones(
    out: Path, given: bones.Bones, laws: DrawLaws, tables: AnatomyTables, knees: int, seed: int, execution: Execution
) -> Section:
    def make() -> tuple[tuple[list[Row], list[Row]], bytes]:
        drawn = bones.drawn_bones(laws, tables, knees, seed, execution.workers)
        built = bones.built_bones(Knee(), tables)
        compared = bones.compare(given, built, drawn, execution.workers)
        return (compared.rows, compared.forms), compared.figure

    with execution.timer.stage("bones", "knees", knees):
        key = key_of(code_digest(CODE), facts_of_bones(given), encoded(laws, knees, seed))
        part = KeptPart(folder=out, name="bones", tables=("bones", "bones_forms"), key=key)
        (rows, forms), figure = part.completed(make)
    line = "; ".join(f"{row['bone']} {row['what']} {row['rms_mm']:.2f} mm" for row in rows)
    return Section(
        name="Bones",
        line=line,
        text=_BONES,
        tables=(
            Table(name="bones", rows=rows, caption="Distances, mm."),
            Table(name="bones_forms", rows=forms, caption="Measures of form, at one size.", shown=30),
        ),
        figures=(Picture(
            name="bones", png=figure, alt="Built mean bones coloured by distance",
            caption="The built mean bones; their colour is the distance from the mean of the given ones.",
        ),),
        facts={"rows": rows},
    )  # fmt: skip


def _films(out: Path, sources: Sequence[Source], plan: Plan, tables: FilmTables, execution: Execution) -> Section:
    with execution.stage("templates", "knees", 1):
        # Each process of films gets them, and makes them soft anew.
        whole = standard_templates("scanline", workers=execution.workers)
        templates = [compact(template, 0.0, tables.localisation) for template in whole]
    simulated = simulated_films(out / _FILMS_FOLDER, plan, tables.looks, execution)
    records = _measured(sources, out, templates, tables.localisation, execution)
    simulated = in_pixels_as_large(simulated, records, plan.seed)
    records |= _measured((simulated,), out, templates, tables.localisation, execution)
    with execution.stage("models", "parts", 1):
        read = partial(_read, {one.name: one for one in (*sources, simulated)})
        return films_section(records, read, execution, seed=plan.seed)


def _measured(
    sources: Sequence[Source], out: Path, templates: Sequence[Template], table: Localisation, execution: Execution
) -> dict[str, list[Record]]:
    paths = {source.name: out / f"films_{source.name}.csv" for source in sources}
    known = {name: known_rows(path, "sha256", _TEXT) for name, path in paths.items()}
    return measure_films(
        sources, templates, table, execution, known=known, save=lambda name, rows: save_rows(paths[name], rows)
    )


def _read(sources: Mapping[str, Source], name: str, file: str) -> Array:
    source = sources[name]
    look = next(film.look for film in source.films if film.file == file)
    return read_film(source.folder / file, look).pixels


def _write(out: Path, sections: Sequence[Section], facts: dict[str, Any]) -> Realism:
    paths = []
    for section in sections:
        for table in section.tables:
            paths.append(out / f"{table.name}.csv")
            save_rows(paths[-1], table.rows)
        for figure in section.figures:
            paths.append(out / "pictures" / f"{figure.name}.png")
            results.save_bytes(paths[-1], figure.png)
    page, machine = out / "realism.html", out / "realism.json"
    results.save_text(page, render(sections, facts))
    results.save_json(machine, facts | {section.name.lower(): section.facts for section in sections})
    return Realism(
        page=page,
        lines=tuple(f"{section.name}: {section.line}" for section in sections),
        paths=(*paths, machine, page),
        rows={table.name: list(table.rows) for section in sections for table in section.tables},
    )
