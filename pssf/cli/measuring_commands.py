"""Commands that measure or list: validate, quality, compare-patients, separability, protocols, knees."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .shared_options import (
    GradeTable,
    Out,
    Processes,
    ProtocolName,
    Seed,
    Workers,
)


def validate(
    *,
    out: Out,
    tables: Annotated[
        str,
        typer.Option(
            help="Names of tables, separated by commas, or all; an unknown name gives an error that lists all names."
        ),
    ] = "all",
    knees: Annotated[int, typer.Option(help="Number of sampled knees for each table that needs knees.")] = 30,
    workers: Workers = 2,
) -> None:
    """Measure numerical errors and run times on this machine, and write tables (CSV) and a figure."""
    from ..core.checks import require_integer
    from ..core.progress_display import show_status
    from ..io.run_record import start_run_record
    from ..validation import DEFAULT_TABLES, run_validation

    require_integer("knees", knees, 1, 100_000, "")
    wanted = DEFAULT_TABLES if tables == "all" else tuple(name.strip() for name in tables.split(","))
    record = start_run_record()
    with show_status("measuring") as shown:
        paths = run_validation(out, workers=workers, tables=wanted, knees=knees, progress=shown)
    for path in [*paths, record.save(out)]:
        print(path)


def quality(*, out: Out, protocol: ProtocolName = "reference") -> None:
    """Measure beam, MTF, NPS, DQE and exposure of a protocol, and compare them with reference values.

    The command writes tables (CSV) and a figure.
    """
    from rich.console import Console
    from rich.table import Table

    from ..core.progress_display import show_status
    from ..io.atomic_write import make_folder
    from ..io.run_record import start_run_record
    from ..model.protocol import load_protocol
    from ..quality import measure_quality, write_quality

    technique = load_protocol(protocol)
    record = start_run_record()
    make_folder(out)
    with show_status("measuring") as shown:
        measured = measure_quality(technique, progress=shown)
    table = Table("quantity", "value", "reference", "source")
    for row in measured.rows:
        known = f"{row['low']} to {row['high']}" if row["low"] != "" else str(row["reference"])
        table.add_row(row["quantity"], row["value"], known, row["source"])
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    paths = write_quality(measured, technique, out)
    for path in [*paths, record.save(out)]:
        print(path)


def compare_patients(
    *,
    out: Out,
    workers: Processes,
    films: Annotated[
        Path | None,
        typer.Option(
            help="Folder of patient radiographs, with one subfolder per grade (0 to 4) or with a CSV file. For several "
            "sources, a folder that contains one folder of this form per source."
        ),
    ] = None,
    bones: Annotated[
        Path | None,
        typer.Option(
            help="Bones of patients: an .npz file, or a folder of meshes in mm with subfolders femur, tibia, patella."
        ),
    ] = None,
    cohort: Annotated[
        Path | None,
        typer.Option(
            help="Cohort folder written by pssf cohort; its radiographs under --protocol provide the simulated "
            "contours."
        ),
    ] = None,
    protocol: ProtocolName = "reference",
    knees: Annotated[int, typer.Option(help="Number of sampled knees, distributed equally over the grades.")] = 200,
    grade_table: GradeTable = "population",
    seed: Seed = 0,
) -> None:
    """Compare simulated knees with bones, contours and radiographs of patients, and write one page and tables (CSV).

    A comparison with bones or radiographs runs only if its data are specified. Contours are always compared with
    published values; contours_sizes.csv contains joint space, plateau width and convergence by grade. An interrupted
    run continues where it stopped.
    """
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..io.run_record import start_run_record
    from ..patient_comparison.comparison_run import compare_with_patients
    from ..study import require_extra

    require_extra()
    record = start_run_record()
    execution = Execution(workers=workers, progress_bar=show_progress_bar)
    measured = compare_with_patients(
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
    record.save(out)
    for line in measured.summaries:
        print(line)
    print(f"page      {measured.page}")


def separability(
    *,
    out: Out,
    grade_table: GradeTable = "population",
    knees: Annotated[
        int,
        typer.Option(
            help="Total number of sampled knees, distributed equally over the grades; fewer knees give wider intervals."
        ),
    ] = 30_000,
    seed: Seed = 0,
) -> None:
    """Estimate how well JSW alone, or all knee parameters together, can separate the grades of a grade table.

    No image is made. Radiographs of the sampled knees cannot separate the grades better than the knee parameters do.
    The estimate uses the better of two classifiers, so it is a lower bound of the separability.
    """
    from rich.console import Console
    from rich.table import Table

    from ..core.progress_display import show_status
    from ..data.analysis.landmark_table import load_landmark_reference
    from ..io.atomic_write import make_folder
    from ..io.study_results import save_table
    from ..model.sampling.knee_sampling import load_knee_distributions
    from ..study import require_extra

    require_extra()
    from ..study.learn.grade_separability import estimate_separability

    with show_status("sampling and fitting"):
        measured = estimate_separability(
            load_knee_distributions(grade_table), load_landmark_reference().gap_alone_auc, knees=knees, seed=seed
        )
    shown = Table("grades", "parameters", "method", "knees", "AUC", "95 %", "minimum JSW on patient radiographs")
    for row in measured.to_dict("records"):
        patient_auc = "" if row["patient_auc"] != row["patient_auc"] else f"{row['patient_auc']:.2f}"
        interval = f"{row['low']:.2f} to {row['high']:.2f}"
        shown.add_row(
            row["grades"],
            row["parameters"],
            row["method"],
            str(row["knees"]),
            f"{row['auc']:.3f}",
            interval,
            patient_auc,
        )
    Console(width=None if sys.stdout.isatty() else 160).print(shown)
    path = make_folder(out) / "separability.csv"
    save_table(path, measured)
    print(path)


def protocols(
    name: Annotated[
        str, typer.Argument(help="Protocol (name or TOML file) whose values are shown as the defaults.")
    ] = "",
    *,
    detector: Annotated[
        str, typer.Option(metavar="<name>", help="Instead, list the fields of a detector (name or TOML file).")
    ] = "",
) -> None:
    """List the fields of a protocol with meaning, unit, allowed values, default and source of typical values."""
    from ..data.data_files import list_protocols
    from ..model.detector import load_detector
    from ..model.field_listing import list_fields
    from ..model.protocol import load_protocol, protocol_to_dict

    if detector:
        own = asdict(load_detector(detector))
        _print_fields([row | {"default": str(own[row["field"]])} for row in list_fields("detector")])
        return
    values = protocol_to_dict(load_protocol(name)) if name else {}
    if not name:
        _print_wrapped(f"protocols: {', '.join(list_protocols())}")
    _print_fields([row | {"default": str(values.get(row["field"], row["default"]))} for row in list_fields("protocol")])


def knees(
    *,
    template: Annotated[
        bool, typer.Option("--template", help="Instead, print a template of the TOML file for --knee.")
    ] = False,
) -> None:
    """List the fields of a knee with meaning, unit, allowed values, default and source of typical values."""
    from ..model.field_listing import format_knee_template, list_fields

    if template:
        print(format_knee_template(), end="")
        return
    _print_fields(list_fields("knee"))


def _print_fields(rows: "list[dict[str, str]]") -> None:
    """Print fields in one column, which fits terminals of any width."""
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        shown = f" = {row['default']}{unit}" if row["default"] else unit
        _print_wrapped(f"{row['field']}{shown}  [{row['allowed']}]")
        _print_wrapped("; ".join(text for text in (row["what"], row["source"]) if text), "    ")


def _print_wrapped(text: str, indent: str = "") -> None:
    """Print a text with lines of at most 79 characters."""
    from textwrap import fill

    print(fill(text, 79, initial_indent=indent, subsequent_indent=indent or "    "))
