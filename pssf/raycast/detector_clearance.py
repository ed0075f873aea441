"""Check or adjust the distance between leg and detector, so that no ray ends inside the leg."""

from dataclasses import replace

import numpy as np

from ..core.checks import InputError
from ..geometry.scene import Scene
from ..geometry.view import depth_fraction, project_at_depth, resolve_view
from ..model.protocol import Protocol
from .engines.triangle_clipping import MIN_DEPTH_FRACTION


def require_detector_clearance(scene: Scene, protocol: Protocol) -> None:
    """Raise an error if a part of the leg in the field of view is behind the detector.

    Parameters
    ----------
    scene : Scene
        Closed surfaces of the leg; only surfaces in contact with the ambient material (air) are used.
    protocol : Protocol
        Source and detector.

    Raises
    ------
    InputError
        If the leg extends behind the detector. The message reports the largest allowed `sod_mm`.
    """
    behind_mm = _depth_behind_detector_mm(scene, protocol)
    if behind_mm > 0:
        raise InputError(
            f"sod_mm must be at most {np.floor(protocol.sod_mm - behind_mm):g} mm with sdd_mm = {protocol.sdd_mm:g} mm,"
            f" got {protocol.sod_mm:g} mm: the leg extends {behind_mm:.1f} mm behind the detector"
        )


def move_clear_of_detector(scene: Scene, protocol: Protocol) -> Protocol:
    """Move the joint towards the source until the leg is in front of the detector.

    The distance `sod_mm` decreases in steps of 1 mm; most knees need no change. In reality, a large thigh touches the
    detector cover, so that the knee is farther from the detector.

    Parameters
    ----------
    scene : Scene
        Closed surfaces of the leg; only surfaces in contact with the ambient material (air) are used.
    protocol : Protocol
        Source and detector.

    Returns
    -------
    Protocol
        Protocol with the largest `sod_mm` for which the leg is in front of the detector.
    """
    while (behind_mm := _depth_behind_detector_mm(scene, protocol)) > 0:
        protocol = replace(protocol, sod_mm=round(protocol.sod_mm - float(np.ceil(behind_mm)), 3))
    return protocol


def _depth_behind_detector_mm(scene: Scene, protocol: Protocol) -> float:
    """Measure how far the skin in the field of view extends behind the detector, in mm; 0 or less if it does not."""
    view = resolve_view(protocol)
    shares = [0.0]
    for surface in (one for one in scene.surfaces if one.outside == "air"):
        points_mm = surface.mesh_arrays.vertices
        depth = depth_fraction(points_mm, view)
        ahead = depth > MIN_DEPTH_FRACTION
        seen = project_at_depth(points_mm[ahead], depth[ahead], view)
        within = ((seen >= 0) & (seen < (view.rows, view.cols))).all(axis=1)
        shares.append(float(np.max(depth[ahead][within], initial=0.0)) - 1)
    return max(shares) * protocol.sdd_mm
