"""Soft structures of the joint, each carved clear of the bones and of those before it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import PatellaShape
from ..geometry.mesh import Mesh
from ..model.knee import Knee
from . import bones, cartilage
from .joint import KneeAssembly
from .planes import fat_pad, fat_planes, tendon
from .solids import mesh_of

# Splinters that carving leaves are not worth a surface.
_LEAST_MM3 = 1.0
# The joint lies within this height of the knee frame's origin; bones are cut there before they are carved with.
_NEAR_MM = 75.0


@dataclass(frozen=True)
class Part:
    """One soft structure within the fascia."""

    name: str
    material: str
    mesh: Mesh


def between(knee: Knee, assembly: KneeAssembly, placed: dict[str, bones.Bone], muscle: Manifold) -> list[Part]:
    """Cartilage, menisci, patellar tendon, fat pad and fat planes of a knee, in its frame, none overlapping another.

    placed  the bones, in the knee's frame
    muscle  all that lies within the fascia
    """
    shape, s, pose = assembly.build.shape, assembly.build.scale, assembly.pose
    spaces_mm = (knee.jsw_medial_mm, knee.jsw_lateral_mm)
    layers = (
        cartilage.on_femur(assembly.femur.outer, shape, s, spaces_mm),
        cartilage.on_tibia(assembly.tibia.outer, shape, s, spaces_mm),
    )
    moves = (assembly.femur_mm, assembly.tibia_mm)
    parts, keep = [], []
    for name, layer, move in zip(("femur_cartilage", "tibia_cartilage"), layers, moves, strict=True):
        vertices, faces = layer.alone()
        used, number = np.unique(faces, return_inverse=True)
        mesh = Mesh(move(vertices[used]), number.reshape(-1, 3))
        parts.append(Part(name, "cartilage", mesh))
        keep.append(_near(layer.covered(), move))
    keep += [_cut(placed[name].outer) for name in placed if name not in ("femur", "tibia")]
    rings = [solid.transform(pose.tibia()) for solid in cartilage.menisci(shape.menisci, s)]
    joint = [
        ("patella_cartilage", "cartilage", _behind(placed["patella"].outer, shape.patella, s, pose.femur())),
        ("medial_meniscus", "cartilage", rings[0]),
        ("lateral_meniscus", "cartilage", rings[1]),
        ("patellar_tendon", "tendon", tendon(shape.tendon, s, _apex(placed["patella"].outer), pose.tibia())),
        ("fat_pad", "adipose", fat_pad(shape.fat_pad, s, pose.tibia())),
    ]
    sheets = [
        (f"fat_plane_{number}", "adipose", sheet.transform(pose.soft()))
        for number, sheet in enumerate(fat_planes(shape, s, pose.flexion_deg), start=1)
    ]
    shafts = [placed[name].outer for name in ("femur", "tibia", "fibula")]
    return parts + _carved(joint, keep, muscle) + _carved(sheets, shafts, muscle)


def _carved(wanted: list[tuple[str, str, Manifold]], keep: list[Manifold], muscle: Manifold) -> list[Part]:
    """What is left of solids within the fascia, without those to keep clear of and without each other."""
    parts, taken = [], list(keep)
    for name, material, solid in wanted:
        left = solid ^ muscle
        for other in _touching(left, taken):
            left = left - other
        if left.volume() > _LEAST_MM3:
            parts.append(Part(name, material, mesh_of(left)))
            taken.append(left)
    return parts


def _apex(patella: Manifold) -> Array:
    points = mesh_of(patella).vertices
    return points[points[:, 2].argmin()]


def _behind(patella: Manifold, table: PatellaShape, scale: float, frame: Array) -> Manifold:
    """What lies behind a patella, as thick as its cartilage, before bones are taken out of it.

    frame  (3, 4)  transform of the femur into the knee frame, mm
    """
    back, up = frame[:, 1], frame[:, 2]
    heights = mesh_of(patella).vertices @ up
    least = float(heights.min() + table.cartilage_from * np.ptp(heights))
    return patella.translate(tuple(table.cartilage_mm * scale * back)).trim_by_plane(tuple(up), least)


def _near(solid: Manifold, move: Callable[[Array], Array]) -> Manifold:
    return _cut(solid.warp_batch(lambda points: move(np.array(points))))


def _cut(solid: Manifold) -> Manifold:
    return solid.trim_by_plane((0.0, 0.0, 1.0), -_NEAR_MM).trim_by_plane((0.0, 0.0, -1.0), -_NEAR_MM)


def _touching(solid: Manifold, others: list[Manifold]) -> list[Manifold]:
    """Those whose box meets that of a solid."""
    box = np.array(solid.bounding_box())
    boxes = [np.array(other.bounding_box()) for other in others]
    meet = [(b[:3] < box[3:]).all() and (box[:3] < b[3:]).all() for b in boxes]
    return [other for other, is_met in zip(others, meet, strict=True) if is_met]
