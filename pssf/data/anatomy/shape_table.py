"""Statistical shape model of the bones: lattices of control points that deform the template (``data/shapes.toml``)."""

from functools import cache

import numpy as np

from ...core.checks import Array
from ..data_files import load_data_table
from ..table_records import Record, Triple, parse_record


class ShapeMode(Record, frozen=True):
    """One mode of variation of the bones of a knee.

    Attributes
    ----------
    name : str
        Shape measure with the highest correlation to the score of the mode; it increases with the score.
    correlation : float
        Correlation between the shape measure and the score.
    also : str
        Other shape measures that correlate with the score, with the sign of the correlation.
    share : float
        Fraction of the variance of surface distances that the mode explains.
    rms_mm : (float, float, float)
        RMS displacement of the surfaces of femur, tibia and patella per SD, in mm.
    """

    name: str
    correlation: float
    also: str
    share: float
    rms_mm: Triple


class LatticeTable(Record, frozen=True):
    """Lattice of control points around a bone.

    Each line of a displacement text contains the x, y and z displacements of one column of control points along z.

    Attributes
    ----------
    origin_mm : (float, float, float)
        Position of the first control point, in mm.
    pitch_mm : float
        Distance between control points, in mm.
    counts : (int, int, int)
        Number of control points along x, y and z.
    shaft : {1, -1, 0}
        End at which the deformation continues along the shaft: 1 is proximal, -1 distal, 0 neither.
    mean_mm : str
        Displacements from the template to the mean shape, in mm, as text.
    modes_mm : tuple of str
        Displacements per SD of each mode, in mm, as text.
    """

    origin_mm: Triple
    pitch_mm: float
    counts: tuple[int, int, int]
    shaft: int
    mean_mm: str
    modes_mm: tuple[str, ...]


class BoneLattices(Record, frozen=True):
    """Lattices of control points of femur, tibia and patella.

    Attributes
    ----------
    femur : LatticeTable
        Lattice of the femur.
    tibia : LatticeTable
        Lattice of the tibia.
    patella : LatticeTable
        Lattice of the patella.
    """

    femur: LatticeTable
    tibia: LatticeTable
    patella: LatticeTable


class ShapeModel(Record, frozen=True):
    """Statistical shape model of the knee bones.

    Attributes
    ----------
    source : str
        Source of the bones to which the model was fitted.
    licence : str
        Licence of the source.
    knees : int
        Number of knees to which the model was fitted.
    modes : tuple of ShapeMode
        Modes of variation.
    lattices : BoneLattices
        Lattices of control points.
    """

    source: str
    licence: str
    knees: int
    modes: tuple[ShapeMode, ...]
    lattices: BoneLattices


def parse_displacements(text: str, counts: tuple[int, int, int], label: str) -> Array:
    """Parse displacements of control points from text.

    Parameters
    ----------
    text : str
        Numbers, in mm, separated by white space.
    counts : (int, int, int)
        Number of control points along x, y and z.
    label : str
        Name of the table, shown in error messages.

    Returns
    -------
    (nx, ny, nz, 3) float64 array
        Displacements, in mm.

    Raises
    ------
    ValueError
        If the text contains anything but finite numbers, or a wrong number of values.
    """
    try:
        values = np.array(text.split(), np.float64)
    except ValueError as error:
        raise ValueError(f"table {label} must contain only numbers, got: {error}") from None
    wanted = int(np.prod(counts)) * 3
    if len(values) != wanted or not np.isfinite(values).all():
        raise ValueError(f"table {label} must contain {wanted} finite numbers, got {np.isfinite(values).sum()}")
    return values.reshape(*counts, 3)


def format_displacements(displacements_mm: Array, digits: int) -> str:
    """Format displacements of control points as text, one line per column of control points along z.

    Parameters
    ----------
    displacements_mm : (nx, ny, nz, 3) array
        Displacements, in mm.
    digits : int
        Number of decimals.

    Returns
    -------
    str
        Text in the format that `parse_displacements` reads.
    """
    rows = np.round(displacements_mm, digits).reshape(-1, displacements_mm.shape[2] * 3) + 0.0
    return "\n".join(" ".join(f"{value:.{digits}f}".rstrip("0").rstrip(".") for value in row) for row in rows)


@cache
def load_shape_model() -> ShapeModel:
    """Load the statistical shape model.

    Returns
    -------
    ShapeModel
        Content of ``data/shapes.toml``.
    """
    return parse_record(ShapeModel, load_data_table("shapes"), "shapes")
