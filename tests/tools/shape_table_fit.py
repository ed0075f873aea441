"""Fit of the shape table ``data/shapes.toml`` to patient bones; equal bones give an identical file.

Run ``python -m tools.shape_table_fit BONES OUT --source TEXT --licence TEXT`` in the folder ``tests``.
"""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from tools.mode_names import ModeName, measure_knees, name_modes
from tools.shape_modes import (
    MeanFit,
    ShapeModes,
    compute_modes,
    fit_knees,
    fit_mean,
)

from pssf.anatomy.template.bone_form import build_shape_model
from pssf.core.checks import Array
from pssf.data.anatomy.anatomy_tables import AnatomyTables, load_anatomy_tables
from pssf.data.anatomy.shape_table import ShapeModel, format_displacements
from pssf.data.table_records import parse_record
from pssf.geometry.freeform_deformation import Lattice
from pssf.geometry.mesh import Mesh
from pssf.io.meshes.bone_folder import read_bones
from pssf.io.study_results import save_text
from pssf.patient_comparison.bones.bone_registration import BONES

# Decimal places of mean displacements, in mm.
_MEAN_DIGITS = 2
# Decimal places of mode displacements, in mm; one more than for the mean, because they are multiplied by scores.
_MODE_DIGITS = 3
_TOML_HEADER = """\
# Statistical shape model: control-point lattices that deform the template bones to the mean of patient bones.
# Each bone (anatomy.toml) is deformed in its own frame, before posture is applied.
# The table also contains the displacements per standard deviation of each shape mode, in mm.
# The deformation uses cubic B-splines (geometry/freeform_deformation.py).
# tests/tools/shape_table_fit.py fitted the lattices to the bones named in `source`.
# Pose and size are removed; all three bones have the same size factor, so the tibial plateau keeps its width.
# The table contains no vertices, faces or eigenvectors of the source.
# A mode is named after the shape measure with the highest correlation to the mode score.
# The shape measure that names a mode increases with the mode score.
# rms_mm is the RMS displacement of femur, tibia and patella.
"""


def derive_shape_modes(
    patient_bones: Mapping[str, Sequence[Mesh]], tables: AnatomyTables, workers: int = 1, keep_means: bool = False
) -> tuple[MeanFit, ShapeModes, tuple[ModeName, ...]]:
    """Derive mean lattices and named shape modes from patient bones.

    Parameters
    ----------
    patient_bones : mapping of str to sequence of Mesh
        Patient bones by name; bone k of each type belongs to knee k.
    tables : AnatomyTables
        Anatomy tables of the template anatomy.
    workers : int, default 1
        Number of worker processes.
    keep_means : bool, default False
        True uses the mean lattices of the package and derives only the modes.

    Returns
    -------
    MeanFit
        Template bones and mean lattices.
    ShapeModes
        Shape modes.
    tuple of ModeName
        Name of each mode.

    Raises
    ------
    InputError
        Femur, tibia or patella is missing.
    """
    kept = (
        {name: form.mean for name, form in build_shape_model(tables.shape_model).bones.items()} if keep_means else None
    )
    mean = fit_mean(patient_bones, tables, workers, kept)
    fitted = fit_knees(patient_bones, mean, workers)
    names, values = measure_knees(mean, fitted)
    modes, called = name_modes(compute_modes(fitted, mean), names, values)
    if kept is not None:
        modes = replace(modes, means={name: lattice.displacements_mm.reshape(-1, 3) for name, lattice in kept.items()})
    return mean, modes, called


def format_shape_table(mean: MeanFit, modes: ShapeModes, names: Sequence[ModeName], source: str, licence: str) -> str:
    """Format the shape table as TOML, and check the text by parsing it.

    Parameters
    ----------
    mean : MeanFit
        Template bones and mean lattices.
    modes : ShapeModes
        Shape modes.
    names : sequence of ModeName
        Name of each mode.
    source : str
        Source of the patient bones.
    licence : str
        Licence of the patient bones.

    Returns
    -------
    str
        TOML text.
    """
    parts = [
        _TOML_HEADER,
        f"source = {_quote_toml(source)}",
        f"licence = {_quote_toml(licence)}",
        f"knees = {len(modes.scores)}",
    ]
    for k, called in enumerate(names):
        parts += ["", "[[modes]]", f'name = "{called.name}"', f"correlation = {called.correlation:.2f}"]
        parts += [f'also = "{called.other_measures}"', f"share = {modes.variance_fraction[k]:.3f}"]
        parts += [f"rms_mm = [{', '.join(f'{modes.rms_mm[name][k]:.3f}' for name in BONES)}]"]
    for name in BONES:
        parts += ["", *_format_lattice(name, mean.lattices[name], modes.means[name], modes.directions[name])]
    text = "\n".join(parts) + "\n"
    parse_record(ShapeModel, tomllib.loads(text), "shapes")
    return text


def _quote_toml(text: str) -> str:
    """Format a text as a TOML string."""
    # JSON is used because TOML strings have the same escape sequences.
    return json.dumps(text, ensure_ascii=False)


def _format_lattice(name: str, lattice: Lattice, mean: Array, directions: Array) -> list[str]:
    """Format lattice, mean displacements and mode displacements of a bone as TOML lines."""
    shape = (*lattice.counts, 3)
    origin = ", ".join(f"{float(value):.3f}" for value in lattice.origin_mm)
    lines = [f"[lattices.{name}]", f"origin_mm = [{origin}]", f"pitch_mm = {lattice.pitch_mm}"]
    lines += [f"counts = {list(lattice.counts)}", f"shaft = {lattice.shaft_sign}"]
    lines += [f"mean_mm = '''\n{format_displacements(mean.reshape(shape), _MEAN_DIGITS)}'''", "modes_mm = ["]
    lines += [f"'''\n{format_displacements(one.reshape(shape), _MODE_DIGITS)}'''," for one in directions]
    return [*lines, "]"]


def main(
    bones: Annotated[
        Path, typer.Argument(help="Patient bones: an .npz file, or folders femur, tibia, patella of meshes in mm.")
    ],
    out: Annotated[Path, typer.Argument(help="TOML file to write.")],
    source: Annotated[str, typer.Option(help="Source of the patient bones.")],
    licence: Annotated[str, typer.Option(help="Licence of the patient bones, with its scope.")],
    keep_means: Annotated[bool, typer.Option(help="Keep the present mean lattices; derive modes only.")] = False,
    workers: Annotated[int, typer.Option(help="Number of worker processes.")] = 1,
) -> None:
    """Derive the shape table from patient bones, write it to a file, and print the modes.

    \f

    Parameters
    ----------
    bones : Path
        File or folder of patient bones.
    out : Path
        TOML file to write.
    source : str
        Source of the patient bones.
    licence : str
        Licence of the patient bones.
    keep_means : bool, default False
        True uses the mean lattices of the package and derives only the modes.
    workers : int, default 1
        Number of worker processes.
    """
    mean, modes, names = derive_shape_modes(read_bones(bones), load_anatomy_tables(), workers, keep_means)
    save_text(out, format_shape_table(mean, modes, names, source, licence))
    for share, total, called in zip(modes.variance_fraction, np.cumsum(modes.variance_fraction), names, strict=True):
        print(f"{share:.3f} {total:.3f}  {called.name} ({called.correlation:.2f}; {called.other_measures})")


if __name__ == "__main__":
    typer.run(main)
