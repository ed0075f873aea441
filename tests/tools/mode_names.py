"""Names of shape modes: each mode is named after the shape measure with the highest correlation to its score."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from tools.shape_modes import MeanFit, ShapeModes, make_lattice

from pssf.core.checks import Array
from pssf.geometry.freeform_deformation import displace_points
from pssf.geometry.mesh import Mesh
from pssf.patient_comparison.bones.shape_measures import measure_bones

# Minimum absolute correlation of the other listed measures.
_ALSO = 0.4
# Maximum number of other listed measures.
_AT_MOST = 3


@dataclass(frozen=True, kw_only=True)
class ModeName:
    """Name of a shape mode.

    Attributes
    ----------
    name : str
        Shape measure with the highest correlation that is not the name of an earlier mode.
    correlation : float
        Correlation between measure and score over knees; positive.
    other_measures : str
        Other correlated measures, with + or - for the sign of the correlation.
    """

    name: str
    correlation: float
    other_measures: str


def deform_bones(mean: MeanFit, displacements_mm: Mapping[str, Array]) -> dict[str, Mesh]:
    """Deform template bones by lattice displacements in their bone frames, before posture is applied.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    displacements_mm : mapping of str to (controls, 3) array
        Control-point displacements of each bone, in mm.

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
    """Compute shape measures of fitted knees.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    knee_displacements : mapping of str to (knees, controls, 3) array, mm
        Control-point displacements of each bone and knee.

    Returns
    -------
    tuple of str
        Names of the shape measures.
    (knees, measures) array
        Values of the measures, as fractions or in degrees.
    """
    knees = len(next(iter(knee_displacements.values())))
    rows = [
        measure_bones(deform_bones(mean, {name: values[k] for name, values in knee_displacements.items()}))
        for k in range(knees)
    ]
    return tuple(rows[0]), np.array([list(row.values()) for row in rows])


def name_modes(modes: ShapeModes, names: tuple[str, ...], values: Array) -> tuple[ShapeModes, tuple[ModeName, ...]]:
    """Name shape modes, and choose the sign of each mode so that the measure in its name increases with the score.

    Parameters
    ----------
    modes : ShapeModes
        Shape modes.
    names : tuple of str
        Names of the shape measures.
    values : (knees, measures) array, any unit
        Shape measures of the knees from which the modes were computed.

    Returns
    -------
    ShapeModes
        Shape modes with final signs.
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
