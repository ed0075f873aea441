"""Osteophytes: beaks at the joint margins, each with a cortex of its own."""

import numpy as np
from manifold3d import Manifold

from ..knee import Osteophyte
from .bones import Bone
from .solids import checked, mesh_of

_CORTEX_MM = 0.5
# Height band (mm at scale 1) in which a bone's margin is looked for, height of the tip, and of the base.
_PLACE = {"femur": ((3.0, 10.0), 5.5, 8.5), "tibia": ((-7.0, 0.0), -2.2, -5.0)}


def add_osteophytes(bone: Bone, name: str, osteophytes: tuple[Osteophyte, ...], scale: float) -> Bone:
    """The bone with the beaks that belong to it, united with its outer and inner solid."""
    outer, inner = bone.outer, bone.inner
    for beak in osteophytes:
        side, where = beak.site.split("_")
        if where != name:
            continue
        direction = 1.0 if side == "medial" else -1.0
        margin = _margin_mm(bone.outer, name, direction, scale)
        outer = outer + _beak(name, direction, margin, beak.size_mm, 0.0, scale)
        inner = inner + _beak(name, direction, margin, beak.size_mm, _CORTEX_MM, scale)
    return Bone(outer=checked(outer, name), inner=checked(inner, f"{name} inner"), canal=bone.canal)


def _margin_mm(outer: Manifold, name: str, direction: float, scale: float) -> float:
    (low, high), _, _ = _PLACE[name]
    vertices = mesh_of(outer).vertices
    band = vertices[(vertices[:, 2] >= low * scale) & (vertices[:, 2] <= high * scale)]
    return float((band[:, 0] * direction).max())


def _beak(name: str, direction: float, margin_mm: float, size_mm: float, inset_mm: float, scale: float) -> Manifold:
    """Hull of a broad base within the bone and a small tip; its farthest point is `size_mm` out of the margin."""
    _, tip_z, base_z = _PLACE[name]
    tip_radius = 0.35 + 0.15 * size_mm
    base_radius = 1.6 + 0.5 * size_mm
    width = 4.0 + 2.0 * size_mm
    tip = (margin_mm + size_mm - tip_radius, 0.0, tip_z * scale)
    # The cortex takes the whole tip of a small beak, whose inner part then ends within the base.
    inner_tip = max(tip_radius - inset_mm, 0.1)
    back = 0.0 if inset_mm == 0 else max(0.0, inset_mm - (tip_radius - inner_tip))
    parts = [_ball((direction * (tip[0] - back), 0.0, tip[2]), inner_tip)]
    for y in (-width, 0.0, width):
        inward = margin_mm - base_radius - 1.2 - 1.5 * (y / width) ** 2
        parts.append(_ball((direction * inward, y, base_z * scale), base_radius - inset_mm))
    return checked(Manifold.batch_hull(parts), "osteophyte")


def _ball(centre_mm: tuple[float, float, float], radius_mm: float) -> Manifold:
    return Manifold.sphere(radius_mm, 32).translate(np.asarray(centre_mm))
