"""Command that makes data sets of labelled images: dataset, dataset verify."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .shared_options import Engine, GradeTable, Processes, Scheduler, Seed

if TYPE_CHECKING:
    from ..dataset import DatasetSettings

dataset_app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)


@dataset_app.callback(invoke_without_command=True)
def dataset(
    context: typer.Context,
    *,
    workers: Processes,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Output folder; created if it does not exist. Required, except with --dry-run."),
    ] = None,
    images: Annotated[int, typer.Option(help="Number of images; rounded up to a whole number of subjects.")] = 500,
    seed: Seed = 0,
    matrix: Annotated[
        int, typer.Option(help="Number of pixels along the longer side of an image or crop; 0: as in the protocol.")
    ] = 512,
    protocols: Annotated[
        str, typer.Option(help="Names or TOML files of protocols, separated by commas; each knee gets one at random.")
    ] = "fixed_flexion",
    grade_table: GradeTable = "population",
    grades: Annotated[
        str,
        typer.Option(
            help="balanced (the same number of subjects of each KL grade) or prevalence (as in the baseline of the "
            "Osteoarthritis Initiative)."
        ),
    ] = "balanced",
    both_knees: Annotated[bool, typer.Option("--both-knees", help="Image both knees of each subject.")] = False,
    acquisition: Annotated[
        str,
        typer.Option(
            help="sampled or fixed; sampled varies positioning, beam angle, source-detector distance, kV, mAs, "
            "field and marker."
        ),
    ] = "sampled",
    equipment: Annotated[
        str,
        typer.Option(
            help="nominal or sampled; sampled varies focal spot, filtration, and the grid of protocols with a grid."
        ),
    ] = "nominal",
    display: Annotated[
        str, typer.Option(help="Display processing of the 8-bit images: sampled, processed, log or film.")
    ] = "sampled",
    kinds: Annotated[
        str, typer.Option(help="Kinds of images, separated by commas: linear (16-bit TIFF), display (8-bit PNG).")
    ] = "linear,display",
    crop_mm: Annotated[
        float, typer.Option(help="Side of a square crop around the joint, on the detector, in mm; 0: whole images.")
    ] = 0.0,
    crop_shift_mm: Annotated[
        float,
        typer.Option(
            help="Standard deviation of the random shift of the crop in each direction, in mm; clipped at two SD."
        ),
    ] = 3.0,
    split: Annotated[
        str, typer.Option(help="Fractions of subjects for training, validation and test, separated by commas.")
    ] = "0.7,0.15,0.15",
    randomise: Annotated[
        str,
        typer.Option(
            help="Random transforms after the simulation, separated by commas; all except affine change only 8-bit "
            "images: affine, contrast, gamma, inversion, blur, boxes, dropout, noise, or the recipes mild and strong."
        ),
    ] = "",
    pairs: Annotated[
        str,
        typer.Option(
            help="Paired images of each knee: none, protocol (exactly two --protocols), lesion (with and without one "
            "lesion) or visit (two visits)."
        ),
    ] = "none",
    maps: Annotated[
        str, typer.Option(help="Materials whose path lengths are saved as maps in mm, separated by commas.")
    ] = "",
    layout: Annotated[str, typer.Option(help="folder (single files) or shards (tar files for WebDataset).")] = "folder",
    shard_images: Annotated[int, typer.Option(help="Target number of images per shard.")] = 100,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Also write index.parquet. Requires the extra parquet.")
    ] = False,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Simulate a few images, print the estimated CPU time, run time, disk space and number of files, and "
            "write nothing.",
        ),
    ] = False,
) -> None:
    """Make a data set of labelled images for the training of networks.

    An interrupted run continues where it stopped: existing files are checked and not written again, and the final files
    are byte-identical for any number of workers.
    """
    if context.invoked_subcommand is not None:
        return
    from ..core.checks import require_workers
    from ..dataset import DatasetSettings

    require_workers(workers, "processes")
    settings = DatasetSettings(
        images=images,
        seed=seed,
        matrix=matrix,
        protocols=_parse_names(protocols),
        grade_table=grade_table,
        grades=grades,
        knees_per_subject=2 if both_knees else 1,
        acquisition=acquisition,
        equipment=equipment,
        display=display,
        kinds=_parse_names(kinds),
        crop_mm=crop_mm,
        crop_shift_mm=crop_shift_mm,
        split=_parse_fractions(split),
        randomise=_parse_names(randomise),
        pairs=pairs,
        maps=_parse_names(maps),
        layout=layout,
        shard_images=shard_images,
        parquet=parquet,
        engine=engine,
    )
    if dry_run:
        _print_estimate(settings, workers)
        return
    make_with_progress(settings, out, workers, scheduler)


@dataset_app.command()
def verify(folder: Annotated[Path, typer.Argument(help="Folder of a data set written by pssf dataset.")]) -> None:
    """Check every file of a data set against its hash, and find missing and extra files.

    The command prints one line per fault. If there is a fault, the exit code is 2.
    """
    from ..core.progress_display import show_status
    from ..dataset import verify_dataset

    with show_status("reading"):
        images, faults = verify_dataset(folder)
    for fault in faults:
        print(fault)
    if faults:
        raise typer.Exit(2)
    print(f"intact    {images} images, all unchanged")


def make_with_progress(settings: "DatasetSettings", out: Path | None, workers: int, scheduler: str | None) -> None:
    """Make the data set with a progress bar."""
    from ..core.checks import InputError
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..dataset import make_dataset

    if out is None:
        raise InputError("out must be a folder for the data set, got out = none: add --out FOLDER")
    total = settings.subject_count * settings.images_per_subject
    with Execution(progress_bar=show_progress_bar).stage("images", "images", total) as stage:
        index = make_dataset(
            settings, out, workers=workers, scheduler=scheduler, progress=stage.advance, on_kept=stage.add_already_done
        )
    print(f"index     {index}")


def _print_estimate(settings: "DatasetSettings", workers: int) -> None:
    """Simulate a few images, and print how much time and disk space the data set needs."""
    from ..core.progress_display import show_status
    from ..dataset import estimate_cost

    with show_status("simulating a few images"):
        cost = estimate_cost(settings)
    print(f"images    {cost.images:,} in {cost.files:,} files")
    print(f"disk      {_format_size(cost.disk_mb)}")
    print(f"CPU time  {_format_time(cost.cpu_seconds)}")
    print(f"run time  {_format_time(cost.cpu_seconds / workers)} with {workers} workers on as many cores")
    print(f"estimated from {cost.measured_images} images on this machine")


def _format_size(size_mb: float) -> str:
    """Format a size on disk with a suitable unit."""
    return f"{size_mb:,.1f} MB" if size_mb < 1000 else f"{size_mb / 1000:,.1f} GB"


def _format_time(seconds: float) -> str:
    """Format a time with a suitable unit."""
    unit, name = next(
        (unit, name) for unit, name in ((3600, "h"), (60, "min"), (1, "s")) if seconds >= 2 * unit or unit == 1
    )
    return f"{seconds / unit:,.1f} {name}"


def _parse_names(text: str) -> tuple[str, ...]:
    """Split names at commas; an empty text gives no names."""
    return tuple(part.strip() for part in text.split(",")) if text else ()


def _parse_fractions(text: str) -> tuple[float, float, float]:
    """Parse three fractions separated by commas."""
    from ..core.checks import InputError

    try:
        first, second, third = map(float, text.split(","))
    except ValueError:
        raise InputError(f"split must be three fractions, such as 0.7,0.15,0.15, got {text!r}") from None
    return first, second, third
