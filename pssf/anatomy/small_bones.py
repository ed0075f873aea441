"""Fibula, patella and fabella of a right knee, beside the bones that they lie on."""

import numpy as np
from manifold3d import Manifold
from scipy.interpolate import LinearNDInterpolator

from ..core.checks import Array
from ..geometry.freeform import displaced
from ..model.knee import Knee
from .bone_build import Build, eased, formed, scaled
from .bones import SHAFT_END_MM, Bone, levels, trimmed
from .pose import Pose, moved, rotation
from .solids import checked, column, mesh_of, thickness

# Straight shafts and what trabeculae blur are drawn with fewer triangles, within this.
_COARSER_MM = 0.02
# Of the fibula, towards the tibia.
_JOINT_PLATE_MM = 0.7
# Of the fibula, from here on it leans with the tibia's shaft (mean man's size).
_FIBULA_LEANS_BELOW_MM = -25.0
# The part of the femur that a patella can lie on, and what of it faces the front: as much as the sides of the trochlea.
_FRONT_BELOW_MM, _FACES_FRONT = 90.0, 0.3
# The gap to the femur is that at so small a share of the patella's places, and at none less than such a share of it.
_NEAR_SHARE, _LEAST_SHARE = 0.1, 0.6
# Of the flexion the patella does not follow so large a share: it flexes by 0.65 of what the knee does (Nha 2008).
_LAG = 0.35
# Turns in which height and depth of the patella are made to agree, which in flexion depend on each other.
_TURNS = 2


def fibula(knee: Knee, build: Build, tibia: Manifold) -> Bone:
    """Fibula in the tibia's frame, its tip as far below the plateau as the knee says, cut clear of the tibia.

    tibia  outer solid, as it stands
    """
    table, s = build.shape.fibula, build.scale
    sections = scaled(table.sections, s)
    sections[:, 4] += np.tan(np.deg2rad(build.tibia_varus_deg)) * eased(_FIBULA_LEANS_BELOW_MM * s - sections[:, 0])
    cortex = thickness(scaled(table.cortex, s), build.cortex)
    # It goes where this person's tibia has the joint for it.
    joint = np.array([table.joint_mm])
    sideways = ((formed(joint, build.tibia) - joint) * s)[0]
    down = -knee.fibular_tip_mm - sections[:, 0].max()
    heights = levels(-SHAFT_END_MM - down, sections[:, 0].max(), 1.5)
    # Rings at the same heights, so that between them too the inner loft lies within the outer one.
    within = heights[(heights > heights[0] + 1.4) & (heights < heights[-1] - 0.7)]
    outer, inner = (
        column(sections, inset, rings, "fibula", count=64).simplify(tolerance).translate((*sideways[:2], down))
        for inset, rings, tolerance in ((np.zeros_like, heights, _COARSER_MM / 2), (cortex, within, _COARSER_MM))
    )
    near = trimmed(tibia, +1, -knee.fibular_tip_mm + 5.0)
    towards = np.array(table.faces) / np.linalg.norm(table.faces)
    # Simplified before they are cut: in the sharp edge that the cut leaves there is no room for it.
    return Bone(
        outer=checked(outer - near.translate(-table.gap_to_tibia_mm * towards), "fibula"),
        inner=checked(inner - near.translate(-(table.gap_to_tibia_mm + _JOINT_PLATE_MM) * towards), "fibula marrow"),
    )


def patella(build: Build) -> Bone:
    """Patella about its middle."""
    table, s = build.shape.patella, build.scale
    sections = scaled(table.sections, 1.0)
    low, high = sections[:, 0].min(), sections[:, 0].max()
    cortex = thickness(table.cortex, build.cortex)
    outer = column(sections, np.zeros_like, levels(low, high, 1.0), "patella", power=2.1)
    inner = column(sections, cortex, levels(low + 1.2, high - 1.2, 1.0), "patella marrow", power=2.1)

    def formed_as(solid: Manifold) -> Manifold:
        middle = np.array(table.centre_mm)
        return solid.warp_batch(lambda points: (displaced(np.array(points) + middle, build.patella) - middle) * s)

    # Simplified only when they are deformed: flat places do not stay flat.
    return Bone(
        outer=checked(formed_as(outer).simplify(_COARSER_MM / 2), "patella"),
        inner=checked(formed_as(inner).simplify(_COARSER_MM), "patella marrow"),
    )


def patella_place(knee: Knee, build: Build, patella: Manifold, femur: Manifold, pose: Pose) -> Array:
    """(3, 4)  transform of the patella from its own frame into the femur's.

    Its height is that of the Insall-Salvati index, its depth such that cartilage of both bones fills what is between.
    patella, femur  outer solids, the femur's as it stands
    """
    table, s = build.shape.patella, build.scale
    turn = rotation(0, _LAG * pose.flexion_deg) @ rotation(2, -knee.patellar_tilt_deg)
    points = mesh_of(patella).vertices
    low, high = points[:, 2].min(), points[:, 2].max()
    # The tendon is as long as the index says, from the apex down to the tuberosity, all but upright.
    apex_mm = build.shape.tendon.tuberosity[2] * s + table.tendon_end_mm * s + knee.insall_salvati * (high - low)
    to_leg = pose.femur_on_tibia()
    place = np.array([formed(np.array([[0.0, 0.0, 20.0]]), build.femur)[0, 0] * s - knee.patellar_shift_mm, 0.0, 0.0])
    place[1] = table.centre_mm[1] * s
    turned, front = points @ turn.T, _front(femur)
    for _ in range(_TURNS):
        # Height in the leg's frame is linear in the place: solved for z.
        rest = moved(np.array([[place[0], place[1], 0.0]]), to_leg)[0, 2]
        place[2] = (apex_mm - rest) / to_leg[2, 2] - low
        # The space between them front to back, nan beside the femur; where they are closest cartilage is thinner.
        space = front((turned + place)[:, [0, 2]]) - turned[:, 1]
        near = float(np.nanquantile(space, _NEAR_SHARE))
        place[1] = min(near - table.gap_to_femur_mm, float(np.nanmin(space)) - table.gap_to_femur_mm * _LEAST_SHARE)
    return np.column_stack((turn, place))


def _front(femur: Manifold) -> LinearNDInterpolator:
    """(n, 2) x and z -> (n,) y  of the front of a femur, mm"""
    mesh = mesh_of(trimmed(femur, +1, _FRONT_BELOW_MM)).as_trimesh()
    points = mesh.vertices[mesh.vertex_normals[:, 1] < -_FACES_FRONT]
    return LinearNDInterpolator(points[:, [0, 2]], points[:, 1])


def fabella(knee: Knee, build: Build, femur: Manifold) -> tuple[Bone, Array]:
    """Fabella about its middle, and the (3, 4) transform into the femur's frame, behind the lateral condyle.

    femur  outer solid, as it stands
    """
    table, s = build.shape.fabella, build.scale
    points = mesh_of(femur).vertices / s
    beside = points[
        (np.abs(points[:, 0] - table.x) < table.reach_mm) & (np.abs(points[:, 2] - table.z) < table.reach_mm)
    ]
    half = knee.fabella_mm / 2 * np.array(table.form)
    centre = np.array([table.x * s, beside[:, 1].max() * s + table.behind_mm + half[1], table.z * s])
    ball = Manifold.sphere(1.0, 32)
    return Bone(outer=ball.scale(half), inner=ball.scale(half - table.cortex_mm)), np.column_stack((np.eye(3), centre))
