"""Commands that make something: simulate, meshes, cohort."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    Bilateral,
    CohortGrades,
    Engine,
    Grade,
    GradeTable,
    KneeChoice,
    KneeCounts,
    KneeFile,
    Matrix,
    Out,
    Preset,
    Processes,
    ProtocolName,
    Scheduler,
    Seed,
    Settings,
    Workers,
    cohort_overrides,
    knee_of,
    subject_of,
    taken_as,
    tell_cropped,
)

if TYPE_CHECKING:
    from ..geometry.scene import Scene
    from ..model.protocol import Protocol


def simulate(
    *,
    out: Out,
    grade: Grade = 0,
    grade_table: GradeTable = "population",
    protocol: ProtocolName = "reference",
    seed: Seed = 0,
    knee: KneeFile = None,
    engine: Engine = "embree",
    workers: Workers = 2,
    kinds: Annotated[
        str, typer.Option("--formats", help="Any of tif, png, json, dcm (two: linear, and for eyes), with commas.")
    ] = "tif,png,json",
    border: Annotated[
        str, typer.Option(help="none, or marked: collimator's edge and side marker in what is for eyes.")
    ] = "none",
    look: Annotated[
        str, typer.Option(help="Of what is for eyes: processed as a flat panel's software, linear, or film.")
    ] = "processed",
    exposure: Annotated[
        str, typer.Option(help="fixed, or drawn: centring, turn, beam, kV, mAs, field, marker vary with the seed.")
    ] = "fixed",
    masks: Annotated[
        bool, typer.Option("--masks", help="Masks of bones and osteophytes too: TIFF, and DICOM if that is asked for.")
    ] = False,
    settings: Settings = None,
    matrix: Matrix = 0,
    scene: Annotated[
        Path | None,
        typer.Option(
            help="TOML file that names meshes of your own, in mm, instead of a knee: a table [[surface]] for "
            "each, with file, inside, outside."
        ),
    ] = None,
) -> None:
    """One radiograph: 16-bit TIFF, PNG for eyes, the parameters as JSON; DICOM if asked for.

    Of both knees of a person under a protocol that takes both.
    """
    from ..core.checks import require_choice, require_workers
    from ..core.progress import waiting
    from ..model.listing import changes, with_changes
    from ..model.protocol import load_protocol

    of_knee, of_protocol = changes(settings or ())
    meant, wanted = load_protocol(protocol), kinds.split(",")
    choice = KneeChoice(knee, grade, seed, grade_table, of_knee, scene)
    subject, name = subject_of(choice, with_changes(meant, of_protocol))
    technique = with_changes(taken_as(exposure, meant, subject, seed), of_protocol)
    technique = technique.resampled(matrix) if matrix else technique
    tell_cropped(of_protocol)
    require_workers(workers)
    _require_known(scene is not None, subject, masks, border)
    with waiting("simulating; the first run after an installation compiles for some seconds more"):
        from ..detector import LOOKS
        from ..geometry.scene import Scene
        from ..io.atomic import folder
        from ..io.images import BORDERS, KINDS, save_kinds
        from ..io.masks import save_masks
        from ..raycast import ENGINES
        from ..simulation import simulate as run

        require_choice("engine", engine, ENGINES)
        for kind in wanted:
            require_choice("formats", kind, KINDS)
        require_choice("border", border, BORDERS)
        require_choice("look", look, LOOKS)
        if isinstance(subject, Scene):
            _tell_noted(subject, technique)
        folder(out)
        keep = ("masks",) if masks else ()
        radiograph = run(subject, technique, rng=seed, keep=keep, engine=engine, workers=workers)
    stem = out / f"{name}_{technique.name}_seed{seed}"
    paths = save_kinds(radiograph, stem, wanted, border=border, look=look)
    if masks:
        paths += [save_masks(radiograph, f"{stem}_masks.{kind}") for kind in ("tif", "dcm") if kind in ("tif", *wanted)]
    for path in paths:
        print(path)


def _require_known(own: bool, subject: object, masks: bool, border: str) -> None:
    """Refuse what only a knee has, of a scene of one's own; and what only one has, of both."""
    from ..core.checks import InputError
    from ..model.knee import Knee

    if masks and own:
        raise InputError("masks = of a scene; allowed: of a knee, or of both")
    if border != "none" and not isinstance(subject, Knee):
        raise InputError(f"border = {border!r} of {'a scene' if own else 'both knees'}; allowed: of one knee")


def _tell_noted(scene: "Scene", protocol: "Protocol") -> None:
    """What is traced as it is, and may not be what was meant, a line each."""
    from ..raycast.check import COVERS_NO_PIXEL, check

    faults = [fault for fault in check(scene, protocol).faults if fault.outcome == "noted"]
    unseen = [fault for fault in faults if fault.what == COVERS_NO_PIXEL]
    for fault in faults:
        # Of a scene that is outside the field of view as a whole `simulate` warns once.
        if fault not in unseen or len(unseen) < len(scene.surfaces):
            print(f"pssf: noted: {fault}", file=sys.stderr)


def meshes(
    *,
    out: Out,
    grade: Grade = 0,
    grade_table: GradeTable = "population",
    seed: Seed = 0,
    knee: KneeFile = None,
    kinds: Annotated[
        str, typer.Option("--formats", help="Any of stl, ply, glb, 3mf, with commas.")
    ] = "stl,ply,glb,3mf",
    settings: Settings = None,
    tolerance_mm: Annotated[float, typer.Option(help="How far a surface may move to save triangles, mm.")] = 0.0,
) -> None:
    """The solids of a knee as STL, PLY, GLB and 3MF, in mm."""
    from ..anatomy import build
    from ..core.checks import InputError
    from ..io.atomic import folder
    from ..io.meshes import export_meshes, require_export
    from ..model.listing import changes

    of_knee, of_protocol = changes(settings or ())
    if of_protocol:
        raise InputError(f"set = {', '.join(of_protocol)}; allowed: fields of a knee, since no radiograph is made")
    subject, name = knee_of(KneeChoice(knee, grade, seed, grade_table, of_knee))
    formats = tuple(kinds.split(","))
    require_export(formats, tolerance_mm)
    folder(out)
    for path in export_meshes(build(subject).scene, out, formats=formats, stem=name, tolerance_mm=tolerance_mm):
        print(path)


cohort_app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)


@cohort_app.callback(invoke_without_command=True)
def cohort(
    context: typer.Context,
    *,
    workers: Processes,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for what is made; made if need be. Required.")
    ] = None,
    preset: Preset = "quick",
    seed: Seed = 0,
    knees: KneeCounts = "",
    bilateral: Bilateral = -1,
    protocols: Annotated[str, typer.Option(help="Names or TOML files, with commas, instead of the preset's.")] = "",
    grade_table: CohortGrades = "",
    exposures: Annotated[
        str, typer.Option(help="fixed, or drawn: each taking a little other; instead of the preset's.")
    ] = "",
    masks: Annotated[bool, typer.Option("--masks", help="Masks of bones and osteophytes too, as TIFF.")] = False,
    settings: Settings = None,
    matrix: Matrix = 0,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
) -> None:
    """Radiographs of a whole cohort and their manifest; one's own by --knees, --protocols and --grade-table.

    Goes on where an earlier run stopped or was killed, and ends with the same bytes: what stands is checked and kept.
    A folder that holds another cohort is refused, with the first difference.
    """
    if context.invoked_subcommand is not None:
        return
    from ..cohort import make_cohort, plan_cohort
    from ..core.checks import InputError
    from ..core.execution import Execution
    from ..core.progress import bar
    from ..model.listing import changes

    if out is None:
        raise InputError("out = none; allowed: a folder for the cohort (--out)")
    tell_cropped(changes(settings or ())[1])
    overrides = cohort_overrides(knees, bilateral, protocols, grade_table, exposures, matrix=matrix, settings=settings)
    plan = plan_cohort(preset, seed=seed, overrides=overrides, masks="tif" if masks else "none")
    total = sum(len(case.exposures) for case in plan.cases)
    with Execution(bar=bar).stage("radiographs", "radiographs", total) as stage:
        manifest = make_cohort(
            plan, out, workers=workers, scheduler=scheduler, engine=engine, progress=stage.advance, kept=stage.keep
        )
    print(f"manifest  {manifest}")
    table = plan.cases[0].grade_table
    print(f"grades    {table}; how well they can be separated at best: pssf grades --grade-table {table}")


@cohort_app.command()
def verify(folder: Annotated[Path, typer.Argument(help="Folder that pssf cohort made.")]) -> None:
    """Check every file of a cohort against its hash; a line for each fault, and exit code 2 if there is one."""
    from ..cohort import verify_cohort
    from ..core.progress import waiting

    with waiting("reading"):
        verified = verify_cohort(folder)
    for fault in verified.faults:
        print(fault)
    if verified.faults:
        raise typer.Exit(2)
    print(f"whole     {verified.radiographs} radiographs, {verified.files} files, as they were written")


@cohort_app.command()
def labels(folder: Annotated[Path, typer.Argument(help="Folder that pssf cohort made.")], *, out: Out) -> None:
    """Labels of a cohort as the field reads them: a CSV with the OAI's columns, .pts, COCO, and pictures by grade."""
    from ..cohort import write_labels
    from ..core.progress import waiting

    with waiting("reading"):
        paths = write_labels(folder, out)
    for path in paths:
        print(path)
