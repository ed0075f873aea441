"""The command that reads films by a saved model."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Out, Processes

if TYPE_CHECKING:
    from ..io.films import Film


def read(
    model: Annotated[Path, typer.Argument(help="Model that pssf study saved (.skops).")],
    films: Annotated[list[Path], typer.Argument(metavar="FILM...", help="Films; or folders or CSVs of films.")],
    *,
    out: Out,
    workers: Processes,
    side: Annotated[
        str, typer.Option(help="right or left, where no name or table of films says; found if none is named.")
    ] = "",
    pixel_mm: Annotated[
        float, typer.Option(help="Pitch where no table of films says, mm; 0: the file's, or by the plateau's width.")
    ] = 0.0,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear",
            help="The pixels of films that pssf has not written are linear in the signal, air bright; side and pitch "
            "must be known then.",
        ),
    ] = False,
) -> None:
    """A saved model on films: grade probabilities, features, and the region drawn on each film; a CSV and PNGs.

    A film that does not say what its pixels are is taken for a display, and its result has a warning.
    """
    from ..core.execution import Execution
    from ..core.progress import bar
    from ..io import results
    from ..io.pictures import side_by_side
    from ..study import require_extra

    require_extra()
    from ..study.learn.modelfile import differences, unpack
    from ..study.reading import picture, read_films

    loaded = unpack(results.load_bytes(model), f"file {model}")
    listed = [film for path in films for film in _listed(path, side, pixel_mm)]
    other = differences(loaded.card)
    if other:
        print(f"pssf: model {model.name} was made by others than these: {other}", file=sys.stderr)
    done = read_films(loaded, listed, Path(), Execution(workers=workers, bar=bar), linear=linear)
    for line in done.warnings:
        print(f"pssf: {line}", file=sys.stderr)
    results.save_table(out / "read.csv", done.table)
    names = dict(zip(loaded.card.grades, loaded.card.grade_names, strict=True))
    taken: set[str] = set()
    for _, row in done.table.iterrows():
        chances = ", ".join(f"grade {grade} ({name}) {row[f'p grade {grade}']:.3f}" for grade, name in names.items())
        print(f"{row['file']}  {chances if row['status'] == 'found' else 'refused: ' + row['status']}")
        if row["row_px"] == row["row_px"]:  # else nothing was looked for
            side_by_side(
                [picture(loaded, row, Path(), linear=linear)], out / "pictures" / f"{_free(row['file'], taken)}.png"
            )
    print(f"table     {out / 'read.csv'}")


def _listed(path: Path, side: str, pixel_mm: float) -> "list[Film]":
    """The films of a path, with side and pitch where they do not say."""
    from dataclasses import replace

    from ..core.checks import require, require_choice
    from ..io.film_list import SIDES, Film, list_films, require_film, subject_and_side
    from ..io.records import sha256

    if side:
        require_choice("side", side, SIDES)
    if pixel_mm:
        require("pixel-mm", pixel_mm, 0.01, 5, "mm")
    if path.is_dir() or path.suffix.lower() == ".csv":
        folder = path if path.is_dir() else path.parent
        films = [replace(film, file=(folder / film.file).as_posix()) for film in list_films(path)]
    else:
        require_film(path)
        file, (subject, own) = path.as_posix(), subject_and_side(path.stem)
        films = [Film(file=file, grade=None, subject=subject, side=own, pixel_mm=None, sha256=sha256(path))]
    return [replace(f, side=f.side or side or None, pixel_mm=f.pixel_mm or pixel_mm or None) for f in films]


def _free(file: str, taken: set[str]) -> str:
    """The stem of a file, with a number where another of that name was before it."""
    stem, count = Path(file).stem, 1
    name = stem
    while name in taken:
        count += 1
        name = f"{stem}_{count}"
    taken.add(name)
    return name
