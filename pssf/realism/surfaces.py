"""Distances between two closed surfaces, and the similarity that brings one closest to the other."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..core.checks import Array, InputError
from ..geometry.mesh import Mesh

# Points by which a surface is measured, and by which it is fitted.
POINTS, FIT_POINTS = 4000, 1000
# Of a surface no triangle is longer than this, so that the nearest one is among those whose middles are nearest: on
# the package's bones and on people's (Clouthier et al. 2019) to 0.012 mm at worst and 0.0004 mm RMS.
_LONGEST_MM = 3.0
_CANDIDATES = 8
_STEPS, _STILL_MM = 40, 2e-3
# Nearer than this two places are one, and the way from one to the other is the surface's normal.
_TOUCHING_MM = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Similarity:
    """Turned, scaled, then moved: scale * points @ rotation.T + shift_mm.

    rotation  (3, 3)  proper
    shift_mm  (3,)
    """

    rotation: Array
    scale: float
    shift_mm: Array

    def apply(self, points_mm: Array) -> Array:
        """(n, 3)  where points go

        points_mm  (n, 3)
        """
        return np.asarray(self.scale * points_mm @ self.rotation.T + self.shift_mm)

    def undo(self, points_mm: Array) -> Array:
        """(n, 3)  where points came from

        points_mm  (n, 3)
        """
        return np.asarray((points_mm - self.shift_mm) @ self.rotation / self.scale)


UNMOVED = Similarity(rotation=np.eye(3), scale=1.0, shift_mm=np.zeros(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredSurface:
    """A surface that nearest points can be asked of; from `measured`.

    mesh       as it was given, mm
    points_mm  (n, 3)     spread evenly over it
    corners    (m, 3, 3)  of its triangles, long ones cut up
    outward    (m, 3)     their normals
    tree       of their middles
    """

    mesh: Mesh
    points_mm: Array
    corners: Array
    outward: Array
    tree: cKDTree

    def nearest(self, points_mm: Array) -> tuple[Array, Array]:
        """(n, 3), (n, 3)  nearest places on the surface, and its normals there

        points_mm  (n, 3)
        """
        _, near = self.tree.query(points_mm, k=min(_CANDIDATES, len(self.corners)))
        near = near.reshape(len(points_mm), -1)
        repeated = np.repeat(points_mm, near.shape[1], axis=0)
        places = trimesh.triangles.closest_point(self.corners[near.ravel()], repeated).reshape(*near.shape, 3)
        best = ((places - points_mm[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        rows = np.arange(len(points_mm))
        return places[rows, best], self.outward[near[rows, best]]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceDistance:
    """How far two surfaces are apart, asked at points of both.

    on_mm      (n, 3)  points of the surface that was moved, where it was moved to
    signed_mm  (n,)    their distances from the other; positive: outside it
    back_mm    (m,)    distances of points of the other from the moved one; positive: the moved one is outside there too
    """

    on_mm: Array
    signed_mm: Array
    back_mm: Array

    @property
    def both_mm(self) -> Array:
        """(n + m,)  both ways"""
        return np.concatenate((self.signed_mm, self.back_mm))

    @property
    def rms_mm(self) -> float:
        """Root mean square of both ways."""
        return float(np.sqrt((self.both_mm**2).mean()))

    @property
    def mean_mm(self) -> float:
        """How much the moved surface stands out beyond the other on the whole."""
        return float(self.both_mm.mean())

    @property
    def p99_mm(self) -> float:
        """99th percentile of the distances both ways."""
        return float(np.percentile(np.abs(self.both_mm), 99))


def measured(mesh: Mesh, points: int = POINTS, seed: int = 0) -> MeasuredSurface:
    """A surface made ready to be measured.

    points  drawn evenly by area, from the seed
    raises  InputError for a mesh without an area
    """
    whole = trimesh.Trimesh(*mesh, process=False)
    if not whole.area > 0:
        raise InputError(f"surface: area = {whole.area:g} mm2; allowed: more than 0")
    # Slivers have no normal of their own, and nothing is nearest to them alone.
    whole.update_faces(whole.nondegenerate_faces(height=1e-8))
    places, _ = trimesh.sample.sample_surface(whole, points, seed=seed)
    vertices, faces = trimesh.remesh.subdivide_to_size(whole.vertices, whole.faces, _LONGEST_MM, max_iter=20)
    corners = np.asarray(vertices[faces])
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
    return MeasuredSurface(
        mesh=mesh,
        points_mm=np.asarray(places),
        corners=corners,
        outward=outward,
        tree=cKDTree(corners.mean(axis=1)),
    )


def trimmed(mesh: Mesh, low_mm: float, high_mm: float) -> Mesh:
    """A mesh between two heights (z); open where it was cut.

    raises  InputError where nothing of it lies between them
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    for height, up in ((low_mm, 1.0), (high_mm, -1.0)):
        if np.isfinite(height):
            vertices, faces, _ = trimesh.intersections.slice_faces_plane(
                vertices, faces, plane_normal=[0.0, 0.0, up], plane_origin=[0.0, 0.0, height]
            )
    if not len(faces):
        raise InputError(f"surface: faces between {low_mm:g} and {high_mm:g} mm = 0; allowed: 1 or more")
    return Mesh(vertices, faces)


def fit_similarity(
    moving: MeasuredSurface,
    onto: MeasuredSurface,
    start: Similarity = UNMOVED,
    heights_mm: tuple[float, float] = (-np.inf, np.inf),
    points: int = FIT_POINTS,
) -> Similarity:
    """The similarity with the least squared distances between two surfaces, nearest points both ways.

    Gauss-Newton on the distances themselves (after Fitzgibbon 2003), from a start that must be near.
    heights_mm  of `onto` between which distances count
    points      of each surface that are asked
    raises      InputError where nothing of one lies between the heights
    """
    fit = start
    target = onto.points_mm[:points]
    target = target[_between(target, heights_mm)]
    for _ in range(_STEPS):
        placed = fit.apply(moving.points_mm[:points])
        placed = placed[_between(placed, heights_mm)]
        if not len(placed) or not len(target):
            what = f"{len(placed)} and {len(target)} points within {heights_mm[0]:g} to {heights_mm[1]:g} mm"
            raise InputError(f"surfaces: {what} = too few; allowed: two that overlap in height")
        there, outward = onto.nearest(placed)
        here, own = moving.nearest(fit.undo(target))
        moved = np.vstack((placed, fit.apply(here)))
        wanted = np.vstack((there, target))
        normals = np.vstack((outward, own @ fit.rotation.T))
        fit, step_mm = _one_step(fit, moved, wanted, normals)
        if step_mm < _STILL_MM:
            break
    return fit


def surface_distance(
    moving: MeasuredSurface,
    onto: MeasuredSurface,
    fit: Similarity = UNMOVED,
    heights_mm: tuple[float, float] = (-np.inf, np.inf),
) -> SurfaceDistance:
    """Distances between two surfaces, one of them moved by a similarity, both ways.

    heights_mm  of `onto` between which points count
    """
    placed = fit.apply(moving.points_mm)
    placed = placed[_between(placed, heights_mm)]
    there, outward = onto.nearest(placed)
    target = onto.points_mm[_between(onto.points_mm, heights_mm)]
    here, own = moving.nearest(fit.undo(target))
    back = _signed(fit.apply(here) - target, own @ fit.rotation.T)
    return SurfaceDistance(on_mm=placed, signed_mm=_signed(placed - there, outward), back_mm=back)


def _between(points: Array, heights_mm: tuple[float, float]) -> NDArray[np.bool_]:
    return (points[:, 2] > heights_mm[0]) & (points[:, 2] < heights_mm[1])


def _signed(away: Array, normals: Array) -> Array:
    """(n,)  lengths of vectors (n, 3), with the sign that they have along normals (n, 3)"""
    return np.linalg.norm(away, axis=1) * np.where((away * normals).sum(axis=1) < 0, -1.0, 1.0)


def _one_step(fit: Similarity, moved: Array, wanted: Array, normals: Array) -> tuple[Similarity, float]:
    """The next similarity, and how far it moves the points (RMS, mm)."""
    middle = moved.mean(axis=0)
    arm = moved - middle
    away = wanted - moved
    off = np.linalg.norm(away, axis=1)
    apart = off > _TOUCHING_MM
    # At an edge the way to the nearest place is along no triangle's normal.
    ways = np.where(apart[:, None], away / np.where(apart, off, 1.0)[:, None], normals)
    columns = np.column_stack((np.cross(arm, ways), ways, (arm * ways).sum(axis=1)))
    # A part that turns or slides in itself, as a ball does, has no best place: it stays where it is.
    change = np.linalg.lstsq(columns, off, rcond=1e-6)[0]
    turn, scale = Rotation.from_rotvec(change[:3]).as_matrix(), float(np.exp(change[6]))
    shift = scale * (fit.shift_mm - middle) @ turn.T + middle + change[3:6]
    after = Similarity(rotation=turn @ fit.rotation, scale=scale * fit.scale, shift_mm=shift)
    step = scale * arm @ turn.T - arm + change[3:6]
    return after, float(np.sqrt((step**2).sum(axis=1).mean()))
