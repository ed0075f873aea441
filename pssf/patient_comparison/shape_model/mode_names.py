"""Names of shape modes: each is named after the measure of form with the highest correlation, which fixes its sign."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...core.checks import Array
from ...geometry.freeform_deformation import displace_points
from ...geometry.mesh import Mesh
from ..bones.shape_measures import measure_bones
from .shape_modes import MeanFit, ShapeModes, make_lattice

# Minimum correlation of further measures that are listed.
_ALSO = 0.4
# Maximum number of further measures that are listed.
_AT_MOST = 3


@dataclass(frozen=True, kw_only=True)
class ModeName:
    """Name of a shape mode.

    Attributes
    ----------
    name : str
        Measure of form with the highest correlation, among those that no earlier mode is named after.
    correlation : float
        Correlation of measure and score over knees, positive.
    other_measures : str
        Other correlated measures, with + for positive and - for negative correlation.
    """

    name: str
    correlation: float
    other_measures: str


def deform_bones(mean: MeanFit, displacements_mm: Mapping[str, Array]) -> dict[str, Mesh]:
    """Deform template bones by lattice displacements, each in its own frame before posture is applied.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    displacements_mm : mapping of str to (controls, 3) array
        Displacements of each bone, in mm.

    Returns
    -------
    dict of str to Mesh
        Deformed bones, in mm.
    """
    return {
        name: Mesh(displace_points(mean.bones[name].vertices, make_lattice(mean, name, values)), mean.bones[name].faces)
        for name, values in displacements_mm.items()
    }


def measure_knees(mean: MeanFit, knee_displacements: Mapping[str, Array]) -> tuple[tuple[str, ...], Array]:
    """Measure the form of knees that were fitted.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    knee_displacements : mapping of str to (knees, controls, 3) array, mm
        Displacements of each bone and knee.

    Returns
    -------
    tuple of str
        Names of the measures.
    (knees, measures) array
        Values, each in its own unit.
    """
    knees = len(next(iter(knee_displacements.values())))
    rows = [
        measure_bones(deform_bones(mean, {name: values[k] for name, values in knee_displacements.items()}))
        for k in range(knees)
    ]
    return tuple(rows[0]), np.array([list(row.values()) for row in rows])


def name_modes(modes: ShapeModes, names: tuple[str, ...], values: Array) -> tuple[ShapeModes, tuple[ModeName, ...]]:
    """Name shape modes, and turn their sign so that the naming measure increases with the score.

    Parameters
    ----------
    modes : ShapeModes
        Shape modes.
    names : tuple of str
        Names of the measures.
    values : (knees, measures) array, any unit
        Measures of the knees from which the modes were computed.

    Returns
    -------
    ShapeModes
        Modes with their final sign.
    tuple of ModeName
        Name of each mode.
    """
    off = values - values.mean(axis=0)
    scores = modes.scores - modes.scores.mean(axis=0)
    follow = scores.T @ off / np.outer(np.linalg.norm(scores, axis=0), np.maximum(np.linalg.norm(off, axis=0), 1e-30))
    signs, named = [], list[ModeName]()
    for row in follow:
        order = np.argsort(-np.abs(row), kind="stable")
        first = next(i for i in order if names[i] not in [one.name for one in named])
        sign = 1.0 if row[first] >= 0 else -1.0
        others = [i for i in order if i != first and abs(row[i]) >= _ALSO][:_AT_MOST]
        also = ", ".join(f"{'+' if sign * row[i] > 0 else '-'} {names[i]}" for i in others)
        named.append(ModeName(name=names[first], correlation=float(abs(row[first])), other_measures=also))
        signs.append(sign)
    turn = np.array(signs)
    turned = {name: values * turn[:, None, None] for name, values in modes.directions.items()}
    return replace(modes, directions=turned, scores=modes.scores * turn), tuple(named)
