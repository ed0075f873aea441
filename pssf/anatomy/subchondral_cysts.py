"""Subchondral cysts: spheres of soft tissue with a cortical wall in the trabecular bone of femur and tibia."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from scipy.spatial import cKDTree

from ..core.checks import Array, InputError
from ..geometry.mesh import Mesh
from ..model.knee import Cyst, Knee
from .bones.bone_shells import Bone
from .meshing.rigid_pose import apply_transform
from .meshing.solids import extract_mesh
from .outlines.projected_contours import COMPARTMENT_RANGE
from .posture.attrition import measure_attrition_mm
from .posture.knee_assembly import KneeAssembly
from .template.bone_builder import scale_and_lean_femur, scale_slope_and_lean_tibia

# Thickness of the cortical wall, in mm (assumed). Patient radiographs show a thin rim around a dark cyst. A thicker
# wall would make the cyst appear bright.
WALL_MM = 0.3
# Smallest distance of a cyst wall from the boundary of the trabecular bone and from other cyst walls, in mm.
_CLEARANCE_MM = 0.3
# Step of the search for the smallest possible depth of a cyst below the subchondral bone plate, in mm.
_STEP_MM = 0.25
# Largest depth of a cyst below the subchondral bone plate in the search, in mm.
_DEEPEST_MM = 16.0
# Inward shifts of a cyst that are tried if a tapering bone has too little space, as fractions of the distance to
# `_INNERMOST`.
_INWARDS = (0.0, 0.125, 0.25, 0.375, 0.5, 0.75, 1.0)
# Location to which the largest inward shift moves a cyst, on the scale of `Cyst.outward`, dimensionless.
_INNERMOST = 0.3
# Additional depth of a cyst below a worn plateau, in mm. The depth of wear differs slightly between postures.
_WEAR_MARGIN_MM = 1.0
# Height of the bone layer at the joint surface in which the antero-posterior range of a compartment is measured, in mm.
_LAYER_MM = 8.0
# Half width of the sagittal strip of vertices in which the antero-posterior range of a compartment is measured, in mm.
_BESIDE_MM = 4.0
# Distance of a cyst with `Cyst.place` = -1 or +1 from the centre of a compartment, as a fraction of half the
# antero-posterior range.
_PLACE_FRACTION = 0.6
# Segments per great circle of a sphere mesh. The mesh has 0.6 % less volume than the sphere.
_SPHERE_SEGMENTS = 64


@dataclass(frozen=True)
class CystSolids:
    """Solids of one cyst in the frame of the leg, before the leg is mirrored.

    Attributes
    ----------
    cyst : Cyst
        Parameters of the cyst.
    wall : Manifold
        Solid bounded by the outer surface of the wall, in mm.
    contents : Manifold
        Solid of the soft contents, in mm.
    """

    cyst: Cyst
    wall: Manifold
    contents: Manifold


def place_cysts(
    knee: Knee, assembly: KneeAssembly, bones: dict[str, Bone], worn_mm: Mapping[str, float] | None = None
) -> dict[str, list[CystSolids]]:
    """Place all cysts of a knee as close to the subchondral bone plate as possible.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee, including its cysts.
    assembly : KneeAssembly
        Bones of the knee in their pose.
    bones : dict of str to Bone
        Solids of the bones in the frame of the leg, in mm.
    worn_mm : Mapping of str to float, optional
        Depth of wear of the medial and lateral plateau, in mm. None means that the function measures the wear. Cysts
        below a worn plateau are deeper.

    Returns
    -------
    dict of str to list of CystSolids
        Cysts of each bone.

    Raises
    ------
    InputError
        If a bone has too little space for a cyst.
    """
    if not knee.cysts:
        return {}
    worn_mm, build, pose = worn_mm or measure_attrition_mm(assembly), assembly.bone_parameters, assembly.pose
    femur, tibia = assembly.femur.deformed_vertices_mm, assembly.tibia.deformed_vertices_mm
    ways = {
        "femur": _JointEnd(scale_and_lean_femur(femur, build), pose.femur_transform(), -1.0, build.half_ml_mm),
        "tibia": _JointEnd(scale_slope_and_lean_tibia(tibia, build), pose.tibia_transform(), 1.0, build.half_ml_mm),
    }
    made: dict[str, list[CystSolids]] = {}
    for cyst in knee.cysts:
        side, bone = cyst.site.split("_")
        before = made.setdefault(bone, [])
        spared_mm = worn_mm[side] + _WEAR_MARGIN_MM if bone == "tibia" and worn_mm[side] else 0.0
        before.append(_place_cyst(cyst, bones[bone], ways[bone], spared_mm, before))
    return made


def build_cyst_meshes(cysts: dict[str, list[CystSolids]], assembly: KneeAssembly) -> dict[str, Mesh]:
    """Build one mesh per site of the cysts, including their walls.

    Parameters
    ----------
    cysts : dict of str to list of CystSolids
        Cysts of each bone.
    assembly : KneeAssembly
        Bones of the knee in their pose.

    Returns
    -------
    dict of str to Mesh
        Closed surface per site in the knee frame, in mm.
    """
    by_site: dict[str, list[Manifold]] = {}
    for of_bone in cysts.values():
        for one in of_bone:
            by_site.setdefault(one.cyst.site, []).append(one.wall)
    return {site: assembly.orient_mesh(extract_mesh(Manifold.compose(walls))) for site, walls in by_site.items()}


@dataclass(frozen=True)
class _JointEnd:
    """Joint end of a bone before wear.

    `outer_mm` (n, 3) are the outer vertices in the frame of the bone. `frame` (3, 4) is the transform from the frame of
    the bone to the frame of the leg. `joint_sign` is +1 if the joint is above the bone along z, else -1. `half_ml_mm`
    is half the width of the plateau.
    """

    outer_mm: Array
    frame: Array
    joint_sign: float
    half_ml_mm: float

    def column_start_mm(self, cyst: Cyst, inwards: float) -> Array:
        """Return the surface point (3,), in the frame of the bone, from which the depth of a cyst is measured.

        `inwards` (0 to 1) moves the point from the specified location towards the centre of the compartment.
        """
        inner, outer = (share * self.half_ml_mm for share in COMPARTMENT_RANGE)
        outward = cyst.outward + inwards * (min(cyst.outward, _INNERMOST) - cyst.outward)
        x = (inner + outward * (outer - inner)) * (1.0 if cyst.site.startswith("medial") else -1.0)
        near = self.outer_mm[np.abs(self.outer_mm[:, 0] - x) < _BESIDE_MM]
        heights = near[:, 2] * self.joint_sign
        layer = near[heights > heights.max() - _LAYER_MM]
        low, high = layer[:, 1].min(), layer[:, 1].max()
        y = (low + high) / 2 + (1 - inwards) * cyst.place * _PLACE_FRACTION * (high - low) / 2
        return np.array([x, y, layer[np.argmin(np.abs(layer[:, 1] - y)), 2]])


def _place_cyst(
    cyst: Cyst, bone: Bone, joint: _JointEnd, worn_mm: float, earlier_cysts: list[CystSolids]
) -> CystSolids:
    """Place a cyst at the first location that is clear of the bone plate, the canal and earlier cysts.

    `worn_mm` is added to the depth. The cyst therefore has the same location in the bone in all postures.
    """
    radius = cyst.diameter_mm / 2 + WALL_MM
    around = [bone.inner, *_list_obstacles(bone, earlier_cysts)]
    walls = cKDTree(np.vstack([extract_mesh(solid).vertices for solid in around]))
    wall, soft = (Manifold.sphere(size, _SPHERE_SEGMENTS) for size in (radius, cyst.diameter_mm / 2))
    depths = np.arange(radius + worn_mm, _DEEPEST_MM, _STEP_MM)[:, None] * [0.0, 0.0, joint.joint_sign]
    centres = np.vstack(
        [apply_transform(joint.column_start_mm(cyst, share) - depths, joint.frame) for share in _INWARDS]
    )
    # The distance to vertices only preselects candidates, because faces may be nearer. The Boolean test of the solids
    # decides.
    for centre in centres[walls.query(centres)[0] >= radius + _CLEARANCE_MM]:
        at = tuple(centre)
        if _has_room(wall.translate(at), bone, earlier_cysts):
            return CystSolids(cyst, wall.translate(at), soft.translate(at))
    raise InputError(
        f"cyst at {cyst.site} must fit into the trabecular bone, got diameter_mm = {cyst.diameter_mm:g} mm, "
        f"place = {cyst.place:g}, outward = {cyst.outward:g}: reduce the diameter or change the location"
    )


def _has_room(wall: Manifold, bone: Bone, earlier_cysts: list[CystSolids]) -> bool:
    """Test whether a cyst wall is entirely within the trabecular bone and clear of the canal and earlier cysts."""
    left = (wall - bone.inner).volume() > 0
    return not left and not any((wall ^ other).volume() > 0 for other in _list_obstacles(bone, earlier_cysts))


def _list_obstacles(bone: Bone, earlier_cysts: list[CystSolids]) -> list[Manifold]:
    """List the solids within the trabecular bone that a cyst must not intersect: the canal and earlier cysts."""
    return [solid for solid in (bone.canal, *(one.wall for one in earlier_cysts)) if solid is not None]
