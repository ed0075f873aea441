"""Register two bones of the same type by a similarity transform of the joint end, excluding the cut of the shaft."""

from dataclasses import dataclass

import numpy as np

from ...core.checks import Array
from ...geometry.mesh import Mesh
from .surface_distance import (
    SampledSurface,
    SimilarityTransform,
    fit_similarity,
    sample_surface,
    trim_to_heights,
)

# Bone types that are compared.
BONES = ("femur", "tibia", "patella")
# End of each bone at the knee joint: +1 proximal, -1 distal; 0 for the patella, which has no cut shaft.
_JOINT_END = {"femur": -1, "tibia": +1, "patella": 0}
# Largest distance from the joint end at which bones are compared, in mm.
_REACH_MM = 100.0
# Length of shaft next to the cut that is excluded, in mm, because the cut plane is not a bone surface.
_FROM_CUT_MM = 5.0
# Length of the joint end whose bounding box defines the initial transform, in mm.
_END_MM = 40.0
# Distance from the joint end beyond which a bone is cropped, in mm; large enough for bones of any size.
_KEPT_MM = 140.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneFit:
    """Bone of the default knee, registered to the mean patient bone.

    Attributes
    ----------
    placed_mesh : Mesh
        Mesh of the registered bone, trimmed to the compared heights, in mm.
    off_mm : (n,) array
        Signed distance of each vertex of `placed_mesh` from the mean patient bone, in mm; positive outside.
    fit : SimilarityTransform
        Transform from the bone of the default knee to the mean patient bone.
    heights_mm : tuple of float
        Lower and upper limit of the compared heights, in mm.
    """

    placed_mesh: Mesh
    off_mm: Array
    fit: SimilarityTransform
    heights_mm: tuple[float, float]


def fit_bone(bone: Mesh, fixed: SampledSurface, name: str) -> BoneFit:
    """Register a bone to another bone of the same type, and measure the distances of its vertices.

    Parameters
    ----------
    bone : Mesh
        Bone to register, in mm.
    fixed : SampledSurface
        Fixed bone, to which the other bone is registered.
    name : {"femur", "tibia", "patella"}
        Bone type, which defines the joint end.

    Returns
    -------
    BoneFit
        Registered bone and signed distances.
    """
    heights, near = compared_heights_mm(fixed.mesh, name), crop_near_joint(bone, name)
    fit = register_bone(sample_surface(near), fixed, name)
    placed = trim_to_heights(Mesh(fit.apply(near.vertices), near.faces), *heights)
    away, outward = fixed.find_nearest(placed.vertices)
    off = np.linalg.norm(placed.vertices - away, axis=1)
    off *= np.where(((placed.vertices - away) * outward).sum(axis=1) < 0, -1.0, 1.0)
    return BoneFit(placed_mesh=placed, off_mm=off, fit=fit, heights_mm=heights)


def register_bone(moving: SampledSurface, fixed: SampledSurface, name: str) -> SimilarityTransform:
    """Register the joint end of a bone to another bone of the same type by a similarity transform.

    Parameters
    ----------
    moving : SampledSurface
        Bone to register.
    fixed : SampledSurface
        Fixed bone, to which the other bone is registered.
    name : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    SimilarityTransform
        Transform from the moving to the fixed bone.
    """
    return fit_similarity(
        moving, fixed, _guess_similarity(moving.mesh, fixed.mesh, name), compared_heights_mm(fixed.mesh, name)
    )


def compared_heights_mm(bone: Mesh, name: str) -> tuple[float, float]:
    """Return the range of heights (z) that are compared: within 100 mm of the joint, and 5 mm or more from a cut.

    Parameters
    ----------
    bone : Mesh
        Bone, in mm.
    name : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    tuple of float
        Lower and upper height in mm; infinite if an end is not excluded.
    """
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if _JOINT_END[name] < 0:
        return (-np.inf, float(min(high - _FROM_CUT_MM, low + _REACH_MM)))
    if _JOINT_END[name] > 0:
        return (float(max(low + _FROM_CUT_MM, high - _REACH_MM)), np.inf)
    return (-np.inf, np.inf)


def crop_near_joint(bone: Mesh, name: str) -> Mesh:
    """Crop the shaft of a bone 140 mm from the joint end, to save computation time.

    Parameters
    ----------
    bone : Mesh
        Bone, in mm.
    name : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    Mesh
        Cropped bone.
    """
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if not _JOINT_END[name] or high - low <= _KEPT_MM:
        return bone
    return (
        trim_to_heights(bone, -np.inf, low + _KEPT_MM)
        if _JOINT_END[name] < 0
        else trim_to_heights(bone, high - _KEPT_MM, np.inf)
    )


def _guess_similarity(bone: Mesh, fixed: Mesh, name: str) -> SimilarityTransform:
    """Compute an initial transform without rotation that matches the width and position of the joint ends."""
    box, box_onto = _joint_end_box(bone, name), _joint_end_box(fixed, name)
    scale = float(np.ptp(box_onto[:, 0]) / np.ptp(box[:, 0]))
    middle, middle_onto = box.mean(axis=0), box_onto.mean(axis=0)
    if _JOINT_END[name]:
        end = 0 if _JOINT_END[name] < 0 else 1
        middle[2], middle_onto[2] = box[end, 2], box_onto[end, 2]
    return SimilarityTransform(rotation=np.eye(3), scale=scale, translation_mm=middle_onto - scale * middle)


def _joint_end_box(mesh: Mesh, name: str) -> Array:
    """Return the bounding box of a joint end as lower and upper corner, (2, 3), in mm."""
    points, end = mesh.vertices, _JOINT_END[name]
    if end:
        outward = points[:, 2] * end
        points = points[outward > outward.max() - _END_MM]
    return np.stack((points.min(axis=0), points.max(axis=0)))
