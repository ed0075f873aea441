"""Labels of a knee after surgery: what its implants and resections have made meaningless is left out.

A landmark stays where the bones that are left give the same place as the whole ones. The joint space of a side is left
out in a view in which its contours have changed, or in which an implant lies over them. A side is replaced where the
contours that its joint space is defined on have changed; its readings and the grade of the knee are then left out in
every view.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array, InputError
from ..geometry.mesh import Indices, Mesh
from ..geometry.scene import Scene, Surface
from ..geometry.topology import Faces, bodies
from ..geometry.view import View, project, view_of
from ..model.radiograph import Truth
from .bones import Bone
from .contours import Gap, envelope, measure_gap, turned_px
from .landmarks import plateau_floor
from .solids import closed_edges, mesh_of, solid_of
from .truth import widest

if TYPE_CHECKING:
    from .built import BuiltKnee

SIDES = ("medial", "lateral")
# Contours within this of each other on the detector are the same.
_SAME_PX = 1e-6
# A place of a bone is gone if a surgical step meets a box of this size about it.
_PLACE_MM = 0.01
_LETTERS = {"medial": "M", "lateral": "L", "femur": "F", "tibia": "T"}


class SurgeryNotice(UserWarning):
    """Labels of a radiograph are absent, since implants or resections have made them meaningless."""


def surviving_labels(built: "BuiltKnee", view: View) -> Truth:
    """The labels of a knee that are still true after its surgery, in a view of its scene.

    warns  SurgeryNotice where a joint space or the grade is left out
    """
    truth, cut = _labels(built, built.bones, view), _cut_sites(built)
    try:
        altered = _labels(built, built.bones_left, view)
    except (ValueError, KeyError, IndexError):  # so little bone is left that a contour has no places
        altered = replace(truth, landmarks_px={}, readings={}, jsw_at_mm={})
    replaced = replaced_sides(built)
    hidden = [side for side in lost_joint_spaces(built, view) if side not in replaced]
    _notify(replaced, hidden)
    lost = [*replaced, *hidden]
    return replace(
        truth,
        jsw_medial_mm=None if "medial" in lost else truth.jsw_medial_mm,
        jsw_lateral_mm=None if "lateral" in lost else truth.jsw_lateral_mm,
        jsw_at_mm={
            at: mm
            for at, mm in truth.jsw_at_mm.items()
            if SIDES[int(at > 0.5)] not in lost and _same(mm, altered.jsw_at_mm.get(at))
        },
        attrition_mm={side: mm for side, mm in truth.attrition_mm.items() if side not in replaced},
        readings={
            name: value
            for name, value in truth.readings.items()
            if _same(value, altered.readings.get(name)) and not _is_lost(name, replaced, cut)
        },
        landmarks_px={
            name: place
            for name, place in _same_places(built, truth, altered, view).items()
            if not any(name.startswith(f"{side}_jsw_") for side in lost)
        },
        grade=None if replaced else truth.grade,
        grade_read=None if replaced else truth.grade_read,
    )


def replaced_sides(built: "BuiltKnee") -> list[str]:
    """Sides on which surgery has changed the contours that joint space is defined on."""
    if not built.surgery:
        return []
    view = view_of(built.assembly.defined_under)
    before, after = (_Contours(built, bones, view, in_leg=True) for bones in (built.bones, built.bones_left))
    return [side for side in SIDES if not before.alike(after, side)]


def lost_joint_spaces(built: "BuiltKnee", view: View) -> list[str]:
    """Sides whose joint space a view does not show, since surgery has changed its contours or covers them."""
    if not built.surgery or not built.assembly.posture.is_frontal:
        return []
    before, after = (_Contours(built, bones, view) for bones in (built.bones, built.bones_left))
    implants = {step.name for step in built.surgery if step.material is not None}
    bodies_of = [surface.solid for surface in built.scene.surfaces if surface.name in implants]
    parts = [Mesh(solid.points, faces) for solid in bodies_of for faces in _connected(solid.faces, len(solid.points))]
    return [
        side for side in SIDES if not before.alike(after, side) or any(before.is_covered(part, side) for part in parts)
    ]


def require_bone(built: "BuiltKnee", sides: list[str], what: str) -> None:
    """Refuse a measurement between bones on sides where surgery has changed or covered them.

    raises  InputError
    """
    if sides:
        steps = ", ".join(step.name for step in built.surgery)
        raise InputError(f"{what} must be of bones that are seen, got {' and '.join(sides)} after {steps}")


@dataclass(frozen=True)
class _Contours:
    """Femur and tibia of a built knee with these bones, as a view sees them.

    in_leg  whether the view is of the leg as it stands, before it is turned and mirrored
    """

    built: "BuiltKnee"
    bones: Mapping[str, Bone]
    view: View
    in_leg: bool = False

    @property
    def medial(self) -> int:
        """Direction of x in which medial is."""
        return 1 if self.in_leg or self.built.knee.side == "right" else -1

    @property
    def lean_deg(self) -> float:
        """Return the lean of the leg on the detector, in degrees."""
        return self.built.assembly.pose.lean_deg * self.medial

    def gap(self, side: str, *, floor: bool = False) -> Gap:
        """The joint space of a side; with `floor` down to the plateau's floor, as readers take it."""
        meshes = [mesh_of(self.bones[name].outer) for name in ("femur", "tibia")]
        femur, tibia = meshes if self.in_leg else map(self.built.assembly.mirrored, meshes)
        sign = self.medial if side == "medial" else -self.medial
        upper = plateau_floor(tibia, self.view, self.medial, self.lean_deg) if floor else _with_edges(tibia)
        half = self.built.assembly.build.half_ml_mm
        return measure_gap(_with_edges(femur), upper, self.view, sign, half, self.lean_deg)

    def alike(self, other: "_Contours", side: str) -> bool:
        """Tell whether both have the same contours along the joint space of a side."""
        for floor in {False, self.built.knee.jsw_as == "read"}:
            try:
                one, two = (contours.gap(side, floor=floor) for contours in (self, other))
            except (ValueError, IndexError):  # so little bone is left that a contour has no places
                return False
            for first, second in ((one.femur_px, two.femur_px), (one.tibia_px, two.tibia_px)):
                if not np.allclose(first, second, rtol=0, atol=_SAME_PX):
                    return False
        return True

    def is_covered(self, body: Mesh, side: str) -> bool:
        """Tell whether a connected body, in the frame of the view, covers the joint space of a side."""
        gap = self.gap(side)
        finer = round(1 / (gap.columns_px[1] - gap.columns_px[0]))
        seen = turned_px(project(body.vertices, self.view), self.view, -self.lean_deg) * (1, finer)
        first, edges = round(gap.columns_px[0] * finer), closed_edges(body.faces)
        low, high = (envelope(seen, edges, first, len(gap.columns_px), end) for end in (1.0, -1.0))
        return bool(((low > gap.femur_px) & (high < gap.tibia_px)).any())


def _labels(built: "BuiltKnee", bones: Mapping[str, Bone], view: View) -> Truth:
    """Labels of a knee with these bones."""
    outer = {name: built.assembly.mirrored(mesh_of(bones[name].outer)) for name in ("femur", "tibia")}
    scene = Scene([Surface(mesh, "cortical_bone", "muscle", name) for name, mesh in outer.items()])
    return built.labels_of(scene, dict(bones), view)


def _same_places(built: "BuiltKnee", truth: Truth, altered: Truth, view: View) -> dict[str, tuple[float, float]]:
    """Landmarks whose place on the bones is still there."""
    gone = set()
    if built.assembly.posture.is_frontal:
        # These are of the bones without their osteophytes, which surgery does not change: their places are asked for.
        for name, place_mm in widest(built.knee, built.assembly, view).items():
            about = Manifold.cube((_PLACE_MM,) * 3, True).translate(tuple(place_mm))
            if any(not (about ^ step.solid).is_empty() for step in built.surgery):
                gone.add(name)
    others = {name: place for name, place in altered.landmarks_px.items() if name not in gone}
    return {
        name: place
        for name, place in truth.landmarks_px.items()
        if name in others and np.allclose(place, others[name], rtol=0, atol=_SAME_PX)
    }


def _cut_sites(built: "BuiltKnee") -> set[str]:
    """Sites whose osteophyte or cyst surgery has taken part of."""
    cut = set()
    for kind, meshes in (("osteophyte", built.osteophytes()), ("cyst", built.cyst_meshes())):
        for site, mesh in meshes.items():
            if not len(mesh.faces):  # an osteophyte that lies within bone
                continue
            whole = solid_of(mesh.vertices, mesh.faces, f"{site}_{kind}")
            if any(not (whole ^ step.solid).is_empty() for step in built.surgery):
                cut.add(f"{site}_{kind}")
    return cut


def _is_lost(name: str, replaced: list[str], cut: set[str]) -> bool:
    """Tell whether surgery has made a reading meaningless."""
    if name == "XRKL" and replaced:
        return True
    # XROSFM: osteophytes of the femur, medial.
    of_side = {_LETTERS[side] for side in replaced}
    if name.startswith("XR") and name != "XRKL" and name[-1] in of_side:
        return True
    names = set()
    for site in cut:
        side, bone, kind = site.split("_")
        if side in SIDES and bone in ("femur", "tibia"):
            names.add(f"XR{'OS' if kind == 'osteophyte' else 'CY'}{_LETTERS[bone]}{_LETTERS[side]}")
    return name in names


def _same(value: float, other: float | None) -> bool:
    return other is not None and bool(np.isclose(value, other, rtol=0, atol=_SAME_PX))


def _with_edges(mesh: Mesh) -> tuple[Array, Indices]:
    return mesh.vertices, closed_edges(mesh.faces)


def _connected(faces: Faces, count: int) -> list[Faces]:
    """Faces of each connected body of a mesh with so many vertices."""
    body, number = bodies(faces, count)
    return [faces[body[faces[:, 0]] == one] for one in range(number)]


def _notify(replaced: list[str], hidden: list[str]) -> None:
    if replaced:
        sides = f"the {' and '.join(replaced)} joint contours"
        message = f"surgery replaces {sides}; truth has no grade, and no joint space and joint readings of these sides"
        warnings.warn(f"{message}; knee.jsw_{replaced[0]}_mm keeps what was specified", SurgeryNotice, stacklevel=4)
    if hidden:
        what = " and ".join(hidden)
        message = f"an implant covers the {what} joint space in this view; truth has no joint space there"
        warnings.warn(f"{message}; move the implant or the view to have it", SurgeryNotice, stacklevel=4)
