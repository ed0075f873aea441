"""Labels of a frontal radiograph: JSW, landmarks and the meshes of the osteophytes."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from manifold3d import Manifold, OpType
from scipy.spatial import cKDTree

from ...core.checks import Array
from ...core.label_names import JSW_FRACTIONS
from ...data.table_records import Pair
from ...geometry.mesh import Mesh
from ...geometry.scene import Scene
from ...geometry.view import View, project_points
from ...model.knee import Knee
from ...model.radiograph import Truth
from ..meshing.implicit_shapes import project_solid
from ..meshing.solids import extract_mesh, find_closed_mesh_edges
from ..outlines.contour_landmarks import find_contour_landmarks, find_plateau_floor
from ..outlines.projected_contours import (
    COMPARTMENT_RANGE,
    Gap,
    measure_gap,
    rotate_px,
)
from ..posture.knee_assembly import KneeAssembly
from .osteophyte_faces import MIN_PROTRUSION_MM, find_owners, list_bones_with_osteophytes, select_raised_faces

# Range in which JSW(x) is measured, as fractions of half the plateau width. The range includes the part of the femur
# that overhangs the plateau edge.
_JSW_FRACTION_RANGE = (0.2, 1.0)
# Height range in which the edges of the condyles are searched for, in mm at template size in the frame of the femur.
_CONDYLES = (1.0, 12.0)
# Height range in which the epicondyles are searched for, in mm at template size in the frame of the femur.
_EPICONDYLES = (22.0, 42.0)
# Height range in which the edges of the plateau are searched for, in mm at template size in the frame of the tibia.
_PLATEAU = (-9.0, 1.0)
# Largest distance between a connected component of an osteophyte and the faces that the osteophyte raises, in mm.
_MAX_PIECE_DISTANCE_MM = 1.0
# Landmarks of the joint space: the centre of each compartment, the midpoint of the two centres, and the ends of the
# minimum JSW.
_JOINT_LANDMARKS = (
    "medial_joint_line", "lateral_joint_line", "joint_centre",
    "medial_jsw_femur", "medial_jsw_tibia", "lateral_jsw_femur", "lateral_jsw_tibia",
)  # fmt: skip


def measure_labels(knee: Knee, assembly: KneeAssembly, scene: Scene, view: View) -> Truth:
    """Measure JSW and landmarks on the radiograph of a knee.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    assembly : KneeAssembly
        Bones of the knee in their pose.
    scene : Scene
        Surfaces of the knee. Only the outer surfaces of femur and tibia are used.
    view : View
        Source and detector of a frontal view.

    Returns
    -------
    Truth
        JSW in mm, scaled to the joint plane; landmarks in pixels; and the reader grade.
    """
    (medial, lateral), wide = _measure_gaps(knee, assembly, scene, view, (COMPARTMENT_RANGE, _JSW_FRACTION_RANGE))
    spots = _find_widest_px(knee, assembly, view)
    return Truth(
        jsw_medial_mm=round(medial.jsw_mm, 4),
        jsw_lateral_mm=round(lateral.jsw_mm, 4),
        jsw_at_mm=_measure_jsw_at_mm(spots, wide, view, _lean_deg(knee, assembly)),
        reader_grade=knee.reader_grade,
        landmarks_px=_find_joint_line_landmarks((medial, lateral), view, _lean_deg(knee, assembly))
        | spots
        | _find_landmarks_on_contours(knee, assembly, scene, view),
    )


def measure_jsw_mm(knee: Knee, assembly: KneeAssembly, scene: Scene, view: View) -> tuple[float, float]:
    """Measure the medial and lateral JSW in a view, including osteophytes.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee; `Knee.jsw_definition` selects how JSW is measured.
    assembly : KneeAssembly
        Bones of the knee in their pose.
    scene : Scene
        Surfaces of the knee. Only the outer surfaces of femur and tibia are used.
    view : View
        Source and detector of a frontal view.

    Returns
    -------
    tuple of float
        Medial and lateral JSW, in mm, scaled to the joint plane.
    """
    medial, lateral = _measure_gaps(knee, assembly, scene, view)[0]
    return medial.jsw_mm, lateral.jsw_mm


def build_osteophyte_meshes(knee: Knee, assembly: KneeAssembly) -> dict[str, Mesh]:
    """Build a mesh of the bone that the osteophytes add at each site.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee, including its osteophytes.
    assembly : KneeAssembly
        Bones of the knee in their pose.

    Returns
    -------
    dict of str to Mesh
        Closed surface per site in the knee frame, in mm. The surface encloses only bone that protrudes by more than
        0.05 mm.
    """
    meshes = {}
    for mean, grown, move, sites in list_bones_with_osteophytes(knee, assembly):
        bare = project_solid(mean.outer, mean.field, depth_mm=lambda points: np.full(len(points), -MIN_PROTRUSION_MM))
        # Both solids are moved before the subtraction. The cuts are therefore on the moved triangles, and the
        # osteophyte stays inside its bone.
        outer, bare = (_warp_solid(solid, move) for solid in (grown.outer, bare))
        tips = move(np.array([shape.tip for shape in grown.shapes]))
        near = _select_pieces_near(outer - bare, move(select_raised_faces(mean, grown).vertices))
        for site, added in _split_by_site(near, sites, tips).items():
            meshes[site] = assembly.orient_mesh(extract_mesh(added))
    return meshes


def _select_pieces_near(solid: Manifold, points: Array) -> Manifold:
    """Keep the connected components of a solid that are near any of the points (n, 3), in mm.

    At the cut end of a shaft, the meshes of the bone with and without osteophytes differ by slivers.
    """
    if not len(points):
        return Manifold()
    tree = cKDTree(points)
    return Manifold.compose(
        [
            piece
            for piece in solid.decompose()
            if tree.query(extract_mesh(piece).vertices)[0].min() < _MAX_PIECE_DISTANCE_MM
        ]
    )


def _warp_solid(solid: Manifold, move: Callable[[Array], Array]) -> Manifold:
    """Apply a function of points (n, 3), in mm, to the vertices of a solid."""
    return solid.warp_batch(lambda points: move(np.array(points)))


def _split_by_site(added: Manifold, sites: list[str], tips: Array) -> dict[str, Manifold]:
    """Split the bone added by osteophytes into one solid per site.

    Each connected component is assigned to the nearest tip; `tips` (n, 3) are the tips of the osteophytes at `sites`. A
    component that joins several sites, such as both tibial spines, is cut halfway between their tips.
    """
    pieces: dict[str, list[Manifold]] = {site: [] for site in sites}
    for piece in added.decompose():
        low, high = np.array(piece.bounding_box()).reshape(2, 3)
        owners = find_owners(low, high, sites, tips)
        for owner in owners:
            others = [other for other in owners if sites[other] != sites[owner]]
            pieces[sites[owner]].append(_trim_to_nearest_tip(piece, tips[owner], tips[others]))
    return {site: Manifold.batch_boolean(parts, OpType.Add) for site, parts in pieces.items()}


def _trim_to_nearest_tip(piece: Manifold, tip: Array, others: Array) -> Manifold:
    """Trim a connected component to the volume nearest to `tip` (3,).

    The cuts are halfway between `tip` and the other tips (n, 3).
    """
    for other in others:
        way = (tip - other) / np.linalg.norm(tip - other)
        piece = piece.trim_by_plane(way, way @ (tip + other) / 2)
    return piece


def _measure_gaps(
    knee: Knee, assembly: KneeAssembly, scene: Scene, view: View, ranges: Sequence[Pair] = (COMPARTMENT_RANGE,)
) -> list[tuple[Gap, Gap]]:
    """Measure the medial and lateral joint space in a view for several ranges of positions.

    The ranges are fractions of half the plateau width.
    """
    meshes = _select_outer_meshes(scene)
    femur, tibia = ((mesh.vertices, find_closed_mesh_edges(mesh.faces)) for mesh in meshes)
    medial, half, lean = _medial_sign(knee), assembly.bone_parameters.half_ml_mm, _lean_deg(knee, assembly)
    upper = find_plateau_floor(meshes[1], view, medial, lean) if knee.jsw_definition == "read" else tibia

    def seen(side: int, between: Pair) -> Gap:
        return measure_gap(femur, upper, view, side * medial, half, lean, between)

    return [(seen(+1, between), seen(-1, between)) for between in ranges]


def _select_outer_meshes(scene: Scene) -> tuple[Mesh, Mesh]:
    """Return the outer surfaces of femur and tibia."""
    meshes = {s.name: s.mesh_arrays for s in scene.surfaces if s.name in ("femur", "tibia")}
    return meshes["femur"], meshes["tibia"]


def _find_landmarks_on_contours(
    knee: Knee, assembly: KneeAssembly, scene: Scene, view: View
) -> dict[str, tuple[float, float]]:
    """Find the sixteen contour landmarks.

    ``notch_top`` is included a second time under its deprecated name ``notch``.
    """
    spots = find_contour_landmarks(*_select_outer_meshes(scene), view, _medial_sign(knee), _lean_deg(knee, assembly))
    return {**spots, "notch": spots["notch_top"]}


def _find_joint_line_landmarks(gaps: tuple[Gap, Gap], view: View, lean_deg: float) -> dict[str, tuple[float, float]]:
    """Return the pixel positions of the joint space landmarks in both compartments."""
    lines = rotate_px(np.array([gap.middle_px() for gap in gaps]), view, lean_deg)
    narrowest = rotate_px(np.array([place for gap in gaps for place in gap.narrowest_px()]), view, lean_deg)
    places = (*lines, lines.mean(axis=0), *narrowest)
    return {name: _convert_to_pixel(place) for name, place in zip(_JOINT_LANDMARKS, places, strict=True)}


def _measure_jsw_at_mm(
    edges: dict[str, tuple[float, float]], gaps: tuple[Gap, Gap], view: View, lean_deg: float
) -> dict[float, float]:
    """Measure JSW(x) at fixed fractions of the femoral width from the medial epicondyle.

    `edges` contains the pixel positions of the epicondyles. `gaps` are the medial and lateral joint space.
    """
    epicondyles = np.array([edges["medial_epicondyle"], edges["lateral_epicondyle"]])
    medial, lateral = rotate_px(epicondyles, view, -lean_deg)[:, 1]
    spaces = {}
    for fraction in JSW_FRACTIONS:
        gap = gaps[0] if fraction < 0.5 else gaps[1]
        col = medial + fraction * (lateral - medial)
        wide_px = np.interp(col, gap.columns_px, gap.tibia_px - gap.femur_px)
        spaces[fraction] = float(wide_px * gap.mm_per_pixel)
    return spaces


def _find_widest_px(knee: Knee, assembly: KneeAssembly, view: View) -> dict[str, tuple[float, float]]:
    """Return the pixel positions (row, column) of the widest points of the bones without osteophytes."""
    return {name: _convert_to_pixel(seen) for name, seen, _ in _find_widest_vertices(knee, assembly, view)}


def find_widest_points_mm(knee: Knee, assembly: KneeAssembly, view: View) -> dict[str, Array]:
    """Find the widest points of the bones in a view, without osteophytes.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    assembly : KneeAssembly
        Bones of the knee in their pose.
    view : View
        Source and detector of a frontal view.

    Returns
    -------
    dict of str to (3,) float64 array
        Position of each epicondyle, condyle edge and plateau edge in the knee frame, in mm.
    """
    return {name: place for name, _, place in _find_widest_vertices(knee, assembly, view)}


def _find_widest_vertices(knee: Knee, assembly: KneeAssembly, view: View) -> Iterator[tuple[str, Array, Array]]:
    """For each widest point, yield the name, the pixel position (2,) and the position (3,) in the knee frame, in mm."""
    build, medial, lean = assembly.bone_parameters, _medial_sign(knee), _lean_deg(knee, assembly)
    femur, tibia = (extract_mesh(bone.outer) for bone in (build.template_femur, build.template_tibia))
    for side, sign in (("medial", +1), ("lateral", -1)):
        for name, mesh, band, move in (
            ("epicondyle", femur, _EPICONDYLES, assembly.place_femur_points),
            ("condyle_edge", femur, _CONDYLES, assembly.place_femur_points),
            ("plateau_edge", tibia, _PLATEAU, assembly.place_tibia_points),
        ):
            points = mesh.vertices
            near = (points[:, 2] > band[0]) & (points[:, 2] < band[1]) & (points[:, 0] * sign > 0)
            places = move(points[near]) * assembly.mirror
            seen = project_points(places, view)
            upright = rotate_px(seen, view, -lean)
            number = (upright[:, 1] * sign * medial).argmax()
            yield f"{side}_{name}", seen[number], places[number]


def _convert_to_pixel(position_px: Array) -> tuple[float, float]:
    """Convert an array (2,) to a (row, column) tuple."""
    return (float(position_px[0]), float(position_px[1]))


def _lean_deg(knee: Knee, assembly: KneeAssembly) -> float:
    """Return the lean of the leg in the image, in degrees, clockwise positive."""
    return assembly.pose.lean_deg * _medial_sign(knee)


def _medial_sign(knee: Knee) -> int:
    """Return +1 if the medial side is towards +x, else -1."""
    return 1 if knee.side == "right" else -1
