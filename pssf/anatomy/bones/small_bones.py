"""Small bones of a right knee: fibula, patella and fabella, placed relative to femur and tibia."""

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold
from scipy.interpolate import LinearNDInterpolator, PchipInterpolator
from scipy.optimize import brentq

from ...core.checks import Array, InputError
from ...data.anatomy.bone_tables import PatellaShape
from ...geometry.freeform_deformation import displace_points
from ...model.knee import Knee
from ..meshing.implicit_shapes import lengths
from ..meshing.rigid_pose import Pose, rotation_matrix
from ..meshing.solids import (
    build_bounding_box,
    extract_mesh,
    loft_column,
    make_thickness_profile,
    require_valid_solid,
)
from ..template.bone_builder import (
    BoneParameters,
    deform_template_points,
    scale_sections,
    smooth_ramp_mm,
)
from .bone_shells import SHAFT_END_MM, Bone, space_ring_heights

# Largest distance by which simplification moves a surface, in mm. It applies to straight shafts, and to solids whose
# surfaces are blurred by trabeculae in the radiograph.
_SIMPLIFY_TOLERANCE_MM = 0.02
# Number of points per ring of the patella.
_PATELLA_COUNT = 64
# Distance between two rings of the patella, mm.
_PATELLA_STEP_MM = 1.25
# Smallest vertical thickness of the patellar cortex, in mm.
_DRAWN_IN_MM = 0.1
# Vertical thickness of the cortex at the upper and lower end of the patella, mm.
_END_CORTEX_MM = 0.4
# Thickness of the subchondral bone plate of the fibula at the tibia, in mm.
_JOINT_PLATE_MM = 0.7
# Thickness of the cortex at the tip of the fibular head, mm.
_TIP_CORTEX_MM = 0.3
# Length of the fibular head, in mm. The head is strongly curved, so the distance between its rings is smaller than in
# the shaft.
_HEAD_LENGTH_MM = 40.0
# Tibial bone within this margin around the fibula is subtracted from the fibula, in mm.
_NEAR_FIBULA_MM = 5.0
# Height below which the fibula leans together with the tibial shaft, in mm at template size.
_FIBULA_LEANS_BELOW_MM = -25.0
# Height below which the femur can support the patella, in mm.
_FRONT_BELOW_MM = 90.0
# Smallest anterior component of the unit normal of a supporting face, dimensionless. The limit includes the sides of
# the trochlea.
_FACES_FRONT = 0.3
# Width of the supporting surface beyond the medial and lateral edges of the patella, in mm.
_BESIDE_MM = 6.0
# Quantile of the gaps between patellar points and the femur that equals the nominal gap, dimensionless.
_NEAR_SHARE = 0.1
# Smallest gap between a patellar point and the femur, as a fraction of the nominal gap.
_LEAST_SHARE = 0.6
# Fraction of the knee flexion that the patella does not follow (assumed). The patella therefore flexes by about two
# thirds of the knee flexion.
_PATELLAR_LAG_FRACTION = 0.35
# Step of the downward search for the height of the patella, mm.
_STEP_MM = 4.0
# Tolerance of the height of the patella, mm.
_HEIGHT_MM = 1e-3
# Approximate number of points on the posterior surface of the patella that are compared with the femur.
_PLACES = 500
# Largest fraction of the compared patellar points that may have no femur behind them.
_MOST_BESIDE = 0.9


def build_fibula(knee: Knee, bone_parameters: BoneParameters, tibia: Manifold) -> Bone:
    """Build the fibula, and remove the volume of the tibia and of a gap around the tibia.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee; `fibular_tip_mm` is the depth of the tip below the plateau.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    tibia : Manifold
        Outer solid of the tibia in its own frame, in mm.

    Returns
    -------
    Bone
        Solids in the frame of the tibia, in mm.

    Raises
    ------
    InputError
        If a solid is not valid.
    """
    table, s = bone_parameters.shape.fibula, bone_parameters.scale
    sections = scale_sections(table.sections, s)
    sections[:, 4] += np.tan(np.deg2rad(bone_parameters.tibia_varus_deg)) * smooth_ramp_mm(
        _FIBULA_LEANS_BELOW_MM * s - sections[:, 0]
    )
    cortex = make_thickness_profile(scale_sections(table.cortex, s), bone_parameters.cortex_scale)
    # The fibula is shifted together with the proximal tibiofibular joint of the deformed tibia.
    joint = np.array([table.joint_mm])
    sideways = ((deform_template_points(joint, bone_parameters.tibia) - joint) * s)[0]
    top_mm = sections[:, 0].max()
    down = -knee.fibular_tip_mm - top_mm
    shaft, head = (
        space_ring_heights(-SHAFT_END_MM - down, top_mm - _HEAD_LENGTH_MM, 4.0),
        space_ring_heights(top_mm - _HEAD_LENGTH_MM, top_mm, 1.5),
    )
    heights = np.sort(np.concatenate((shaft[:-1], head, [top_mm - _TIP_CORTEX_MM])))
    # The rings of both lofts have the same heights, so the inner loft is inside the outer loft between the rings too.
    within = heights[(heights > heights[0] + 1.4) & (heights < heights[-1])]
    outer, inner = (
        loft_column(sections, inset, rings, "fibula", count=64).simplify(tolerance).translate((*sideways[:2], down))
        for inset, rings, tolerance in (
            (np.zeros_like, heights, _SIMPLIFY_TOLERANCE_MM / 2),
            (cortex, within, _SIMPLIFY_TOLERANCE_MM),
        )
    )
    near = (tibia ^ build_bounding_box(outer, _NEAR_FIBULA_MM)).trim_by_plane(
        (0.0, 0.0, -1.0), knee.fibular_tip_mm - 5.0
    )
    towards = np.array(table.faces) / np.linalg.norm(table.faces)
    # Both lofts are simplified before the cut, because simplification would damage the sharp edge of the cut.
    return Bone(
        # The unshifted tibia is also subtracted, because a tibial osteophyte may be thinner than the gap.
        outer=require_valid_solid(outer - near.translate(-table.gap_to_tibia_mm * towards) - near, "fibula"),
        inner=require_valid_solid(
            inner - near.translate(-(table.gap_to_tibia_mm + _JOINT_PLATE_MM) * towards), "fibula marrow"
        ),
    )


def build_patella(bone_parameters: BoneParameters) -> Bone:
    """Build the patella in its own frame.

    Parameters
    ----------
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.

    Returns
    -------
    Bone
        Solids in the frame of the patella, whose origin is the centre of the patella, in mm.

    Raises
    ------
    InputError
        If a solid is not valid.
    """
    table, s = bone_parameters.shape.patella, bone_parameters.scale
    drawn_in = _make_patella_inset(table, make_thickness_profile(table.cortex, bone_parameters.cortex_scale))
    low, high = min(table.sections)[0], max(table.sections)[0]
    # The rings of both lofts have the same heights, so the inner loft is inside the outer loft between the rings too.
    within = space_ring_heights(low + _END_CORTEX_MM, high - _END_CORTEX_MM, _PATELLA_STEP_MM)
    outer = _loft_patella(table, np.zeros_like, np.array([low, *within, high]), "patella")
    inner = _loft_patella(table, drawn_in, within, "patella marrow")

    def formed_as(solid: Manifold) -> Manifold:
        middle = np.array(table.centre_mm)
        return solid.warp_batch(
            lambda points: (displace_points(np.array(points) + middle, bone_parameters.patella) - middle) * s
        )

    # The lofts are simplified after the deformation, because the deformation bends flat regions.
    return Bone(
        outer=require_valid_solid(formed_as(outer).simplify(_SIMPLIFY_TOLERANCE_MM), "patella"),
        inner=require_valid_solid(formed_as(inner).simplify(_SIMPLIFY_TOLERANCE_MM), "patella marrow"),
    )


def _make_patella_inset(table: PatellaShape, cortex: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Make a function that maps heights (n,), in mm, to insets (n,) of patellar sections, in mm.

    The inset is at least the cortical thickness. It is larger where the outline is nearly horizontal, because a
    horizontal inset leaves little cortex above and below the trabecular bone there.
    """
    rows = scale_sections(table.sections, 1.0)
    rows = rows[np.argsort(rows[:, 0])]
    outline = PchipInterpolator(rows[:, 0], rows[:, 1:])

    def inset(z_mm: Array) -> Array:
        here, taken_mm = outline(z_mm), cortex(z_mm)
        for way in (-_DRAWN_IN_MM, _DRAWN_IN_MM):
            change = outline(z_mm + way) - here
            # Each half width must be compared with the centre on the same axis, so the two centre columns are read in
            # reverse order.
            less_mm = np.abs(change[:, [3, 2]]) - change[:, :2]
            taken_mm = np.maximum(taken_mm, less_mm.max(axis=1))
        return taken_mm

    return inset


def _loft_patella(table: PatellaShape, inset: Callable[[Array], Array], heights: Array, name: str) -> Manifold:
    """Build a loft through the patellar sections after an inset has reduced their widths."""
    return loft_column(scale_sections(table.sections, 1.0), inset, heights, name, 2.1, _PATELLA_COUNT)


def place_patella(knee: Knee, bone_parameters: BoneParameters, patella: Manifold, femur: Manifold, pose: Pose) -> Array:
    """Compute the position of the patella in front of the femur.

    The Insall-Salvati index determines the length of the patellar tendon. The cartilage of both bones fills the gap
    between patella and femur, which is measured along the antero-posterior axis of the patella.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee: Insall-Salvati index, patellar shift and tilt.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    patella : Manifold
        Outer solid of the patella in its own frame, in mm.
    femur : Manifold
        Outer solid of the femur in its own frame, in mm.
    pose : Pose
        Pose of the leg.

    Returns
    -------
    (3, 4) float64 array
        Transform from the frame of the patella to the frame of the femur: rotation and translation (mm).

    Raises
    ------
    InputError
        If the patella would not rest on the femur.
    """
    table, s = bone_parameters.shape.patella, bone_parameters.scale
    tilt = rotation_matrix(2, -knee.patellar_tilt_deg)
    points = extract_mesh(patella).vertices @ tilt.T
    apex, tendon_mm = points[:, 2].argmin(), knee.insall_salvati * np.ptp(points[:, 2])
    # Positions are in a frame with the axes of the patella and the origin of the femur.
    facing, to_leg = rotation_matrix(0, -_PATELLAR_LAG_FRACTION * pose.flexion_deg), pose.femur_to_tibia_transform()
    below = np.array(bone_parameters.shape.patellar_tendon.tuberosity) * s + [0.0, 0.0, table.tendon_end_mm * s]
    below = facing @ to_leg[:, :3].T @ (below - to_leg[:, 3])
    across = (
        deform_template_points(np.array([[0.0, 0.0, 20.0]]), bone_parameters.femur)[0, 0] * s - knee.patellar_shift_mm
    )
    front = _fit_femur_front(
        femur, facing, across + np.array([points[:, 0].min() - _BESIDE_MM, points[:, 0].max() + _BESIDE_MM])
    )
    behind = points[points[:, 1] > np.median(points[:, 1])]
    behind = behind[:: max(1, len(behind) // _PLACES)]

    def depth_mm(height_mm: float) -> float:
        """Compute the antero-posterior position of the patella at a height, in mm."""
        # The gap is nan where no femur is behind the patella. The cartilage may be thinner where the gap is smallest.
        space = front((behind + np.array([across, 0.0, height_mm]))[:, [0, 2]]) - behind[:, 1]
        if np.isnan(space).mean() > _MOST_BESIDE:
            raise InputError(
                f"flexion must allow contact of patella and femur, got {pose.flexion_deg:g} deg with insall_salvati = "
                f"{knee.insall_salvati:g}: reduce the flexion or increase insall_salvati"
            )
        near = float(np.nanquantile(space, _NEAR_SHARE))
        return min(near - table.gap_to_femur_mm, float(np.nanmin(space)) - table.gap_to_femur_mm * _LEAST_SHARE)

    def too_far_mm(height_mm: float) -> float:
        """Compute the difference between the apex-tuberosity distance and the tendon length, in mm."""
        forward = points[apex, 1] + depth_mm(height_mm) - below[1]
        return float(np.hypot(forward, points[apex, 2] + height_mm - below[2]) - tendon_mm)

    high = below[2] + tendon_mm - points[apex, 2]
    while too_far_mm(high - _STEP_MM) > 0:
        high -= _STEP_MM
    height_mm = brentq(too_far_mm, high - _STEP_MM, high + _HEIGHT_MM, xtol=_HEIGHT_MM)
    place = np.array([across, depth_mm(height_mm), height_mm])
    return np.column_stack((facing.T @ tilt, facing.T @ place))


def _fit_femur_front(femur: Manifold, facing: Array, between_mm: Array) -> LinearNDInterpolator:
    """Fit the anterior surface of the rotated femur: y as a function of x and z, in mm.

    `between_mm` (2,) is the range of x in which the surface is fitted.
    """
    mesh = extract_mesh(femur)
    faces = mesh.faces[mesh.vertices[mesh.faces[:, 0], 2] < _FRONT_BELOW_MM]
    first, second, third = (mesh.vertices @ facing.T)[faces.T]
    normals = np.cross(second - first, third - first)
    faces_front = normals[:, 1] < -_FACES_FRONT * lengths(normals)
    points = ((first + second + third) / 3)[faces_front]
    points = points[(points[:, 0] > between_mm[0]) & (points[:, 0] < between_mm[1])]
    return LinearNDInterpolator(points[:, [0, 2]], points[:, 1])


def build_fabella(knee: Knee, bone_parameters: BoneParameters, femur: Manifold) -> tuple[Bone, Array]:
    """Build the fabella and place it behind the lateral condyle.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee; `fabella_mm` is the size of the fabella.
    bone_parameters : BoneParameters
        Parameters of the bones of the knee.
    femur : Manifold
        Outer solid of the femur in its own frame, in mm.

    Returns
    -------
    fabella : Bone
        Solids of the fabella in its own frame, with its centre as the origin, in mm.
    transform : (3, 4) float64 array
        Transform from the frame of the fabella to the frame of the femur: rotation and translation (mm).
    """
    table, s = bone_parameters.shape.fabella, bone_parameters.scale
    points = extract_mesh(femur).vertices / s
    beside = points[
        (np.abs(points[:, 0] - table.x) < table.reach_mm) & (np.abs(points[:, 2] - table.z) < table.reach_mm)
    ]
    half = knee.fabella_mm / 2 * np.array(table.form)
    centre = np.array([table.x * s, beside[:, 1].max() * s + table.behind_mm + half[1], table.z * s])
    ball = Manifold.sphere(1.0, 32)
    return Bone(outer=ball.scale(half), inner=ball.scale(half - table.cortex_mm)), np.column_stack((np.eye(3), centre))
