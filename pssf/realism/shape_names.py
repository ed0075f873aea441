"""Modes of variation named by what they do: the measure of form that follows each best, which fixes its sign."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..geometry.freeform import displaced
from ..geometry.mesh import Mesh
from .shape_measures import measures
from .shape_modes import MeanFit, Modes, lattice_of

# Measures that are named beside the first correlate at least so much with the score, and no more are named than these.
_ALSO, _AT_MOST = 0.4, 3


@dataclass(frozen=True, kw_only=True)
class ModeName:
    """What a mode does.

    name         the measure that follows its score most closely, among those no earlier mode is called by
    correlation  of the two over knees, positive
    also         other measures, with + where they grow with the score and - where they fall
    """

    name: str
    correlation: float
    also: str


def formed(mean: MeanFit, displacements_mm: Mapping[str, Array]) -> dict[str, Mesh]:
    """Bones as displacements form them, each in its own frame, before they stand.

    displacements_mm  bone -> (controls, 3)
    """
    return {
        name: Mesh(displaced(mean.bones[name].vertices, lattice_of(mean, name, values)), mean.bones[name].faces)
        for name, values in displacements_mm.items()
    }


def measured_knees(mean: MeanFit, fitted: Mapping[str, Array]) -> tuple[tuple[str, ...], Array]:
    """Names of measures, and (knees, measures) of knees that were fitted.

    fitted  bone -> (knees, controls, 3)  displacements, mm
    """
    knees = len(next(iter(fitted.values())))
    rows = [measures(formed(mean, {name: values[k] for name, values in fitted.items()})) for k in range(knees)]
    return tuple(rows[0]), np.array([list(row.values()) for row in rows])


def name_modes(modes: Modes, names: tuple[str, ...], values: Array) -> tuple[Modes, tuple[ModeName, ...]]:
    """Modes, turned so that the measure each is named by grows with its score, and their names.

    values  (knees, measures)  each in its own unit, of the knees that the modes come from
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
        named.append(ModeName(name=names[first], correlation=float(abs(row[first])), also=also))
        signs.append(sign)
    turn = np.array(signs)
    turned = {name: values * turn[:, None, None] for name, values in modes.directions.items()}
    return replace(modes, directions=turned, scores=modes.scores * turn), tuple(named)
