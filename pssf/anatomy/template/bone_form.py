"""Statistical shape model: compute the lattices that deform the template bones from the scores of shape modes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...core.checks import Array, InputError
from ...data.anatomy.shape_table import (
    LatticeTable,
    ShapeMode,
    ShapeModel,
    parse_displacements,
)
from ...geometry.freeform_deformation import Lattice, replace_displacements


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneShapeModel:
    """Statistical shape model of one bone.

    Attributes
    ----------
    mean : Lattice
        Deformation of the template bone into the mean bone of the population, in the frame of the bone.
    modes_mm : (modes, nx, ny, nz, 3) float64 array
        Change of the lattice displacements per standard deviation of each mode, in mm.
    """

    mean: Lattice
    modes_mm: Array

    def build_lattice(self, scores: Array) -> Lattice:
        """Build the lattice of one knee from its mode scores.

        Parameters
        ----------
        scores : (modes,) float64 array, SD
            Score of each mode, in standard deviations.

        Returns
        -------
        Lattice
            Deformation of the template bone into the bone with these scores.

        Raises
        ------
        InputError
            If the number of scores differs from the number of modes.
        """
        if np.shape(scores) != (len(self.modes_mm),):
            raise InputError(f"scores must have shape ({len(self.modes_mm)},), got {np.shape(scores)}")
        return replace_displacements(self.mean, self.mean.displacements_mm + np.tensordot(scores, self.modes_mm, 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class KneeShapeModel:
    """Statistical shape model of a knee.

    Attributes
    ----------
    bones : Mapping of str to BoneShapeModel
        Shape model of each bone: femur, tibia and patella.
    modes : tuple of ShapeMode
        Shape modes, which are common to all bones.
    """

    bones: Mapping[str, BoneShapeModel]
    modes: tuple[ShapeMode, ...]


@cache
def build_shape_model(table: ShapeModel) -> KneeShapeModel:
    """Build the statistical shape model from its table.

    Parameters
    ----------
    table : ShapeModel
        Mean shapes and shape modes.

    Returns
    -------
    KneeShapeModel
        Shape model with lattices.

    Raises
    ------
    ValueError
        If the displacements of a bone do not match the size of its lattice or the number of modes.
    """
    lattices = {name: getattr(table.lattices, name) for name in ("femur", "tibia", "patella")}
    return KneeShapeModel(
        bones={name: _build_bone_shape_model(of, len(table.modes), name) for name, of in lattices.items()},
        modes=table.modes,
    )


def build_lattices(scores: Sequence[float], shape_model: KneeShapeModel) -> dict[str, Lattice]:
    """Build the lattices that deform the template bones into the bones of one knee.

    Parameters
    ----------
    scores : sequence of float
        Scores in standard deviations, in the order of the modes. Omitted scores are 0, which is the mean.
    shape_model : KneeShapeModel
        Statistical shape model.

    Returns
    -------
    dict of str to Lattice
        Lattice of each bone: femur, tibia and patella.
    """
    all_scores = np.zeros(len(shape_model.modes))
    all_scores[: len(scores)] = scores
    return {name: bone.build_lattice(all_scores) for name, bone in shape_model.bones.items()}


def _build_bone_shape_model(table: LatticeTable, modes: int, name: str) -> BoneShapeModel:
    """Check the number of modes in the table of one bone, and build the shape model of this bone."""
    if len(table.modes_mm) != modes:
        raise ValueError(f"table shapes: {name} must have {modes} modes, got {len(table.modes_mm)}")
    mean = Lattice(
        origin_mm=np.array(table.origin_mm),
        pitch_mm=table.pitch_mm,
        displacements_mm=parse_displacements(table.mean_mm, table.counts, f"shapes: {name} mean"),
        shaft_sign=table.shaft,
    )
    added = [parse_displacements(text, table.counts, f"shapes: {name} modes") for text in table.modes_mm]
    return BoneShapeModel(mean=mean, modes_mm=np.array(added))
