"""Where one bone lies closest on another of its kind: by its joint's end, without the flat cut of its shaft."""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array
from ..geometry.mesh import Mesh
from .surfaces import MeasuredSurface, Similarity, fit_similarity, measured, trimmed

BONES = ("femur", "tibia", "patella")
# +1: the joint is at the bone's upper end; -1: at its lower one; 0: no end is cut.
_JOINT_END = {"femur": -1, "tibia": +1, "patella": 0}
# Of a shaft this much is compared, and nothing so near its cut, whose plane is no part of the bone.
_REACH_MM, _FROM_CUT_MM = 100.0, 5.0
# Of a joint's end, by which a fit begins; and of a shaft, what is kept at all, for bones of any size.
_END_MM, _KEPT_MM = 40.0, 140.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneFit:
    """The built mean bone where it lies closest to the mean of the given ones, at their size.

    placed      the built bone, without what is not compared
    off_mm      (n,)  distance of its vertices from the given mean; positive: the built bone stands out
    heights_mm  between which the given mean is compared
    """

    placed: Mesh
    off_mm: Array
    fit: Similarity
    heights_mm: tuple[float, float]


def fit_bone(bone: Mesh, onto: MeasuredSurface, name: str) -> BoneFit:
    """How one bone lies closest on another of its kind.

    name  femur | tibia | patella: which end is the joint
    """
    heights, near = heights_mm(onto.mesh, name), near_joint(bone, name)
    fit = laid_onto(measured(near), onto, name)
    placed = trimmed(Mesh(fit.apply(near.vertices), near.faces), *heights)
    away, outward = onto.nearest(placed.vertices)
    off = np.linalg.norm(placed.vertices - away, axis=1)
    off *= np.where(((placed.vertices - away) * outward).sum(axis=1) < 0, -1.0, 1.0)
    return BoneFit(placed=placed, off_mm=off, fit=fit, heights_mm=heights)


def laid_onto(surface: MeasuredSurface, onto: MeasuredSurface, name: str) -> Similarity:
    """The similarity that lays a bone, near its joint, closest on another of its kind."""
    return fit_similarity(surface, onto, _start_of(surface.mesh, onto.mesh, name), heights_mm(onto.mesh, name))


def heights_mm(bone: Mesh, name: str) -> tuple[float, float]:
    """Between which heights (z) a bone is compared: within 100 mm of the joint, and 5 mm clear of a cut."""
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if _JOINT_END[name] < 0:
        return (-np.inf, float(min(high - _FROM_CUT_MM, low + _REACH_MM)))
    if _JOINT_END[name] > 0:
        return (float(max(low + _FROM_CUT_MM, high - _REACH_MM)), np.inf)
    return (-np.inf, np.inf)


def near_joint(bone: Mesh, name: str) -> Mesh:
    """A bone without what of its shaft is farther than 140 mm from the joint, for the sake of time."""
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if not _JOINT_END[name] or high - low <= _KEPT_MM:
        return bone
    return trimmed(bone, -np.inf, low + _KEPT_MM) if _JOINT_END[name] < 0 else trimmed(bone, high - _KEPT_MM, np.inf)


def _start_of(bone: Mesh, onto: Mesh, name: str) -> Similarity:
    """A first guess: as wide as the other near the joint, and there in the same place; turned as it is."""
    box, box_onto = _end_box(bone, name), _end_box(onto, name)
    scale = float(np.ptp(box_onto[:, 0]) / np.ptp(box[:, 0]))
    middle, middle_onto = box.mean(axis=0), box_onto.mean(axis=0)
    if _JOINT_END[name]:
        end = 0 if _JOINT_END[name] < 0 else 1
        middle[2], middle_onto[2] = box[end, 2], box_onto[end, 2]
    return Similarity(rotation=np.eye(3), scale=scale, shift_mm=middle_onto - scale * middle)


def _end_box(mesh: Mesh, name: str) -> Array:
    """(2, 3)  corners of the box around a joint's end"""
    points, end = mesh.vertices, _JOINT_END[name]
    if end:
        outward = points[:, 2] * end
        points = points[outward > outward.max() - _END_MM]
    return np.stack((points.min(axis=0), points.max(axis=0)))
