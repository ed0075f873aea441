"""Cartilage and menisci: layers on the articular surfaces that share the joint space, and wedges between them."""

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ..core.checks import Array
from ..data.bones import BoneShape
from ..data.records import Pair
from ..data.soft import Menisci, Meniscus
from ..geometry.mesh import Indices, Mesh
from .femur import field_of as femur_field
from .implicit import Field, lengths, with_gradient
from .solids import closed_edges, dilate_rings, loft, ring, solid_of
from .tibia import above
from .tibia import field_of as tibia_field

# Farther than this from the bare bone's surface is osteophyte, which bears no cartilage.
_BARE_MM = 0.02
# Nor do so many rings of triangles around one.
_RINGS = 3
_THINNEST_MM = 0.05
_THINNINGS = 12


@dataclass(frozen=True)
class Layer:
    """Cartilage on a bone: the bone's mesh, and the same mesh with the layer on it.

    bone   (n, 3)  vertices, at the mean man's size
    top    (n, 3)  the same, moved outward by the layer's thickness
    faces  (m, 3)
    """

    bone: Array
    top: Array
    faces: Indices

    def covered(self, top_mm: Array) -> Manifold:
        """The bone with its cartilage, its vertices (n, 3) moved to where they are with it in a knee."""
        return solid_of(top_mm, self.faces, "bone with cartilage")

    @property
    def thick(self) -> NDArray[np.bool_]:
        """(n,)  where it is on the bone"""
        return np.asarray((self.top != self.bone).any(axis=1))

    def alone(self) -> Indices:
        """(k, 3)  faces of the cartilage alone: numbers of the bone's vertices, then of those on top

        Its lower side is the bone's own surface, face by face.
        """
        thick = self.thick
        # A margin vertex, where the layer has no thickness, belongs to both sides; so the layer is closed.
        upper = np.where(thick, np.arange(len(thick)) + len(thick), np.arange(len(thick)))
        chosen = self.faces[thick[self.faces].any(axis=1)]
        return np.vstack((upper[chosen], chosen[:, ::-1]))


def on_femur(outer: Mesh, shape: BoneShape, scale: float, spaces_mm: tuple[float, float]) -> Layer:
    """Cartilage on the surface of a femur at the mean man's size.

    shape      of the mean man's bones
    spaces_mm  medial and lateral joint space, of which the femur's cartilage takes its share
    """
    limits = shape.cartilage.femur

    def zone(points: Array) -> Array:
        x, y, z = points.T
        below = z - limits.below_z
        behind = np.maximum(limits.behind_y - y, z - limits.behind_z)
        before = np.max([y - limits.before_y, z - limits.before_z, np.abs(x) - limits.before_x], axis=0)
        notch = np.minimum(limits.notch_x - np.abs(x), y - limits.notch_y)
        return np.asarray(np.maximum(np.min([below, behind, before], axis=0), notch))

    return _layer(outer, femur_field(shape.femur), zone, _full_mm(shape, scale, spaces_mm))


def on_tibia(outer: Mesh, shape: BoneShape, scale: float, spaces_mm: tuple[float, float]) -> Layer:
    """Cartilage on the surface of a tibia at the mean man's size, level; arguments as in `on_femur`."""
    parts = shape.cartilage.tibia

    def zone(points: Array) -> Array:
        ovals = [
            (np.hypot((points[:, 0] - p.x) / p.half_x, (points[:, 1] - p.y) / p.half_y) - 1) * p.half_x for p in parts
        ]
        return np.asarray(np.maximum(np.min(ovals, axis=0), -2.5 - above(points, shape.tibia.relief)))

    return _layer(outer, tibia_field(shape.tibia), zone, _full_mm(shape, scale, spaces_mm))


def menisci(table: Menisci, scale: float) -> list[Manifold]:
    """Medial and lateral ring, open to the spines, in the tibia's frame; bones and cartilage leave wedges of them."""
    rings = []
    for part in (table.medial, table.lateral):
        outer, inner = (_disc(part, half, table.height_mm) for half in (part.outer, part.inner))
        middle = float(np.sign(part.x)) * table.gap_mm / 2
        gap = Manifold.cube((table.gap_mm, 18.0, 40.0), True).translate((middle, part.y, 0.0))
        rings.append((outer - inner - gap).scale((scale, scale, scale)))
    return rings


def _full_mm(shape: BoneShape, scale: float, spaces_mm: tuple[float, float]) -> Field:
    """Points (n, 3) -> (n,)  thickness of the layer away from its margin, at the mean man's size"""

    def full(points: Array) -> Array:
        medial = np.clip(0.5 + points[:, 0] / 12.0, 0.0, 1.0)
        return shape.cartilage.share / scale * (medial * spaces_mm[0] + (1 - medial) * spaces_mm[1])

    return full


def _layer(outer: Mesh, field: Field, zone: Field, full_mm: Field) -> Layer:
    points, faces = outer
    # From the margin inwards it grows to its full thickness over 4 mm.
    thickness = full_mm(points) * np.clip(-zone(points) / 4.0, 0.0, 1.0)
    thickness[thickness < _THINNEST_MM] = 0.0
    candidates = np.flatnonzero(thickness)
    grown = np.zeros(len(points), np.bool_)
    grown[candidates] = np.abs(field(points[candidates])) > _BARE_MM
    thickness[dilate_rings(grown, faces, _RINGS)] = 0.0
    while len(pinched := _pinched(faces, thickness > 0)):
        thickness[pinched] = _THINNEST_MM
    bearing = np.flatnonzero(thickness)
    way = with_gradient(field, points[bearing])[1]
    way /= lengths(way)[:, None]
    thickness[bearing] = np.minimum(thickness[bearing], _room(points, bearing, way, faces))
    normals = np.zeros_like(points)
    normals[bearing] = way
    suspect = faces[(thickness[faces] > 0).any(axis=1)]
    for _ in range(_THINNINGS):
        folded = _folded(points, points + normals * thickness[:, None], suspect)
        if not len(folded):
            break
        thickness[folded] /= 2
        # The others have been found not to fold, and stay.
        suspect = suspect[np.isin(suspect, folded).any(axis=1)]
    # What is thinner lies in a crease, whose other side it would cross.
    thickness[thickness < _THINNEST_MM] = 0.0
    while len(pinched := _pinched(faces, thickness > 0)):
        around = np.isin(np.arange(len(points)), pinched)
        thickness[dilate_rings(around, faces, 1)] = 0.0
    return Layer(points, points + normals * thickness[:, None], faces)


def _room(points: Array, bearing: NDArray[np.int64], way: Array, faces: Indices) -> Array:
    """(n,)  how thick a layer may be where the bone is hollow: half the radius in which the ways outward converge"""
    normals, bears = np.zeros_like(points), np.zeros(len(points), np.bool_)
    normals[bearing], bears[bearing] = way, (way != 0).any(axis=1)
    edges = closed_edges(faces)
    edges = edges[bears[edges].all(axis=1)]
    span, turn = (part[edges[:, 1]] - part[edges[:, 0]] for part in (points, normals))
    bend = np.maximum(-(span * turn).sum(axis=1) / (span**2).sum(axis=1), 0.0)
    most = np.zeros(len(points))
    for end in (0, 1):
        np.maximum.at(most, edges[:, end], bend)
    return np.maximum(0.5 / np.maximum(most[bearing], 1e-6), _THINNEST_MM)


def _folded(bone: Array, top: Array, faces: Indices) -> NDArray[np.int64]:
    """Vertices of triangles that a layer turns by more than 70 degrees, where a hollow is too tight for it."""
    below, above = (np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]) for p in (bone, top))
    size = lengths(below) * lengths(above)
    return np.unique(faces[(below * above).sum(axis=1) < 0.34 * size])


def _pinched(faces: Indices, thick: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Vertices without thickness on an edge that has the layer on both sides: there it would touch itself."""
    chosen = faces[thick[faces].any(axis=1)]
    edges = np.sort(np.vstack((chosen[:, [0, 1]], chosen[:, [1, 2]], chosen[:, [2, 0]])), axis=1)
    edges, count = np.unique(edges[~thick[edges].any(axis=1)], axis=0, return_counts=True)
    return np.unique(edges[count > 1])


def _disc(part: Meniscus, half: Pair, height_mm: tuple[float, ...]) -> Manifold:
    centre = (part.x, part.y)
    return loft(np.array([ring(half[0], half[1], (*centre, z), 2.0, 64) for z in height_mm]), "meniscus")
