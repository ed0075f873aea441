"""Command `predict`: apply a saved model to patient radiographs."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .film_arguments import collect_films, make_unique_stem
from .shared_options import Out, Processes


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
    listed = [film for path in films for film in collect_films(path, side, pixel_mm)]
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
                out / "pictures" / f"{make_unique_stem(row['file'], taken)}.png",
            )
    print(f"table     {out / 'film_predictions.csv'}")
