"""Compare simulated knees with patient data, and write an HTML page with the results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..anatomy.posture.knee_assembly import load_jsw_protocol
from ..cohort import Plan
from ..core.checks import Array, InputError, require_integer
from ..core.processes.execution import Execution
from ..data.analysis.landmark_table import LandmarkReference, load_landmark_reference
from ..data.analysis.localisation_table import LocalisationSettings, load_localisation_settings
from ..data.anatomy.anatomy_tables import AnatomyTables, load_anatomy_tables
from ..data.code_hash import compute_code_hashes
from ..data.imaging.display_table import load_display_processing
from ..data.table_records import encode_records
from ..io import study_results
from ..io.atomic_write import make_folder
from ..io.image_kind import is_visible
from ..io.meshes.bone_folder import read_bones
from ..io.patients.patient_radiographs import list_films, read_film
from ..model.knee import Knee
from ..model.protocol import load_protocol
from ..model.sampling.acquisition import sample_acquisition
from ..model.sampling.knee_sampling import KneeDistributions, load_knee_distributions, sample_knees
from ..radiomics.localisation.crop_template import crop_template
from ..radiomics.localisation.templates import Template
from ..standard_templates import make_standard_templates
from ..study.report.report_elements import Picture
from .bones import bone_comparison
from .checkpoint import (
    CODE_PATHS,
    RowCheckpoint,
    SectionCheckpoint,
    compute_key,
    hash_bones,
    load_known_rows,
    save_rows,
)
from .comparison_page import (
    Row,
    Section,
    Table,
    render_page,
)
from .contours import landmark_comparison
from .contours.cohort_landmarks import load_cohort_landmarks
from .film_report import make_films_section
from .films.film_features import (
    FilmSource,
    FilmTables,
    Record,
    measure_films,
)
from .films.simulated_films import SIMULATED, match_pixel_sizes, plan_simulated_films, simulate_films
from .page_texts import BONES_TEXT, CONTOURS_TEXT

# Subfolder of the output folder for simulated radiographs.
_FILMS_FOLDER = "simulated"
# Columns that contain text in the CSV files of radiograph records.
_TEXT_COLUMNS = ("sha256", "key", "file", "source", "subject", "status", "side", "polarity", "pixel_from", "reason")
# Maximum number of simulated knees in the bone comparison.
_MAX_BONE_KNEES = 50


@dataclass(frozen=True, kw_only=True)
class PatientComparison:
    """Result of :func:`compare_with_patients`.

    Attributes
    ----------
    page : Path
        HTML page ``patient_comparison.html``.
    summaries : tuple of str
        Main result of each page section in one line.
    paths : tuple of Path
        Paths of all written files.
    """

    page: Path
    summaries: tuple[str, ...]
    paths: tuple[Path, ...]


def compare_with_patients(
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
) -> PatientComparison:
    """Compare simulated knees with patient data, and write an HTML page, tables and figures.

    A second call with the same output folder resumes an interrupted comparison, see
    :mod:`~pssf.patient_comparison.checkpoint`.

    Parameters
    ----------
    out : str or Path
        Output folder.
    execution : Execution
        Number of worker processes, run-time measurement and progress display.
    films : Path or None, default None
        Folder with patient radiographs, or with one subfolder per source of patient radiographs, see
        :func:`~pssf.io.patients.patient_radiographs.list_films`. None skips the comparison of radiographs.
    bones_folder : Path or None, default None
        Folder with patient bones, see :func:`~pssf.io.meshes.bone_folder.read_bones`. None skips the comparison of
        bones.
    cohort : Path or None, default None
        Cohort folder with radiographs of `protocol`, from which the simulated contours are loaded. None uses the
        radiographs simulated for this comparison, or newly sampled knees if `films` is None.
    protocol : str, default "reference"
        Name or path of the protocol. The acquisition of every simulated radiograph is sampled around this protocol.
    knees : int, default 200
        Number of simulated knees, distributed equally over the KL grades.
    grade_table : str, default "population"
        Grade table from which knees are sampled.
    seed : int, default 0
        Seed of all random numbers.

    Returns
    -------
    PatientComparison
        Main results and paths of the written files.

    Raises
    ------
    InputError
        A folder contains no data, a number is out of range, `protocol` is not frontal, or a file cannot be written.
    """
    laws, tables = load_knee_distributions(grade_table), load_anatomy_tables()
    count = len(laws.grades.grades)
    require_integer("knees", knees, 2 * count, 100_000, "")
    seen_under = load_protocol(protocol)
    if not seen_under.posture.is_frontal or seen_under.knee_distance_mm:
        raise InputError(
            f"protocol must image one knee in a frontal view, got {seen_under.name}: contours require a frontal view"
        )
    given = read_bones(bones_folder) if bones_folder is not None else None
    sources = find_film_sources(films) if films is not None else ()
    out = make_folder(Path(out))
    # Radiographs are simulated first, so that an output folder with a different cohort raises InputError immediately.
    of_films = []
    if sources:
        plan = plan_simulated_films(protocol, knees, grade_table, count, seed)
        film_tables = FilmTables(load_localisation_settings(), load_display_processing())
        of_films = [_make_films_section(out, sources, plan, film_tables, execution)]
        cohort = cohort or out / _FILMS_FOLDER
    with execution.timer.stage("contours", "knees", knees):
        if cohort is None:
            # Right knees suffice, because left knees are mirrored. The JSW definition is "read", because readers
            # measured patient JSW.
            drawn = sample_knees(laws, knees, seed, side="right", jsw_definition="read")
            by = load_jsw_protocol(drawn[0])
            takings = landmark_comparison.sample_acquisitions(
                drawn, partial(sample_acquisition, seen_under, side="right"), seed
            )
            kept = RowCheckpoint(path=out / "contours_knees.csv", code=compute_code_hashes(CODE_PATHS))
            sample = landmark_comparison.compute_simulated_landmarks(takings, tables, by, execution.workers, kept)
        else:
            sample = load_cohort_landmarks(cohort, seen_under.name)
    sections = [_make_contours_section(sample, load_landmark_reference())]
    if given is not None:
        sections.append(_make_bones_section(out, given, laws, tables, min(knees, _MAX_BONE_KNEES), seed, execution))
    sections += of_films
    facts: dict[str, Any] = {"protocol": seen_under.name, "knees": knees, "grade table": grade_table, "seed": seed}
    facts |= {} if cohort is None else {"cohort of the contours": cohort.name, "its radiographs": len(sample.grades)}
    facts |= {f"radiographs of {source.name}": len(source.films) for source in sources}
    return _write_report(out, sections, facts)


def find_film_sources(films_folder: Path) -> tuple[FilmSource, ...]:
    """Find the sources of patient radiographs in a folder.

    Parameters
    ----------
    films_folder : Path
        Folder with the radiographs of one source, or with one subfolder per source.

    Returns
    -------
    tuple of FilmSource
        Sources with their radiographs.

    Raises
    ------
    InputError
        The folder contains no radiographs, or a source has the reserved name ``simulated``.
    """
    if not films_folder.is_dir():
        raise InputError(
            "films must be a folder with radiographs, or with one subfolder of radiographs per source, "
            f"got {films_folder}"
        )
    try:
        return (FilmSource(name=films_folder.resolve().name, folder=films_folder, films=list_films(films_folder)),)
    except InputError as error:
        nothing = error
    sources = []
    for below in sorted(path for path in films_folder.iterdir() if path.is_dir() and is_visible(path)):
        try:
            sources.append(FilmSource(name=below.name, folder=below, films=list_films(below)))
        except InputError:
            continue
    if not sources:
        raise nothing
    if any(source.name == SIMULATED for source in sources):
        raise InputError(
            f"subfolders of films must not be named {SIMULATED}, got {films_folder / SIMULATED}: "
            "this name is reserved for simulated radiographs"
        )
    return tuple(sources)


def _make_contours_section(sample: landmark_comparison.LandmarkSample, reference: LandmarkReference) -> Section:
    """Compare simulated with patient contour landmarks, and make the contour section of the page."""
    compared = landmark_comparison.compare_contours(sample, reference)
    counts = [f"{row['outside']} of {row['total']} at grade {row['grade']}" for row in compared.outside]
    cosines = ", ".join(f"{row['cosine']:.2f}" for row in compared.modes[:3])
    return Section(
        name="Contours",
        summary=f"means and SDs outside tolerance: {'; '.join(counts)}; cosines of first modes: {cosines or 'none'}",
        text=CONTOURS_TEXT,
        tables=(
            Table(name="contours_outside", rows=compared.outside,
                  caption="Number of landmark heights whose mean or SD is outside the tolerance, by KL-like grade. "
                  "Means and SDs are counted separately."),
            Table(name="contours_landmarks", rows=compared.landmarks, max_rows_shown=32,
                  caption="Landmark coordinates as fractions of the plateau width."),
            Table(name="contours_sizes", rows=compared.sizes,
                  caption="Plateau width and joint gaps (mm at the detector), and joint line convergence (deg)."),
            Table(name="contours_gap_auc", rows=compared.gap_auc,
                  caption="AUC of the smaller joint gap for each grade against grade 0."),
            Table(name="contours_modes", rows=compared.modes,
                  caption="First principal modes of landmark variation in grades 0 and 1."),
        ),
        figures=(Picture(
            name="contours", png=compared.figure,
            alt="Mean contours of simulated knees and patients, with one-SD ellipses",
            caption="Mean landmarks of simulated knees and patients for each grade, with one-SD ellipses.",
        ),),
        facts={name: getattr(compared, name) for name in ("outside", "sizes", "gap_auc", "modes")},
    )  # fmt: skip


def _make_bones_section(
    out: Path,
    patient_bones: bone_comparison.Bones,
    laws: KneeDistributions,
    tables: AnatomyTables,
    knees: int,
    seed: int,
    execution: Execution,
) -> Section:
    """Compare simulated with patient bones and make the bone section of the page; reuse saved results."""

    def make() -> tuple[tuple[list[Row], list[Row]], bytes]:
        drawn = bone_comparison.sample_bones(laws, tables, knees, seed, execution.workers)
        built = bone_comparison.build_bones(Knee(), tables)
        compared = bone_comparison.compare_bones(patient_bones, built, drawn, execution.workers)
        return (compared.rows, compared.measure_rows), compared.figure

    with execution.timer.stage("bones", "knees", knees):
        key = compute_key(compute_code_hashes(CODE_PATHS), hash_bones(patient_bones), encode_records(laws, knees, seed))
        part = SectionCheckpoint(folder=out, name="bones", tables=("bones", "bones_shape_measures"), key=key)
        (rows, forms), figure = part.complete(make)
    line = "; ".join(f"{row['bone']} {row['comparison']} {row['rms_mm']:.2f} mm" for row in rows)
    return Section(
        name="Bones",
        summary=line,
        text=BONES_TEXT,
        tables=(
            Table(name="bones", rows=rows, caption=(
                "Distances between bone surfaces in mm. In this table, *built mean* denotes the bone of the default "
                "knee; the scale is the size of the patient bones divided by the size of the built mean."
            )),
            Table(name="bones_shape_measures", rows=forms, max_rows_shown=30,
                  caption="Shape measures of patient bones and of sampled bones (simulated), scaled to the same size."),
        ),
        figures=(Picture(
            name="bones", png=figure, alt="Bones of the default knee, coloured by distance from the patient mean",
            caption="Bones of the default knee; the colour shows the signed distance from the mean patient bone.",
        ),),
        facts={"rows": rows},
    )  # fmt: skip


def _make_films_section(
    out: Path, sources: Sequence[FilmSource], plan: Plan, tables: FilmTables, execution: Execution
) -> Section:
    """Simulate radiographs, measure simulated and patient radiographs, and make the radiograph section of the page."""
    with execution.stage("templates", "knees", 1):
        # Templates are cropped once, before worker processes start; every worker process smooths the cropped templates.
        whole = make_standard_templates("scanline", workers=execution.workers)
        templates = [crop_template(template, 0.0, tables.localisation) for template in whole]
    simulated = simulate_films(out / _FILMS_FOLDER, plan, tables.looks, execution)
    records = _measure_sources(sources, out, templates, tables.localisation, execution)
    simulated = match_pixel_sizes(simulated, records, plan.seed)
    records |= _measure_sources((simulated,), out, templates, tables.localisation, execution)
    with execution.stage("models", "parts", 1):
        read = partial(_read_source_film, {one.name: one for one in (*sources, simulated)})
        return make_films_section(records, read, execution, seed=plan.seed)


def _measure_sources(
    sources: Sequence[FilmSource],
    out: Path,
    templates: Sequence[Template],
    table: LocalisationSettings,
    execution: Execution,
) -> dict[str, list[Record]]:
    """Measure every radiograph of all sources; reuse the saved records of an earlier run."""
    paths = {source.name: out / f"radiographs_{source.name}.csv" for source in sources}
    known = {name: load_known_rows(path, "sha256", _TEXT_COLUMNS) for name, path in paths.items()}
    return measure_films(
        sources,
        templates,
        table,
        execution,
        previous_records=known,
        save=lambda name, rows: save_rows(paths[name], rows),
    )


def _read_source_film(sources: Mapping[str, FilmSource], name: str, file: str) -> Array:
    """Read a radiograph of a source and apply its display processing."""
    source = sources[name]
    processing = next(film.processing for film in source.films if film.file == file)
    return read_film(source.folder / file, processing).pixels


def _write_report(out: Path, sections: Sequence[Section], facts: dict[str, Any]) -> PatientComparison:
    """Write the tables, figures, HTML page and JSON file of the comparison."""
    paths = []
    for section in sections:
        for table in section.tables:
            paths.append(out / f"{table.name}.csv")
            save_rows(paths[-1], table.rows)
        for figure in section.figures:
            paths.append(out / "pictures" / f"{figure.name}.png")
            study_results.save_bytes(paths[-1], figure.png)
    page, machine = out / "patient_comparison.html", out / "patient_comparison.json"
    study_results.save_text(page, render_page(sections, facts))
    study_results.save_json(machine, facts | {section.name.lower(): section.facts for section in sections})
    return PatientComparison(
        page=page,
        summaries=tuple(f"{section.name}: {section.summary}" for section in sections),
        paths=(*paths, machine, page),
    )
