"""Fit of a deformation lattice to a surface: nearest points in both directions, tangent planes, bending penalty."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.spatial import cKDTree

from pssf.core.checks import Array
from pssf.geometry.freeform_deformation import (
    Lattice,
    basis_matrix,
    displace_points,
    invert_displacement,
    replace_displacements,
)
from pssf.geometry.mesh import Indices, Mesh
from pssf.patient_comparison.bones.surface_distance import SampledSurface, sample_surface, trim_to_heights

# Number of points of each surface that are matched to the other surface.
_POINTS_PER_SURFACE = 2000
# Weight of the bending penalty relative to squared distance in each step, from coarse to fine.
STIFFNESS = (1.0, 0.3, 0.1, 0.03, 0.01, 0.01, 0.003, 0.003, 0.003)
# Weight of squared displacement relative to bending, per mm2. It keeps displacement small far from the surface. With
# 0.3, mean patient bones are fitted to 0.01 mm RMS, as with 0.03, and deformations are twice as far from
# self-intersection.
_RIDGE = 0.3
# Minimum cosine between the normals of matched points; it prevents matches across a sharp edge or the notch.
_MIN_NORMAL_COSINE = 0.3


class _PointPairs(NamedTuple):
    """Matched points (n, 3) of undeformed bone and target, and normals (n, 3) of the tangent planes at these points."""

    source_points: Array
    target_points: Array
    normals: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class DeformableBone:
    """Bone with a mesh fine enough for deformation, from :func:`make_deformable_bone`.

    Attributes
    ----------
    vertices : (n, 3) array
        Vertices in mm.
    faces : (m, 3) int array
        Vertex numbers of each triangle.
    points_mm : (k, 3) array
        Points sampled uniformly over the bone surface, in mm.
    heights_mm : tuple of float
        Lower and upper height between which the bone is compared, in mm.
    """

    vertices: Array
    faces: Indices
    points_mm: Array
    heights_mm: tuple[float, float]

    def apply_lattice(self, lattice: Lattice) -> SampledSurface:
        """Deform the bone surface by a lattice.

        Parameters
        ----------
        lattice : Lattice
            Deformation lattice.

        Returns
        -------
        SampledSurface
            Deformed surface.
        """
        vertices = displace_points(self.vertices, lattice)
        corners = vertices[self.faces]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
        return SampledSurface(
            mesh=Mesh(vertices, self.faces),
            points_mm=displace_points(self.points_mm, lattice),
            triangles_mm=corners,
            triangle_normals=outward,
            tree=cKDTree(corners.mean(axis=1)),
        )


def make_deformable_bone(bone: Mesh, heights_mm: tuple[float, float], margin_mm: float = 15.0) -> DeformableBone:
    """Prepare a bone for deformation between two heights (z).

    Parameters
    ----------
    bone : Mesh
        Bone, in mm.
    heights_mm : tuple of float
        Lower and upper height between which the bone is compared, in mm.
    margin_mm : float, default 15.0
        Length of bone beyond `heights_mm` that is kept, in mm, because deformation may move it between these heights.

    Returns
    -------
    DeformableBone
        Bone prepared for deformation.
    """
    kept = trim_to_heights(bone, heights_mm[0] - margin_mm, heights_mm[1] + margin_mm)
    surface = sample_surface(kept, 2 * _POINTS_PER_SURFACE)
    vertices, faces = trimesh.triangles.to_kwargs(surface.triangles_mm).values()
    whole = trimesh.Trimesh(vertices, faces, process=True)
    return DeformableBone(
        vertices=np.asarray(whole.vertices),
        faces=np.asarray(whole.faces),
        points_mm=surface.points_mm,
        heights_mm=heights_mm,
    )


def make_lattice_around(bone: DeformableBone, pitch_mm: float, shaft_sign: int) -> Lattice:
    """Make an undeformed lattice that extends one pitch beyond a bone in every direction.

    Parameters
    ----------
    bone : DeformableBone
        Bone; the lattice encloses the part between the compared heights.
    pitch_mm : float
        Distance between control points, in mm.
    shaft_sign : int
        Direction of the shaft: +1 proximal, -1 distal, 0 for a bone without a shaft.

    Returns
    -------
    Lattice
        Lattice with zero displacements.
    """
    low, high = bone.vertices.min(axis=0), bone.vertices.max(axis=0)
    low[2], high[2] = max(low[2], bone.heights_mm[0]), min(high[2], bone.heights_mm[1])
    counts = np.ceil((high - low) / pitch_mm).astype(int) + 3
    origin = (low + high) / 2 - (counts - 1) / 2 * pitch_mm
    return Lattice(
        origin_mm=np.round(origin, 3), pitch_mm=pitch_mm, displacements_mm=np.zeros((*counts, 3)), shaft_sign=shaft_sign
    )


def fit_lattice(
    bone: DeformableBone, fixed: SampledSurface, start: Lattice, stiffness: Sequence[float] = STIFFNESS
) -> Lattice:
    """Fit a lattice that deforms a bone to a surface, with a penalty on bending relative to an initial lattice.

    Parameters
    ----------
    bone : DeformableBone
        Bone to deform.
    fixed : SampledSurface
        Target surface, in the frame of the bone.
    start : Lattice
        Initial lattice, relative to which bending is measured.
    stiffness : sequence of float, default STIFFNESS
        Weight of the bending penalty relative to mean squared distance in each step.

    Returns
    -------
    Lattice
        Fitted lattice.

    Notes
    -----
    Each step matches the nearest points of the two surfaces and minimises a sum of squares. The terms are distances to
    tangent planes (Chen and Medioni 1992), and second differences of the control-point displacements relative to the
    initial lattice.
    """
    count = int(np.prod(start.counts))
    bending = sparse.kron(sparse.eye_array(3), _bending_matrix(start)).toarray()
    first = start.displacements_mm.reshape(count, 3)
    lattice = start
    for weight in stiffness:
        pairs = _match_points(bone, fixed, lattice)
        basis = basis_matrix(pairs.source_points, start)
        rows = sparse.hstack([basis.multiply(pairs.normals[:, [axis]]) for axis in range(3)]).toarray()
        off = ((pairs.target_points - pairs.source_points - basis @ first) * pairs.normals).sum(axis=1)
        normal = rows.T @ rows / len(off) + weight * bending
        change = linalg.solve(normal, rows.T @ off / len(off), assume_a="pos")
        lattice = replace_displacements(start, first + change.reshape(3, count).T)
    return lattice


def _match_points(bone: DeformableBone, fixed: SampledSurface, lattice: Lattice) -> _PointPairs:
    """Match nearest points of bone and target in both directions; omit pairs with different normals."""
    surface = bone.apply_lattice(lattice)
    asked, away = surface.points_mm[:_POINTS_PER_SURFACE], fixed.points_mm[:_POINTS_PER_SURFACE]
    there, outward = fixed.find_nearest(asked)
    _, own = surface.find_nearest(asked)
    keep = (
        ((own * outward).sum(axis=1) > _MIN_NORMAL_COSINE)
        & _is_within_heights(asked, bone)
        & _is_within_heights(there, bone)
    )
    here, back = surface.find_nearest(away)
    _, facing = fixed.find_nearest(away)
    also = (
        ((back * facing).sum(axis=1) > _MIN_NORMAL_COSINE)
        & _is_within_heights(away, bone)
        & _is_within_heights(here, bone)
    )
    return _PointPairs(
        source_points=np.vstack((bone.points_mm[:_POINTS_PER_SURFACE][keep], invert_displacement(here[also], lattice))),
        target_points=np.vstack((there[keep], away[also])),
        normals=np.vstack((outward[keep], back[also])),
    )


def _is_within_heights(points: Array, bone: DeformableBone) -> NDArray[np.bool_]:
    """Report which points (n, 3) are between the compared heights of a bone."""
    return (points[:, 2] > bone.heights_mm[0]) & (points[:, 2] < bone.heights_mm[1])


def _bending_matrix(lattice: Lattice) -> sparse.csr_array:
    """Compute the (n, n) quadratic form of mean squared second differences and displacements of control points."""
    steps = [_difference_matrices(n) for n in lattice.counts]
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


def _difference_matrices(count: int) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Make the matrices of first and second differences along an axis of control points."""
    one = sparse.diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1], shape=(count - 1, count))
    two = sparse.diags_array(
        [np.ones(count - 2), -2 * np.ones(count - 2), np.ones(count - 2)], offsets=[0, 1, 2], shape=(count - 2, count)
    )
    return sparse.csr_array(one), sparse.csr_array(two)
