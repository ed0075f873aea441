"""People's bones -> the table of shapes: `python -m pssf.realism.shape_fit BONES OUT --source TEXT --licence TEXT`.

Where the numbers of `data/shapes.toml` come from; the same bones give the same bytes.
"""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..anatomy.shape import knee_form
from ..core.checks import Array
from ..data.anatomy import AnatomyTables, anatomy_tables
from ..data.records import record
from ..data.shapes import ShapeTable, write_displacements
from ..geometry.freeform import Lattice
from ..geometry.mesh import Mesh
from ..io.bones import read_bones
from ..io.results import save_text
from .bone_fit import BONES
from .shape_modes import MeanFit, Modes, fit_knees, fit_mean, modes_of
from .shape_names import ModeName, measured_knees, name_modes

# Thousandths of a millimetre for what is multiplied by scores, hundredths for what is not.
_MEAN_DIGITS, _MODE_DIGITS = 2, 3
_HEAD = """\
# Lattices of control points that deform the mean man's bones (anatomy.toml, in their own frames before they stand) into
# people's mean, and what one standard deviation of each mode of variation adds; mm. Cubic B-splines, see
# geometry/freeform.py. Fitted by this package (python -m pssf.realism.shape_fit) to the bones named as source; pose and
# size taken out, one size for all three bones, so that the tibial plateau is as wide as before. None of the source's
# vertices, faces or eigenvectors is in here. A mode is named by the measure of form that follows its score most closely
# (its correlation over knees), and its sign is such that this measure grows; rms_mm: of femur, tibia, patella.
"""


def derive(
    given: Mapping[str, Sequence[Mesh]], tables: AnatomyTables, workers: int = 1, keep_means: bool = False
) -> tuple[MeanFit, Modes, tuple[ModeName, ...]]:
    """Mean lattices and named modes of given bones; bone k of each kind is of knee k.

    tables      that the mean man is made from
    keep_means  the means stay those of the package's own table, from which the modes then go
    raises  InputError where a bone is not given
    """
    kept = {name: form.mean for name, form in knee_form(tables.forms).bones.items()} if keep_means else None
    mean = fit_mean(given, tables, workers, kept)
    fitted = fit_knees(given, mean, workers)
    names, values = measured_knees(mean, fitted)
    modes, called = name_modes(modes_of(fitted, mean), names, values)
    if kept is not None:
        modes = replace(modes, means={name: lattice.displacements_mm.reshape(-1, 3) for name, lattice in kept.items()})
    return mean, modes, called


def table_text(mean: MeanFit, modes: Modes, names: Sequence[ModeName], source: str, licence: str) -> str:
    """The table of shapes as TOML, read back once to be sure of it."""
    parts = [_HEAD, f"source = {_quoted(source)}", f"licence = {_quoted(licence)}", f"knees = {len(modes.scores)}"]
    for k, called in enumerate(names):
        parts += ["", "[[modes]]", f'name = "{called.name}"', f"correlation = {called.correlation:.2f}"]
        parts += [f'also = "{called.also}"', f"share = {modes.share[k]:.3f}"]
        parts += [f"rms_mm = [{', '.join(f'{modes.rms_mm[name][k]:.3f}' for name in BONES)}]"]
    for name in BONES:
        parts += ["", *_lattice_lines(name, mean.lattices[name], modes.means[name], modes.directions[name])]
    text = "\n".join(parts) + "\n"
    record(ShapeTable, tomllib.loads(text), "shapes")
    return text


def _quoted(text: str) -> str:
    # What JSON escapes, TOML escapes alike.
    return json.dumps(text, ensure_ascii=False)


def _lattice_lines(name: str, lattice: Lattice, mean: Array, directions: Array) -> list[str]:
    shape = (*lattice.counts, 3)
    origin = ", ".join(f"{float(value):.3f}" for value in lattice.origin_mm)
    lines = [f"[lattices.{name}]", f"origin_mm = [{origin}]", f"pitch_mm = {lattice.pitch_mm}"]
    lines += [f"counts = {list(lattice.counts)}", f"shaft = {lattice.shaft}"]
    lines += [f"mean_mm = '''\n{write_displacements(mean.reshape(shape), _MEAN_DIGITS)}'''", "modes_mm = ["]
    lines += [f"'''\n{write_displacements(one.reshape(shape), _MODE_DIGITS)}'''," for one in directions]
    return [*lines, "]"]


def main(
    bones: Annotated[
        Path, typer.Argument(help="Real bones: an .npz, or folders femur, tibia, patella of meshes in mm.")
    ],
    out: Annotated[Path, typer.Argument(help="The table that is written (TOML).")],
    source: Annotated[str, typer.Option(help="Where the bones are from.")],
    licence: Annotated[str, typer.Option(help="Their licence, and what it covers.")],
    keep_means: Annotated[bool, typer.Option(help="Only the modes; the means stay those of the package.")] = False,
    workers: Annotated[int, typer.Option(help="Processes.")] = 1,
) -> None:
    """Derive the table of shapes anew from real bones."""
    mean, modes, names = derive(read_bones(bones), anatomy_tables(), workers, keep_means)
    save_text(out, table_text(mean, modes, names, source, licence))
    for share, total, called in zip(modes.share, np.cumsum(modes.share), names, strict=True):
        print(f"{share:.3f} {total:.3f}  {called.name} ({called.correlation:.2f}; {called.also})")


if __name__ == "__main__":
    typer.run(main)
