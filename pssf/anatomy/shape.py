"""The form of a knee's bones: scores of people's modes of variation -> lattices that deform the mean man's bones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..core.checks import Array, InputError
from ..data.shapes import LatticeTable, Mode, ShapeTable, read_displacements
from ..geometry.freeform import Lattice, with_displacements


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneForm:
    """How people's bones of one kind are formed.

    mean      makes the mean man's bone, in its own frame before it stands, people's mean
    modes_mm  (modes, nx, ny, nz, 3)  what one standard deviation of each mode adds to its displacements
    """

    mean: Lattice
    modes_mm: Array

    def lattice(self, scores: Array) -> Lattice:
        """The lattice of a knee.

        scores  (modes,)  SD
        raises  InputError for another number of scores
        """
        if np.shape(scores) != (len(self.modes_mm),):
            raise InputError(f"scores: shape = {np.shape(scores)}; allowed: ({len(self.modes_mm)},)")
        return with_displacements(self.mean, self.mean.displacements_mm + np.tensordot(scores, self.modes_mm, 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class KneeForm:
    """How people's knees are formed: bone (femur, tibia, patella) -> its form; the modes, which all bones share."""

    bones: Mapping[str, BoneForm]
    modes: tuple[Mode, ...]


@cache
def knee_form(table: ShapeTable) -> KneeForm:
    """What a table of shapes says, as lattices.

    raises  ValueError for a bone whose numbers are not as many as its lattice and the modes need
    """
    lattices = {name: getattr(table.lattices, name) for name in ("femur", "tibia", "patella")}
    return KneeForm(
        bones={name: _bone_form(of, len(table.modes), name) for name, of in lattices.items()}, modes=table.modes
    )


def lattices_of(scores: Sequence[float], form: KneeForm) -> dict[str, Lattice]:
    """Bone -> the lattice that moves the mean man's to a person's.

    scores  in standard deviations, in the order of the modes; those left out are 0, the mean
    """
    all_scores = np.zeros(len(form.modes))
    all_scores[: len(scores)] = scores
    return {name: bone.lattice(all_scores) for name, bone in form.bones.items()}


def _bone_form(table: LatticeTable, modes: int, name: str) -> BoneForm:
    if len(table.modes_mm) != modes:
        raise ValueError(f"table shapes: {name} modes = {len(table.modes_mm)}; allowed: {modes}")
    mean = Lattice(
        origin_mm=np.array(table.origin_mm),
        pitch_mm=table.pitch_mm,
        displacements_mm=read_displacements(table.mean_mm, table.counts, f"shapes: {name} mean"),
        shaft=table.shaft,
    )
    added = [read_displacements(text, table.counts, f"shapes: {name} modes") for text in table.modes_mm]
    return BoneForm(mean=mean, modes_mm=np.array(added))
