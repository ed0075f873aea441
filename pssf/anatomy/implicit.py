"""Shapes as fields: approximate signed distances (mm, negative inside), blended; and solids settled
onto them.

CSG makes a solid of the right topology with hard creases; settling moves its vertices onto the level set of a field in
which the same parts are blended, so that one part flows into the other.
"""

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold
from scipy.interpolate import PchipInterpolator

from ..core.checks import Array
from ..data.records import Triple

Field = Callable[[Array], Array]

# Step of the differences that give a field's gradient, mm: fields are smooth over this, and float64 resolves it.
_STEP_MM = 0.01
_MOST_MM, _NEAR_MM = 1.5, 0.05


def blend(one: Array, other: Array, radius_mm: float | Array) -> Array:
    """(n,)  union of two fields with a fillet (polynomial smooth minimum, Quilez 2013)

    one, other  (n,)  values of two fields, mm
    radius_mm   of the fillet, one or (n,)
    """
    overlap = np.maximum(radius_mm - np.abs(one - other), 0.0) / radius_mm
    return np.minimum(one, other) - overlap**2 * radius_mm / 4


def meet(one: Array, other: Array, radius_mm: float | Array) -> Array:
    """(n,)  intersection of two fields with a rounded edge

    one, other  (n,)  values of two fields, mm
    radius_mm   of the rounding, one or (n,)
    """
    return -blend(-one, -other, radius_mm)


def carve(one: Array, other: Array, radius_mm: float) -> Array:
    """(n,)  one field without the other, each (n,) mm, with a rounded edge"""
    return meet(one, -other, radius_mm)


def ellipsoid(points: Array, centre_mm: Triple, half_mm: Triple) -> Array:
    """(n,)  field of an ellipsoid, mm; points (n, 3) mm"""
    half = np.asarray(half_mm)
    scaled = (points - np.asarray(centre_mm)) / half
    norm, slope = lengths(scaled), lengths(scaled / half)
    return np.where(slope > 0, norm * (norm - 1) / np.maximum(slope, 1e-9), -half.min())


def squares(vectors: Array) -> Array:
    """(n,)  squared lengths of vectors (n, 3), any unit; a sum over so short an axis takes numpy four times as long"""
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


def lengths(vectors: Array) -> Array:
    """(n,)  lengths of vectors (n, 3), in their own unit"""
    return np.sqrt(squares(vectors))


class Column:
    """Field of superelliptic sections interpolated in height; beyond the first and the last they go on unchanged.

    sections  (n, 5)  z, half ML, half AP, centre y, centre x; any order in z
    """

    def __init__(self, sections: Array, power: float) -> None:
        rows = np.asarray(sections, dtype=np.float64)
        rows = rows[np.argsort(rows[:, 0])]
        self.ends, self.power = (rows[0, 0], rows[-1, 0]), power
        self.at = PchipInterpolator(rows[:, 0], rows[:, 1:])

    def __call__(self, points: Array) -> Array:
        half_x, half_y, y, x = self.at(np.clip(points[:, 2], *self.ends)).T
        u, v, power = np.abs(points[:, 0] - x) / half_x, np.abs(points[:, 1] - y) / half_y, self.power
        norm = (u**power + v**power) ** (1 / power)
        way = np.maximum(norm, 1e-9)
        slope = np.hypot((u / way) ** (power - 1) / half_x, (v / way) ** (power - 1) / half_y)
        # On the axis itself there is no direction; the nearest side is that of the smaller half.
        return (norm - 1) / np.where(norm > 1e-9, slope, 1 / np.minimum(half_x, half_y))


def with_gradient(field: Field, points: Array) -> tuple[Array, Array]:
    """Values (n,) of a field, mm, at points (n, 3), mm, and its gradient there (n, 3), by differences.

    One call of the field, not four: most of it is what numpy takes to begin, at the hundreds of points about a lip.
    """
    shifts = _STEP_MM * np.vstack((np.zeros(3), np.eye(3)))
    value, *beside = field((points + shifts[:, None]).reshape(-1, 3)).reshape(4, -1)
    return value, np.stack([(shifted - value) / _STEP_MM for shifted in beside], axis=1)


def project_solid(solid: Manifold, field: Field, *, depth_mm: Field | None = None, steps: int = 5) -> Manifold:
    """The solid with its vertices moved along the gradient to where the field is zero, or a depth below it (Newton).

    depth_mm  how deep inside; 0 everywhere if None
    """
    return solid.warp_batch(lambda points: project_to_surface(np.array(points), field, depth_mm, steps))


def project_to_surface(places: Array, field: Field, depth_mm: Field | None, steps: int) -> Array:
    """Places (n, 3) after so many steps towards where the field is zero, or a depth below it.

    places  (n, 3)  mm
    """
    slope, moved_mm = np.empty(0), np.inf
    for _ in range(steps):
        # The gradient takes three more fields; where nothing has moved far since, it is still good.
        if moved_mm > _NEAR_MM:
            value, slope = with_gradient(field, places)
        else:
            value = field(places)
        miss = value + (0.0 if depth_mm is None else depth_mm(places))
        step = -miss[:, None] * slope / np.maximum(squares(slope), 0.05)[:, None]
        length = lengths(step)
        moved_mm = float(length.max(initial=0.0))
        # Where fields are blended the gradient is short; a long step would leave the neighbourhood.
        places = places + step * np.minimum(1.0, _MOST_MM / np.maximum(length, 1e-12))[:, None]
    return places
