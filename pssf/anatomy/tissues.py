"""Soft structures of the joint, each carved clear of the bones and of those before it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, OpType

from ..core.checks import Array
from ..data.bones import PatellaShape
from ..data.records import Rows
from ..geometry.mesh import Mesh
from ..geometry.within import lie_apart
from ..model.knee import Knee
from . import bones, cartilage
from .envelope import envelope
from .joint import KneeAssembly
from .solids import mesh_of, solid_of
from .tendons import fat_pad, patellar_tendon, quadriceps_tendon

# Splinters that carving leaves are not worth a surface.
_LEAST_MM3 = 1.0
# So little that two solids share is rounding.
_MEETING_MM3 = 1e-6
# In a joint space below this cartilage of one bone may meet the other, away from where the space is told.
_NARROW_MM = 3.0
# Less than what lies between the fat and all else: edges of muscles are seen through centimetres of others.
_COARSER_MM = 0.1
# No soft tissue is farther up or down.
_FAR_MM = 230.0


@dataclass(frozen=True)
class Part:
    """One soft structure within the fascia."""

    name: str
    material: str
    mesh: Mesh


@dataclass(frozen=True)
class Covered:
    """A bone's cartilage in the knee frame, and where the bone's vertices are with it: (n, 3) `top_mm`."""

    layer: cartilage.Layer
    part: Part
    top_mm: Array


def cartilage_of(knee: Knee, assembly: KneeAssembly) -> tuple[Covered, Covered]:
    """Cartilage of femur and tibia."""
    shape, s = assembly.build.shape, assembly.build.scale
    spaces_mm = (knee.jsw_medial_mm, knee.jsw_lateral_mm)

    def covered(name: str, layer: cartilage.Layer, bone_mm: Array, move: Callable[[Array], Array]) -> Covered:
        thick, top_mm = layer.thick, bone_mm.copy()
        top_mm[thick] = move(layer.top[thick])
        used, number = np.unique(layer.alone(), return_inverse=True)
        mesh = Mesh(np.vstack((bone_mm, top_mm))[used], number.reshape(-1, 3))
        return Covered(layer, Part(name, "cartilage", mesh), top_mm)

    femur = cartilage.on_femur(assembly.femur.mesh, shape, s, spaces_mm)
    tibia = cartilage.on_tibia(assembly.tibia.mesh, shape, s, spaces_mm)
    return (
        covered("femur_cartilage", femur, assembly.outer_femur_mm(), assembly.femur_mm),
        covered("tibia_cartilage", tibia, assembly.outer_tibia_mm(), assembly.tibia_mm),
    )


def between(
    knee: Knee,
    assembly: KneeAssembly,
    placed: dict[str, bones.Bone],
    covered: tuple[Covered, Covered],
    muscle: Manifold,
    fat: Manifold,
) -> list[Part]:
    """Cartilage, menisci, tendons, fat pad and fat between muscles, in the knee frame, none overlapping another.

    placed   the bones, in the knee's frame
    covered  femur and tibia with their cartilage
    muscle   all that lies within the fascia
    fat      what muscles leave of it, before all else is taken out
    """
    shape, s, pose = assembly.build.shape, assembly.build.scale, assembly.pose
    keep = [one.layer.covered(one.top_mm) for one in covered]
    femoral, tibial = (one.part for one in covered)
    narrow = min(knee.jsw_medial_mm, knee.jsw_lateral_mm) < _NARROW_MM or knee.subluxation_mm != 0
    parts = _clear(femoral, tibial, placed, narrow)
    small = [placed[name].outer for name in placed if name not in ("femur", "tibia")]
    rings = [solid.transform(pose.tibia()) for solid in cartilage.menisci(shape.menisci, s)]
    patella, femur_frame, tibia_frame = placed["patella"].outer, pose.femur(), pose.tibia()
    upper, lower = _poles(patella)
    thin, sheaths = (
        (
            patellar_tendon(shape.patellar_tendon, s, lower, tibia_frame, more_mm),
            quadriceps_tendon(shape.quadriceps_tendon, s, upper, femur_frame, more_mm),
            fat_pad(shape.fat_pad, s, tibia_frame, more_mm),
        )
        for more_mm in (0.0, shape.deep_fat.sheath_mm)
    )
    joint = [
        ("patella_cartilage", "cartilage", _patellar_cartilage(patella, shape.patella, s, femur_frame)),
        ("medial_meniscus", "cartilage", rings[0]),
        ("lateral_meniscus", "cartilage", rings[1]),
        ("patellar_tendon", "tendon", thin[0]),
        ("quadriceps_tendon", "tendon", thin[1]),
        ("fat_pad", "adipose", thin[2]),
    ]
    parts += _carved(joint, keep + small, muscle)
    cover = _thickened(shape.deep_fat.cover, shape.effusion.about, knee.effusion_mm)
    return [*parts, _between_muscles(fat, placed, parts, sheaths, cover)]


def _between_muscles(
    fat: Manifold, placed: dict[str, bones.Bone], parts: list[Part], sheaths: tuple[Manifold, ...], cover: Rows
) -> Part:
    """What is left of the fat between muscles, clear of all bones and parts by what covers them, and of sheaths.

    No face of it lies in one of theirs, where rounding could make them overlap.
    cover  of bones, mm: rows of height and thickness
    """
    meshes = {name: mesh_of(bone.outer) for name, bone in placed.items()} | {part.name: part.mesh for part in parts}
    patella = [meshes.pop(name) for name in ("patella", "patella_cartilage") if name in meshes]
    for name in ("patellar_tendon", "quadriceps_tendon", "fat_pad"):
        meshes.pop(name, None)
    small = [[meshes.pop(name)] for name in placed if name not in ("femur", "tibia", "patella")]
    # Femur and tibia with all that is left: cartilage and menisci, and the joint space between.
    covers = [envelope(group, cover, "cover of bones", _FAR_MM) for group in (list(meshes.values()), patella, *small)]
    left = Manifold.batch_boolean([fat, *covers, *sheaths], OpType.Subtract).simplify(_COARSER_MM)
    whole = Manifold.compose([piece for piece in left.decompose() if piece.volume() > _LEAST_MM3])
    return Part("intermuscular_fat", "adipose", mesh_of(whole))


def _thickened(cover: Rows, about: Rows, effusion_mm: float) -> Rows:
    """What covers bones, with an effusion: rows of height and thickness, mm."""
    if effusion_mm == 0:
        return cover
    usual, swollen = (np.array(sorted(rows)).T for rows in (cover, about))
    heights = np.union1d(usual[0], swollen[0])
    thickness = np.interp(heights, *usual) + effusion_mm * np.interp(heights, *swollen)
    return tuple(zip(heights.tolist(), thickness.tolist(), strict=True))


def _clear(femoral: Part, tibial: Part, placed: dict[str, bones.Bone], narrow: bool) -> list[Part]:
    """Cartilage of femur and tibia without what the patella has, and in a narrow joint what the other bone has."""
    parts = [part for part in (femoral, tibial) if len(part.mesh.faces)]
    takes: dict[str, list[Manifold]] = {part.name: [] for part in parts}
    patella = placed["patella"].outer
    # A solid of the cartilage takes five times as long as to see that it keeps clear, as it nearly always does.
    if femoral in parts and not lie_apart(femoral.mesh, mesh_of(patella)):
        takes[femoral.name].append(patella)
    met = parts if narrow else [part for part in parts if takes[part.name]]
    solids = {part.name: solid_of(part.mesh.vertices, part.mesh.faces, part.name) for part in met}
    if narrow and femoral in parts:
        takes[femoral.name].append(placed["tibia"].outer)
    if narrow and tibial in parts:
        takes[tibial.name] += [placed["femur"].outer, *(solids[n] for n in (femoral.name,) if n in solids)]
    kept = []
    for part in parts:
        meeting = [other for other in takes[part.name] if (solids[part.name] ^ other).volume() > _MEETING_MM3]
        if not meeting:
            kept.append(part)
            continue
        left = Manifold.batch_boolean([solids[part.name], *meeting], OpType.Subtract)
        if left.volume() > _LEAST_MM3:
            kept.append(Part(part.name, part.material, mesh_of(left)))
    return kept


def _carved(wanted: list[tuple[str, str, Manifold]], keep: list[Manifold], muscle: Manifold) -> list[Part]:
    """What is left of solids within the fascia, without those to keep clear of and without each other."""
    apart: list[Manifold] = []
    for _, _, solid in wanted:
        left = solid ^ muscle
        for other in _touching(left, apart):
            left = left - other
        apart.append(left)
    carved = _without(apart, keep)
    return [
        Part(name, material, mesh_of(solid))
        for (name, material, _), solid in zip(wanted, carved, strict=True)
        if solid.volume() > _LEAST_MM3
    ]


def _without(solids: list[Manifold], bones: list[Manifold]) -> list[Manifold]:
    """Solids without bones, which have far more faces: they are taken out of all solids at once that do not touch."""
    left = list(range(len(solids)))
    carved = list(solids)
    while left:
        group: list[int] = []
        for i in left:
            if not _touching(solids[i], [solids[j] for j in group]):
                group.append(i)
        left = [i for i in left if i not in group]
        own = {i: solids[i].as_original() for i in group}
        whole = Manifold.compose(list(own.values()))
        for bone in _touching(whole, bones):
            whole = whole - bone
            # Now: later the bones would be made one first, which takes twice as long.
            whole.status()
        whose = {solid.original_id(): i for i, solid in own.items()}
        pieces: dict[int | None, list[Manifold]] = {i: [] for i in (None, *group)}
        for piece in whole.decompose():
            pieces[_source(piece, whose)].append(piece)
        for i in group:
            if pieces[None]:  # bones alone bound a splinter or a cavity
                carved[i] = Manifold.batch_boolean([solids[i], *_touching(solids[i], bones)], OpType.Subtract)
            else:
                carved[i] = Manifold.compose(pieces[i])
    return carved


def _source(piece: Manifold, whose: dict[int, int]) -> int | None:
    """Of which solid a piece is, by the numbers of the originals that its faces come from; None if of none."""
    mesh = piece.to_mesh64()
    faces = zip(mesh.run_original_id, np.diff(mesh.run_index), strict=True)
    solids = {whose[source] for source, count in faces if count and source in whose}
    assert len(solids) <= 1, "solids that touch each other were carved together"
    return solids.pop() if solids else None


def _poles(patella: Manifold) -> tuple[Array, Array]:
    """Highest and lowest place of a patella."""
    points = mesh_of(patella).vertices
    return points[points[:, 2].argmax()], points[points[:, 2].argmin()]


def _patellar_cartilage(patella: Manifold, table: PatellaShape, scale: float, frame: Array) -> Manifold:
    """What lies behind a patella, as thick as its cartilage, before bones are taken out of it.

    frame  (3, 4)  transform of the femur into the knee frame, mm
    """
    back, up = frame[:, 1], frame[:, 2]
    heights = mesh_of(patella).vertices @ up
    least = float(heights.min() + table.cartilage_from * np.ptp(heights))
    return patella.translate(tuple(table.cartilage_mm * scale * back)).trim_by_plane(tuple(up), least)


def _touching(solid: Manifold, others: list[Manifold]) -> list[Manifold]:
    """Those whose box meets that of a solid."""
    box = np.array(solid.bounding_box())
    boxes = [np.array(other.bounding_box()) for other in others]
    meet = [(b[:3] < box[3:]).all() and (box[:3] < b[3:]).all() for b in boxes]
    return [other for other, is_met in zip(others, meet, strict=True) if is_met]
