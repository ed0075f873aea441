"""Plateau wear (attrition): remove tibial bone where the femur would overlap it, bone on bone."""

import numpy as np
from manifold3d import Manifold, OpType

from ...core.checks import Array
from .bone_shells import Bone
from .parameter_conflicts import SolidConflictError

# Gap between worn bones, mm, which touch in vivo: half of the tolerance of the joint space width.
CONTACT_MM = 5e-4
# Largest depth by which a plateau or a spine may be worn, mm (assumed; the OARSI atlas gives no number). In shapes 3 SD
# from the mean in every mode, a tall spine with an osteophyte overlaps the wall of a narrow notch by 6 mm.
MAX_WEAR_MM = 7.0
# Overlap up to this volume is rounding error, mm3.
ROUNDING_MM3 = 1e-6
# Detached bodies up to this volume are removed where a plateau is worn thin, mm3.
_CRUMB_MM3 = 0.1


def wear_tibia(tibia: Bone, femur: Manifold, plate_mm: float) -> Bone:
    """Remove from the tibia what the femur overlaps, and keep the plate thickness under the worn surface.

    Parameters
    ----------
    tibia : Bone
        Solids of the tibia in the knee frame, in mm.
    femur : Manifold
        Outer solid of the femur in the knee frame, in mm.
    plate_mm : float
        Thickness of the subchondral bone plate under the worn surface, in mm.

    Returns
    -------
    Bone
        The worn tibia; `tibia` itself if the bones do not overlap.

    Raises
    ------
    InputError
        The wear would be deeper than `MAX_WEAR_MM`.
    """
    wearing = _find_wearing_part(tibia.outer, femur, CONTACT_MM + plate_mm)
    if wearing is None:
        return tibia
    return Bone(
        outer=_remove_crumbs(_subtract_femur(tibia.outer, wearing, CONTACT_MM)),
        inner=_remove_crumbs(_subtract_femur(tibia.inner, wearing, CONTACT_MM + plate_mm)),
        canal=tibia.canal,
    )


def wear_outer_tibia(tibia: Manifold, femur: Manifold) -> Manifold:
    """Remove from the outer solid of the tibia what the femur overlaps.

    Parameters
    ----------
    tibia : Manifold
        Outer solid of the tibia, in mm.
    femur : Manifold
        Outer solid of the femur in the same frame, in mm.

    Returns
    -------
    Manifold
        The worn solid, including small detached bodies; `tibia` itself if the bones do not overlap.

    Raises
    ------
    InputError
        The wear would be deeper than `MAX_WEAR_MM`.
    """
    wearing = _find_wearing_part(tibia, femur, CONTACT_MM)
    return tibia if wearing is None else _subtract_femur(tibia, wearing, CONTACT_MM)


def crop_to_box(femur: Manifold, box_mm: Array, margin_mm: float) -> Manifold:
    """Crop the femur to a box with a margin, because wear does not depend on the rest of it.

    Parameters
    ----------
    femur : Manifold
        Outer solid of the femur, in mm.
    box_mm : (2, 3) float64 array
        Lower and upper corner of the box, in mm.
    margin_mm : float
        Margin around the box, in mm.

    Returns
    -------
    Manifold
        The part of the femur inside the enlarged box.
    """
    low, high = box_mm[0] - margin_mm, box_mm[1] + margin_mm
    for axis, way in enumerate(np.eye(3)):
        femur = femur.trim_by_plane(tuple(way), low[axis]).trim_by_plane(tuple(-way), -high[axis])
    return femur


def _find_wearing_part(tibia: Manifold, femur: Manifold, margin_mm: float) -> Manifold | None:
    """Return the part of the femur within a margin of the overlap with the tibia, or None without overlap."""
    shared = tibia ^ femur
    if shared.volume() <= ROUNDING_MM3:
        return None
    if (tibia ^ femur.translate((0.0, 0.0, MAX_WEAR_MM))).volume() > ROUNDING_MM3:
        raise SolidConflictError(
            f"femur and tibia must overlap by at most {MAX_WEAR_MM:g} mm, the deepest wear of a plateau, got more in "
            f"a shared volume of {shared.volume():.3g} mm3: joint space, osteophytes or pose leave no clearance"
        )
    return crop_to_box(femur, np.array(shared.bounding_box()).reshape(2, 3), margin_mm)


def _subtract_femur(solid: Manifold, femur: Manifold, clearance_mm: float) -> Manifold:
    """Subtract the femur and a clearance around it, downwards and to all sides, from a solid."""
    # The femur itself is subtracted too, because one of its edges may be thinner than the shift of the copies.
    ways = clearance_mm * np.array([[0, 0, 0], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return Manifold.batch_boolean([solid, *(femur.translate(way) for way in ways)], OpType.Subtract)


def _remove_crumbs(solid: Manifold) -> Manifold:
    """Remove small detached bodies from a solid."""
    bodies = solid.decompose()
    return solid if len(bodies) == 1 else Manifold.compose([one for one in bodies if one.volume() > _CRUMB_MM3])
