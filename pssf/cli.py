"""The command line: pssf simulate | meshes | cohort | study | accuracy | quality | protocols."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.status import Status
from rich.table import Table

from .core.checks import InputError, require_choice, require_seed, require_whole, require_workers
from .core.execution import Execution
from .core.parallel import cores
from .core.progress import bar
from .core.workers import WorkersLostError
from .data import tables
from .io.atomic import folder
from .model.knee import Knee, draw_knee, knee_from
from .radiomics.families import FAMILIES
from .study.settings import MODELS, SELECTIONS

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)

Out = Annotated[Path, typer.Option("--out", help="Folder for what is made; made if need be.")]
Seed = Annotated[int, typer.Option(help="Seed of all chance; the same seed gives the same bytes.")]
Grade = Annotated[int, typer.Option(help="KL-like grade of the drawn knee: 0, 1 or 2.")]
KneeFile = Annotated[Path | None, typer.Option("--knee", help="TOML file of a knee's parameters, instead of a draw.")]
Workers = Annotated[int, typer.Option(help="Processes or threads; they do not change the result.")]
Processes = Annotated[
    int,
    typer.Option(
        "--workers",
        default_factory=cores,
        show_default="all cores that this process may use",
        help="Processes of this machine, one thread each; they do not change the result.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:PORT",
        help="Dask scheduler whose workers make the radiographs, instead of processes of this machine; all must see "
        "--out under the same path and have the same pssf (extra: cluster).",
    ),
]
Engine = Annotated[str, typer.Option(help="Ray caster: embree or scanline; they agree, and scanline is faster.")]
Readme = Annotated[Path | None, typer.Option(help="Source checkout whose READMEs get the tables of what is measured.")]
Preset = Annotated[str, typer.Option(help="Cohort: quick (24 subjects) or paper (180 subjects).")]


def main() -> None:
    """Run the command line; bad input ends in one line and exit code 2."""
    try:
        sys.exit(app(standalone_mode=False))
    except InputError as error:
        print(f"pssf: {error}", file=sys.stderr)
        sys.exit(2)
    except typer.Abort:
        sys.exit(130)
    except WorkersLostError as error:
        print(f"pssf: {error}; run the same command to go on from there", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("pssf: stopped; run the same command to go on from there", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        # A misused option: the parser's own classes are private, their one-line message is not.
        if not hasattr(error, "format_message"):
            raise
        print(f"pssf: {error.format_message()}", file=sys.stderr)
        sys.exit(2)


@app.command()
def simulate(
    out: Out,
    grade: Grade = 0,
    protocol: Annotated[str, typer.Option(help="Protocol by name, or the path of a TOML file.")] = "reference",
    seed: Seed = 0,
    knee: KneeFile = None,
    engine: Engine = "embree",
    workers: Workers = 2,
    kinds: Annotated[
        str, typer.Option("--formats", help="Any of tif, png, json, dcm (two: linear, and for eyes), with commas.")
    ] = "tif,png,json",
    border: Annotated[str, typer.Option(help="none, or marked: collimator's edge and side, for eyes.")] = "none",
) -> None:
    """One radiograph: 16-bit TIFF, PNG for eyes, the parameters as JSON; DICOM if asked for."""
    from .io.images import BORDERS, KINDS, save_kinds
    from .model.protocol import load_protocol
    from .raycast import ENGINES
    from .simulation import simulate as run

    technique, wanted = load_protocol(protocol), kinds.split(",")
    require_choice("engine", engine, ENGINES)
    require_workers(workers)
    for kind in wanted:
        require_choice("formats", kind, KINDS)
    require_choice("border", border, BORDERS)
    subject, name = _knee_of(knee, grade, seed)
    folder(out)
    with _waiting("simulating; the first run after an installation compiles for some seconds more"):
        radiograph = run(subject, technique, seed=seed, engine=engine, workers=workers)
    stem = out / f"{name}_{technique.name}_seed{seed}"
    for path in save_kinds(radiograph, stem, wanted, border=border):
        print(path)


@app.command()
def meshes(
    out: Out,
    grade: Grade = 0,
    seed: Seed = 0,
    knee: KneeFile = None,
    kinds: Annotated[
        str, typer.Option("--formats", help="Any of stl, ply, glb, 3mf, with commas.")
    ] = "stl,ply,glb,3mf",
    tolerance_mm: Annotated[float, typer.Option(help="How far a surface may move to save triangles, mm.")] = 0.0,
) -> None:
    """The solids of a knee as STL, PLY, GLB and 3MF, in mm."""
    from .anatomy import build
    from .io.meshes import export_meshes

    subject, name = _knee_of(knee, grade, seed)
    kept = tuple(kinds.split(","))
    for path in export_meshes(build(subject).scene, out, formats=kept, stem=name, tolerance_mm=tolerance_mm):
        print(path)


cohort_app = typer.Typer(pretty_exceptions_enable=False)
app.add_typer(cohort_app, name="cohort")


@cohort_app.callback(invoke_without_command=True)
def cohort(
    context: typer.Context,
    workers: Processes,
    out: Annotated[Path | None, typer.Option(help="Folder for what is made; made if need be. Required.")] = None,
    preset: Preset = "quick",
    seed: Seed = 0,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
) -> None:
    """Radiographs of a whole cohort and their manifest.

    Goes on where an earlier run stopped or was killed, and ends with the same bytes: what stands is checked and kept.
    A folder that holds another cohort is refused, with the first difference.
    """
    from .cohort import make_cohort, plan_cohort

    if context.invoked_subcommand is not None:
        return
    if out is None:
        raise InputError("option --out is missing; allowed: a folder for the cohort")
    plan = plan_cohort(preset, seed=seed)
    total = sum(len(case.exposures) for case in plan.cases)
    with Execution(bar=bar).stage("radiographs", "radiographs", total) as stage:
        manifest = make_cohort(
            plan, out, workers=workers, scheduler=scheduler, engine=engine, progress=stage.advance, kept=stage.keep
        )
    print(f"manifest  {manifest}")


@cohort_app.command()
def verify(folder: Annotated[Path, typer.Argument(help="Folder that pssf cohort made.")]) -> None:
    """Check every file of a cohort against its hash; a line for each fault, and exit code 2 if there is one."""
    from .cohort import verify_cohort

    with _waiting("reading"):
        verified = verify_cohort(folder)
    for fault in verified.faults:
        print(fault)
    if verified.faults:
        raise typer.Exit(2)
    print(f"whole     {verified.radiographs} radiographs, {verified.files} files, as they were written")


@app.command()
def study(
    out: Out,
    workers: Processes,
    preset: Preset = "quick",
    seed: Seed = 0,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
    protocols: Annotated[
        str, typer.Option(help="Names or TOML files, with commas, instead of the preset's; the first may be alone.")
    ] = "",
    families: Annotated[str, typer.Option(help="Families of features, with commas.")] = ",".join(FAMILIES),
    selections: Annotated[str, typer.Option(help="Selections of features, with commas.")] = ",".join(SELECTIONS),
    models: Annotated[str, typer.Option(help="Models, with commas.")] = ",".join(MODELS),
    until: Annotated[str, typer.Option(help="report, or features: stop when they are measured.")] = "report",
    readme: Readme = None,
) -> None:
    """The whole study: cohort, regions, features, models, report; goes on where an earlier run stopped.

    What is left out costs nothing: protocols, families of features, selections, models.
    """
    from .experiment import SHOWN, make_experiment, measure_experiment, run_experiment, shown_rows
    from .io.readme import open_checkout

    require_choice("until", until, ("features", "report"))
    checkout = open_checkout(readme, SHOWN, preset=preset)
    execution = Execution(workers=workers, bar=bar, scheduler=scheduler)
    wanted = {"families": families, "selections": selections, "models": models}
    settings = {name: tuple(listed.split(",")) for name, listed in wanted.items()}
    cohort = {"protocols": protocols.split(",")} if protocols else None
    made = make_experiment(out, execution, preset=preset, seed=seed, engine=engine, cohort=cohort, settings=settings)
    if until == "features":
        print(f"features  {measure_experiment(made, execution)}")
        return
    result = run_experiment(made, execution)
    checkout.take(shown_rows(result) if readme else {}, result.pictures.values(), measured_with=result.report)
    print(f"results   of {result.origin}")
    print(f"report    {result.report}")
    for what, paths in (("picture", result.pictures), ("model", result.models)):
        for path in paths.values():
            print(f"{what:<10}{path}")


@app.command()
def accuracy(
    out: Out,
    tables: Annotated[
        str, typer.Option(help="Names with commas, or all; an unknown one is refused with those there are.")
    ] = "all",
    knees: Annotated[int, typer.Option(help="Random knees for the tables that draw some.")] = 30,
    workers: Workers = 2,
    readme: Readme = None,
) -> None:
    """Error against run time on this machine, as tables (CSV) and a figure."""
    from .accuracy import TABLES, measure

    require_whole("knees", knees, 1, 100_000, "")
    wanted = TABLES if tables == "all" else tuple(name.strip() for name in tables.split(","))
    with _waiting("measuring") as status:
        paths = measure(out, workers=workers, tables=wanted, knees=knees, readme=readme, progress=status.update)
    for path in paths:
        print(path)


@app.command()
def quality(
    out: Out,
    protocol: Annotated[str, typer.Option(help="Protocol by name, or the path of a TOML file.")] = "reference",
    readme: Readme = None,
) -> None:
    """A protocol measured beside references: beam, MTF, NPS, DQE, exposure; tables (CSV) and a figure."""
    from .io.readme import open_checkout
    from .model.protocol import load_protocol
    from .quality import measure_quality, write_quality

    technique = load_protocol(protocol)
    name = f"quality_{technique.name}"
    checkout = open_checkout(readme, [name])
    folder(out)
    with _waiting("measuring") as status:
        measured = measure_quality(technique, progress=status.update)
    table = Table("quantity", "value", "reference", "source")
    for row in measured.rows:
        known = f"{row['low']} to {row['high']}" if row["low"] != "" else str(row["reference"])
        table.add_row(row["quantity"], row["value"], known, row["source"])
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    paths = write_quality(measured, technique, out)
    for path in [*paths, *checkout.take({name: measured.rows}, paths)]:
        print(path)


@app.command()
def protocols(
    name: Annotated[str, typer.Argument(help="Protocol, by name or path, whose values to show.")] = "",
) -> None:
    """Fields of a protocol: what each is, its unit, what it may be, its default, where usual values come from."""
    from .model.protocol import field_rows, load_protocol, protocol_table

    values = protocol_table(load_protocol(name)) if name else {}
    if not name:
        print("protocols:", ", ".join(tables.protocol_names()))
    table = Table("field", *([name] if name else ["default"]), "unit", "allowed", "what", "source")
    for row in field_rows():
        shown = str(values[row["field"]]) if name else row["default"]
        table.add_row(row["field"], shown, row["unit"], row["allowed"], row["what"], row["source"])
    Console(width=None if sys.stdout.isatty() else 200).print(table)


def _knee_of(path: Path | None, grade: int, seed: int) -> tuple[Knee, str]:
    """A knee from a file, or drawn by grade and seed; and a name for its files."""
    require_seed(seed)
    if path is not None:
        return knee_from(tables.read_toml(path), f"knee {path.name}"), path.stem
    return draw_knee(grade=grade, rng=np.random.default_rng(seed)), f"knee_grade{grade}"


def _waiting(why: str) -> Status:
    """Says on standard error what is being waited for, while it lasts."""
    return Console(stderr=True).status(why)
