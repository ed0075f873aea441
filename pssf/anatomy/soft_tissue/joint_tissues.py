"""Soft tissues of the joint, each cut so that it overlaps neither a bone nor another tissue."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, OpType

from ...core.checks import Array
from ...data.anatomy.bone_tables import PatellaShape
from ...data.table_records import Rows
from ...geometry.mesh import Mesh
from ...geometry.mesh_containment import are_meshes_disjoint
from ...model.knee import Knee
from ..bones import bone_shells
from ..meshing.bounding_solid import build_envelope
from ..meshing.solids import build_solid, extract_mesh
from ..posture.knee_assembly import GrownBones, KneeAssembly
from . import cartilage_and_menisci
from .cartilage_and_menisci import CartilageLayer
from .tendons_and_fat_pad import build_fat_pad, build_patellar_tendon, build_quadriceps_tendon

# Smallest volume of a tissue component, in mm3. Subtraction leaves smaller splinters, which are removed.
_MIN_PART_MM3 = 1.0
# Largest overlap volume of two solids that counts as a rounding error, in mm3.
_MIN_OVERLAP_MM3 = 1e-6
# JSW below which the cartilage of one bone may overlap the other bone outside the JSW measurement range, in mm.
_NARROW_JSW_MM = 3.0
# Tolerance for simplifying the fat mesh, in mm. It is smaller than the margin between fat and other tissue. Muscle
# edges need no finer mesh, because a ray through a muscle edge also passes through centimetres of other tissue.
_SIMPLIFY_TOLERANCE_MM = 0.1
# Largest distance of soft tissue from the joint line, upwards and downwards, in mm.
_MAX_HEIGHT_MM = 230.0


@dataclass(frozen=True)
class SoftTissuePart:
    """One soft tissue within the fascia.

    Attributes
    ----------
    name : str
        Name of the surface in the scene, such as ``"medial_meniscus"``.
    material : str
        Name of the material, such as ``"cartilage"``.
    mesh : Mesh
        Closed surface in the knee frame, in mm.
    """

    name: str
    material: str
    mesh: Mesh


@dataclass(frozen=True)
class CoveredBone:
    """Femur or tibia with its cartilage.

    Attributes
    ----------
    layer : CartilageLayer
        Cartilage layer at template size.
    cartilage_part : SoftTissuePart
        Cartilage as a closed surface in the knee frame.
    top_mm : (n, 3) float64 array
        Vertices of the bone covered by its cartilage, in the knee frame, in mm.
    """

    layer: CartilageLayer
    cartilage_part: SoftTissuePart
    top_mm: Array


def build_cartilage(knee: Knee, grown: GrownBones) -> tuple[CartilageLayer, CartilageLayer]:
    """Build the cartilage layers of femur and tibia, which are the same for every posture.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee, including the medial and lateral JSW.
    grown : GrownBones
        Femur and tibia with their osteophytes.

    Returns
    -------
    tuple of CartilageLayer
        Layers of femur and tibia at template size.
    """
    shape, s = grown.bone_parameters.shape, grown.bone_parameters.scale
    spaces_mm = (knee.jsw_medial_mm, knee.jsw_lateral_mm)
    return (
        cartilage_and_menisci.build_femoral_cartilage(grown.femur.mesh, shape, s, spaces_mm),
        cartilage_and_menisci.build_tibial_cartilage(grown.tibia.mesh, shape, s, spaces_mm),
    )


def cover_bones(
    layers: tuple[CartilageLayer, CartilageLayer], assembly: KneeAssembly
) -> tuple[CoveredBone, CoveredBone]:
    """Place the cartilage of femur and tibia in the knee frame.

    Parameters
    ----------
    layers : tuple of CartilageLayer
        Layers of femur and tibia, from `build_cartilage`.
    assembly : KneeAssembly
        Bones of the knee and their pose.

    Returns
    -------
    tuple of CoveredBone
        Femur and tibia.
    """

    def covered(name: str, layer: CartilageLayer, bone_mm: Array, move: Callable[[Array], Array]) -> CoveredBone:
        thick, top_mm = layer.has_cartilage, bone_mm.copy()
        top_mm[thick] = move(layer.top[thick])
        used, number = np.unique(layer.select_cartilage_faces(), return_inverse=True)
        mesh = Mesh(np.vstack((bone_mm, top_mm))[used], number.reshape(-1, 3))
        return CoveredBone(layer, SoftTissuePart(name, "cartilage", mesh), top_mm)

    return (
        covered("femur_cartilage", layers[0], assembly.outer_femur_vertices_mm(), assembly.place_femur_points),
        covered("tibia_cartilage", layers[1], assembly.outer_tibia_vertices_mm(), assembly.place_tibia_points),
    )


def build_joint_tissues(
    knee: Knee,
    assembly: KneeAssembly,
    placed_bones: dict[str, bone_shells.Bone],
    covered_bones: tuple[CoveredBone, CoveredBone],
    muscle: Manifold,
    fat: Manifold,
) -> list[SoftTissuePart]:
    """Build cartilage, menisci, tendons, fat pad and intermuscular fat without overlap.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee: JSW, subluxation and effusion.
    assembly : KneeAssembly
        Bones of the knee and their pose.
    placed_bones : dict of str to Bone
        Solids of each bone in the knee frame.
    covered_bones : tuple of CoveredBone
        Femur and tibia with their cartilage.
    muscle : Manifold
        Solid of the volume within the fascia, in the knee frame.
    fat : Manifold
        Solid of the volume within the fascia except the muscles, before bones and joint tissues are subtracted.

    Returns
    -------
    list of SoftTissuePart
        Soft tissues in the knee frame; the intermuscular fat is last.

    Raises
    ------
    InputError
        If a tissue does not form a valid solid.
    """
    shape, s, pose = assembly.bone_parameters.shape, assembly.bone_parameters.scale, assembly.pose
    keep = [one.layer.build_covered_bone(one.top_mm) for one in covered_bones]
    femoral, tibial = (one.cartilage_part for one in covered_bones)
    narrow = min(knee.jsw_medial_mm, knee.jsw_lateral_mm) < _NARROW_JSW_MM or knee.subluxation_mm != 0
    parts = _carve_cartilage(femoral, tibial, placed_bones, narrow)
    small = [placed_bones[name].outer for name in placed_bones if name not in ("femur", "tibia")]
    rings = [solid.transform(pose.tibia_transform()) for solid in cartilage_and_menisci.build_menisci(shape.menisci, s)]
    patella, femur_frame, tibia_frame = placed_bones["patella"].outer, pose.femur_transform(), pose.tibia_transform()
    upper, lower = _find_patella_poles(patella)
    thin, sheaths = (
        (
            build_patellar_tendon(shape.patellar_tendon, s, lower, tibia_frame, more_mm),
            build_quadriceps_tendon(shape.quadriceps_tendon, s, upper, femur_frame, more_mm),
            build_fat_pad(shape.fat_pad, s, tibia_frame, more_mm),
        )
        for more_mm in (0.0, shape.deep_fat.sheath_mm)
    )
    joint = [
        ("patella_cartilage", "cartilage", _build_patellar_cartilage(patella, shape.patella, s, femur_frame)),
        ("medial_meniscus", "cartilage", rings[0]),
        ("lateral_meniscus", "cartilage", rings[1]),
        ("patellar_tendon", "tendon", thin[0]),
        ("quadriceps_tendon", "tendon", thin[1]),
        ("fat_pad", "adipose", thin[2]),
    ]
    parts += _carve_parts(joint, keep + small, muscle)
    cover = _add_effusion_cover(shape.deep_fat.cover, shape.effusion.height_profile, knee.effusion_mm)
    return [*parts, _carve_intermuscular_fat(fat, placed_bones, parts, sheaths, cover)]


def _carve_intermuscular_fat(
    fat: Manifold,
    placed_bones: dict[str, bone_shells.Bone],
    parts: list[SoftTissuePart],
    sheaths: tuple[Manifold, ...],
    cover: Rows,
) -> SoftTissuePart:
    """Subtract bones, joint tissues and tendon sheaths from the fat between the muscles.

    Bones and joint tissues are enlarged by `cover` (rows of height and thickness, in mm). Without this enlargement,
    faces of the fat and of other tissues would coincide, and rounding could make them overlap.
    """
    meshes = {name: extract_mesh(bone.outer) for name, bone in placed_bones.items()} | {
        part.name: part.mesh for part in parts
    }
    patella = [meshes.pop(name) for name in ("patella", "patella_cartilage") if name in meshes]
    for name in ("patellar_tendon", "quadriceps_tendon", "fat_pad"):
        meshes.pop(name, None)
    small = [[meshes.pop(name)] for name in placed_bones if name not in ("femur", "tibia", "patella")]
    # The remaining meshes are the femur, the tibia, their cartilage and the menisci. They get one common cover, which
    # also fills the joint space.
    covers = [
        build_envelope(group, cover, "cover of bones", _MAX_HEIGHT_MM)
        for group in (list(meshes.values()), patella, *small)
    ]
    left = Manifold.batch_boolean([fat, *covers, *sheaths], OpType.Subtract).simplify(_SIMPLIFY_TOLERANCE_MM)
    whole = Manifold.compose([piece for piece in left.decompose() if piece.volume() > _MIN_PART_MM3])
    return SoftTissuePart("intermuscular_fat", "adipose", extract_mesh(whole))


def _add_effusion_cover(cover: Rows, effusion_profile: Rows, effusion_mm: float) -> Rows:
    """Add the thickness of an effusion to the tissue cover, and return rows of height and thickness, in mm."""
    if effusion_mm == 0:
        return cover
    usual, swollen = (np.array(sorted(rows)).T for rows in (cover, effusion_profile))
    heights = np.union1d(usual[0], swollen[0])
    thickness = np.interp(heights, *usual) + effusion_mm * np.interp(heights, *swollen)
    return tuple(zip(heights.tolist(), thickness.tolist(), strict=True))


def _carve_cartilage(
    femoral: SoftTissuePart, tibial: SoftTissuePart, placed_bones: dict[str, bone_shells.Bone], narrow: bool
) -> list[SoftTissuePart]:
    """Subtract the patella from the femoral cartilage.

    If the joint is narrow, also subtract the opposite bone from each cartilage.
    """
    parts = [part for part in (femoral, tibial) if len(part.mesh.faces)]
    takes: dict[str, list[Manifold]] = {part.name: [] for part in parts}
    patella = placed_bones["patella"].outer
    # The femoral cartilage rarely touches the patella, and testing the meshes takes a fifth of the time needed to build
    # a solid.
    if femoral in parts and not are_meshes_disjoint(femoral.mesh, extract_mesh(patella)):
        takes[femoral.name].append(patella)
    met = parts if narrow else [part for part in parts if takes[part.name]]
    solids = {part.name: build_solid(part.mesh.vertices, part.mesh.faces, part.name) for part in met}
    if narrow and femoral in parts:
        takes[femoral.name].append(placed_bones["tibia"].outer)
    if narrow and tibial in parts:
        takes[tibial.name] += [placed_bones["femur"].outer, *(solids[n] for n in (femoral.name,) if n in solids)]
    kept = []
    for part in parts:
        meeting = [other for other in takes[part.name] if (solids[part.name] ^ other).volume() > _MIN_OVERLAP_MM3]
        if not meeting:
            kept.append(part)
            continue
        left = Manifold.batch_boolean([solids[part.name], *meeting], OpType.Subtract)
        if left.volume() > _MIN_PART_MM3:
            kept.append(SoftTissuePart(part.name, part.material, extract_mesh(left)))
    return kept


def _carve_parts(
    tissues: list[tuple[str, str, Manifold]], obstacles: list[Manifold], muscle: Manifold
) -> list[SoftTissuePart]:
    """Crop tissues to the fascia, and subtract obstacles and earlier tissues from each tissue.

    Each tissue is a tuple of name, material and solid.
    """
    apart: list[Manifold] = []
    for _, _, solid in tissues:
        left = solid ^ muscle
        for other in _select_touching(left, apart):
            left = left - other
        apart.append(left)
    carved = _subtract_bones(apart, obstacles)
    return [
        SoftTissuePart(name, material, extract_mesh(solid))
        for (name, material, _), solid in zip(tissues, carved, strict=True)
        if solid.volume() > _MIN_PART_MM3
    ]


def _subtract_bones(solids: list[Manifold], bones: list[Manifold]) -> list[Manifold]:
    """Subtract bones from solids.

    Solids that do not touch each other are cut in one operation, because bones have many more faces and each Boolean
    operation on them is slow.
    """
    left = list(range(len(solids)))
    carved = list(solids)
    while left:
        group: list[int] = []
        for i in left:
            if not _select_touching(solids[i], [solids[j] for j in group]):
                group.append(i)
        left = [i for i in left if i not in group]
        own = {i: solids[i].as_original() for i in group}
        whole = Manifold.compose(list(own.values()))
        for bone in _select_touching(whole, bones):
            whole = whole - bone
            # Calling `status` evaluates the subtraction immediately. Otherwise, manifold3d would first unite all bones,
            # which doubles the time.
            whole.status()
        whose = {solid.original_id(): i for i, solid in own.items()}
        pieces: dict[int | None, list[Manifold]] = {i: [] for i in (None, *group)}
        for piece in whole.decompose():
            pieces[_find_source_solid(piece, whose)].append(piece)
        for i in group:
            if pieces[None]:  # A splinter or cavity that has only bone faces has no source solid.
                carved[i] = Manifold.batch_boolean([solids[i], *_select_touching(solids[i], bones)], OpType.Subtract)
            else:
                carved[i] = Manifold.compose(pieces[i])
    return carved


def _find_source_solid(piece: Manifold, owners: dict[int, int]) -> int | None:
    """Return the index of the solid from which a component was cut, or None if all its faces come from bones.

    `owners` maps the original id of each solid to its index.
    """
    mesh = piece.to_mesh64()
    faces = zip(mesh.run_original_id, np.diff(mesh.run_index), strict=True)
    solids = {owners[source] for source, count in faces if count and source in owners}
    assert len(solids) <= 1, "solids that touch each other were cut in one operation"
    return solids.pop() if solids else None


def _find_patella_poles(patella: Manifold) -> tuple[Array, Array]:
    """Return the highest and the lowest point (3,) of a patella, in mm."""
    points = extract_mesh(patella).vertices
    return points[points[:, 2].argmax()], points[points[:, 2].argmin()]


def _build_patellar_cartilage(patella: Manifold, table: PatellaShape, scale: float, frame: Array) -> Manifold:
    """Build the patellar cartilage as a layer behind the patella, before bones are subtracted from it.

    `frame` (3, 4) is the transform of the femur into the knee frame, in mm.
    """
    back, up = frame[:, 1], frame[:, 2]
    heights = extract_mesh(patella).vertices @ up
    least = float(heights.min() + table.cartilage_from * np.ptp(heights))
    return patella.translate(tuple(table.cartilage_mm * scale * back)).trim_by_plane(tuple(up), least)


def _select_touching(solid: Manifold, others: list[Manifold]) -> list[Manifold]:
    """Select the solids whose bounding boxes overlap the bounding box of another solid."""
    box = np.array(solid.bounding_box())
    boxes = [np.array(other.bounding_box()) for other in others]
    meet = [(b[:3] < box[3:]).all() and (box[:3] < b[3:]).all() for b in boxes]
    return [other for other, is_met in zip(others, meet, strict=True) if is_met]
