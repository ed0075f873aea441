"""Checks of bone solids: shells must be nested, and bones must not overlap.

Without these checks, path lengths through the scene could be wrong without a warning.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from manifold3d import Manifold, OpType

from ...geometry.mesh_containment import is_mesh_within
from ..meshing.solids import build_bounding_box, extract_mesh
from .bone_shells import Bone
from .parameter_conflicts import SolidConflictError

# Largest volume of trabecular bone outside its cortex that is repaired, in mm3.
_MENDED_MM3 = 10.0
# Distance by which a repair moves the trabecular surface inwards, in mm.
_DRAWN_IN_MM = 0.1
# Margin around the protruding trabecular bone within which a repair moves the surface, in mm.
_ABOUT_MM = 0.5
# Largest volume of a protrusion or an overlap that counts as a rounding error, mm3.
_ROUNDING_MM3 = 1e-6


def is_nested(part: Bone) -> bool:
    """Test whether the trabecular bone is inside the outer surface of its bone.

    Parameters
    ----------
    part : Bone
        Solids of one bone.

    Returns
    -------
    bool
        True if the trabecular bone is inside.
    """
    # Testing the meshes is several times faster than computing the Boolean difference of the two solids.
    return is_mesh_within(extract_mesh(part.inner), extract_mesh(part.outer))


def repair_nesting(name: str, part: Bone) -> Bone:
    """Move trabecular bone inwards where it protrudes from a thin, folded cortex.

    Parameters
    ----------
    name : str
        Name of the bone in the error message.
    part : Bone
        Solids of one bone.

    Returns
    -------
    Bone
        Repaired bone, or unchanged `part` if the trabecular bone is inside.

    Raises
    ------
    InputError
        If more than 10 mm3 of trabecular bone is outside the cortex, which is too much for a fold.
    """
    outside = part.inner - part.outer
    outside_mm3 = outside.volume()
    if outside_mm3 <= _ROUNDING_MM3:
        return part
    if outside_mm3 > _MENDED_MM3:
        raise SolidConflictError(
            f"trabecular bone of the {name} must be inside the solid around it, got {outside_mm3:.3g} mm3 outside"
        )
    # Only the bone around the protrusions is copied. The surfaces of complete copies cross at many locations, so the
    # computation of their intersection would take a second.
    pieces = outside.decompose()
    about = part.outer ^ _unite_boxes(pieces, _ABOUT_MM + 2 * _DRAWN_IN_MM)
    ways = [about.translate(tuple(way)) for way in _DRAWN_IN_MM * np.vstack((np.eye(3), -np.eye(3)))]
    smaller = Manifold.batch_boolean([about, *ways], OpType.Intersect)
    return replace(part, inner=part.inner - (_unite_boxes(pieces, _ABOUT_MM) - smaller))


def _unite_boxes(pieces: list[Manifold], margin_mm: float) -> Manifold:
    """Unite the bounding boxes of all connected components after enlarging each box by a margin."""
    return Manifold.batch_boolean([build_bounding_box(piece, margin_mm) for piece in pieces], OpType.Add)


def check_nesting(bones: Mapping[str, Bone], muscle: Manifold) -> None:
    """Check that every shell is inside the solid around it and that no bones overlap.

    Parameters
    ----------
    bones : Mapping of str to Bone
        Solids of each bone, by bone name, in the frame of `muscle`, in mm.
    muscle : Manifold
        Solid that encloses all bones.

    Raises
    ------
    InputError
        If a shell is partly outside the solid around it, or if two bones overlap. The message names the bones and the
        volume.
    """
    for name, part in bones.items():
        shells = [("cortex", part.outer, muscle)]
        shells += [("marrow", part.canal, part.inner)] if part.canal is not None else []
        for what, inside, host in shells:
            if is_mesh_within(extract_mesh(inside), extract_mesh(host)):
                continue
            outside_mm3 = (inside - host).volume()
            if outside_mm3 > _ROUNDING_MM3:
                raise SolidConflictError(
                    f"{what} of the {name} must be inside the solid around it, got {outside_mm3:.3g} mm3 outside"
                )
    names = list(bones)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            shared = (bones[one].outer ^ bones[other].outer).volume()
            if shared > _ROUNDING_MM3:
                why = "joint space, osteophytes or pose leave no clearance"
                raise SolidConflictError(f"{one} and {other} must not overlap, got {shared:.3g} mm3 of overlap: {why}")
