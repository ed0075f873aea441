"""Fibula, patella and fabella of a right knee, beside the bones that they lie on."""

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold
from scipy.interpolate import LinearNDInterpolator, PchipInterpolator
from scipy.optimize import brentq

from ..core.checks import Array, InputError
from ..data.bones import PatellaShape
from ..geometry.freeform import displaced
from ..model.knee import Knee
from .bone_build import Build, eased, formed, scaled
from .bones import SHAFT_END_MM, Bone, levels
from .implicit import lengths
from .pose import Pose, rotation
from .solids import box_about, checked, column, mesh_of, thickness

# Straight shafts and what trabeculae blur are drawn with fewer triangles, within this.
_COARSER_MM = 0.02
# Of the patella's sections, and between them.
_PATELLA_COUNT, _PATELLA_STEP_MM = 64, 1.25
# Of its cortex upwards and downwards: the least, and at either end.
_DRAWN_IN_MM, _END_CORTEX_MM = 0.1, 0.4
# Of the fibula, towards the tibia; and of the tip of its head.
_JOINT_PLATE_MM = 0.7
_TIP_MM = 0.3
# Its head, where it bends most, ends so far below.
_HEAD_MM = 40.0
# What of the tibia is farther from the fibula than this takes nothing of it.
_NEAR_FIBULA_MM = 5.0
# Of the fibula, from here on it leans with the tibia's shaft (mean man's size).
_FIBULA_LEANS_BELOW_MM = -25.0
# The part of the femur that a patella can lie on, what of it faces the front: as much as the sides of the trochlea, and
# by how much that is broader than the patella.
_FRONT_BELOW_MM, _FACES_FRONT, _BESIDE_MM = 90.0, 0.3, 6.0
# The gap to the femur is that at so small a share of the patella's places, and at none less than such a share of it.
_NEAR_SHARE, _LEAST_SHARE = 0.1, 0.6
# Of its flexion the knee keeps so large a share from the patella, which flexes by two thirds (judgement).
_LAG = 0.35
# The patella's height is looked for downwards in such steps, and found to this.
_STEP_MM, _HEIGHT_MM = 4.0, 1e-3
# Places of a patella's back that are held against the femur; of them at most such a share may have no femur behind it.
_PLACES, _MOST_BESIDE = 500, 0.9


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
    top_mm = sections[:, 0].max()
    down = -knee.fibular_tip_mm - top_mm
    shaft, head = levels(-SHAFT_END_MM - down, top_mm - _HEAD_MM, 4.0), levels(top_mm - _HEAD_MM, top_mm, 1.5)
    heights = np.sort(np.concatenate((shaft[:-1], head, [top_mm - _TIP_MM])))
    # Rings at the same heights, so that between them too the inner loft lies within the outer one.
    within = heights[(heights > heights[0] + 1.4) & (heights < heights[-1])]
    outer, inner = (
        column(sections, inset, rings, "fibula", count=64).simplify(tolerance).translate((*sideways[:2], down))
        for inset, rings, tolerance in ((np.zeros_like, heights, _COARSER_MM / 2), (cortex, within, _COARSER_MM))
    )
    near = (tibia ^ box_about(outer, _NEAR_FIBULA_MM)).trim_by_plane((0.0, 0.0, -1.0), knee.fibular_tip_mm - 5.0)
    towards = np.array(table.faces) / np.linalg.norm(table.faces)
    # Simplified before they are cut: in the sharp edge that the cut leaves there is no room for it.
    return Bone(
        # Without the tibia itself too: a lip of it may be thinner than the gap.
        outer=checked(outer - near.translate(-table.gap_to_tibia_mm * towards) - near, "fibula"),
        inner=checked(inner - near.translate(-(table.gap_to_tibia_mm + _JOINT_PLATE_MM) * towards), "fibula marrow"),
    )


def patella(build: Build) -> Bone:
    """Patella about its middle."""
    table, s = build.shape.patella, build.scale
    drawn_in = _drawn_in_mm(table, thickness(table.cortex, build.cortex))
    low, high = min(table.sections)[0], max(table.sections)[0]
    # Rings of both at the same heights, so that between them too the inner loft lies within the outer one.
    within = levels(low + _END_CORTEX_MM, high - _END_CORTEX_MM, _PATELLA_STEP_MM)
    outer = _patella_column(table, np.zeros_like, np.array([low, *within, high]), "patella")
    inner = _patella_column(table, drawn_in, within, "patella marrow")

    def formed_as(solid: Manifold) -> Manifold:
        middle = np.array(table.centre_mm)
        return solid.warp_batch(lambda points: (displaced(np.array(points) + middle, build.patella) - middle) * s)

    # Simplified only when they are deformed: flat places do not stay flat.
    return Bone(
        outer=checked(formed_as(outer).simplify(_COARSER_MM), "patella"),
        inner=checked(formed_as(inner).simplify(_COARSER_MM), "patella marrow"),
    )


def _drawn_in_mm(table: PatellaShape, cortex: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """What is taken off a patella's sections by height: its cortex, and more where the outline is all but level.

    There little is left above and below of what is drawn in sideways.
    """
    rows = scaled(table.sections, 1.0)
    rows = rows[np.argsort(rows[:, 0])]
    outline = PchipInterpolator(rows[:, 0], rows[:, 1:])

    def inset(z_mm: Array) -> Array:
        here, taken_mm = outline(z_mm), cortex(z_mm)
        for way in (-_DRAWN_IN_MM, _DRAWN_IN_MM):
            change = outline(z_mm + way) - here
            # Of either half width, and of the middle along the same axis, whose columns are the other way round.
            less_mm = np.abs(change[:, [3, 2]]) - change[:, :2]
            taken_mm = np.maximum(taken_mm, less_mm.max(axis=1))
        return taken_mm

    return inset


def _patella_column(table: PatellaShape, inset: Callable[[Array], Array], heights: Array, name: str) -> Manifold:
    return column(scaled(table.sections, 1.0), inset, heights, name, 2.1, _PATELLA_COUNT)


def patella_place(knee: Knee, build: Build, patella: Manifold, femur: Manifold, pose: Pose) -> Array:
    """(3, 4)  transform of the patella from its own frame into the femur's.

    Its tendon is as long as the Insall-Salvati index says, and cartilage of both bones fills what is between it and the
    femur, front to back as it faces.
    patella, femur  outer solids, the femur's as it stands
    raises          InputError where it would lie off the femur
    """
    table, s = build.shape.patella, build.scale
    tilt = rotation(2, -knee.patellar_tilt_deg)
    points = mesh_of(patella).vertices @ tilt.T
    apex, tendon_mm = points[:, 2].argmin(), knee.insall_salvati * np.ptp(points[:, 2])
    # All is worked out as the patella faces: with axes parallel to its own, and the femur's origin.
    facing, to_leg = rotation(0, -_LAG * pose.flexion_deg), pose.femur_on_tibia()
    below = np.array(build.shape.patellar_tendon.tuberosity) * s + [0.0, 0.0, table.tendon_end_mm * s]
    below = facing @ to_leg[:, :3].T @ (below - to_leg[:, 3])
    across = formed(np.array([[0.0, 0.0, 20.0]]), build.femur)[0, 0] * s - knee.patellar_shift_mm
    front = _front(femur, facing, across + np.array([points[:, 0].min() - _BESIDE_MM, points[:, 0].max() + _BESIDE_MM]))
    behind = points[points[:, 1] > np.median(points[:, 1])]
    behind = behind[:: max(1, len(behind) // _PLACES)]

    def depth_mm(height_mm: float) -> float:
        """Where the patella is front to back, at a height."""
        # The space between them, nan beside the femur; where they are closest cartilage is thinner.
        space = front((behind + np.array([across, 0.0, height_mm]))[:, [0, 2]]) - behind[:, 1]
        if np.isnan(space).mean() > _MOST_BESIDE:
            raise InputError(
                f"flexion = {pose.flexion_deg:g} deg with insall_salvati = {knee.insall_salvati:g}: the patella lies "
                "off the femur; allowed: less flexion, or a longer tendon"
            )
        near = float(np.nanquantile(space, _NEAR_SHARE))
        return min(near - table.gap_to_femur_mm, float(np.nanmin(space)) - table.gap_to_femur_mm * _LEAST_SHARE)

    def too_far_mm(height_mm: float) -> float:
        """By how much the apex is farther from the tuberosity than the tendon is long."""
        forward = points[apex, 1] + depth_mm(height_mm) - below[1]
        return float(np.hypot(forward, points[apex, 2] + height_mm - below[2]) - tendon_mm)

    high = below[2] + tendon_mm - points[apex, 2]
    while too_far_mm(high - _STEP_MM) > 0:
        high -= _STEP_MM
    height_mm = brentq(too_far_mm, high - _STEP_MM, high + _HEIGHT_MM, xtol=_HEIGHT_MM)
    place = np.array([across, depth_mm(height_mm), height_mm])
    return np.column_stack((facing.T @ tilt, facing.T @ place))


def _front(femur: Manifold, facing: Array, between_mm: Array) -> LinearNDInterpolator:
    """(n, 2) x and z -> (n,) y  of the front of a femur that is turned, between two places (2,) in x, mm"""
    mesh = mesh_of(femur)
    faces = mesh.faces[mesh.vertices[mesh.faces[:, 0], 2] < _FRONT_BELOW_MM]
    first, second, third = (mesh.vertices @ facing.T)[faces.T]
    normals = np.cross(second - first, third - first)
    faces_front = normals[:, 1] < -_FACES_FRONT * lengths(normals)
    points = ((first + second + third) / 3)[faces_front]
    points = points[(points[:, 0] > between_mm[0]) & (points[:, 0] < between_mm[1])]
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
