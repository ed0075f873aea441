"""The part on films: what the records of real and simulated ones say, as tables and figures of the page."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.execution import Execution
from ..core.parallel import ordered_map
from ..radiomics.aspect import with_square_pixels
from ..study.report.page import Picture
from .blind import blind_choice, blind_test
from .domains import ALL, Films, learnable, told_apart, transferred
from .effects import effects
from .films import EDGES, FINE, TONE, Record
from .form import Place, field_of, made_smaller, stretched
from .forms import beside
from .page import Section, Table
from .sheets import sheet

Row = dict[str, Any]
# A reading of a film in display values, bone bright; by source and file.
Reading = Callable[[str, str], Array]
# Two sources, and the grades that are told from grade 0; none where the sources are told apart.
Pairing = tuple[str, str, tuple[int, ...]]
# A film in the standard form, as it is shown.
Form = NDArray[np.uint8]
# Source of a film, and its record.
Shown = tuple[str, Record]
# A grade, and its rows of films under their captions.
SheetOfGrade = tuple[int, list[tuple[str, list[Shown]]]]
SIMULATED = "simulated"
# What is to be told apart: grade 0 from these.
TASKS = ((2,), (3, 4))
_A_SHEET = 6
# Groups of features that are ratios of the outlines.
_RATIOS = ("shape|", "margins|")
_TEXT = (
    "Every film, real or simulated, is searched for its joint, turned into a right knee and brought to one size of the "
    "plateau (78 mm), one pitch (0.46 mm; simulated films first to pixels as large as those of most real ones), one "
    "field (92 by 77 mm) and one histogram (8 bits between the 1st and 99th percentile); its contours are traced, and "
    "groups of features measured. Models are logistic regressions (L2) on standardised features. Intervals are 95 per "
    "cent, from a bootstrap of subjects with the models held: they hold the chance of which films were tested, and are "
    "wide where films are few."
)
_CAPTIONS = {
    "domains": "(a) Real against simulated, and real against real as a control: 0.5 is alike, 1 told apart always.",
    "transfer": "(b) Grades on real films, learnt from simulated ones, beside the same learnt from real ones by folds; "
    "way is the share of what lies between chance and these, where real films teach anything for sure.",
    "effects": "(c) Standardised differences between grades, real against simulated, over the features of a group: "
    "correlation and share of equal signs; most is the correlation that so many films could show.",
    "ratios": "(d) Ratios of the outlines in shares of the plateau's width, of all films of a source and of the "
    "simulated ones: those of another view differ by the view.",
    "tone": "(d) Tone, in the display's values: contrasts, and greys with soft tissue as 0 and the shaft's cortex as 1 "
    "where a film holds the shaft; how far the joint is from the film's middle, mm at the joint (of crops that is who "
    "cropped them), and the mean grey about it.",
    "edges": "(d) Brightness across the sides of the bones, so many mm inwards of where it is steepest, soft tissue as "
    "0 and what is 6 to 12 mm in as 1; and the strongest line on either side, over the spread of ridges.",
    "fine": "(d) Texture at the film's own pitch, where that is 0.25 mm or less.",
    "form": "(d) Texture in the standard form, 0.2 to 0.8 cycles/mm.",
}


class Comparison(NamedTuple):
    """Rows of what was compared.

    domains   of `told_apart`
    transfer  of `transferred`
    features  effects of each feature, of `effects`
    groups    effects of each group, of `effects`
    """

    domains: list[Row]
    transfer: list[Row]
    features: list[Row]
    groups: list[Row]


_NOTHING = Comparison(domains=[], transfer=[], features=[], groups=[])


def films_section(
    records: Mapping[str, Sequence[Record]],
    read: Reading,
    execution: Execution,
    *,
    replicates: int = 1000,
    seed: int = 0,
) -> Section:
    """What films say; the simulated ones are called SIMULATED, all others are real.

    records    source -> one record a film, as `measure_films` gives them
    execution  whose processes compare sources and read the films that are shown; with more than one, `read` must be
               picklable
    """
    sheets, order = contact_sheets(records), blind_choice(records, SIMULATED, seed)
    shown = [*order, *(one for _, rows in sheets for _, chosen in rows for one in chosen)]
    compared, forms = _made(records, shown, read, execution, replicates=replicates, seed=seed)
    fates, (figures, key) = found_rows(records), blind_test(order, lambda name, one: forms[name, one["file"]])
    tables = (
        Table(name="films_found", rows=fates, caption="Films of each source, and what became of them."),
        Table(name="films_domains", rows=compared.domains, caption=_CAPTIONS["domains"]),
        Table(name="films_transfer", rows=compared.transfer, caption=_CAPTIONS["transfer"]),
        Table(name="films_effects", rows=compared.groups, caption=_CAPTIONS["effects"]),
        Table(name="films_effects_of_features", rows=compared.features, caption="(c) Of every feature.", shown=12),
        Table(name="films_ratios", rows=ratio_rows(records), caption=_CAPTIONS["ratios"], shown=31),
        Table(name="films_tone", rows=quantity_rows(records, TONE), caption=_CAPTIONS["tone"]),
        Table(name="films_edges", rows=quantity_rows(records, EDGES), caption=_CAPTIONS["edges"], shown=29),
        Table(name="films_texture", rows=quantity_rows(records, FINE), caption=_CAPTIONS["fine"]),
        Table(name="films_form_texture", rows=quantity_rows(records, "texture"), caption=_CAPTIONS["form"], shown=40),
        *key,
    )
    return Section(
        name="Films",
        line=summary_line(compared),
        text=_TEXT,
        tables=tuple(table for table in tables if table.rows),
        figures=(*(_drawn(grade, rows, forms) for grade, rows in sheets), *figures),
        facts={
            "found": fates, "domains": compared.domains, "transfer": compared.transfer, "effects": compared.groups,
        },
    )  # fmt: skip


def _made(
    records: Mapping[str, Sequence[Record]],
    shown: Sequence[Shown],
    read: Reading,
    execution: Execution,
    *,
    replicates: int,
    seed: int,
) -> tuple[Comparison, dict[tuple[str, str], Form]]:
    """What sources say of each other, and films as they are shown, by source and file: all by the same processes."""
    measured = {name: learnable(name, of) for name, of in records.items() if _any_measured(of)}
    comparing = [
        partial(_compared, pair, measured=measured, replicates=replicates, seed=seed) for pair in _pairings(measured)
    ]
    films = {(name, one["file"]): one for name, one in shown}
    showing = [partial(_read_form, read, name, one) for (name, _), one in films.items()]
    # A process of its own has one thread for linear algebra: small models take three times as long on two.
    made = ordered_map(_run, [*comparing, *showing], shared={}, workers=execution.workers)
    compared = made[: len(comparing)]
    rows = ([row for rows in one for row in rows] for one in zip(_NOTHING, *compared, strict=True))
    return Comparison(*rows), dict(zip(films, made[len(comparing) :], strict=True))


def _run(part: Callable[[], Any]) -> Any:
    return part()


def _pairings(measured: Mapping[str, Films]) -> list[Pairing]:
    """Every real source against the simulated films, and against every other real one."""
    real = [name for name in measured if name != SIMULATED]
    pairs: list[Pairing] = []
    for name in real if SIMULATED in measured else ():
        grades = measured[name].grades
        pairs.append((name, SIMULATED, ()))
        pairs += [
            (name, SIMULATED, high) for high in TASKS if np.isin(grades, [0]).any() and np.isin(grades, high).any()
        ]
    return pairs + [(name, other, ()) for index, name in enumerate(real) for other in real[index + 1 :]]


def _compared(pair: Pairing, *, measured: Mapping[str, Films], replicates: int, seed: int) -> Comparison:
    """Two sources told apart, or where grades are named what is learnt on the second carried over to the first."""
    name, other, high = pair
    first, second = measured[name], measured[other]
    chance = {"replicates": replicates, "seed": seed}
    if not high:
        return _NOTHING._replace(domains=told_apart(first, second, **chance))
    carried = transferred(first, second, low=0, high=high, **chance)
    of_features, of_groups = effects(first, second, low=0, high=high, **chance)
    return Comparison(domains=[], transfer=carried, features=of_features, groups=of_groups)


def found_rows(records: Mapping[str, Sequence[Record]]) -> list[Row]:
    """One row a source: films, those found, those refused by reason, and where their pitch is from."""
    rows = []
    for name, of in records.items():
        status = pd.Series([record["status"] for record in of]).value_counts()
        row: Row = {"source": name, "films": len(of), "found": int(status.get("found", 0))}
        row |= {reason: int(count) for reason, count in sorted(status.items()) if reason != "found"}
        pitch = [record["pixel_mm"] for record in of if record["status"] == "found"]
        row["pixel_mm_median"] = round(float(np.median(pitch)), 4) if pitch else None
        row["pixel_estimated"] = sum(record.get("pixel_from") == "plateau" for record in of)
        rows.append(row)
    return rows


def _found_tables(records: Mapping[str, Sequence[Record]]) -> dict[str, pd.DataFrame]:
    """Source -> its films with a joint found."""
    return {name: pd.DataFrame([one for one in of if one["status"] == "found"]) for name, of in records.items()}


def quantity_rows(records: Mapping[str, Sequence[Record]], group: str) -> list[Row]:
    """One row a quantity of a group: median, 10th and 90th percentile and count in each source."""
    tables = _found_tables(records)
    columns = dict.fromkeys(column for table in tables.values() for column in table if column.startswith(f"{group}|"))
    rows = []
    for column in columns:
        row: Row = {"quantity": column.split("|")[1]}
        for name, table in tables.items():
            values = table[column].dropna().astype(float) if column in table else pd.Series(dtype=float)
            if len(values):
                low, median, high = np.percentile(values, [10, 50, 90])
                row |= {f"{name}_median": float(median), f"{name}_p10": float(low), f"{name}_p90": float(high)}
                row[f"{name}_films"] = len(values)
        rows.append(row)
    return rows


def ratio_rows(records: Mapping[str, Sequence[Record]]) -> list[Row]:
    """One row a ratio of the outlines and a real source, beside the simulated films; see `forms.beside`."""
    tables = _found_tables(records)
    ours = tables.pop(SIMULATED, pd.DataFrame())
    rows = []
    for name, table in tables.items():
        for column in (column for column in table if column in ours and column.startswith(_RATIOS)):
            values = [one[column].dropna().to_numpy(np.float64) for one in (table, ours)]
            if min(map(len, values)) > 1:
                rows.append({"source": name, "measure": column.split("|")[1]} | beside(*values))
    return rows


def contact_sheets(records: Mapping[str, Sequence[Record]]) -> list[SheetOfGrade]:
    """Of each grade its rows: films of every source, spread over the list."""
    sheets = []
    for grade in sorted({int(one["grade"]) for of in records.values() for one in of}):
        rows = []
        for name, of in records.items():
            chosen = _spread([one for one in of if one["status"] == "found" and int(one["grade"]) == grade])
            if chosen:
                rows.append((f"{name}, {_called(grade)}", [(name, one) for one in chosen]))
        if rows:
            sheets.append((grade, rows))
    return sheets


def _drawn(grade: int, rows: Sequence[tuple[str, Sequence[Shown]]], forms: Mapping[tuple[str, str], Form]) -> Picture:
    return Picture(
        name=f"sheet_{'unknown' if grade < 0 else grade}",
        png=sheet([(caption, [forms[name, one["file"]] for name, one in chosen]) for caption, chosen in rows]),
        alt=f"Real and simulated knees, {_called(grade)}, in rows",
        caption=f"(e) {_called(grade).capitalize()}: a row a source, one scale, all as right knees.",
    )


def summary_line(compared: Comparison) -> str:
    """What the part found, in one line."""
    parts = []
    for row in compared.domains:
        if row["group"] == ALL and "auc" in row and row["second"] == SIMULATED:
            parts.append(f"{row['first']} told from simulated with AUC {row['auc']:.2f}")
    for row in compared.transfer:
        if row["group"] == ALL and "auc" in row:
            parts.append(
                f"{row['source']} {row['task']} learnt from simulated {row['auc']:.2f}, from real {row['real_auc']:.2f}"
            )
    parts += [
        f"{row['source']} {row['task']} effects r = {row['r']:+.2f}" for row in compared.groups if row["group"] == ALL
    ]
    return "; ".join(parts) or "too few films to say anything"


def _any_measured(records: Sequence[Record]) -> bool:
    return any(record["status"] == "found" for record in records)


def _spread(records: Sequence[Record]) -> list[Record]:
    """A few of a list, evenly spread over it."""
    places = np.unique(np.linspace(0, len(records) - 1, min(_A_SHEET, len(records))).round().astype(int))
    return [records[place] for place in places] if records else []


def _read_form(read: Reading, source: str, record: Record) -> Form:
    return _form(read(source, record["file"]), record)


def _form(film: Array, record: Record) -> Form:
    film = with_square_pixels(film, float(record["pixel_height"]))
    bright = film if record["polarity"] == "bone bright" else 1 - film
    place = Place(
        row=record["joint_row_px"], col=record["joint_col_px"], side=record["side"], pitch_mm=record["pitch_mm"]
    )
    return stretched(field_of(*made_smaller(bright, place, float(record["binned"])))).astype(np.uint8)


def _called(grade: int) -> str:
    return "grade unknown" if grade < 0 else f"grade {grade}"
