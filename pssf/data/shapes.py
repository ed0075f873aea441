"""ShapeTable: lattices that give the mean man's bones people's form and its variation, as `data/shapes.toml` has it."""

from functools import cache

import numpy as np

from ..core.checks import Array
from .records import Record, Triple, record
from .tables import data


class Mode(Record, frozen=True):
    """One way in which the bones of a knee differ together.

    name      the measure of form that follows its score most closely; it grows with the score
    also      others that follow it, with + or -
    share     of the variance of distances between surfaces
    rms_mm    how far one standard deviation moves the surfaces of femur, tibia and patella
    """

    name: str
    correlation: float
    also: str
    share: float
    rms_mm: Triple


class LatticeTable(Record, frozen=True):
    """A lattice of control points around a bone; a line of text has x, y, z of each of those above one another.

    shaft     +1: goes on above, -1: below, 0: neither, see `geometry.freeform.Lattice`
    mean_mm   displacements of the mean, as text
    modes_mm  what one standard deviation of each mode adds, as text
    """

    origin_mm: Triple
    pitch_mm: float
    counts: tuple[int, int, int]
    shaft: int
    mean_mm: str
    modes_mm: tuple[str, ...]


class Lattices(Record, frozen=True):
    """Of the bones that have one."""

    femur: LatticeTable
    tibia: LatticeTable
    patella: LatticeTable


class ShapeTable(Record, frozen=True):
    """All of `data/shapes.toml`.

    knees  that the numbers were fitted to
    """

    source: str
    licence: str
    knees: int
    modes: tuple[Mode, ...]
    lattices: Lattices


def read_displacements(text: str, counts: tuple[int, int, int], what: str) -> Array:
    """(nx, ny, nz, 3)  displacements, mm, from text

    what    how they are called in a refusal
    raises  ValueError for another count of numbers, or what is no number
    """
    try:
        values = np.array(text.split(), np.float64)
    except ValueError as error:
        raise ValueError(f"table {what}: {error}; allowed: numbers") from None
    wanted = int(np.prod(counts)) * 3
    if len(values) != wanted or not np.isfinite(values).all():
        raise ValueError(f"table {what}: finite numbers = {np.isfinite(values).sum()}; allowed: {wanted}")
    return values.reshape(*counts, 3)


def write_displacements(displacements_mm: Array, digits: int) -> str:
    """Text that `read_displacements` reads, a line for each row of control points along z.

    displacements_mm  (nx, ny, nz, 3)
    digits            behind the point
    """
    rows = np.round(displacements_mm, digits).reshape(-1, displacements_mm.shape[2] * 3) + 0.0
    return "\n".join(" ".join(f"{value:.{digits}f}".rstrip("0").rstrip(".") for value in row) for row in rows)


@cache
def shape_table() -> ShapeTable:
    """The package's table of shapes."""
    return record(ShapeTable, data("shapes"), "shapes")
