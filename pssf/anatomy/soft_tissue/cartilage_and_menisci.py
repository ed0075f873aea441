"""Cartilage layers on the articular surfaces of femur and tibia, and the menisci between them."""

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ...core.checks import Array
from ...data.anatomy.bone_tables import TemplateAnatomy
from ...data.anatomy.soft_tissue_tables import Menisci, Meniscus
from ...data.table_records import Pair
from ...geometry.mesh import Indices, Mesh
from ..meshing.implicit_shapes import ScalarField, evaluate_with_gradient, lengths
from ..meshing.solids import (
    build_solid,
    dilate_rings,
    find_closed_mesh_edges,
    loft,
    make_ring,
)
from ..template.template_femur import make_distance_field as femur_field
from ..template.template_tibia import height_above_plateau_mm
from ..template.template_tibia import make_distance_field as tibia_field

# Smallest distance from the surface without osteophytes at which a vertex belongs to an osteophyte, in mm. Osteophytes
# have no cartilage.
_BONE_TOLERANCE_MM = 0.02
# Number of triangle rings around an osteophyte that also have no cartilage.
_OSTEOPHYTE_RINGS = 3
# Smallest thickness of a cartilage layer, in mm at template size. Thinner cartilage is removed.
_MIN_THICKNESS_MM = 0.05
# Largest number of times that the cartilage thickness is halved where the layer folds.
_MAX_THINNINGS = 12


@dataclass(frozen=True)
class CartilageLayer:
    """Cartilage on one bone, defined by the bone surface and the outer surface of the cartilage.

    Attributes
    ----------
    bone : (n, 3) float64 array
        Vertices of the bone surface at template size, in mm.
    top : (n, 3) float64 array
        Bone vertices moved outward by the thickness of the cartilage, in mm. Vertices without cartilage are unchanged.
    faces : (m, 3) integer array
        Vertex indices of the triangles, with outward winding. Both surfaces have the same triangles.
    """

    bone: Array
    top: Array
    faces: Indices

    def build_covered_bone(self, top_mm: Array) -> Manifold:
        """Build a solid of the bone together with its cartilage.

        Parameters
        ----------
        top_mm : (n, 3) float64 array
            Vertices of the covered bone in the knee frame, in mm.

        Returns
        -------
        Manifold
            Solid in the frame of `top_mm`.

        Raises
        ------
        InputError
            If the vertices do not bound a valid solid.
        """
        return build_solid(top_mm, self.faces, "bone with cartilage")

    @property
    def has_cartilage(self) -> NDArray[np.bool_]:
        """Array (n,) of bool: True for each vertex that has cartilage."""
        return np.asarray((self.top != self.bone).any(axis=1))

    def select_cartilage_faces(self) -> Indices:
        """List the faces of the cartilage layer as a closed surface.

        Returns
        -------
        (k, 3) integer array
            Vertex indices of the triangles. They refer to the bone vertices followed by the top vertices. The underside
            of the layer has the same triangles as the bone surface.
        """
        thick = self.has_cartilage
        # The layer has no thickness at its margin, so margin vertices belong to both surfaces and close the layer.
        upper = np.where(thick, np.arange(len(thick)) + len(thick), np.arange(len(thick)))
        chosen = self.faces[thick[self.faces].any(axis=1)]
        return np.vstack((upper[chosen], chosen[:, ::-1]))


def build_femoral_cartilage(
    outer: Mesh, shape: TemplateAnatomy, scale: float, jsw_mm: tuple[float, float]
) -> CartilageLayer:
    """Build the cartilage layer on the articular surface of a femur.

    Parameters
    ----------
    outer : Mesh
        Outer surface of the femur with its osteophytes, at template size, in mm.
    shape : TemplateAnatomy
        Template anatomy with the limits of the articular surface.
    scale : float
        Size of the bones relative to the template.
    jsw_mm : tuple of float
        Medial and lateral JSW of the knee, in mm. The layer thickness is the JSW multiplied by the fraction
        ``shape.cartilage.share``.

    Returns
    -------
    CartilageLayer
        Layer at template size.
    """
    limits = shape.cartilage.femur

    def zone(points: Array) -> Array:
        x, y, z = points.T
        below = z - limits.below_z
        behind = np.maximum(limits.behind_y - y, z - limits.behind_z)
        before = np.max([y - limits.before_y, z - limits.before_z, np.abs(x) - limits.before_x], axis=0)
        notch = np.minimum(limits.notch_x - np.abs(x), y - limits.notch_y)
        return np.asarray(np.maximum(np.min([below, behind, before], axis=0), notch))

    return _build_layer(outer, femur_field(shape.femur), zone, _make_full_thickness_mm(shape, scale, jsw_mm))


def build_tibial_cartilage(
    outer: Mesh, shape: TemplateAnatomy, scale: float, jsw_mm: tuple[float, float]
) -> CartilageLayer:
    """Build the cartilage layer on the plateau of a tibia.

    Parameters
    ----------
    outer : Mesh
        Outer surface of the tibia with its osteophytes, at template size and without tibial slope, in mm.
    shape : TemplateAnatomy
        Template anatomy with the ellipses that bound the cartilage on the plateau.
    scale : float
        Size of the bones relative to the template.
    jsw_mm : tuple of float
        Medial and lateral JSW of the knee, in mm. The layer thickness is the JSW multiplied by the fraction
        ``shape.cartilage.share``.

    Returns
    -------
    CartilageLayer
        Layer at template size.
    """
    parts = shape.cartilage.tibia

    def zone(points: Array) -> Array:
        ovals = [
            (np.hypot((points[:, 0] - p.x) / p.half_x, (points[:, 1] - p.y) / p.half_y) - 1) * p.half_x for p in parts
        ]
        return np.asarray(np.maximum(np.min(ovals, axis=0), -2.5 - height_above_plateau_mm(points, shape.tibia.relief)))

    return _build_layer(outer, tibia_field(shape.tibia), zone, _make_full_thickness_mm(shape, scale, jsw_mm))


def build_menisci(table: Menisci, scale: float) -> list[Manifold]:
    """Build the medial and lateral meniscus as rings that are open towards the tibial spines.

    The rings overlap femur, tibia and cartilage. Subtracting these tissues leaves the wedge shape of a meniscus.

    Parameters
    ----------
    table : Menisci
        Semi-axes, heights and gap of the template menisci, in mm.
    scale : float
        Size of the bones relative to the template.

    Returns
    -------
    list of Manifold
        Medial and lateral ring in the frame of the tibia, in mm.
    """
    rings = []
    for part in (table.medial, table.lateral):
        outer, inner = (_build_disc(part, half, table.height_mm) for half in (part.outer, part.inner))
        middle = float(np.sign(part.x)) * table.gap_mm / 2
        gap = Manifold.cube((table.gap_mm, 18.0, 40.0), True).translate((middle, part.y, 0.0))
        rings.append((outer - inner - gap).scale((scale, scale, scale)))
    return rings


def _make_full_thickness_mm(shape: TemplateAnatomy, scale: float, jsw_mm: tuple[float, float]) -> ScalarField:
    """Make a function that maps points (n, 3) to the layer thickness (n,) away from the margin.

    All lengths are in mm at template size.
    """

    def full(points: Array) -> Array:
        medial = np.clip(0.5 + points[:, 0] / 12.0, 0.0, 1.0)
        return shape.cartilage.share / scale * (medial * jsw_mm[0] + (1 - medial) * jsw_mm[1])

    return full


def _build_layer(outer: Mesh, field: ScalarField, margin_distance: ScalarField, full_mm: ScalarField) -> CartilageLayer:
    """Build a cartilage layer that leaves osteophytes uncovered and does not fold.

    `field` is the signed distance to the bone without osteophytes. `margin_distance` is negative inside the articular
    surface. These two fields and the full thickness `full_mm` are in mm at template size.
    """
    points, faces = outer
    # The thickness increases from 0 at the margin to its full value over 4 mm.
    thickness = full_mm(points) * np.clip(-margin_distance(points) / 4.0, 0.0, 1.0)
    thickness[thickness < _MIN_THICKNESS_MM] = 0.0
    candidates = np.flatnonzero(thickness)
    grown = np.zeros(len(points), np.bool_)
    grown[candidates] = np.abs(field(points[candidates])) > _BONE_TOLERANCE_MM
    thickness[dilate_rings(grown, faces, _OSTEOPHYTE_RINGS)] = 0.0
    while len(pinched := _find_pinched_vertices(faces, thickness > 0)):
        thickness[pinched] = _MIN_THICKNESS_MM
    bearing = np.flatnonzero(thickness)
    way = evaluate_with_gradient(field, points[bearing])[1]
    way /= lengths(way)[:, None]
    thickness[bearing] = np.minimum(thickness[bearing], _limit_thickness_in_hollows_mm(points, bearing, way, faces))
    normals = np.zeros_like(points)
    normals[bearing] = way
    suspect = faces[(thickness[faces] > 0).any(axis=1)]
    for _ in range(_MAX_THINNINGS):
        folded = _find_folded_vertices(points, points + normals * thickness[:, None], suspect)
        if not len(folded):
            break
        thickness[folded] /= 2
        # Triangles without folded vertices do not fold and need no further check.
        suspect = suspect[np.isin(suspect, folded).any(axis=1)]
    # Cartilage below the smallest thickness is in a crease of the bone and would intersect the opposite wall of the
    # crease.
    thickness[thickness < _MIN_THICKNESS_MM] = 0.0
    while len(pinched := _find_pinched_vertices(faces, thickness > 0)):
        around = np.isin(np.arange(len(points)), pinched)
        thickness[dilate_rings(around, faces, 1)] = 0.0
    return CartilageLayer(points, points + normals * thickness[:, None], faces)


def _limit_thickness_in_hollows_mm(
    points: Array, covered_vertices: NDArray[np.int64], directions: Array, faces: Indices
) -> Array:
    """Return the largest thickness (n,), in mm, at each covered vertex of a concave surface.

    The limit is half the radius at which neighbouring outward `directions` (n, 3) converge.
    """
    normals, bears = np.zeros_like(points), np.zeros(len(points), np.bool_)
    normals[covered_vertices], bears[covered_vertices] = directions, (directions != 0).any(axis=1)
    edges = find_closed_mesh_edges(faces)
    edges = edges[bears[edges].all(axis=1)]
    span, turn = (part[edges[:, 1]] - part[edges[:, 0]] for part in (points, normals))
    bend = np.maximum(-(span * turn).sum(axis=1) / (span**2).sum(axis=1), 0.0)
    most = np.zeros(len(points))
    for end in (0, 1):
        np.maximum.at(most, edges[:, end], bend)
    return np.maximum(0.5 / np.maximum(most[covered_vertices], 1e-6), _MIN_THICKNESS_MM)


def _find_folded_vertices(bone: Array, top: Array, faces: Indices) -> NDArray[np.int64]:
    """Find vertices of triangles whose normals differ by more than 70 degrees between bone and cartilage surface."""
    below, above = (np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]) for p in (bone, top))
    size = lengths(below) * lengths(above)
    return np.unique(faces[(below * above).sum(axis=1) < 0.34 * size])


def _find_pinched_vertices(faces: Indices, thick: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Find vertices with zero thickness on edges that have cartilage on both sides.

    The layer would touch itself at these vertices.
    """
    chosen = faces[thick[faces].any(axis=1)]
    edges = np.sort(np.vstack((chosen[:, [0, 1]], chosen[:, [1, 2]], chosen[:, [2, 0]])), axis=1)
    edges, count = np.unique(edges[~thick[edges].any(axis=1)], axis=0, return_counts=True)
    return np.unique(edges[count > 1])


def _build_disc(part: Meniscus, half: Pair, height_mm: tuple[float, ...]) -> Manifold:
    """Build an elliptical disc with semi-axes `half` (x, y) through the heights `height_mm`, all at template size."""
    centre = (part.x, part.y)
    return loft(np.array([make_ring(half[0], half[1], (*centre, z), 2.0, 64) for z in height_mm]), "meniscus")
