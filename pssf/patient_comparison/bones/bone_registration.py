"""Registration of one bone to another of its kind by the joint end, without the flat cut of the shaft."""

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

# Bones that are compared.
BONES = ("femur", "tibia", "patella")
# End of the bone with the joint: +1 proximal, -1 distal, 0 for a bone without a cut end.
_JOINT_END = {"femur": -1, "tibia": +1, "patella": 0}
# Length of bone from the joint that is compared, in mm.
_REACH_MM = 100.0
# Distance from the cut of the shaft, in mm, that is excluded, because the cut plane is no part of the bone.
_FROM_CUT_MM = 5.0
# Length of the joint end from which the fit starts, in mm.
_END_MM = 40.0
# Length of bone from the joint that is kept, in mm, for bones of any size.
_KEPT_MM = 140.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneFit:
    """Built mean bone registered to the mean of the patient bones, at their size.

    Attributes
    ----------
    placed_mesh : Mesh
        Registered bone without the parts that are not compared, in mm.
    off_mm : (n,) array
        Signed distance of its vertices from the patient mean, in mm; positive outside.
    fit : SimilarityTransform
        Transform of the built bone.
    heights_mm : tuple of float
        Heights between which the patient mean is compared, in mm.
    """

    placed_mesh: Mesh
    off_mm: Array
    fit: SimilarityTransform
    heights_mm: tuple[float, float]


def fit_bone(bone: Mesh, fixed: SampledSurface, name: str) -> BoneFit:
    """Register one bone to another of its kind and measure the distances of its vertices.

    Parameters
    ----------
    bone : Mesh
        Bone to register, in mm.
    fixed : SampledSurface
        Bone to register to.
    name : {"femur", "tibia", "patella"}
        Kind of bone, which defines the joint end.

    Returns
    -------
    BoneFit
        Registered bone and distances.
    """
    heights, near = compared_heights_mm(fixed.mesh, name), crop_near_joint(bone, name)
    fit = register_bone(sample_surface(near), fixed, name)
    placed = trim_to_heights(Mesh(fit.apply(near.vertices), near.faces), *heights)
    away, outward = fixed.find_nearest(placed.vertices)
    off = np.linalg.norm(placed.vertices - away, axis=1)
    off *= np.where(((placed.vertices - away) * outward).sum(axis=1) < 0, -1.0, 1.0)
    return BoneFit(placed_mesh=placed, off_mm=off, fit=fit, heights_mm=heights)


def register_bone(moving: SampledSurface, fixed: SampledSurface, name: str) -> SimilarityTransform:
    """Register a bone near its joint to another of its kind by a similarity transform.

    Parameters
    ----------
    moving : SampledSurface
        Bone to register.
    fixed : SampledSurface
        Bone to register to.
    name : {"femur", "tibia", "patella"}
        Kind of bone.

    Returns
    -------
    SimilarityTransform
        Transform of the moving bone.
    """
    return fit_similarity(
        moving, fixed, _guess_similarity(moving.mesh, fixed.mesh, name), compared_heights_mm(fixed.mesh, name)
    )


def compared_heights_mm(bone: Mesh, name: str) -> tuple[float, float]:
    """Return the heights (z) between which a bone is compared: within 100 mm of the joint and 5 mm clear of a cut.

    Parameters
    ----------
    bone : Mesh
        Bone, in mm.
    name : {"femur", "tibia", "patella"}
        Kind of bone.

    Returns
    -------
    tuple of float
        Lower and upper height in mm; infinite where nothing is excluded.
    """
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if _JOINT_END[name] < 0:
        return (-np.inf, float(min(high - _FROM_CUT_MM, low + _REACH_MM)))
    if _JOINT_END[name] > 0:
        return (float(max(low + _FROM_CUT_MM, high - _REACH_MM)), np.inf)
    return (-np.inf, np.inf)


def crop_near_joint(bone: Mesh, name: str) -> Mesh:
    """Remove the part of the shaft that is farther than 140 mm from the joint, to save time.

    Parameters
    ----------
    bone : Mesh
        Bone, in mm.
    name : {"femur", "tibia", "patella"}
        Kind of bone.

    Returns
    -------
    Mesh
        Bone near its joint.
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
    """Guess a similarity transform with equal width and position of the joint ends and without rotation."""
    box, box_onto = _joint_end_box(bone, name), _joint_end_box(fixed, name)
    scale = float(np.ptp(box_onto[:, 0]) / np.ptp(box[:, 0]))
    middle, middle_onto = box.mean(axis=0), box_onto.mean(axis=0)
    if _JOINT_END[name]:
        end = 0 if _JOINT_END[name] < 0 else 1
        middle[2], middle_onto[2] = box[end, 2], box_onto[end, 2]
    return SimilarityTransform(rotation=np.eye(3), scale=scale, translation_mm=middle_onto - scale * middle)


def _joint_end_box(mesh: Mesh, name: str) -> Array:
    """Return the (2, 3) corners of the bounding box of a joint end, in mm."""
    points, end = mesh.vertices, _JOINT_END[name]
    if end:
        outward = points[:, 2] * end
        points = points[outward > outward.max() - _END_MM]
    return np.stack((points.min(axis=0), points.max(axis=0)))
