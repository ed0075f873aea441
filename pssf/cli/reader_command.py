"""Commands of the reader: landmarks, train-reader."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .film_arguments import collect_films, make_unique_stem
from .shared_options import Out, Processes, Seed

if TYPE_CHECKING:
    from ..io.patients.landmark_annotations import LandmarkAnnotation
    from ..io.patients.patient_radiographs import Film
    from ..reader.film_reading import FilmReading
    from ..reader.knee_reading import Reader
    from ..reader_training.hold_out import HoldOutErrors
    from ..reader_training.training_settings import FineTuningSettings

Networks = Annotated[
    Path | None, typer.Option(help="Folder with networks made by pssf train-reader; default: those of the package.")
]

# Views of the training images; half of the images are in fixed flexion, and the other half in the other frontal views.
_TRAINING_PROTOCOLS = (*["fixed_flexion"] * 3, "ap_standing", "rosenberg", "lyon_schuss")


def landmarks(
    films: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILM...", help="Radiographs, folders of radiographs, or CSV files that list radiographs."
        ),
    ],
    *,
    out: Out,
    pixel_mm: Annotated[
        float, typer.Option(help="Pixel size in mm, if not in a table; 0 reads it from the file if it is there.")
    ] = 0.0,
    networks: Networks = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with annotated landmarks of the same radiographs: file, side, kl (optional), and NAME_x_mm "
            "and NAME_y_mm of the sixteen landmarks, y downwards, left knees mirrored."
        ),
    ] = None,
) -> None:
    """Find landmarks, joint space and bone masks on frontal knee radiographs.

    The command writes landmarks.csv and landmarks.json with one entry per knee, and per knee a landmark file (.pts) and
    per radiograph a picture. With --compare, it also writes reader_agreement.csv, with one row per group of
    radiographs, and reader_agreement_films.csv. The networks were trained on simulated radiographs alone. They are for
    research, not for diagnosis.
    """
    from ..core.checks import InputError
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..io.cohort_records import write_csv, write_json
    from ..io.run_record import start_run_record
    from ..reader.knee_reading import load_reader

    record, reader = start_run_record(), load_reader(networks)
    listed = [film for path in films for film in collect_films(path, "", pixel_mm)]
    annotated = _read_annotations(compare)
    rows: list[dict[str, Any]] = []
    taken: set[str] = set()
    readings: dict[str, FilmReading] = {}
    with Execution(progress_bar=show_progress_bar).stage("landmarks", "radiographs", len(listed)) as stage:
        for film in listed:
            try:
                readings[Path(film.file).name] = knees = _read_film(
                    film, reader, out, make_unique_stem(film.file, taken)
                )
                rows += knees.rows()
            except InputError as error:
                rows.append({"file": film.file, "status": f"unreadable: {error}"})
            stage.advance(1)
    for row in rows:
        if row["status"] != "read":
            print(f"pssf: {row['file']}: {row['status']}", file=sys.stderr)
    write_csv(out / "landmarks.csv", rows)
    write_json(out / "landmarks.json", rows)
    if annotated:
        _write_agreement(readings, annotated, out)
    record.save(out)
    count = sum(row["status"] == "read" for row in rows)
    print(f"table     {out / 'landmarks.csv'}, {count} of {len(rows)} knees read")


def _read_annotations(path: Path | None) -> "list[LandmarkAnnotation]":
    """Read annotated landmarks, or return none without a path."""
    from ..core.label_names import CONTOUR_LANDMARKS
    from ..io.patients.landmark_annotations import read_landmark_annotations

    return [] if path is None else read_landmark_annotations(path, CONTOUR_LANDMARKS)


def _write_agreement(readings: "dict[str, FilmReading]", annotated: "list[LandmarkAnnotation]", out: Path) -> None:
    """Compare readings with annotations, and write and print the agreement."""
    from ..core.checks import InputError
    from ..io.cohort_records import write_csv
    from ..reader.landmark_agreement import compare_landmarks, select_annotated_knee, summarise_agreement

    matched = [annotation for annotation in annotated if annotation.file in readings]
    if not matched:
        raise InputError(f"annotated files must include a radiograph that was read, got {annotated[0].file} and others")
    rows = []
    for annotation in matched:
        knee = select_annotated_knee(readings[annotation.file], annotation.side)
        rows.append(compare_landmarks(knee, annotation.landmarks_mm, annotation.side))
    grades = [annotation.grade for annotation in matched]
    named = [{"file": one.file, "kl": one.grade, **row} for one, row in zip(matched, rows, strict=True)]
    write_csv(out / "reader_agreement_films.csv", named)
    summary = summarise_agreement(rows, grades)
    write_csv(out / "reader_agreement.csv", summary)
    for row in summary:
        values = (f"{name} {value:.3g}" for name, value in row.items() if isinstance(value, (int, float)))
        print(f"{row['radiographs']:<10}{', '.join(values)}")


def _read_film(film: "Film", reader: "Reader", out: Path, stem: str) -> "FilmReading":
    """Read one radiograph, and write its landmark files and picture."""
    from ..io.landmark_files import write_pts
    from ..io.pictures import write_image_row
    from ..reader.film_reading import read

    knees = read(film.file, pixel_mm=film.pixel_mm, reader=reader)
    for knee in knees:
        write_pts(out / "points" / f"{stem}_{knee.side}.pts", knee.landmarks_px)
    write_image_row([knees.draw()], out / "pictures" / f"{stem}.png")
    return knees


def train_reader(
    *,
    out: Out,
    workers: Processes,
    images: Annotated[int, typer.Option(help="Number of simulated radiographs.")] = 4000,
    seed: Seed = 0,
    data: Annotated[
        Path | None, typer.Option(help="Existing data set made by pssf dataset; default: simulate one in --out.")
    ] = None,
    landmark_steps: Annotated[
        int, typer.Option(help="Training steps of the network that finds landmarks and masks.")
    ] = 6000,
    locator_steps: Annotated[int, typer.Option(help="Training steps of the network that finds knees.")] = 3000,
    side_steps: Annotated[
        int, typer.Option(help="Training steps of the network that tells right from left knees.")
    ] = 4200,
    randomisation: Annotated[str, typer.Option(help="Random change of grey values: none, mild or strong.")] = "strong",
    threads: Annotated[
        int, typer.Option(help="Number of threads of PyTorch; it changes the last digits of the networks.")
    ] = 2,
    finetune: Annotated[
        Path | None,
        typer.Option(
            help="Folder of your radiographs and their landmark files points/NAME_right.pts or NAME_left.pts, as pssf "
            "landmarks writes them; continues the training of --networks on them instead of training a new reader."
        ),
    ] = None,
    finetune_steps: Annotated[int, typer.Option(help="Training steps of --finetune.")] = 600,
    networks: Networks = None,
) -> None:
    """Train the reader on simulated radiographs, and write its networks.

    With --finetune, the training of an existing reader continues on your own annotated radiographs; one subject in five
    is kept to measure the error before and after. Requires the extra train. An interrupted run continues where it
    stopped, with the same options.
    """
    from ..core.checks import InputError, require_workers
    from ..dataset import DatasetSettings
    from ..io.run_record import start_run_record
    from .dataset_command import make_with_progress

    record = start_run_record()
    require_workers(workers, "processes")
    try:
        from ..reader_training.reader_maker import make_reader
        from ..reader_training.training_settings import FineTuningSettings, ReaderTrainingSettings
    except ModuleNotFoundError as error:
        raise InputError(f"train-reader needs {error.name}: pip install 'pssf[train]'") from error
    if finetune is not None:
        _fine_tune(finetune, networks, FineTuningSettings(seed=seed, steps=finetune_steps, threads=threads), out)
        record.save(out)
        return
    settings = ReaderTrainingSettings(
        images=images,
        seed=seed,
        landmark_steps=landmark_steps,
        locator_steps=locator_steps,
        side_steps=side_steps,
        randomisation=randomisation,
        threads=threads,
    )
    folder = out / "data" if data is None else data
    if data is None:
        simulated = DatasetSettings(
            images=images, seed=seed, matrix=1024, kinds=("display",), protocols=_TRAINING_PROTOCOLS
        )
        make_with_progress(simulated, folder, workers, None)
    errors, _ = make_reader(folder, settings, out, _print_progress, workers)
    record.save(out)
    _print_errors(errors)
    print(f"networks  {out}")


def _print_errors(errors: "HoldOutErrors") -> None:
    """Print the errors on simulated radiographs."""
    mean = sum(errors.landmark_mm.values()) / len(errors.landmark_mm)
    print(f"errors    landmarks {mean:.2f} mm on simulated radiographs for tests")
    print(f"          joint space {_list_values(errors.jsw_mae_mm, ' mm')} (mean absolute error)")
    print(f"masks     Dice {_list_values(errors.dice)}")


def _fine_tune(films: Path, networks: Path | None, settings: "FineTuningSettings", out: Path) -> None:
    """Continue the training of a reader on annotated radiographs."""
    from ..reader.reader_table import PACKAGE_FOLDER
    from ..reader_training.fine_tuning import POINTS_FOLDER, fine_tune_reader

    listed = collect_films(films, "", 0.0)
    errors = fine_tune_reader(listed, films / POINTS_FOLDER, networks or PACKAGE_FOLDER, settings, out, _print_progress)
    print(
        f"errors    {errors.before:.2f} % of the plateau width before, {errors.after:.2f} % after, "
        f"on {errors.knees} knees that were not used"
    )
    print(f"networks  {out}")


def _print_progress(name: str, done: int, of: int, loss: float) -> None:
    """Print the progress of a training."""
    print(f"{name:<9} {done} of {of} steps, loss {loss:.3f}", flush=True)


def _list_values(values: dict[str, float], unit: str = "") -> str:
    """Return named values as text."""
    return ", ".join(f"{name} {value:.2f}{unit}" for name, value in values.items())
