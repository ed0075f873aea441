"""Commands that write radiographs or meshes: simulate, meshes, cohort."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .shared_options import (
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
    make_knee,
    make_subject,
    resolve_acquisition,
    warn_of_cropped_field,
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
        str,
        typer.Option(
            "--formats",
            help="Formats, separated by commas: tif, png, json, dcm. dcm writes a linear file and a file for display.",
        ),
    ] = "tif,png,json",
    border: Annotated[
        str,
        typer.Option(
            help="none or marked; marked draws the collimator edge and the side marker on images for display."
        ),
    ] = "none",
    processing: Annotated[
        str,
        typer.Option(help="Display processing: processed (similar to a flat-panel system), log or film."),
    ] = "processed",
    acquisition: Annotated[
        str,
        typer.Option(
            help="fixed or sampled; sampled varies centring, rotation, beam, kV, mAs, field and marker with the seed."
        ),
    ] = "fixed",
    masks: Annotated[
        bool,
        typer.Option(
            "--masks", help="Also write masks of bones and osteophytes: TIFF, and DICOM if dcm is among the formats."
        ),
    ] = False,
    settings: Settings = None,
    matrix: Matrix = 0,
    scene: Annotated[
        Path | None,
        typer.Option(
            help="TOML file that lists your own meshes in mm, which replace the knee. Each mesh has a table "
            "[[surface]] with the keys file, inside and outside."
        ),
    ] = None,
) -> None:
    """Simulate one radiograph, and write a 16-bit TIFF, a PNG for display, a JSON of parameters, and optionally DICOM.

    With a bilateral protocol, the radiograph shows both knees of one subject.
    """
    from ..core.checks import require_choice, require_workers
    from ..core.progress_display import show_status
    from ..model.field_listing import apply_settings, parse_settings
    from ..model.protocol import load_protocol

    of_knee, of_protocol = parse_settings(settings or ())
    meant, wanted = load_protocol(protocol), kinds.split(",")
    choice = KneeChoice(knee, grade, seed, grade_table, of_knee, scene)
    subject, name = make_subject(choice, apply_settings(meant, of_protocol))
    technique = apply_settings(resolve_acquisition(acquisition, meant, subject, seed), of_protocol)
    technique = technique.resample(matrix) if matrix else technique
    warn_of_cropped_field(of_protocol)
    require_workers(workers)
    _require_knee_options(scene is not None, subject, masks, border)
    with show_status("simulating; the first run after installation also compiles code, which takes a few seconds"):
        from ..detector import DISPLAY_PROCESSING
        from ..geometry.scene import Scene
        from ..io.atomic_write import make_folder
        from ..io.mask_files import save_masks
        from ..io.radiograph_files import BORDERS, FORMATS, save_formats
        from ..raycast import ENGINES
        from ..simulation import simulate as run

        require_choice("engine", engine, ENGINES)
        for kind in wanted:
            require_choice("formats", kind, FORMATS)
        require_choice("border", border, BORDERS)
        require_choice("processing", processing, DISPLAY_PROCESSING)
        if isinstance(subject, Scene):
            _print_scene_warnings(subject, technique)
        make_folder(out)
        keep = ("masks",) if masks else ()
        radiograph = run(subject, technique, rng=seed, keep=keep, engine=engine, workers=workers)
    stem = out / f"{name}_{technique.name}_seed{seed}"
    paths = save_formats(radiograph, stem, wanted, border=border, processing=processing)
    if masks:
        paths += [save_masks(radiograph, f"{stem}_masks.{kind}") for kind in ("tif", "dcm") if kind in ("tif", *wanted)]
    for path in paths:
        print(path)


def _require_knee_options(is_scene: bool, subject: object, masks: bool, border: str) -> None:
    """Raise an error if masks are requested for a scene, or a border for anything other than one knee."""
    from ..core.checks import InputError
    from ..model.knee import Knee

    if masks and is_scene:
        raise InputError("masks must belong to one knee or both knees, got subject = scene: remove --masks")
    if border != "none" and not isinstance(subject, Knee):
        raise InputError(f"border must be none for {'a scene' if is_scene else 'both knees'}, got {border!r}")


def _print_scene_warnings(scene: "Scene", protocol: "Protocol") -> None:
    """Print one warning line for each fault of a scene that may be unintended but is not an error."""
    from ..raycast.scene_check import COVERS_NO_PIXEL, check

    faults = [fault for fault in check(scene, protocol).faults if fault.outcome == "warning"]
    unseen = [fault for fault in faults if fault.problem == COVERS_NO_PIXEL]
    for fault in faults:
        # If all surfaces are outside the field of view, `simulate` gives a single warning.
        if fault not in unseen or len(unseen) < len(scene.surfaces):
            print(f"pssf: warning: {fault}", file=sys.stderr)


def meshes(
    *,
    out: Out,
    grade: Grade = 0,
    grade_table: GradeTable = "population",
    seed: Seed = 0,
    knee: KneeFile = None,
    kinds: Annotated[
        str, typer.Option("--formats", help="Formats, separated by commas: stl, ply, glb, 3mf.")
    ] = "stl,ply,glb,3mf",
    settings: Settings = None,
    tolerance_mm: Annotated[
        float,
        typer.Option(
            help="Largest distance, in mm, by which simplification may move a surface; 0 keeps all triangles."
        ),
    ] = 0.0,
) -> None:
    """Write the solids of a knee as STL, PLY, GLB and 3MF, in mm."""
    from ..anatomy import build
    from ..core.checks import InputError
    from ..io.atomic_write import make_folder
    from ..io.meshes.mesh_export import export_meshes, require_export_options
    from ..model.field_listing import parse_settings

    of_knee, of_protocol = parse_settings(settings or ())
    if of_protocol:
        raise InputError(
            f"set must name fields of a knee, got {', '.join(of_protocol)}: meshes do not depend on a protocol"
        )
    subject, name = make_knee(KneeChoice(knee, grade, seed, grade_table, of_knee))
    formats = tuple(kinds.split(","))
    require_export_options(formats, tolerance_mm)
    make_folder(out)
    for path in export_meshes(build(subject).scene, out, formats=formats, stem=name, tolerance_mm=tolerance_mm):
        print(path)


cohort_app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)


@cohort_app.callback(invoke_without_command=True)
def cohort(
    context: typer.Context,
    *,
    workers: Processes,
    out: Annotated[
        Path | None, typer.Option("--out", help="Output folder; created if it does not exist. Required.")
    ] = None,
    preset: Preset = "quick",
    seed: Seed = 0,
    knees: KneeCounts = "",
    bilateral: Bilateral = -1,
    protocols: Annotated[
        str,
        typer.Option(
            help="Names or TOML files of protocols, separated by commas; they replace the protocols of the preset."
        ),
    ] = "",
    grade_table: CohortGrades = "",
    acquisition: Annotated[
        str, typer.Option(help="fixed, or sampled to vary every acquisition; default: as in the preset.")
    ] = "",
    masks: Annotated[bool, typer.Option("--masks", help="Also write masks of bones and osteophytes, as TIFF.")] = False,
    settings: Settings = None,
    matrix: Matrix = 0,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
) -> None:
    """Make the radiographs and the manifest of a cohort; --knees, --protocols and --grade-table change the preset.

    An interrupted run continues where it stopped: existing files are checked and not written again, and the final files
    are byte-identical. If the folder contains another cohort, the command stops and reports the first difference.
    """
    if context.invoked_subcommand is not None:
        return
    from ..cohort import make_cohort, plan_cohort
    from ..core.checks import InputError
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..model.field_listing import parse_settings

    if out is None:
        raise InputError("out must be a folder for the cohort, got out = none: add --out FOLDER")
    warn_of_cropped_field(parse_settings(settings or ())[1])
    overrides = cohort_overrides(
        knees, bilateral, protocols, grade_table, acquisition, matrix=matrix, settings=settings
    )
    plan = plan_cohort(preset, seed=seed, overrides=overrides, masks="tif" if masks else "none")
    total = sum(len(case.exposures) for case in plan.cases)
    with Execution(progress_bar=show_progress_bar).stage("radiographs", "radiographs", total) as stage:
        manifest = make_cohort(
            plan,
            out,
            workers=workers,
            scheduler=scheduler,
            engine=engine,
            progress=stage.advance,
            on_kept=stage.add_already_done,
        )
    print(f"manifest  {manifest}")
    table = plan.cases[0].grade_table
    print(f"grades    {table}; pssf separability --grade-table {table} estimates how separable the grades are")


@cohort_app.command()
def verify(folder: Annotated[Path, typer.Argument(help="Cohort folder written by pssf cohort.")]) -> None:
    """Check every file of a cohort against its hash.

    The command prints one line per fault. If there is a fault, the exit code is 2.
    """
    from ..cohort import verify_cohort
    from ..core.progress_display import show_status

    with show_status("reading"):
        verified = verify_cohort(folder)
    for fault in verified.faults:
        print(fault)
    if verified.faults:
        raise typer.Exit(2)
    print(f"intact    {verified.radiographs} radiographs, {verified.files} files, all unchanged")


@cohort_app.command()
def labels(folder: Annotated[Path, typer.Argument(help="Cohort folder written by pssf cohort.")], *, out: Out) -> None:
    """Write the labels of a cohort as CSV with OAI columns, .pts and COCO.

    The images are written as 8-bit PNG, sorted by grade.
    """
    from ..cohort import write_labels
    from ..core.progress_display import show_status

    with show_status("reading"):
        paths = write_labels(folder, out)
    for path in paths:
        print(path)
