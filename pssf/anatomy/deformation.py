"""Deformations: what a person's bones differ by from the mean man's built ones, as lattices of control points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..core.checks import Array
from ..data.shapes import ShapeTable, read_displacements
from ..geometry.freeform import Lattice, with_displacements

BONES = ("femur", "tibia", "patella")


@dataclass(frozen=True, eq=False)
class Deformations:
    """People's mean, and how they differ from it.

    means     bone -> lattice of the mean
    modes_mm  bone -> (modes, nx, ny, nz, 3) what one standard deviation of each mode adds
    """

    means: Mapping[str, Lattice]
    modes_mm: Mapping[str, Array]


@lru_cache(maxsize=2)
def deformations(table: ShapeTable) -> Deformations:
    """The lattices of a table of shapes."""
    means, modes_mm = {}, {}
    for bone in BONES:
        rows = getattr(table.lattices, bone)
        means[bone] = Lattice(
            origin_mm=np.array(rows.origin_mm),
            pitch_mm=rows.pitch_mm,
            displacements_mm=read_displacements(rows.mean_mm, rows.counts, f"shapes {bone} mean_mm"),
            shaft=rows.shaft,
        )
        texts = enumerate(rows.modes_mm, start=1)
        modes_mm[bone] = np.array(
            [read_displacements(text, rows.counts, f"shapes {bone} mode {k}") for k, text in texts]
        )
    return Deformations(means, modes_mm)


def lattices_of(scores: Sequence[float], of: Deformations) -> dict[str, Lattice]:
    """Bone -> the lattice that moves its built mean to a person's: people's mean, and modes by their scores.

    scores  in standard deviations, one a mode; those left out are 0
    """
    lattices = {}
    for bone, mean in of.means.items():
        moved = mean.displacements_mm + np.tensordot(np.asarray(scores, float), of.modes_mm[bone][: len(scores)], 1)
        lattices[bone] = with_displacements(mean, moved)
    return lattices
