"""Labels of a knee after surgery, without labels that implants or resections make meaningless.

A landmark remains if its positions on the bones before and after surgery are equal. The JSW of the medial or lateral
compartment is absent in a view if its contours have changed or an implant covers them. A compartment counts as replaced
if surgery has changed the contours that define its JSW. The OARSI grades of a replaced compartment and the KL grade of
the knee are absent in every view.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Manifold

from ...core.checks import Array, InputError
from ...core.label_names import TIBIAL_LANDMARKS
from ...geometry.mesh import Indices, Mesh
from ...geometry.mesh_topology import Faces, label_bodies
from ...geometry.scene import Scene, Surface
from ...geometry.view import View, project_points, resolve_view
from ...model.radiograph import Truth
from ..bones.bone_shells import Bone
from ..meshing.solids import build_solid, extract_mesh, find_closed_mesh_edges
from ..outlines.contour_landmarks import find_plateau_floor
from ..outlines.projected_contours import (
    Gap,
    compute_outline_rows,
    measure_gap,
    rotate_px,
)
from ..surgery import SurgicalMethods
from .radiograph_labels import find_widest_points_mm

SIDES = ("medial", "lateral")
# Largest difference between projected contours that are regarded as equal, in pixels.
_TOLERANCE_PX = 1e-6
# Edge length of a cube around a landmark, in mm. The landmark is absent if a surgical step intersects the cube.
_LANDMARK_BOX_MM = 0.01
# Letters that denote compartment and bone in the names of OARSI grades, such as XROSFM.
_OARSI_LETTERS = {"medial": "M", "lateral": "L", "femur": "F", "tibia": "T"}


class SurgeryNotice(UserWarning):
    """Warning for labels that are absent because implants or resections make them meaningless."""


def compute_labels_after_surgery(built: SurgicalMethods, view: View) -> Truth:
    """Compute the labels of a knee that remain valid after surgery.

    Parameters
    ----------
    built : BuiltKnee
        Knee with its surgical steps.
    view : View
        Source and detector.

    Returns
    -------
    Truth
        Labels. Labels that surgery makes meaningless are None or missing.

    Warns
    -----
    SurgeryNotice
        If a JSW value or the grade is absent.
    """
    truth, cut = _compute_labels(built, built.bones, view), _find_cut_sites(built)
    try:
        altered = _compute_labels(built, built.remaining_bones, view)
    except (ValueError, KeyError, IndexError):  # The remaining bone is too small for a contour.
        altered = replace(truth, landmarks_px={}, readings={}, jsw_at_mm={})
    replaced = find_replaced_sides(built)
    hidden = [side for side in find_lost_joint_spaces(built, view) if side not in replaced]
    _warn_absent_labels(replaced, hidden)
    lost = [*replaced, *hidden]
    return replace(
        truth,
        jsw_medial_mm=None if "medial" in lost else truth.jsw_medial_mm,
        jsw_lateral_mm=None if "lateral" in lost else truth.jsw_lateral_mm,
        jsw_at_mm={
            at: mm
            for at, mm in truth.jsw_at_mm.items()
            if SIDES[int(at > 0.5)] not in lost and _is_unchanged(mm, altered.jsw_at_mm.get(at))
        },
        attrition_mm={side: mm for side, mm in truth.attrition_mm.items() if side not in replaced},
        readings={
            name: value
            for name, value in truth.readings.items()
            if _is_unchanged(value, altered.readings.get(name)) and not _is_reading_lost(name, replaced, cut)
        },
        landmarks_px={
            name: place
            for name, place in _select_unchanged_landmarks(built, truth, altered, view, replaced).items()
            if not any(name.startswith(f"{side}_jsw_") for side in lost)
        },
        grade=None if replaced else truth.grade,
        reader_grade=None if replaced else truth.reader_grade,
    )


def find_replaced_sides(built: SurgicalMethods) -> list[str]:
    """Find the compartments in which surgery has changed the contours that define JSW.

    Parameters
    ----------
    built : BuiltKnee
        Knee with its surgical steps.

    Returns
    -------
    list of str
        ``"medial"``, ``"lateral"``, both or neither.
    """
    if not built.surgery:
        return []
    view = resolve_view(built.assembly.jsw_protocol)
    before, after = (
        _BoneContours(built, bones, view, in_leg_frame=True) for bones in (built.bones, built.remaining_bones)
    )
    return [side for side in SIDES if not before.has_same_gap(after, side)]


def find_lost_joint_spaces(built: SurgicalMethods, view: View) -> list[str]:
    """Find the compartments whose JSW cannot be measured in a view because surgery has changed or covered the contours.

    Parameters
    ----------
    built : BuiltKnee
        Knee with its surgical steps.
    view : View
        Source and detector.

    Returns
    -------
    list of str
        ``"medial"``, ``"lateral"``, both or neither; always empty for lateral and axial views.
    """
    if not built.surgery or not built.assembly.posture.is_frontal:
        return []
    before, after = (_BoneContours(built, bones, view) for bones in (built.bones, built.remaining_bones))
    implants = {step.name for step in built.surgery if step.material is not None}
    bodies_of = [surface.solid for surface in built.scene.surfaces if surface.name in implants]
    parts = [
        Mesh(solid.points, faces) for solid in bodies_of for faces in _split_into_bodies(solid.faces, len(solid.points))
    ]
    return [
        side
        for side in SIDES
        if not before.has_same_gap(after, side) or any(before.is_covered(part, side) for part in parts)
    ]


def require_visible_bone(built: SurgicalMethods, sides: list[str], what: str) -> None:
    """Raise an error if surgery has changed or covered bone that is needed for a measurement.

    Parameters
    ----------
    built : BuiltKnee
        Knee with its surgical steps.
    sides : list of str
        Compartments in which bone is changed or covered.
    what : str
        Name of the measured structure in the error message.

    Raises
    ------
    InputError
        If `sides` is not empty.
    """
    if sides:
        steps = ", ".join(step.name for step in built.surgery)
        raise InputError(
            f"{what} must be visible and unchanged by surgery, got changed or covered bone on the "
            f"{' and '.join(sides)} side after {steps}"
        )


@dataclass(frozen=True)
class _BoneContours:
    """Projected contours of the femur and tibia of a built knee, for specified bones and a view.

    If `in_leg_frame` is True, the leg is projected before it is rotated and mirrored.
    """

    built: SurgicalMethods
    bones: Mapping[str, Bone]
    view: View
    in_leg_frame: bool = False

    @property
    def medial_sign(self) -> int:
        """+1 if the medial side is towards +x, else -1."""
        return 1 if self.in_leg_frame or self.built.knee.side == "right" else -1

    @property
    def lean_deg(self) -> float:
        """Lean of the leg in the image, in degrees, clockwise positive."""
        return self.built.assembly.pose.lean_deg * self.medial_sign

    def measure_side_gap(self, side: str, *, floor: bool = False) -> Gap:
        """Measure the joint space of the medial or lateral compartment.

        If `floor` is True, the gap extends to the floor of the plateau, as readers measure it.
        """
        meshes = [extract_mesh(self.bones[name].outer) for name in ("femur", "tibia")]
        femur, tibia = meshes if self.in_leg_frame else map(self.built.assembly.orient_mesh, meshes)
        sign = self.medial_sign if side == "medial" else -self.medial_sign
        upper = (
            find_plateau_floor(tibia, self.view, self.medial_sign, self.lean_deg)
            if floor
            else _list_vertices_and_edges(tibia)
        )
        half = self.built.assembly.bone_parameters.half_ml_mm
        return measure_gap(_list_vertices_and_edges(femur), upper, self.view, sign, half, self.lean_deg)

    def has_same_gap(self, other: "_BoneContours", side: str) -> bool:
        """Test whether the joint space contours of a compartment are equal for two sets of bones."""
        for floor in {False, self.built.knee.jsw_definition == "read"}:
            try:
                one, two = (contours.measure_side_gap(side, floor=floor) for contours in (self, other))
            except (ValueError, IndexError):  # The remaining bone is too small for a contour.
                return False
            for first, second in ((one.femur_px, two.femur_px), (one.tibia_px, two.tibia_px)):
                if not np.allclose(first, second, rtol=0, atol=_TOLERANCE_PX):
                    return False
        return True

    def is_covered(self, body: Mesh, side: str) -> bool:
        """Test whether a connected component of an implant covers the medial or lateral joint space.

        `body` is the surface of the component in the frame of the view, in mm.
        """
        gap = self.measure_side_gap(side)
        finer = round(1 / (gap.columns_px[1] - gap.columns_px[0]))
        seen = rotate_px(project_points(body.vertices, self.view), self.view, -self.lean_deg) * (1, finer)
        first, edges = round(gap.columns_px[0] * finer), find_closed_mesh_edges(body.faces)
        low, high = (compute_outline_rows(seen, edges, first, len(gap.columns_px), end) for end in (1.0, -1.0))
        return bool(((low > gap.femur_px) & (high < gap.tibia_px)).any())


def _compute_labels(built: SurgicalMethods, bones: Mapping[str, Bone], view: View) -> Truth:
    """Compute the labels of a knee after replacing its bones by other bones."""
    outer = {name: built.assembly.orient_mesh(extract_mesh(bones[name].outer)) for name in ("femur", "tibia")}
    scene = Scene([Surface(mesh, "cortical_bone", "muscle", name) for name, mesh in outer.items()])
    return built.compute_labels(scene, dict(bones), view)


def _select_unchanged_landmarks(
    built: SurgicalMethods, truth: Truth, altered: Truth, view: View, replaced: list[str]
) -> dict[str, tuple[float, float]]:
    """Select the landmarks whose positions are the same before and after surgery.

    A plateau that is replaced on both sides has no landmarks, even if a fragment of a spine remains.
    """
    gone = set(TIBIAL_LANDMARKS if len(replaced) == len(SIDES) else ())
    if built.assembly.posture.is_frontal:
        # The widest points are measured on the bones before surgery, so their positions are tested against the surgical
        # steps.
        for name, place_mm in find_widest_points_mm(built.knee, built.assembly, view).items():
            about = Manifold.cube((_LANDMARK_BOX_MM,) * 3, True).translate(tuple(place_mm))
            if any(not (about ^ step.solid).is_empty() for step in built.surgery):
                gone.add(name)
    others = {name: place for name, place in altered.landmarks_px.items() if name not in gone}
    return {
        name: place
        for name, place in truth.landmarks_px.items()
        if name in others and np.allclose(place, others[name], rtol=0, atol=_TOLERANCE_PX)
    }


def _find_cut_sites(built: SurgicalMethods) -> set[str]:
    """Find the osteophytes and cysts that surgery has cut.

    Their names are ``<site>_osteophyte`` and ``<site>_cyst``.
    """
    cut = set()
    for kind, meshes in (("osteophyte", built.osteophyte_meshes()), ("cyst", built.cyst_meshes())):
        for site, mesh in meshes.items():
            if not len(mesh.faces):  # The mesh of an osteophyte that does not protrude from its bone has no faces.
                continue
            whole = build_solid(mesh.vertices, mesh.faces, f"{site}_{kind}")
            if any(not (whole ^ step.solid).is_empty() for step in built.surgery):
                cut.add(f"{site}_{kind}")
    return cut


def _is_reading_lost(name: str, replaced: list[str], cut_sites: set[str]) -> bool:
    """Test whether surgery makes an OARSI grade meaningless."""
    if name == "XRKL" and replaced:
        return True
    # The last letter of the name of an OARSI grade denotes the compartment: XROSFM grades the osteophytes of the medial
    # femur.
    of_side = {_OARSI_LETTERS[side] for side in replaced}
    if name.startswith("XR") and name != "XRKL" and name[-1] in of_side:
        return True
    names = set()
    for site in cut_sites:
        side, bone, kind = site.split("_")
        if side in SIDES and bone in ("femur", "tibia"):
            names.add(f"XR{'OS' if kind == 'osteophyte' else 'CY'}{_OARSI_LETTERS[bone]}{_OARSI_LETTERS[side]}")
    return name in names


def _is_unchanged(value: float, other: float | None) -> bool:
    """Test whether two values exist and are equal within the tolerance."""
    return other is not None and bool(np.isclose(value, other, rtol=0, atol=_TOLERANCE_PX))


def _list_vertices_and_edges(mesh: Mesh) -> tuple[Array, Indices]:
    """Return the vertices (n, 3) and edges (m, 2) of a closed mesh."""
    return mesh.vertices, find_closed_mesh_edges(mesh.faces)


def _split_into_bodies(faces: Faces, count: int) -> list[Faces]:
    """Split the faces (m, 3) of a mesh with `count` vertices into connected components."""
    body, number = label_bodies(faces, count)
    return [faces[body[faces[:, 0]] == one] for one in range(number)]


def _warn_absent_labels(replaced: list[str], hidden: list[str]) -> None:
    """Warn about labels that are absent in replaced compartments and in compartments that an implant covers."""
    if replaced:
        sides = f"the {' and '.join(replaced)} joint contours"
        message = f"surgery replaces {sides}; their JSW and OARSI grades and the KL grade are absent from the labels"
        warnings.warn(f"{message}; use knee.jsw_{replaced[0]}_mm for the specified JSW", SurgeryNotice, stacklevel=4)
    if hidden:
        what = " and ".join(hidden)
        message = f"an implant covers the {what} joint space in this view; the labels have no JSW of this joint space"
        warnings.warn(
            f"{message}; to measure the JSW, move the implant or change the view", SurgeryNotice, stacklevel=4
        )
