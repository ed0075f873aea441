"""Plateau wear (attrition): remove tibial bone where the femur would overlap the tibia."""

import numpy as np
from manifold3d import Manifold, OpType

from ...core.checks import Array
from .bone_shells import Bone
from .parameter_conflicts import SolidConflictError

# Gap between worn bones, in mm: half the tolerance of the JSW. In vivo, worn bones touch.
CONTACT_MM = 5e-4
# Largest depth of wear of a plateau or a spine, in mm (assumed; the OARSI atlas gives no number). If all shape scores
# are 3 SD, a tall spine with an osteophyte overlaps the wall of a narrow notch by 6 mm.
MAX_WEAR_MM = 7.0
# Largest overlap volume that counts as a rounding error, mm3.
ROUNDING_MM3 = 1e-6
# Largest number of times that the contact gap is doubled. Shifted copies of the femur nearly coincide, so their
# subtraction may leave an overlap.
_WIDENINGS = 3
# Largest volume of a detached component that is removed where wear has made the plateau thin, in mm3.
_CRUMB_MM3 = 0.1


def wear_tibia(tibia: Bone, femur: Manifold, plate_mm: float) -> Bone:
    """Remove the tibial bone that the femur overlaps, and keep the plate thickness below the worn surface unchanged.

    Parameters
    ----------
    tibia : Bone
        Solids of the tibia in the knee frame, in mm.
    femur : Manifold
        Outer solid of the femur in the knee frame, in mm.
    plate_mm : float
        Thickness of the subchondral bone plate below the worn surface, in mm.

    Returns
    -------
    Bone
        Worn tibia, or unchanged `tibia` if the bones do not overlap.

    Raises
    ------
    InputError
        If the wear would be deeper than `MAX_WEAR_MM`.
    """
    wearing = _find_wearing_part(tibia.outer, femur, CONTACT_MM + plate_mm)
    if wearing is None:
        return tibia
    return Bone(
        outer=_remove_crumbs(_wear_outer_solid(tibia.outer, wearing)),
        inner=_remove_crumbs(_subtract_femur(tibia.inner, wearing, CONTACT_MM + plate_mm)),
        canal=tibia.canal,
    )


def wear_outer_tibia(tibia: Manifold, femur: Manifold) -> Manifold:
    """Remove the volume of the outer tibia that the femur overlaps.

    Parameters
    ----------
    tibia : Manifold
        Outer solid of the tibia, in mm.
    femur : Manifold
        Outer solid of the femur in the frame of `tibia`, in mm.

    Returns
    -------
    Manifold
        Worn solid, including small detached components, or unchanged `tibia` if the bones do not overlap.

    Raises
    ------
    InputError
        If the wear would be deeper than `MAX_WEAR_MM`.
    """
    wearing = _find_wearing_part(tibia, femur, CONTACT_MM)
    return tibia if wearing is None else _wear_outer_solid(tibia, wearing)


def crop_to_box(femur: Manifold, box_mm: Array, margin_mm: float) -> Manifold:
    """Crop the femur to a box with a margin, because wear depends only on the bone within it.

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
        Femur within the enlarged box.
    """
    low, high = box_mm[0] - margin_mm, box_mm[1] + margin_mm
    for axis, way in enumerate(np.eye(3)):
        femur = femur.trim_by_plane(tuple(way), low[axis]).trim_by_plane(tuple(-way), -high[axis])
    return femur


def _find_wearing_part(tibia: Manifold, femur: Manifold, margin_mm: float) -> Manifold | None:
    """Return the femur within a margin around its overlap with the tibia, or None if the bones do not overlap."""
    shared = tibia ^ femur
    if shared.volume() <= ROUNDING_MM3:
        return None
    if (tibia ^ femur.translate((0.0, 0.0, MAX_WEAR_MM))).volume() > ROUNDING_MM3:
        raise SolidConflictError(
            f"femur and tibia overlap by more than {MAX_WEAR_MM:g} mm, the largest wear of a plateau; the overlap has "
            f"a volume of {shared.volume():.3g} mm3, because joint space, osteophytes or pose leave no clearance"
        )
    return crop_to_box(femur, np.array(shared.bounding_box()).reshape(2, 3), margin_mm)


def _wear_outer_solid(tibia: Manifold, femur: Manifold) -> Manifold:
    """Subtract the femur and the contact gap from a tibia. The gap is widened if rounding errors leave an overlap."""
    for clearance_mm in CONTACT_MM * 2.0 ** np.arange(_WIDENINGS + 1):
        worn = _subtract_femur(tibia, femur, clearance_mm)
        if (worn ^ femur).volume() <= ROUNDING_MM3:
            break
    return worn


def _subtract_femur(solid: Manifold, femur: Manifold, clearance_mm: float) -> Manifold:
    """Subtract the femur from a solid, and leave a clearance below the femur and on its four sides."""
    # An edge of the femur may be thinner than the shift of its copies, so the femur is also subtracted without a shift.
    ways = clearance_mm * np.array([[0, 0, 0], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return Manifold.batch_boolean([solid, *(femur.translate(way) for way in ways)], OpType.Subtract)


def _remove_crumbs(solid: Manifold) -> Manifold:
    """Remove small connected components from a solid."""
    bodies = solid.decompose()
    return solid if len(bodies) == 1 else Manifold.compose([one for one in bodies if one.volume() > _CRUMB_MM3])
