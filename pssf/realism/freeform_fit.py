"""A lattice fitted to a surface: nearest points both ways, planes at them, and control points that bend little."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.spatial import cKDTree

from ..core.checks import Array
from ..geometry.freeform import Lattice, basis_matrix, displaced, placed_before, with_displacements
from ..geometry.mesh import Indices, Mesh
from .surfaces import MeasuredSurface, measured, trimmed

# Of either surface that are asked for their nearest places.
_POINTS = 2000
# Coarse to fine: how much bending counts beside distance at each step.
STIFFNESS = (1.0, 0.3, 0.1, 0.03, 0.01, 0.01, 0.003, 0.003, 0.003)
# Beside bending, how much displacement itself counts (per mm2), so that it stays small where no surface is near: at 0.3
# people's mean bones are reached to 0.01 mm RMS as well as at 0.03, and folds beside them are twice as far off.
_RIDGE = 0.3
# Places whose normals differ by more than this (cosine) are on two sides of an edge or of the notch, and no pair.
_LEAST_COSINE = 0.3


class _Pairs(NamedTuple):
    """Places on the undeformed bone (n, 3), where they should go (n, 3), and the normals of the planes there (n, 3)."""

    places: Array
    wanted: Array
    normals: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class DeformableBone:
    """A bone ready to be deformed, cut up finely enough for that; from `deformable`.

    vertices    (n, 3)  mm
    faces       (m, 3)  vertex numbers
    points_mm   (k, 3)  spread evenly over it
    heights_mm  between which it is compared
    """

    vertices: Array
    faces: Indices
    points_mm: Array
    heights_mm: tuple[float, float]

    def deformed(self, lattice: Lattice) -> MeasuredSurface:
        """Its surface as a lattice moves it."""
        vertices = displaced(self.vertices, lattice)
        corners = vertices[self.faces]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
        return MeasuredSurface(
            mesh=Mesh(vertices, self.faces),
            points_mm=displaced(self.points_mm, lattice),
            corners=corners,
            outward=outward,
            tree=cKDTree(corners.mean(axis=1)),
        )


def deformable(bone: Mesh, heights_mm: tuple[float, float], margin_mm: float = 15.0) -> DeformableBone:
    """A bone to be deformed between two heights (z).

    margin_mm  of the bone beyond these heights, which displacement may bring between them
    """
    kept = trimmed(bone, heights_mm[0] - margin_mm, heights_mm[1] + margin_mm)
    surface = measured(kept, 2 * _POINTS)
    vertices, faces = trimesh.triangles.to_kwargs(surface.corners).values()
    whole = trimesh.Trimesh(vertices, faces, process=True)
    return DeformableBone(
        vertices=np.asarray(whole.vertices),
        faces=np.asarray(whole.faces),
        points_mm=surface.points_mm,
        heights_mm=heights_mm,
    )


def lattice_around(bone: DeformableBone, pitch_mm: float, shaft: int) -> Lattice:
    """A lattice at rest, one pitch wider than a bone between its heights on every side."""
    low, high = bone.vertices.min(axis=0), bone.vertices.max(axis=0)
    low[2], high[2] = max(low[2], bone.heights_mm[0]), min(high[2], bone.heights_mm[1])
    counts = np.ceil((high - low) / pitch_mm).astype(int) + 3
    origin = (low + high) / 2 - (counts - 1) / 2 * pitch_mm
    return Lattice(
        origin_mm=np.round(origin, 3), pitch_mm=pitch_mm, displacements_mm=np.zeros((*counts, 3)), shaft=shaft
    )


def fit_lattice(
    bone: DeformableBone, onto: MeasuredSurface, start: Lattice, stiffness: Sequence[float] = STIFFNESS
) -> Lattice:
    """The lattice that lays a bone onto a surface with little more bending than the one it starts from.

    Least squares of distances to tangent planes (Chen and Medioni 1992) at the nearest places of both surfaces, and of
    second differences of the control points' displacements from those of the start, alternating.
    onto       in the bone's own frame
    stiffness  weight of the bending (per mm2 of mean squared distance), step by step
    """
    count = int(np.prod(start.counts))
    bending = sparse.kron(sparse.eye_array(3), _bending(start)).toarray()
    first = start.displacements_mm.reshape(count, 3)
    lattice = start
    for weight in stiffness:
        pairs = _pairs(bone, onto, lattice)
        basis = basis_matrix(pairs.places, start)
        rows = sparse.hstack([basis.multiply(pairs.normals[:, [axis]]) for axis in range(3)]).toarray()
        off = ((pairs.wanted - pairs.places - basis @ first) * pairs.normals).sum(axis=1)
        normal = rows.T @ rows / len(off) + weight * bending
        change = linalg.solve(normal, rows.T @ off / len(off), assume_a="pos")
        lattice = with_displacements(start, first + change.reshape(3, count).T)
    return lattice


def _pairs(bone: DeformableBone, onto: MeasuredSurface, lattice: Lattice) -> _Pairs:
    surface = bone.deformed(lattice)
    asked, away = surface.points_mm[:_POINTS], onto.points_mm[:_POINTS]
    there, outward = onto.nearest(asked)
    _, own = surface.nearest(asked)
    keep = ((own * outward).sum(axis=1) > _LEAST_COSINE) & _within(asked, bone) & _within(there, bone)
    here, back = surface.nearest(away)
    _, facing = onto.nearest(away)
    also = ((back * facing).sum(axis=1) > _LEAST_COSINE) & _within(away, bone) & _within(here, bone)
    return _Pairs(
        places=np.vstack((bone.points_mm[:_POINTS][keep], placed_before(here[also], lattice))),
        wanted=np.vstack((there[keep], away[also])),
        normals=np.vstack((outward[keep], back[also])),
    )


def _within(points: Array, bone: DeformableBone) -> NDArray[np.bool_]:
    return (points[:, 2] > bone.heights_mm[0]) & (points[:, 2] < bone.heights_mm[1])


def _bending(lattice: Lattice) -> sparse.csr_array:
    """(n, n)  mean squared second differences of control points, as a quadratic form"""
    steps = [_differences(n) for n in lattice.counts]
    form = _RIDGE * sparse.eye_array(int(np.prod(lattice.counts)))
    for a in range(3):
        for b in range(a, 3):
            parts = [sparse.eye_array(n) for n in lattice.counts]
            if a == b:
                parts[a] = steps[a][1]
            else:
                parts[a], parts[b] = steps[a][0], steps[b][0]
            rows = sparse.kron(sparse.kron(parts[0], parts[1]), parts[2])
            form = form + (1 if a == b else 2) * (rows.T @ rows)
    return sparse.csr_array(form / np.prod(lattice.counts))


def _differences(count: int) -> tuple[sparse.csr_array, sparse.csr_array]:
    """First and second differences along an axis."""
    one = sparse.diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1], shape=(count - 1, count))
    two = sparse.diags_array(
        [np.ones(count - 2), -2 * np.ones(count - 2), np.ones(count - 2)], offsets=[0, 1, 2], shape=(count - 2, count)
    )
    return sparse.csr_array(one), sparse.csr_array(two)
