"""Subchondral cysts: balls in the spongy bone of femur and tibia, each in a wall of compact bone, clear of all else."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from scipy.spatial import cKDTree

from ..core.checks import Array, InputError
from ..geometry.mesh import Mesh
from ..model.knee import Cyst, Knee
from .attrition import attrition_mm
from .bone_build import formed_femur_stood, formed_tibia_stood
from .bones import Bone
from .contours import COMPARTMENT
from .joint import KneeAssembly
from .pose import moved
from .solids import mesh_of

# Of compact bone around what is soft (judgement: on films a thin rim about what is darker than its surroundings, which
# a thicker wall would outweigh).
WALL_MM = 0.3
# Between a wall and what surrounds its spongy bone, or another wall.
_CLEAR_MM = 0.3
# A cyst lies as near to the plate as it can; it is looked for in such steps, and no deeper than that. Where the bone
# tapers there may be no room: it is then looked for farther inwards, by such shares of the way.
_STEP_MM, _DEEPEST_MM = 0.25, 16.0
_INWARDS, _INNERMOST = (0.0, 0.125, 0.25, 0.375, 0.5, 0.75, 1.0), 0.3
# Under a worn plateau a cyst is deeper by so much more: another posture wears it a little otherwise.
_MORE_WORN_MM = 1.0
# What of a compartment, from the place that is nearest to the joint on, its middle and its ends are told by.
_LAYER_MM, _BESIDE_MM = 8.0, 4.0
# A place of -1 or +1 is at such a share of the half of that.
_REACH = 0.6
# Sides of a great circle: the mesh has all but 0.6 per cent of the ball's volume.
_AROUND = 64


@dataclass(frozen=True)
class CystSolids:
    """A cyst in the knee frame, before it is mirrored: its wall's outer surface, and what is soft within."""

    cyst: Cyst
    wall: Manifold
    soft: Manifold


def cysts_of(
    knee: Knee, assembly: KneeAssembly, placed: dict[str, Bone], worn_mm: Mapping[str, float] | None = None
) -> dict[str, list[CystSolids]]:
    """Bone -> its cysts, each as near to the plate as there is room, deeper under a plateau that is worn.

    placed   the bones in the knee's frame
    worn_mm  `wear.attrition_mm` of it, where that is known
    raises   InputError for a cyst that its bone has no room for
    """
    if not knee.cysts:
        return {}
    worn_mm, build, pose = worn_mm or attrition_mm(assembly), assembly.build, assembly.pose
    femur, tibia = assembly.femur.formed, assembly.tibia.formed
    ways = {
        "femur": _Joint(formed_femur_stood(femur, build), pose.femur(), -1.0, build.half_ml_mm),
        "tibia": _Joint(formed_tibia_stood(tibia, build), pose.tibia(), 1.0, build.half_ml_mm),
    }
    made: dict[str, list[CystSolids]] = {}
    for cyst in knee.cysts:
        side, bone = cyst.site.split("_")
        before = made.setdefault(bone, [])
        spared_mm = worn_mm[side] + _MORE_WORN_MM if bone == "tibia" and worn_mm[side] else 0.0
        before.append(_placed(cyst, placed[bone], ways[bone], spared_mm, before))
    return made


def cyst_meshes(cysts: dict[str, list[CystSolids]], assembly: KneeAssembly) -> dict[str, Mesh]:
    """Site -> its cysts with their walls, in the knee frame, mm."""
    by_site: dict[str, list[Manifold]] = {}
    for of_bone in cysts.values():
        for one in of_bone:
            by_site.setdefault(one.cyst.site, []).append(one.wall)
    return {site: assembly.mirrored(mesh_of(Manifold.compose(walls))) for site, walls in by_site.items()}


@dataclass(frozen=True)
class _Joint:
    """A bone's outer vertices (n, 3) before it is worn, in its own frame; that frame; its way to the joint in z."""

    outer_mm: Array
    frame: Array
    up: float
    half_ml_mm: float

    def start_mm(self, cyst: Cyst, inwards: float) -> Array:
        """(3,)  on the bone's outer surface, in its own frame: where the column of a cyst begins"""
        inner, outer = (share * self.half_ml_mm for share in COMPARTMENT)
        outward = cyst.outward + inwards * (min(cyst.outward, _INNERMOST) - cyst.outward)
        x = (inner + outward * (outer - inner)) * (1.0 if cyst.site.startswith("medial") else -1.0)
        near = self.outer_mm[np.abs(self.outer_mm[:, 0] - x) < _BESIDE_MM]
        heights = near[:, 2] * self.up
        layer = near[heights > heights.max() - _LAYER_MM]
        low, high = layer[:, 1].min(), layer[:, 1].max()
        y = (low + high) / 2 + (1 - inwards) * cyst.place * _REACH * (high - low) / 2
        return np.array([x, y, layer[np.argmin(np.abs(layer[:, 1] - y)), 2]])


def _placed(cyst: Cyst, bone: Bone, joint: _Joint, worn_mm: float, before: list[CystSolids]) -> CystSolids:
    """A cyst where there first is room for it, clear of the plate, the canal and those before it.

    worn_mm  that its column is deeper by, so that it is in one place of the bone in all postures
    """
    radius = cyst.diameter_mm / 2 + WALL_MM
    around = [bone.inner, *_others(bone, before)]
    walls = cKDTree(np.vstack([mesh_of(solid).vertices for solid in around]))
    wall, soft = (Manifold.sphere(size, _AROUND) for size in (radius, cyst.diameter_mm / 2))
    depths = np.arange(radius + worn_mm, _DEEPEST_MM, _STEP_MM)[:, None] * [0.0, 0.0, joint.up]
    centres = np.vstack([moved(joint.start_mm(cyst, share) - depths, joint.frame) for share in _INWARDS])
    # Vertices may be far from the middle of a face: the solids decide.
    for centre in centres[walls.query(centres)[0] >= radius + _CLEAR_MM]:
        at = tuple(centre)
        if _has_room(wall.translate(at), bone, before):
            return CystSolids(cyst, wall.translate(at), soft.translate(at))
    raise InputError(
        f"cyst at {cyst.site}: diameter_mm = {cyst.diameter_mm:g} mm, place = {cyst.place:g}, outward = "
        f"{cyst.outward:g}; allowed: what the spongy bone there has room for"
    )


def _has_room(wall: Manifold, bone: Bone, before: list[CystSolids]) -> bool:
    """Whether a wall lies in the spongy bone, the canal and other cysts aside."""
    left = (wall - bone.inner).volume() > 0
    return not left and not any((wall ^ other).volume() > 0 for other in _others(bone, before))


def _others(bone: Bone, before: list[CystSolids]) -> list[Manifold]:
    """What a cyst must keep clear of within the spongy bone."""
    return [solid for solid in (bone.canal, *(one.wall for one in before)) if solid is not None]
