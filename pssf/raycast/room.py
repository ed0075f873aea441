"""Room for a leg before its detector, of which rays would otherwise end inside the leg."""

from dataclasses import replace

import numpy as np

from ..core.checks import InputError
from ..geometry.scene import Scene
from ..geometry.view import depth_of, seen_at, view_of
from ..model.protocol import Protocol
from .clip import NEAREST


def require_room(scene: Scene, protocol: Protocol) -> None:
    """Refuse a detector that stands in what is seen of a scene.

    raises  InputError, which says how far from the source the joint may be at most
    """
    behind_mm = _behind_mm(scene, protocol)
    if behind_mm > 0:
        raise InputError(
            f"sod_mm = {protocol.sod_mm:g} mm with sdd_mm = {protocol.sdd_mm:g} mm: the leg reaches "
            f"{behind_mm:.1f} mm behind the detector; allowed: up to {np.floor(protocol.sod_mm - behind_mm):g} mm"
        )


def with_room(scene: Scene, protocol: Protocol) -> Protocol:
    """The protocol with the joint by so many whole millimetres nearer to the source as the leg needs, mostly none: a
    person whose thigh is at the detector's cover stands no closer.
    """
    while (behind_mm := _behind_mm(scene, protocol)) > 0:
        protocol = replace(protocol, sod_mm=round(protocol.sod_mm - float(np.ceil(behind_mm)), 3))
    return protocol


def _behind_mm(scene: Scene, protocol: Protocol) -> float:
    """By how much of the skin is behind the detector where it is seen."""
    view = view_of(protocol)
    shares = [0.0]
    for surface in (one for one in scene.surfaces if one.outside == "air"):
        points_mm = surface.arrays.vertices
        depth = depth_of(points_mm, view)
        ahead = depth > NEAREST
        seen = seen_at(points_mm[ahead], depth[ahead], view)
        within = ((seen >= 0) & (seen < (view.rows, view.cols))).all(axis=1)
        shares.append(float(np.max(depth[ahead][within], initial=0.0)) - 1)
    return max(shares) * protocol.sdd_mm
