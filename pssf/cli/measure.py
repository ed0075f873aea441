"""Commands that measure or tell: accuracy, quality, realism, grades, protocols, knees."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .options import GradeTable, Out, Processes, ProtocolName, Readme, Seed, Workers


def accuracy(
    *,
    out: Out,
    tables: Annotated[
        str, typer.Option(help="Names with commas, or all; an unknown one is refused with those there are.")
    ] = "all",
    knees: Annotated[int, typer.Option(help="Random knees for the tables that draw some.")] = 30,
    workers: Workers = 2,
    readme: Readme = None,
) -> None:
    """Error against run time on this machine, as tables (CSV) and a figure."""
    from ..accuracy import TABLES, measure
    from ..core.checks import require_whole
    from ..core.progress import waiting

    require_whole("knees", knees, 1, 100_000, "")
    wanted = TABLES if tables == "all" else tuple(name.strip() for name in tables.split(","))
    with waiting("measuring") as shown:
        paths = measure(out, workers=workers, tables=wanted, knees=knees, readme=readme, progress=shown)
    for path in paths:
        print(path)


def quality(*, out: Out, protocol: ProtocolName = "reference", readme: Readme = None) -> None:
    """A protocol measured beside references: beam, MTF, NPS, DQE, exposure; tables (CSV) and a figure."""
    from rich.console import Console
    from rich.table import Table

    from ..core.progress import waiting
    from ..io.atomic import folder
    from ..io.readme import open_checkout
    from ..model.protocol import load_protocol
    from ..quality import measure_quality, write_quality

    technique = load_protocol(protocol)
    name = f"quality_{technique.name}"
    checkout = open_checkout(readme, [name])
    folder(out)
    with waiting("measuring") as shown:
        measured = measure_quality(technique, progress=shown)
    table = Table("quantity", "value", "reference", "source")
    for row in measured.rows:
        known = f"{row['low']} to {row['high']}" if row["low"] != "" else str(row["reference"])
        table.add_row(row["quantity"], row["value"], known, row["source"])
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    paths = write_quality(measured, technique, out)
    for path in [*paths, *checkout.take({name: measured.rows}, paths)]:
        print(path)


def realism(
    *,
    out: Out,
    workers: Processes,
    films: Annotated[
        Path | None,
        typer.Option(help="Folder of real films: folders 0 to 4 by grade, or a CSV; or folders of such, one a source."),
    ] = None,
    bones: Annotated[
        Path | None, typer.Option(help="Real bones: an .npz, or folders femur, tibia, patella of meshes in mm.")
    ] = None,
    cohort: Annotated[
        Path | None,
        typer.Option(help="Folder that pssf cohort made: contours are of its radiographs under the protocol."),
    ] = None,
    protocol: ProtocolName = "reference",
    knees: Annotated[int, typer.Option(help="Knees that are drawn, the grades alike.")] = 200,
    grade_table: GradeTable = "population",
    seed: Seed = 0,
    readme: Readme = None,
) -> None:
    """Simulated knees beside real bones, contours and films: one page, and tables (CSV); goes on where a run stopped.

    Each part is measured where its material is given; contours stand beside published ones always: joint gaps, plateau
    and convergence by grade in contours_sizes.csv.
    """
    from ..core.execution import Execution
    from ..core.progress import bar
    from ..io.readme import open_checkout
    from ..realism.run import PICTURED, SHOWN, measure, shown_as
    from ..study import require_extra

    require_extra()
    given = {"contours": True, "bones": bones is not None, "films": films is not None}
    shown = shown_as([name for part, names in SHOWN.items() if given[part] for name in names], grade_table)
    checkout = open_checkout(readme, shown, protocol=protocol, knees=knees, sample=_sample(cohort, protocol, knees))
    execution = Execution(workers=workers, bar=bar)
    measured = measure(
        out,
        execution,
        films=films,
        bones_folder=bones,
        cohort=cohort,
        protocol=protocol,
        knees=knees,
        grade_table=grade_table,
        seed=seed,
    )
    pictures = measured.paths if grade_table == PICTURED else []
    checkout.take({place: measured.rows.get(name, []) for place, name in shown.items()}, pictures)
    for line in measured.lines:
        print(line)
    print(f"page      {measured.page}")


def _sample(cohort: Path | None, protocol: str, knees: int) -> str:
    """Options that say whose contours are seen: a cohort's, of which the folder's name is told, or drawn knees'."""
    under = f"--protocol {protocol}"
    return f"{under} --knees {knees}" if cohort is None else f"--cohort {cohort.resolve().name} {under}"


def grades(
    *,
    out: Out,
    grade_table: GradeTable = "population",
    knees: Annotated[int, typer.Option(help="Knees that are drawn, the grades alike; fewer tell less.")] = 30_000,
    seed: Seed = 0,
) -> None:
    """How well a table's grades can be told at best, from what its knees are built with: the joint space, or all of it.

    No image is made. A study of radiographs of such knees can do no better than its knees' parameters say, which tell
    grades at least as well as the better of two fits to them.
    """
    from rich.console import Console
    from rich.table import Table

    from ..core.progress import waiting
    from ..data.landmarks import landmark_reference
    from ..io.atomic import folder
    from ..io.results import save_table
    from ..model.draw import draw_laws
    from ..study import require_extra

    require_extra()
    from ..study.learn.separability import separability

    with waiting("drawing and fitting"):
        measured = separability(draw_laws(grade_table), landmark_reference().gap_alone_auc, knees=knees, seed=seed)
    shown = Table("grades", "known", "how", "knees", "AUC", "95 %", "smaller gap on people's films")
    for row in measured.to_dict("records"):
        people = "" if row["people"] != row["people"] else f"{row['people']:.2f}"
        interval = f"{row['low']:.2f} to {row['high']:.2f}"
        shown.add_row(row["grades"], row["known"], row["how"], str(row["knees"]), f"{row['auc']:.3f}", interval, people)
    Console(width=None if sys.stdout.isatty() else 160).print(shown)
    path = folder(out) / "separability.csv"
    save_table(path, measured)
    print(path)


def protocols(
    name: Annotated[str, typer.Argument(help="Protocol, by name or path, whose values to show.")] = "",
) -> None:
    """Fields of a protocol: what each is, its unit, what it may be, its default, where usual values come from."""
    from ..data.tables import protocol_names
    from ..model.listing import field_rows
    from ..model.protocol import load_protocol, protocol_table

    values = protocol_table(load_protocol(name)) if name else {}
    if not name:
        _wrapped(f"protocols: {', '.join(protocol_names())}")
    _listed([row | {"default": str(values.get(row["field"], row["default"]))} for row in field_rows("protocol")])


def knees(
    *,
    template: Annotated[bool, typer.Option("--template", help="A TOML file to fill in, for --knee, instead.")] = False,
) -> None:
    """Fields of a knee: what each is, its unit, what it may be, its default, where usual values come from."""
    from ..model.listing import field_rows, knee_template

    if template:
        print(knee_template(), end="")
        return
    _listed(field_rows("knee"))


def _listed(rows: "list[dict[str, str]]") -> None:
    """Fields one below the other, in the width of any terminal."""
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        shown = f" = {row['default']}{unit}" if row["default"] else unit
        _wrapped(f"{row['field']}{shown}  [{row['allowed']}]")
        _wrapped("; ".join(text for text in (row["what"], row["source"]) if text), "    ")


def _wrapped(text: str, indent: str = "") -> None:
    from textwrap import fill

    print(fill(text, 79, initial_indent=indent, subsequent_indent=indent or "    "))
