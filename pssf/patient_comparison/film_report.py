"""Make the radiograph section of the comparison page from radiograph records."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.processes.execution import Execution
from ..core.processes.parallel_map import map_in_parallel
from ..radiomics.localisation.pixel_aspect import resample_to_square_pixels
from ..study.report.report_elements import Picture
from .bones.bone_measures import compare_samples
from .comparison_page import Section, Table
from .films.contact_sheets import make_contact_sheet
from .films.domain_shift import (
    ALL_FEATURES,
    FilmFeatures,
    make_film_features,
    measure_source_separability,
    measure_transfer,
)
from .films.film_features import (
    EDGES,
    FINE,
    TONE,
    Record,
)
from .films.film_normalisation import (
    JointPosition,
    bin_film,
    resample_joint_field,
    stretch_contrast,
)
from .films.grade_effects import compare_grade_effects
from .films.observer_study import make_observer_sheet, select_observer_films
from .films.simulated_films import SIMULATED
from .page_texts import CAPTIONS, FILMS_TEXT

Row = dict[str, Any]
# Function that returns display values (bone bright) of a radiograph; its arguments are the source name and file name.
FilmReader = Callable[[str, str], Array]
# Two sources, and the KL grades to distinguish from grade 0; no grades if the task is to distinguish the sources.
SourcePair = tuple[str, str, tuple[int, ...]]
# Normalised 8-bit radiograph for display.
NormalisedImage = NDArray[np.uint8]
# Source name and record of a displayed radiograph.
DisplayedFilm = tuple[str, Record]
# KL grade, and contact-sheet rows, each with a caption and radiographs.
GradeSheet = tuple[int, list[tuple[str, list[DisplayedFilm]]]]
# Grades of the positive class of each prediction task; the negative class is grade 0.
GRADE_TASKS = ((2,), (3, 4))
# Number of radiographs in each row of a contact sheet.
_FILMS_PER_ROW = 6
# Prefixes of the outline ratio columns.
_RATIO_GROUPS = ("shape|", "margins|")


class SourceComparison(NamedTuple):
    """Table rows that compare radiograph sources.

    Attributes
    ----------
    domains : list of dict
        Source separability, from ``measure_source_separability``.
    transfer : list of dict
        Grade prediction across sources, from ``measure_transfer``.
    features : list of dict
        Grade effects of each feature, from ``compare_grade_effects``.
    groups : list of dict
        Grade effects of each feature group, from ``compare_grade_effects``.
    """

    domains: list[Row]
    transfer: list[Row]
    features: list[Row]
    groups: list[Row]


_EMPTY_COMPARISON = SourceComparison(domains=[], transfer=[], features=[], groups=[])


def make_films_section(
    records: Mapping[str, Sequence[Record]],
    read_pixels: FilmReader,
    execution: Execution,
    *,
    replicates: int = 1000,
    seed: int = 0,
) -> Section:
    """Make the section that compares patient with simulated radiographs.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Records of each source, from ``measure_films``. The source ``simulated`` contains simulated radiographs; all
        other sources contain patient radiographs.
    read_pixels : callable
        Function of source name and file name that returns a (rows, cols) array of grey values from 0 to 1. It must be
        picklable if `execution` uses more than one process.
    execution : Execution
        Worker processes, timer and progress display.
    replicates : int, default 1000
        Number of bootstrap replicates.
    seed : int, default 0
        Seed for the bootstrap, the cross-validation folds and the observer study.

    Returns
    -------
    Section
        Page section with tables and figures.
    """
    sheets, order = select_contact_sheet_films(records), select_observer_films(records, SIMULATED, seed)
    shown = [*order, *(one for _, rows in sheets for _, chosen in rows for one in chosen)]
    compared, forms = _compare_and_read(records, shown, read_pixels, execution, replicates=replicates, seed=seed)
    fates = count_found_films(records)
    figures, key = make_observer_sheet(order, lambda name, one: forms[name, one["file"]])
    tables = (*_make_tables(records, fates, compared), *key)
    return Section(
        name="Radiographs",
        summary=format_summary(compared),
        text=FILMS_TEXT,
        tables=tuple(table for table in tables if table.rows),
        figures=(*(_make_contact_sheet_picture(grade, rows, forms) for grade, rows in sheets), *figures),
        facts={
            "found": fates, "source_separability": compared.domains, "grade_transfer": compared.transfer,
            "grade_effects": compared.groups,
        },
    )  # fmt: skip


def _make_tables(
    records: Mapping[str, Sequence[Record]], fates: list[Row], compared: SourceComparison
) -> tuple[Table, ...]:
    """Make the tables of the radiograph section, except the answer key of the observer study."""
    return (
        Table(name="radiographs_found", rows=fates, caption="Localised (found) and rejected radiographs per source."),
        Table(name="source_separability", rows=compared.domains, caption=CAPTIONS["domains"]),
        Table(name="grade_transfer", rows=compared.transfer, caption=CAPTIONS["transfer"]),
        Table(name="grade_effects", rows=compared.groups, caption=CAPTIONS["effects"]),
        Table(
            name="feature_grade_effects",
            rows=compared.features,
            caption="(c) Standardised differences between grades for every feature.",
            max_rows_shown=12,
        ),
        Table(name="outline_ratios", rows=compare_ratios(records), caption=CAPTIONS["ratios"], max_rows_shown=31),
        Table(name="grey_values", rows=summarise_quantities(records, TONE), caption=CAPTIONS["tone"]),
        Table(
            name="edge_profiles",
            rows=summarise_quantities(records, EDGES),
            caption=CAPTIONS["edges"],
            max_rows_shown=29,
        ),
        Table(name="fine_texture", rows=summarise_quantities(records, FINE), caption=CAPTIONS["fine"]),
        Table(
            name="normalised_texture",
            rows=summarise_quantities(records, "texture"),
            caption=CAPTIONS["form"],
            max_rows_shown=40,
        ),
    )


def _compare_and_read(
    records: Mapping[str, Sequence[Record]],
    displayed: Sequence[DisplayedFilm],
    read_pixels: FilmReader,
    execution: Execution,
    *,
    replicates: int,
    seed: int,
) -> tuple[SourceComparison, dict[tuple[str, str], NormalisedImage]]:
    """Compare all sources and read the displayed radiographs in the same worker processes."""
    measured = {name: make_film_features(name, of) for name, of in records.items() if _has_found_films(of)}
    comparing = [
        partial(_compare_pair, pair, measured=measured, replicates=replicates, seed=seed)
        for pair in _list_source_pairs(measured)
    ]
    films = {(name, one["file"]): one for name, one in displayed}
    showing = [partial(_read_normalised_film, read_pixels, name, one) for (name, _), one in films.items()]
    # Models are fitted in worker processes with one linear-algebra thread each, because two threads triple the run
    # time.
    made = map_in_parallel(_call, [*comparing, *showing], shared={}, workers=execution.workers)
    compared = made[: len(comparing)]
    rows = ([row for rows in one for row in rows] for one in zip(_EMPTY_COMPARISON, *compared, strict=True))
    return SourceComparison(*rows), dict(zip(films, made[len(comparing) :], strict=True))


def _call(part: Callable[[], Any]) -> Any:
    """Call a function without arguments; a module-level wrapper is required, because worker processes import it."""
    return part()


def _list_source_pairs(measured: Mapping[str, FilmFeatures]) -> list[SourcePair]:
    """List all pairs of a patient source with simulated radiographs, and all pairs of two patient sources."""
    real = [name for name in measured if name != SIMULATED]
    pairs: list[SourcePair] = []
    for name in real if SIMULATED in measured else ():
        grades = measured[name].grades
        pairs.append((name, SIMULATED, ()))
        pairs += [
            (name, SIMULATED, high)
            for high in GRADE_TASKS
            if np.isin(grades, [0]).any() and np.isin(grades, high).any()
        ]
    return pairs + [(name, other, ()) for index, name in enumerate(real) for other in real[index + 1 :]]


def _compare_pair(
    pair: SourcePair, *, measured: Mapping[str, FilmFeatures], replicates: int, seed: int
) -> SourceComparison:
    """Measure the separability of two sources, or grade prediction and grade effects if the pair contains grades."""
    name, other, high = pair
    first, second = measured[name], measured[other]
    chance = {"replicates": replicates, "seed": seed}
    if not high:
        return _EMPTY_COMPARISON._replace(domains=measure_source_separability(first, second, **chance))
    carried = measure_transfer(first, second, low=0, high=high, **chance)
    of_features, of_groups = compare_grade_effects(first, second, low=0, high=high, **chance)
    return SourceComparison(domains=[], transfer=carried, features=of_features, groups=of_groups)


def count_found_films(records: Mapping[str, Sequence[Record]]) -> list[Row]:
    """Count the radiographs of each source, those with a localised joint, and those rejected for each reason.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Radiograph records of each source.

    Returns
    -------
    list of dict
        One row per source, with the counts, the median pixel pitch in mm and the number of estimated pixel pitches.
    """
    rows = []
    for name, of in records.items():
        status = pd.Series([record["status"] for record in of]).value_counts()
        row: Row = {"source": name, "radiographs": len(of), "found": int(status.get("found", 0))}
        row |= {reason: int(count) for reason, count in sorted(status.items()) if reason != "found"}
        pitch = [record["pixel_mm"] for record in of if record["status"] == "found"]
        row["pixel_mm_median"] = round(float(np.median(pitch)), 4) if pitch else None
        row["pixel_estimated"] = sum(record.get("pixel_from") == "plateau" for record in of)
        rows.append(row)
    return rows


def _select_found_films(records: Mapping[str, Sequence[Record]]) -> dict[str, pd.DataFrame]:
    """Make one table per source that contains the records with a localised joint."""
    return {name: pd.DataFrame([one for one in of if one["status"] == "found"]) for name, of in records.items()}


def summarise_quantities(records: Mapping[str, Sequence[Record]], group: str) -> list[Row]:
    """Summarise every feature of a feature group for each source.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Radiograph records of each source.
    group : str
        Name of the feature group.

    Returns
    -------
    list of dict
        One row per feature, with the median, the 10th and 90th percentiles and the number of radiographs for each
        source.
    """
    tables = _select_found_films(records)
    columns = dict.fromkeys(column for table in tables.values() for column in table if column.startswith(f"{group}|"))
    rows = []
    for column in columns:
        row: Row = {"quantity": column.split("|")[1]}
        for name, table in tables.items():
            values = table[column].dropna().astype(float) if column in table else pd.Series(dtype=float)
            if len(values):
                low, median, high = np.percentile(values, [10, 50, 90])
                row |= {f"{name}_median": float(median), f"{name}_p10": float(low), f"{name}_p90": float(high)}
                row[f"{name}_radiographs"] = len(values)
        rows.append(row)
    return rows


def compare_ratios(records: Mapping[str, Sequence[Record]]) -> list[Row]:
    """Compare the outline ratios of each patient source with those of simulated radiographs.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Radiograph records of each source.

    Returns
    -------
    list of dict
        One row per patient source and ratio, with the columns of ``compare_samples``.
    """
    tables = _select_found_films(records)
    ours = tables.pop(SIMULATED, pd.DataFrame())
    rows = []
    for name, table in tables.items():
        for column in (column for column in table if column in ours and column.startswith(_RATIO_GROUPS)):
            values = [one[column].dropna().to_numpy(np.float64) for one in (table, ours)]
            if min(map(len, values)) > 1:
                rows.append({"source": name, "measure": column.split("|")[1]} | compare_samples(*values))
    return rows


def select_contact_sheet_films(records: Mapping[str, Sequence[Record]]) -> list[GradeSheet]:
    """Select radiographs of every source for one contact sheet per KL grade.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Radiograph records of each source.

    Returns
    -------
    list of tuple
        One entry per grade: the grade, and one contact-sheet row per source with a caption and evenly spaced records.
    """
    sheets = []
    for grade in sorted({int(one["grade"]) for of in records.values() for one in of}):
        rows = []
        for name, of in records.items():
            chosen = _select_evenly([one for one in of if one["status"] == "found" and int(one["grade"]) == grade])
            if chosen:
                rows.append((f"{name}, {_format_grade(grade)}", [(name, one) for one in chosen]))
        if rows:
            sheets.append((grade, rows))
    return sheets


def _make_contact_sheet_picture(
    grade: int, rows: Sequence[tuple[str, Sequence[DisplayedFilm]]], forms: Mapping[tuple[str, str], NormalisedImage]
) -> Picture:
    """Make the contact sheet of one grade."""
    return Picture(
        name=f"sheet_{'unknown' if grade < 0 else grade}",
        png=make_contact_sheet(
            [(caption, [forms[name, one["file"]] for name, one in chosen]) for caption, chosen in rows]
        ),
        alt=f"Patient and simulated radiographs, {_format_grade(grade)}, one row per source",
        caption=f"(e) {_format_grade(grade).capitalize()}: one row per source, same scale, all shown as right knees.",
    )


def format_summary(compared: SourceComparison) -> str:
    """Format the main results of the radiograph comparison in one line.

    Parameters
    ----------
    compared : SourceComparison
        Table rows that compare radiograph sources.

    Returns
    -------
    str
        AUCs of source separability and grade prediction, and correlations of grade effects, for models with all
        features.
    """
    parts = []
    for row in compared.domains:
        if row["group"] == ALL_FEATURES and "auc" in row and row["second"] == SIMULATED:
            parts.append(f"{row['first']} against simulated: AUC {row['auc']:.2f}")
    for row in compared.transfer:
        if row["group"] == ALL_FEATURES and "auc" in row:
            parts.append(
                f"{row['source']} {row['task']}: AUC {row['auc']:.2f} if trained on simulated, "
                f"{row['patient_auc']:.2f} trained on patient radiographs"
            )
    parts += [
        f"{row['source']} {row['task']}: grade effects r = {row['r']:+.2f}"
        for row in compared.groups
        if row["group"] == ALL_FEATURES
    ]
    return "; ".join(parts) or "too few radiographs for a comparison"


def _has_found_films(records: Sequence[Record]) -> bool:
    """Return whether the joint was localised on at least one radiograph."""
    return any(record["status"] == "found" for record in records)


def _select_evenly(records: Sequence[Record]) -> list[Record]:
    """Select up to six evenly spaced records from a list."""
    places = np.unique(np.linspace(0, len(records) - 1, min(_FILMS_PER_ROW, len(records))).round().astype(int))
    return [records[place] for place in places] if records else []


def _read_normalised_film(read_pixels: FilmReader, source: str, record: Record) -> NormalisedImage:
    """Read and normalise one radiograph for display."""
    return _normalise_film(read_pixels(source, record["file"]), record)


def _normalise_film(film: Array, record: Record) -> NormalisedImage:
    """Normalise a radiograph to 8 bits with the polarity, joint position, pixel pitch and binning in its record."""
    film = resample_to_square_pixels(film, float(record["pixel_height"]))
    bright = film if record["polarity"] == "bone bright" else 1 - film
    place = JointPosition(
        row=record["joint_row_px"], col=record["joint_col_px"], side=record["side"], pitch_mm=record["pitch_mm"]
    )
    return stretch_contrast(resample_joint_field(*bin_film(bright, place, float(record["binned"])))).astype(np.uint8)


def _format_grade(grade: int) -> str:
    """Format a grade for display; a negative grade means unknown."""
    return "grade unknown" if grade < 0 else f"grade {grade}"
