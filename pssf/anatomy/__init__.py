"""anatomy.build     knee parameters        -> scene of closed meshes between named materials
anatomy.truth_of  knee, scene, protocol  -> labels and landmarks on that radiograph

bones        femur, tibia, fibula, patella as nested solids     osteophytes  beaks that flow into the bone
femur, tibia their outer shapes, blended                        implicit     fields, blends, settling onto them
soft         skin, fat, muscle                                  joint        the pose that gives the joint spaces
cartilage    cartilage and menisci                              planes       fat planes, fat pad, patellar tendon
tissues      all of these, carved clear of each other
contours     projected outlines and the gap between them        solids       lofts, hulls, height fields, checks
"""

from dataclasses import replace

import numpy as np
import trimesh
from manifold3d import Manifold

from ..checks import InputError
from ..files import tables
from ..geometry import view_of
from ..knee import Knee
from ..protocol import Protocol
from ..radiograph import Truth
from ..scene import Scene, Surface
from . import bones, soft
from .contours import Gap, edges_of, measure_gap
from .joint import half_ml_mm, solve_pose
from .solids import checked, mesh_of
from .tissues import between

__all__ = ["build", "measured_jsw_mm", "truth_of"]


def build(knee: Knee) -> Scene:
    """The knee as closed surfaces: skin, fat, muscle, what lies between, and cortex, trabeculae and marrow of bones.

    Surfaces are named ("femur", "femur_trabecular", "femur_marrow", "skin", ...), in the knee frame, mm.
    raises  InputError if a solid fails its checks, which the ranges of `Knee` exclude
    """
    shape = _shape(knee)
    femur, tibia = bones.grown_femur(shape, knee.osteophytes), bones.grown_tibia(shape, knee.osteophytes)
    pose = solve_pose(knee, shape, femur.outer, bones.standing(tibia.outer, shape))
    # The femur's tilt closes the joint; its shaft gives that tilt back, so that varus_deg is the angle of the shafts.
    shape = replace(shape, femur_valgus_deg=shape.femur_valgus_deg + pose.tilt_deg)
    parts = {
        "femur": bones.femur(shape, femur),
        "tibia": bones.tibia(shape, tibia),
        "fibula": bones.fibula(shape),
        "patella": bones.patella(shape),
    }
    frames = {"femur": pose.femur(), "patella": pose.femur(), "tibia": pose.tibia(), "fibula": pose.tibia()}
    placed = {name: _placed(part, frames[name]) for name, part in parts.items()}
    points_mm = np.vstack([part.outer.to_mesh64().vert_properties[:, :3] for part in placed.values()])
    limb = soft.layers(knee, shape, points_mm @ pose.soft()[:, :3])
    wraps = {name: solid.transform(pose.soft()) for name, solid in limb.items()}
    _check_nesting(placed, wraps["muscle"])
    surfaces = [
        _surface(wraps["skin"], "skin", "air", "skin", knee),
        _surface(wraps["adipose"], "adipose", "skin", "adipose", knee),
        _surface(wraps["muscle"], "muscle", "adipose", "muscle", knee),
    ]
    for tissue in between(knee, shape, pose, (femur, tibia), placed, wraps["muscle"]):
        surfaces.append(_sided(tissue.mesh, tissue.material, "muscle", tissue.name, knee))
    for name, part in placed.items():
        surfaces.append(_surface(part.outer, "cortical_bone", "muscle", name, knee))
        surfaces.append(_surface(part.inner, "trabecular_bone", "cortical_bone", f"{name}_trabecular", knee))
        if part.canal is not None:
            surfaces.append(_surface(part.canal, "marrow", "trabecular_bone", f"{name}_marrow", knee))
    return Scene(surfaces)


def truth_of(knee: Knee, scene: Scene, protocol: Protocol) -> Truth:
    """What is known about the radiograph of a built knee under a protocol.

    scene   as `build(knee)` gives it
    """
    medial, lateral = _gaps(knee, scene, protocol)
    spots = {"medial_joint_line": medial.middle_px(), "lateral_joint_line": lateral.middle_px()}
    ends = np.array(list(spots.values()))
    spots["joint_centre"] = (float(ends[:, 0].mean()), float(ends[:, 1].mean()))
    return Truth(
        jsw_medial_mm=knee.jsw_medial_mm, jsw_lateral_mm=knee.jsw_lateral_mm, grade=knee.grade, landmarks_px=spots
    )


def measured_jsw_mm(knee: Knee, scene: Scene, protocol: Protocol) -> tuple[float, float]:
    """Medial and lateral joint space measured on the projected contours of a built knee, osteophytes and all."""
    medial, lateral = _gaps(knee, scene, protocol)
    return medial.jsw_mm, lateral.jsw_mm


def _gaps(knee: Knee, scene: Scene, protocol: Protocol) -> tuple[Gap, Gap]:
    """The medial and the lateral joint space as a protocol's detector sees them."""
    meshes = {s.name: s.mesh for s in scene.surfaces if s.name in ("femur", "tibia")}
    femur, tibia = ((m.vertices, edges_of(m.faces)) for m in (meshes["femur"], meshes["tibia"]))
    medial, half = (1 if knee.side == "right" else -1), half_ml_mm(_shape(knee).scale)
    view = view_of(protocol)
    return measure_gap(femur, tibia, view, medial, half), measure_gap(femur, tibia, view, -medial, half)


def _shape(knee: Knee) -> bones.Build:
    table = tables.data("anatomy")
    size = table["size"]
    sex_scale = size["female_over_male"] if knee.sex == "female" else 1.0
    return bones.Build(
        scale=sex_scale * knee.bone_scale * knee.stature_mm / size["stature_mm"][knee.sex],
        cortex=knee.cortex_scale,
        plate=knee.subchondral_plate,
        slope_deg=knee.tibial_slope_deg,
        femur_valgus_deg=table["femur"]["valgus_deg"] - knee.varus_deg / 2,
        tibia_varus_deg=knee.varus_deg / 2,
    )


def _placed(part: bones.Bone, transform: np.ndarray) -> bones.Bone:
    canal = None if part.canal is None else part.canal.transform(transform)
    return bones.Bone(outer=part.outer.transform(transform), inner=part.inner.transform(transform), canal=canal)


def _check_nesting(placed: dict[str, bones.Bone], muscle: Manifold) -> None:
    """Refuse shells that leave their host and bones that meet: path lengths would then be wrong in silence."""
    for name, part in placed.items():
        shells = [("trabecular bone", part.inner, part.outer), ("cortex", part.outer, muscle)]
        shells += [("marrow", part.canal, part.inner)] if part.canal is not None else []
        for what, inside, host in shells:
            if (inside - host).volume() > 1e-6:
                raise InputError(
                    f"{name}: its {what} leaves its host by {(inside - host).volume():.3g} mm3; allowed: 0"
                )
    names = list(placed)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            shared = (placed[one].outer ^ placed[other].outer).volume()
            if shared > 1e-6:
                why = "joint spaces, osteophytes and pose leave them no room"
                raise InputError(f"{one} and {other} overlap by {shared:.3g} mm3 ({why}); allowed: 0 mm3")


def _surface(solid: Manifold, inside: str, outside: str, name: str, knee: Knee) -> Surface:
    return _sided(mesh_of(checked(solid, name)), inside, outside, name, knee)


def _sided(mesh: trimesh.Trimesh, inside: str, outside: str, name: str, knee: Knee) -> Surface:
    """The surface of a mesh, mirrored for a left knee."""
    if knee.side == "left":
        mesh = trimesh.Trimesh(mesh.vertices * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1], process=False)
    return Surface(mesh, inside=inside, outside=outside, name=name)
