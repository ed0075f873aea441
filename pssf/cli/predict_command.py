"""Command `predict`: apply a saved model to patient radiographs."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .shared_options import Out, Processes

if TYPE_CHECKING:
    from ..io.patients.patient_radiographs import Film


def predict(
    model: Annotated[Path, typer.Argument(help="Model file (.skops) saved by pssf study.")],
    films: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILM...", help="Radiographs, folders of radiographs, or CSV files that list radiographs."
        ),
    ],
    *,
    out: Out,
    workers: Processes,
    side: Annotated[
        str,
        typer.Option(
            help="Side, right or left, for images whose file name and table do not specify it; estimated by default."
        ),
    ] = "",
    pixel_mm: Annotated[
        float,
        typer.Option(
            help="Pixel size in mm, if not in a table; 0 reads it from the file or estimates it from the plateau width."
        ),
    ] = 0.0,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear",
            help="Treat the pixels of files from other programs as linear in the signal, with bright air; side and "
            "pixel size must be known.",
        ),
    ] = False,
) -> None:
    """Apply a saved model to patient radiographs.

    The command writes grade probabilities and features (CSV), and pictures of the regions.

    If an image does not declare the meaning of its pixels, it is treated as processed for display, with a warning.
    """
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..io import study_results
    from ..io.pictures import write_image_row
    from ..study import require_extra

    require_extra()
    from ..study.learn.models.model_file import describe_version_differences, unpack_model
    from ..study.prediction.film_prediction import draw_film_region, predict_films

    loaded = unpack_model(study_results.load_bytes(model), f"file {model}")
    listed = [film for path in films for film in _collect_films(path, side, pixel_mm)]
    other = describe_version_differences(loaded.card)
    if other:
        print(
            f"pssf: model {model.name} was made with other software versions ({other}); results may differ",
            file=sys.stderr,
        )
    done = predict_films(
        loaded, listed, Path(), Execution(workers=workers, progress_bar=show_progress_bar), linear=linear
    )
    for line in done.warnings:
        print(f"pssf: {line}", file=sys.stderr)
    study_results.save_table(out / "film_predictions.csv", done.table)
    names = dict(zip(loaded.card.grades, loaded.card.grade_names, strict=True))
    taken: set[str] = set()
    for _, row in done.table.iterrows():
        chances = ", ".join(f"grade {grade} ({name}) {row[f'p grade {grade}']:.3f}" for grade, name in names.items())
        print(f"{row['file']}  {chances if row['status'] == 'found' else 'rejected: ' + row['status']}")
        if row["row_px"] == row["row_px"]:  # NaN means that no joint was searched for.
            write_image_row(
                [draw_film_region(loaded, row, Path(), linear=linear)],
                out / "pictures" / f"{_make_unique_stem(row['file'], taken)}.png",
            )
    print(f"table     {out / 'film_predictions.csv'}")


def _collect_films(path: Path, side: str, pixel_mm: float) -> "list[Film]":
    """List the radiographs of a path.

    The specified side and pixel size are used for radiographs whose file names and tables do not contain them.
    """
    from dataclasses import replace

    from ..core.checks import require_choice, require_in_range
    from ..io.cohort_records import hash_file
    from ..io.patients.patient_list import (
        SIDES,
        Film,
        list_films,
        parse_subject_and_side,
        require_film,
    )

    if side:
        require_choice("side", side, SIDES)
    if pixel_mm:
        require_in_range("pixel-mm", pixel_mm, 0.01, 5, "mm")
    if path.is_dir() or path.suffix.lower() == ".csv":
        folder = path if path.is_dir() else path.parent
        films = [replace(film, file=(folder / film.file).as_posix()) for film in list_films(path)]
    else:
        require_film(path)
        file, (subject, own) = path.as_posix(), parse_subject_and_side(path.stem)
        films = [Film(file=file, grade=None, subject=subject, side=own, pixel_mm=None, sha256=hash_file(path))]
    return [replace(f, side=f.side or side or None, pixel_mm=f.pixel_mm or pixel_mm or None) for f in films]


def _make_unique_stem(file: str, used_names: set[str]) -> str:
    """Return the stem of a file, with a number appended if another file has the same stem."""
    stem, count = Path(file).stem, 1
    name = stem
    while name in used_names:
        count += 1
        name = f"{stem}_{count}"
    used_names.add(name)
    return name
