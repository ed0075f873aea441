"""What is known about the radiograph of a built knee: joint spaces, landmarks, and where its osteophytes are."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from manifold3d import Manifold, OpType

from ..core.checks import Array
from ..data.records import Pair
from ..geometry.mesh import Mesh
from ..geometry.scene import Scene
from ..geometry.view import View, project
from ..model.knee import Knee
from ..model.radiograph import Truth
from .contours import COMPARTMENT, Gap, measure_gap, turned_px
from .implicit import project_solid
from .joint import KneeAssembly
from .landmarks import contour_landmarks, plateau_floor
from .solids import closed_edges, mesh_of

# Joint space is told at these fractions of the femur's width from its medial edge, as JSW(x) (Neumann et al. 2009).
# That it is the femur's is by CFWDTH of the Osteoarthritis Initiative's table; that it is of the epicondyles, which no
# osteophyte moves, is judgement: between these fractions then lies what least spaces are sought in.
FRACTIONS = (0.15, 0.175, 0.2, 0.225, 0.25, 0.275, 0.3, 0.7, 0.725, 0.75, 0.775, 0.8, 0.825, 0.85, 0.875, 0.9)
# Of the plateau's half width: where JSW(x) may be asked for, of knees whose femur stands over the plateau's edge too.
_ASKED = (0.2, 1.0)
# Height bands (mean man's size, in each bone's frame) in which the bones' edges are looked for.
_CONDYLES, _EPICONDYLES, _PLATEAU = (1.0, 12.0), (22.0, 42.0), (-9.0, 1.0)
# Farther out than this from the bare bone is osteophyte.
_OUT_MM = 0.05
# Landmarks of the joint space: its middle in each compartment and between both, and the ends of its minimum.
_OF_JOINT = (
    "medial_joint_line", "lateral_joint_line", "joint_centre",
    "medial_jsw_femur", "medial_jsw_tibia", "lateral_jsw_femur", "lateral_jsw_tibia",
)  # fmt: skip


def labels(knee: Knee, assembly: KneeAssembly, scene: Scene, view: View) -> Truth:
    """Measure joint spaces and landmarks on the radiograph of a knee in a view.

    assembly  how it stands
    scene     as it is built
    """
    (medial, lateral), wide = _gaps(knee, assembly, scene, view, (COMPARTMENT, _ASKED))
    spots = _widest(knee, assembly, view)
    return Truth(
        jsw_medial_mm=round(medial.jsw_mm, 4),
        jsw_lateral_mm=round(lateral.jsw_mm, 4),
        jsw_at_mm=_jsw_at_mm(spots, wide, view, _lean_deg(knee, assembly)),
        grade_read=knee.grade_read,
        landmarks_px=_joint_lines((medial, lateral), view, _lean_deg(knee, assembly))
        | spots
        | _on_contours(knee, assembly, scene, view),
    )


def measured_jsw_mm(knee: Knee, assembly: KneeAssembly, scene: Scene, view: View) -> tuple[float, float]:
    """Medial and lateral joint space in a view, osteophytes and all, by the measure that `Knee.jsw_as` names."""
    medial, lateral = _gaps(knee, assembly, scene, view)[0]
    return medial.jsw_mm, lateral.jsw_mm


def osteophyte_meshes(knee: Knee, assembly: KneeAssembly) -> dict[str, Mesh]:
    """Site -> what an osteophyte adds to its bone, where it stands out by more than 0.05 mm, in the knee frame."""
    build = assembly.build
    bones = (
        (build.mean_femur, assembly.femur, assembly.femur_mm),
        (build.mean_tibia, assembly.tibia, assembly.tibia_mm),
    )
    meshes = {}
    for mean, grown, move in bones:
        sites = [one.site for one in knee.osteophytes if one.bone == mean.name]
        if not sites:
            continue
        bare = project_solid(mean.outer, mean.field, depth_mm=lambda points: np.full(len(points), -_OUT_MM))
        # Moved first: a cut across a triangle stays within it, and the osteophyte within its bone.
        outer, bare = (_moved(solid, move) for solid in (grown.outer, bare))
        tips = move(np.array([shape.tip for shape in grown.shapes]))
        for site, added in _by_site(outer - bare, sites, tips).items():
            meshes[site] = assembly.mirrored(mesh_of(added))
    return meshes


def _moved(solid: Manifold, move: Callable[[Array], Array]) -> Manifold:
    return solid.warp_batch(lambda points: move(np.array(points)))


def _by_site(added: Manifold, sites: list[str], tips: Array) -> dict[str, Manifold]:
    """Site -> of what osteophytes with tips (n, 3) add to a bone, what is nearest to those there.

    What has grown together of several sites, as both spines may, is parted half way between their tips.
    """
    pieces: dict[str, list[Manifold]] = {site: [] for site in sites}
    for piece in added.decompose():
        low, high = np.array(piece.bounding_box()).reshape(2, 3)
        owners = np.flatnonzero(((tips >= low) & (tips <= high)).all(axis=1)).tolist()
        if len({sites[owner] for owner in owners}) < 2:
            owners = [int(np.linalg.norm(tips - (low + high) / 2, axis=1).argmin())]
        for owner in owners:
            others = [other for other in owners if sites[other] != sites[owner]]
            pieces[sites[owner]].append(_nearer(piece, tips[owner], tips[others]))
    return {site: Manifold.batch_boolean(parts, OpType.Add) for site, parts in pieces.items()}


def _nearer(piece: Manifold, tip: Array, others: Array) -> Manifold:
    """Of a piece, what is nearer to a tip (3,) than to others (n, 3)."""
    for other in others:
        way = (tip - other) / np.linalg.norm(tip - other)
        piece = piece.trim_by_plane(way, way @ (tip + other) / 2)
    return piece


def _gaps(
    knee: Knee, assembly: KneeAssembly, scene: Scene, view: View, ranges: Sequence[Pair] = (COMPARTMENT,)
) -> list[tuple[Gap, Gap]]:
    """The medial and the lateral joint space as a detector sees them, within each range of the plateau's half width."""
    meshes = _outer(scene)
    femur, tibia = ((mesh.vertices, closed_edges(mesh.faces)) for mesh in meshes)
    medial, half, lean = _medial(knee), assembly.build.half_ml_mm, _lean_deg(knee, assembly)
    upper = plateau_floor(meshes[1], view, medial, lean) if knee.jsw_as == "read" else tibia

    def seen(side: int, between: Pair) -> Gap:
        return measure_gap(femur, upper, view, side * medial, half, lean, between)

    return [(seen(+1, between), seen(-1, between)) for between in ranges]


def _outer(scene: Scene) -> tuple[Mesh, Mesh]:
    """Outer surfaces of femur and tibia."""
    meshes = {s.name: s.arrays for s in scene.surfaces if s.name in ("femur", "tibia")}
    return meshes["femur"], meshes["tibia"]


def _on_contours(knee: Knee, assembly: KneeAssembly, scene: Scene, view: View) -> dict[str, tuple[float, float]]:
    """The sixteen contour landmarks; the top of the notch goes by its older name too."""
    spots = contour_landmarks(*_outer(scene), view, _medial(knee), _lean_deg(knee, assembly))
    return {**spots, "notch": spots["notch_top"]}


def _joint_lines(gaps: tuple[Gap, Gap], view: View, lean_deg: float) -> dict[str, tuple[float, float]]:
    lines = turned_px(np.array([gap.middle_px() for gap in gaps]), view, lean_deg)
    narrowest = turned_px(np.array([place for gap in gaps for place in gap.narrowest_px()]), view, lean_deg)
    places = (*lines, lines.mean(axis=0), *narrowest)
    return {name: _place(place) for name, place in zip(_OF_JOINT, places, strict=True)}


def _jsw_at_mm(
    edges: dict[str, tuple[float, float]], gaps: tuple[Gap, Gap], view: View, lean_deg: float
) -> dict[float, float]:
    """Fraction of the femur's width from its medial epicondyle -> joint space there, as a detector sees it.

    edges  of `_widest` in that view
    gaps   medial and lateral, wide enough
    """
    epicondyles = np.array([edges["medial_epicondyle"], edges["lateral_epicondyle"]])
    medial, lateral = turned_px(epicondyles, view, -lean_deg)[:, 1]
    spaces = {}
    for fraction in FRACTIONS:
        gap = gaps[0] if fraction < 0.5 else gaps[1]
        col = medial + fraction * (lateral - medial)
        wide_px = np.interp(col, gap.columns_px, gap.tibia_px - gap.femur_px)
        spaces[fraction] = float(wide_px * gap.scale_mm)
    return spaces


def _widest(knee: Knee, assembly: KneeAssembly, view: View) -> dict[str, tuple[float, float]]:
    """Where the bones are widest, without their osteophytes."""
    return {name: _place(seen) for name, seen, _ in _widest_vertices(knee, assembly, view)}


def widest(knee: Knee, assembly: KneeAssembly, view: View) -> dict[str, Array]:
    """Name -> (3,) where the bones are widest in a view, without their osteophytes: places in the knee frame, mm."""
    return {name: place for name, _, place in _widest_vertices(knee, assembly, view)}


def _widest_vertices(knee: Knee, assembly: KneeAssembly, view: View) -> Iterator[tuple[str, Array, Array]]:
    """Name, (row, column) and place (3,) in the knee frame."""
    build, medial, lean = assembly.build, _medial(knee), _lean_deg(knee, assembly)
    femur, tibia = (mesh_of(bone.outer) for bone in (build.mean_femur, build.mean_tibia))
    for side, sign in (("medial", +1), ("lateral", -1)):
        for name, mesh, band, move in (
            ("epicondyle", femur, _EPICONDYLES, assembly.femur_mm),
            ("condyle_edge", femur, _CONDYLES, assembly.femur_mm),
            ("plateau_edge", tibia, _PLATEAU, assembly.tibia_mm),
        ):
            points = mesh.vertices
            near = (points[:, 2] > band[0]) & (points[:, 2] < band[1]) & (points[:, 0] * sign > 0)
            places = move(points[near]) * assembly.mirror
            seen = project(places, view)
            upright = turned_px(seen, view, -lean)
            number = (upright[:, 1] * sign * medial).argmax()
            yield f"{side}_{name}", seen[number], places[number]


def _place(seen: Array) -> tuple[float, float]:
    return (float(seen[0]), float(seen[1]))


def _lean_deg(knee: Knee, assembly: KneeAssembly) -> float:
    """By how much the leg leans on the film, from columns' end towards rows' start."""
    return assembly.pose.lean_deg * _medial(knee)


def _medial(knee: Knee) -> int:
    """Direction of x in which medial is."""
    return 1 if knee.side == "right" else -1
