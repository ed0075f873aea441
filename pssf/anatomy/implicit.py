"""Shapes as fields: approximate signed distances (mm, negative inside), blended; and solids settled onto them.

CSG makes a solid of the right topology with hard creases; settling moves its vertices onto the level set of a field in
which the same parts are blended, so that one part flows into the other.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.sparse import coo_array, csr_array, diags_array
from trimesh.triangles import closest_point

from ..core.checks import Array
from .solids import edges_of, halved, mesh_of, solid_of, widened

Field = Callable[[Array], Array]
Choice = Callable[[Array], NDArray[np.bool_]]

# Step of the differences that give a field's gradient, mm: fields are smooth over this, and float64 resolves it.
_STEP_MM = 0.01
_MOST_MM, _NEAR_MM = 1.5, 0.05
# Of a whole bone: rounds of evening out its mesh, halvings of edges where it bends, and where its shaft begins.
_ROUNDS, _HALVINGS, _SHAFT_FROM_MM = 6, 4, 70.0
# Shafts are cut off before this height. Rounds of unfolding, and of spreading evenly in each.
_USED_MM, _UNFOLDINGS, _FLATTENINGS = 200.0, 10, 10
# Of a tip: what is about it, how far middles of edges may be off there, halvings, and what may be cut off it.
_TIP_MM, _TIP_TOLERANCE_MM, _TIP_HALVINGS, _CUT_MM = 4.0, 0.02, 3, 1e-4


def blend(one: Array, other: Array, radius_mm: float) -> Array:
    """(n,)  union of two fields with a fillet (polynomial smooth minimum, Quilez 2013)"""
    overlap = np.maximum(radius_mm - np.abs(one - other), 0.0) / radius_mm
    return np.minimum(one, other) - overlap**2 * radius_mm / 4


def meet(one: Array, other: Array, radius_mm: float) -> Array:
    """(n,)  intersection of two fields with a rounded edge"""
    return -blend(-one, -other, radius_mm)


def carve(one: Array, other: Array, radius_mm: float) -> Array:
    """(n,)  one field without the other, with a rounded edge"""
    return meet(one, -other, radius_mm)


def ellipsoid(points: Array, centre_mm: list[float], half_mm: list[float]) -> Array:
    """(n,)  field of an ellipsoid; points (n, 3)"""
    half = np.asarray(half_mm)
    scaled = (points - centre_mm) / half
    norm, slope = lengths(scaled), lengths(scaled / half)
    return np.where(slope > 0, norm * (norm - 1) / np.maximum(slope, 1e-9), -half.min())


def squares(vectors: Array) -> Array:
    """(n,)  squared lengths of vectors (n, 3); a sum over so short an axis takes numpy four times as long"""
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


def lengths(vectors: Array) -> Array:
    """(n,)  lengths of vectors (n, 3)"""
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


def gradient(field: Field, points: Array, value: Array) -> Array:
    """(n, 3)  differences of a field at points (n, 3), where it has the values (n,)"""
    return np.stack([(field(points + shift) - value) / _STEP_MM for shift in np.eye(3) * _STEP_MM], axis=1)


def refined(solid: Manifold, edge_mm: float, shaft_from_mm: float) -> Manifold:
    """The solid with edges of at most `edge_mm`, and four times that along the shaft, beyond a distance from z = 0."""

    def pressed(factor: float) -> Callable[[Array], Array]:
        def move(points: Array) -> Array:
            places = np.array(points)
            beyond = np.maximum(np.abs(places[:, 2]) - shaft_from_mm, 0.0)
            places[:, 2] += np.sign(places[:, 2]) * beyond * (factor - 1)
            return places

        return move

    short = solid.simplify(0.02).warp_batch(pressed(0.25))
    return short.refine_to_length(edge_mm).warp_batch(pressed(4.0))


def shaped(rough: Manifold, field: Field, edge_mm: float, tolerance_mm: float) -> Manifold:
    """A bone by CSG as its field has it: evenly meshed, and finer where it bends.

    edge_mm       longest edge, away from the shaft
    tolerance_mm  how far middles of edges may be off the field
    """
    even = evened(refined(rough, edge_mm, _SHAFT_FROM_MM), field, _ROUNDS)
    # A tenth of the triangles, in flat places, is not needed.
    return resolved(even, field, tolerance_mm, _HALVINGS).simplify(0.4 * tolerance_mm)


def settle(solid: Manifold, field: Field, *, depth_mm: Field | None = None, steps: int = 5) -> Manifold:
    """The solid with its vertices moved along the gradient to where the field is zero, or a depth below it (Newton).

    depth_mm  how deep inside; 0 everywhere if None
    """
    return solid.warp_batch(lambda points: onto(np.array(points), field, depth_mm, steps))


def evened(
    solid: Manifold,
    field: Field,
    rounds: int,
    near: Choice | None = None,
    tips: Sequence[Array] = (),
) -> Manifold:
    """A solid settled on a field, its vertices spread evenly over it, free of the slivers that CSG leaves at creases.

    near  which vertices may move at all: (n, 3) -> (n,) bool; all of them if None
    tips  points (3,) of the field's surface that a coarse mesh would cut off
    """
    mesh = mesh_of(solid)
    places = np.array(mesh.vertices)
    free = np.ones(len(places), np.bool_) if near is None else near(places)
    faces = np.asarray(mesh.faces)
    amid = _amid(faces, len(places))[free]
    places[free] = onto(places[free], field, None, 5)
    for _ in range(rounds):
        places[free] = onto((places[free] + amid @ places) / 2, field, None, 2)
    places = _unfolded(places, faces, free, field)
    for tip in tips:
        places, faces = _tipped(places, faces, field, tip)
    return solid_of(places, faces, "evened")


def _amid(faces: Array, count: int) -> csr_array:
    """(count, count)  takes values at vertices to their means over those that share an edge with each"""
    ends = np.vstack((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    beside = coo_array((np.ones(len(ends)), ends.T), shape=(count, count)).tocsr()
    return csr_array(diags_array(1.0 / beside.sum(axis=1)) @ beside)


def _tipped(places: Array, faces: Array, field: Field, tip: Array) -> tuple[Array, Array]:
    """Places and faces with a tip of the field's surface, where they cut it off.

    Edges about it are halved, then the triangle below it gets a vertex there.
    """
    below, away = _below(places, faces, tip)
    if away >= _CUT_MM:
        about = partial(_within, tip)
        places, faces = _finer(places, faces, field, _TIP_TOLERANCE_MM, _TIP_HALVINGS, about)
        below, away = _below(places, faces, tip)
    if away < _CUT_MM:
        return places, faces
    one, two, three = faces[below]
    new = len(places)
    pieces = [[one, two, new], [two, three, new], [three, one, new]]
    return np.vstack((places, tip)), np.vstack((np.delete(faces, below, axis=0), pieces))


def _below(places: Array, faces: Array, tip: Array) -> tuple[int, float]:
    """The triangle that is nearest to a tip, and how far away it is."""
    about = np.flatnonzero(_within(tip, places[faces].mean(axis=1)))
    away = lengths(closest_point(places[faces[about]], np.repeat(tip[None], len(about), axis=0)) - tip)
    return int(about[away.argmin()]), float(away.min())


def _within(tip: Array, points: Array) -> NDArray[np.bool_]:
    return np.asarray(squares(points - tip) < _TIP_MM**2)


def _unfolded(places: Array, faces: Array, free: NDArray[np.bool_], field: Field) -> Array:
    """The places with triangles that face inwards laid flat: what is around them is spread evenly once more.

    A patch that stays folded is widened, since a narrow one about a tip has no room to turn.
    """
    places = places.copy()
    amid = _amid(faces, len(places))
    used = faces[free[faces].any(axis=1) & (np.abs(places[faces, 2]) < _USED_MM).all(axis=1)]
    suspect = used
    for turn in range(_UNFOLDINGS):
        inside_out = suspect[_inwards(places[suspect], field)]
        if not len(inside_out):
            break
        around = np.zeros(len(places), np.bool_)
        around[inside_out] = True
        around = free & widened(around, faces, 2 + turn)
        suspect = used[around[used].any(axis=1)]  # the others have been found to face outwards, and stay
        middles = amid[around]
        for _ in range(_FLATTENINGS):
            places[around] = onto(middles @ places, field, None, 1)
        places[around] = onto(places[around], field, None, 5)
    return places


def _inwards(triangles: Array, field: Field) -> NDArray[np.bool_]:
    """(n,)  which of (n, 3, 3) corners are in the order of a triangle that faces inwards"""
    one, two, three = (triangles[:, k] for k in range(3))
    middle = (one + two + three) / 3
    outward = gradient(field, middle, field(middle))
    return np.asarray((np.cross(two - one, three - one) * outward).sum(axis=1) <= 0)


def resolved(solid: Manifold, field: Field, tolerance_mm: float, rounds: int) -> Manifold:
    """A solid settled on a field, with those edges halved, up to so many times, whose middles are farther off it."""
    mesh = mesh_of(solid)
    places, faces = np.array(mesh.vertices), np.asarray(mesh.faces)
    places, faces = _finer(places, faces, field, tolerance_mm, rounds)
    places = _unfolded(places, faces, np.ones(len(places), np.bool_), field)
    return solid_of(places, faces, "resolved")


def _finer(
    places: Array, faces: Array, field: Field, tolerance_mm: float, rounds: int, near: Choice | None = None
) -> tuple[Array, Array]:
    """Places and faces with those edges halved, up to so many times, whose middles are farther off the field.

    near  which vertices both ends of an edge must be among: (n, 3) -> (n,) bool; all of them if None
    """
    for _ in range(rounds):
        edges = edges_of(faces)
        if near is not None:
            edges = edges[near(places)[edges].all(axis=1)]
        middles = places[edges].mean(axis=1)
        settled = onto(middles, field, None, 3)
        off = np.linalg.norm(settled - middles, axis=1) > tolerance_mm
        if not off.any():
            break
        faces = halved(faces, edges[off], len(places))
        places = np.vstack((places, settled[off]))
    return places, faces


def onto(places: Array, field: Field, depth_mm: Field | None, steps: int) -> Array:
    """Places (n, 3) after so many steps towards where the field is zero, or a depth below it."""
    slope, moved_mm = np.empty(0), np.inf
    for _ in range(steps):
        value = field(places)
        # The gradient takes three more fields; where nothing has moved far since, it is still good.
        if moved_mm > _NEAR_MM:
            slope = gradient(field, places, value)
        miss = value + (0.0 if depth_mm is None else depth_mm(places))
        step = -miss[:, None] * slope / np.maximum(squares(slope), 0.05)[:, None]
        length = lengths(step)
        moved_mm = float(length.max(initial=0.0))
        # Where fields are blended the gradient is short; a long step would leave the neighbourhood.
        places = places + step * np.minimum(1.0, _MOST_MM / np.maximum(length, 1e-12))[:, None]
    return places
