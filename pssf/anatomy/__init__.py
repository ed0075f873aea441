"""anatomy.build     knee parameters        -> scene of closed meshes between named materials
anatomy.truth_of  knee, scene, protocol  -> labels and landmarks on that radiograph

bones        femur, tibia, fibula, patella as nested solids     osteophytes  beaks that flow into the bone
femur, tibia their outer shapes, blended                        implicit     fields, blends, settling onto them
soft         skin, fat, muscle                                  joint        the pose that gives the joint spaces
cartilage    cartilage and menisci                              planes       fat planes, fat pad, patellar tendon
tissues      all of these, carved clear of each other           trabeculae   density of the spongy bone within
contours     projected outlines and the gap between them        solids       lofts, hulls, height fields, checks
truth        labels and landmarks
"""

from dataclasses import replace

import numpy as np
import trimesh
from manifold3d import Manifold

from ..core.checks import Array, InputError
from ..geometry.scene import Scene, Surface
from ..model.knee import Knee
from . import bones, soft
from .joint import stance_of
from .solids import checked, mesh_of
from .tissues import between
from .trabeculae import BONES, Trabeculae, trabeculae
from .truth import measured_jsw_mm, osteophytes_of, truth_of

__all__ = ["BONES", "bones_of", "build", "measured_jsw_mm", "osteophytes_of", "truth_of"]


def build(knee: Knee) -> Scene:
    """The knee as closed surfaces: skin, fat, muscle, what lies between, and cortex, trabeculae and marrow of bones.

    Surfaces are named ("femur", "femur_trabecular", "femur_marrow", "skin", ...), in the knee frame, mm.
    raises  InputError if a solid fails its checks, which the ranges of `Knee` exclude
    """
    stance, placed = stance_of(knee), bones_of(knee)
    shape, pose = stance.build, stance.pose
    points_mm = np.vstack([part.outer.to_mesh64().vert_properties[:, :3] for part in placed.values()])
    limb = soft.layers(knee, shape, points_mm @ pose.soft()[:, :3])
    wraps = {name: solid.transform(pose.soft()) for name, solid in limb.items()}
    _check_nesting(placed, wraps["muscle"])
    surfaces = [
        _surface(wraps["skin"], "skin", "air", "skin", knee),
        _surface(wraps["adipose"], "adipose", "skin", "adipose", knee),
        _surface(wraps["muscle"], "muscle", "adipose", "muscle", knee),
    ]
    for tissue in between(knee, stance, placed, wraps["muscle"]):
        surfaces.append(_sided(tissue.mesh, tissue.material, "muscle", tissue.name, knee))
    for name, part in placed.items():
        density = _texture(knee, name, shape.scale, pose.bone(name))
        surfaces.append(_surface(part.outer, "cortical_bone", "muscle", name, knee))
        spongy = _surface(part.inner, "trabecular_bone", "cortical_bone", f"{name}_trabecular", knee)
        surfaces.append(replace(spongy, inside_density=density))
        if part.canal is not None:
            canal = _surface(part.canal, "marrow", "trabecular_bone", f"{name}_marrow", knee)
            surfaces.append(replace(canal, outside_density=density))
    return Scene(surfaces)


def bones_of(knee: Knee) -> dict[str, bones.Bone]:
    """Femur, tibia, fibula and patella of a right knee as it stands, by name; a left one is their mirror image in x."""
    stance = stance_of(knee)
    shape = stance.build
    parts = {
        "femur": bones.femur(shape, stance.femur),
        "tibia": bones.tibia(shape, stance.tibia),
        "fibula": bones.fibula(shape),
        "patella": bones.patella(shape),
    }
    return {name: _placed(part, stance.pose.bone(name)) for name, part in parts.items()}


def _texture(knee: Knee, bone: str, scale: float, frame: Array) -> Trabeculae:
    return trabeculae(
        bone,
        seed=knee.texture_seed,
        scale=scale,
        frame=frame,
        mirror=knee.side,
        sclerosis=knee.subchondral_plate,
        age_years=knee.age_years,
        sex=knee.sex,
    )


def _placed(part: bones.Bone, transform: Array) -> bones.Bone:
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
