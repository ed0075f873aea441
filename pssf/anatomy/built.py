"""BuiltKnee: a knee, its solids as a scene, and its labels, as one object."""

from collections.abc import Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from manifold3d import Manifold

from ..core.checks import InputError
from ..core.keywords import keywords
from ..core.workers import one_blas_thread
from ..data.anatomy import anatomy_tables
from ..data.fields import beam_range_deg
from ..data.oarsi import OarsiCuts, oarsi_cuts
from ..data.records import Pair
from ..geometry.density import Density
from ..geometry.mesh import Mesh
from ..geometry.scene import Scene, Surface
from ..geometry.view import View, view_of
from ..model.axes import axes
from ..model.exposure import taking_of
from ..model.knee import Knee
from ..model.oarsi import oarsi
from ..model.protocol import Posture, Protocol
from ..model.radiograph import Truth
from . import bones, soft
from .attrition import attrition_mm
from .bone_build import build_of
from .bones import Bone
from .conflicts import explaining
from .cysts import CystSolids, cyst_meshes, cysts_of
from .joint import KneeAssembly, assemble, defining_protocol
from .placed_bones import PlacedBone, place_bones
from .plateau import along_plateau, inter_margin_mm
from .shells import check_nesting
from .solids import checked, mesh_of
from .surgery import Operable, SurgicalStep, after_surgery
from .surgery_truth import lost_joint_spaces, replaced_sides, require_bone, surviving_labels
from .texture import texture_of
from .tissues import Covered, between, cartilage_of
from .trabeculae import BONES
from .truth import labels, measured_jsw_mm, osteophyte_meshes
from .turned_truth import turned_labels


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltKnee(Operable):
    """A knee that is built: its scene and its labels cannot be another's.

    knee            its parameters
    scene           closed surfaces between named materials, in the knee frame, mm
    assembly        how its bones stand
    bones           femur, tibia, fibula and patella, by name, before they are turned and mirrored as `assembly` says
    cysts           bone -> its cysts, likewise
    attrition       `wear.attrition_mm` of it; None where that is still to be found
    beam_range_deg  that a protocol's central ray may be tilted by
    cuts            that it is graded by
    surgery         what was put into it or taken out of it, in order; bones, cysts and attrition are as before
    """

    knee: Knee
    scene: Scene
    assembly: KneeAssembly
    bones: dict[str, bones.Bone]
    cysts: dict[str, list[CystSolids]]
    attrition: Mapping[str, float] | None
    beam_range_deg: Pair
    cuts: OarsiCuts
    surgery: tuple[SurgicalStep, ...] = ()

    def truth(self, protocol: Protocol) -> Truth:
        """Labels and landmarks on a radiograph of it under a protocol; without masks, which `simulate` casts."""
        aimed = self.aimed(protocol)
        return replace(self.truth_in(view_of(aimed)), taking=taking_of(self.knee, aimed))

    def truth_in(self, view: View) -> Truth:
        """The same in a view of one's own, of the knee where its scene has it."""
        return surviving_labels(self, view) if self.surgery else self.labels_of(self.scene, self.bones, view)

    def labels_of(self, scene: Scene, solids: dict[str, Bone], view: View) -> Truth:
        """Labels in a view, if the knee has the outer femur and tibia of this scene, and these bones."""
        readings = self._readings
        if self.assembly.posture.is_frontal:
            truth = labels(self.knee, self.assembly, scene, view)
            margin_mm = inter_margin_mm(self.assembly, mesh_of(solids["tibia"].outer), view)
            readings = {**readings, **truth.readings, "inter_margin_mm": round(margin_mm, 4)}
        else:
            truth = turned_labels(self.knee, self.assembly, solids, view)
        return replace(truth, grade=int(readings["XRKL"]), attrition_mm=self._worn_mm, readings=readings)

    @cached_property
    def _readings(self) -> dict[str, float]:
        form = self.assembly.build.tables
        return {**oarsi(self.knee, self._worn_mm, self.cuts, form.spongy), **axes(self.knee, form.shape.femur)}

    def aimed(self, protocol: Protocol) -> Protocol:
        """The protocol with its beam fitted to this knee, where it says that the beam goes along the medial plateau.

        raises  InputError where no beam does
        """
        if protocol.beam_along == "horizontal":
            return protocol
        return along_plateau(self.assembly, mesh_of(self.bones["tibia"].outer), protocol, self.beam_range_deg)

    def inter_margin_mm(self, protocol: Protocol) -> float:
        """Height on the film of the front margin of the medial plateau over its back one, scaled to the joint plane.

        raises  InputError for a view in which the plateau is not seen from the front, or that surgery has replaced
        """
        require_bone(self, replaced_sides(self), "plateau")
        return inter_margin_mm(self.assembly, mesh_of(self.bones["tibia"].outer), view_of(self.aimed(protocol)))

    @cached_property
    def _worn_mm(self) -> Mapping[str, float]:
        # Of the posture that spaces are defined in, and so the same under every protocol.
        return attrition_mm(self.assembly) if self.attrition is None else self.attrition

    def measured_jsw_mm(self, protocol: Protocol) -> tuple[float, float]:
        """Medial and lateral joint space measured on the projected contours, osteophytes and all.

        raises  InputError for a view that shows none, as that of a joint that surgery replaced
        """
        if not self.assembly.posture.is_frontal:
            raise InputError(f"projection = {self.assembly.posture.projection!r}; allowed: AP or PA")
        view = view_of(self.aimed(protocol))
        require_bone(self, lost_joint_spaces(self, view), "joint space")
        return measured_jsw_mm(self.knee, self.assembly, self.scene, view)

    def osteophytes(self) -> dict[str, Mesh]:
        """Site -> what an osteophyte adds to its bone, in the knee frame, mm, before surgery."""
        return osteophyte_meshes(self.knee, self.assembly)

    def cyst_meshes(self) -> dict[str, Mesh]:
        """Site -> cysts there, in the knee frame, mm, before surgery."""
        return cyst_meshes(self.cysts, self.assembly)

    def solids(self) -> dict[str, Mesh]:
        """Name -> mesh, mm, of each bone, osteophyte, cysts of a site and implant: what a mask is made of.

        Of bone it is what surgery has left; what has gone as a whole has no mask.
        """
        solids = {surface.name: surface.arrays for surface in self.scene.surfaces if surface.name in BONES}
        solids |= {f"{site}_osteophyte": mesh for site, mesh in self.osteophytes().items()}
        solids |= {f"{site}_cyst": mesh for site, mesh in self.cyst_meshes().items()}
        return after_surgery(solids, self.scene, self.surgery)

    def __copy__(self) -> "BuiltKnee":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "BuiltKnee":
        return self  # no part of it is ever changed

    def __reduce__(self) -> tuple[Any, ...]:
        # Solids of manifold3d cannot be sent to a process: they are built again there, by the same steps to the same
        # bytes. Only a scene that was not built so is sent along.
        own = self.__dict__.get("_scene_as_built") is self.scene
        return build_in, (self.knee, self.assembly.posture, None if own else self.scene, self.surgery)

    def __repr__(self) -> str:
        after = "".join(f", {step.name}" for step in self.surgery)
        return f"BuiltKnee({self.knee!r}, {len(self.scene.surfaces)} surfaces{after})"


@keywords()
def build(knee: Knee, protocol: Protocol | None = None) -> BuiltKnee:
    """The knee as closed surfaces: skin, fat, muscle, what lies between, and cortex, trabeculae and marrow of bones.

    Surfaces are named ("femur", "femur_trabecular", "femur_marrow", "skin", ...), in the knee frame, mm.
    protocol  in whose posture it stands; straight and seen from the front if None, as for most protocols
    raises    InputError for what is no Knee or no Protocol, or for parameters that leave the solids no room, by name
    """
    if not isinstance(knee, Knee):
        raise InputError(f"knee = {knee!r}; allowed: a Knee")
    if not isinstance(protocol, Protocol | None):
        raise InputError(f"protocol = {protocol!r}; allowed: a Protocol, as load_protocol gives it, or None")
    posture = Posture() if protocol is None else protocol.posture
    with explaining(knee, posture):
        return build_in(knee, posture)


@one_blas_thread()
def build_in(
    knee: Knee, posture: Posture, other: Scene | None = None, surgery: tuple[SurgicalStep, ...] = ()
) -> BuiltKnee:
    """Build a knee in a posture, as `build` does; with another scene and its surgery instead, if one is given."""
    form = build_of(knee, anatomy_tables())
    bones.prepare(form)
    # What gives the scene no solid is done beside: two threads that did would leave the order of triangles to chance.
    with ThreadPoolExecutor(2) as aside:
        shells = aside.submit(bones.shells_mm, form)
        assembly = assemble(knee, form, posture, defining_protocol(knee))
        cartilage = aside.submit(cartilage_of, knee, assembly)
        placed = place_bones(knee, assembly, shells.result(), aside)
        solids = {name: part.solids for name, part in placed.items()}
        attrition = _attrition_mm(knee, assembly, placed["tibia"].worn)
        cysts = cysts_of(knee, assembly, solids, attrition)
        scene = Scene(_surfaces(knee, assembly, placed, cysts, cartilage, aside))
    built = BuiltKnee(
        knee=knee,
        scene=scene,
        assembly=assembly,
        bones=solids,
        cysts=cysts,
        attrition=attrition,
        beam_range_deg=beam_range_deg(),
        cuts=oarsi_cuts(),
    )
    object.__setattr__(built, "_scene_as_built", scene)
    return built if other is None else replace(built, scene=other, surgery=surgery)


def _attrition_mm(knee: Knee, assembly: KneeAssembly, worn: bool) -> Mapping[str, float] | None:
    """Side -> how deep the plateau is worn, where cysts ask for it or there is nothing to be found; else None."""
    now, defined = assembly.pose.femur_on_tibia(), assembly.defined.femur_on_tibia()
    if not worn and np.array_equal(now, defined):
        return {"medial": 0.0, "lateral": 0.0}
    return attrition_mm(assembly) if knee.cysts else None


def _surfaces(
    knee: Knee,
    assembly: KneeAssembly,
    placed: dict[str, PlacedBone],
    cysts: dict[str, list[CystSolids]],
    cartilage: "Future[tuple[Covered, Covered]]",
    aside: Executor,
) -> list[Surface]:
    shape, pose = assembly.build, assembly.pose
    solids = {name: part.solids for name, part in placed.items()}
    points_mm = np.vstack([part.outer.to_mesh64().vert_properties[:, :3] for part in solids.values()])
    limb = soft.layers(knee, shape, pose.flexion_deg, points_mm @ pose.soft()[:, :3])
    wraps = {name: solid.transform(pose.soft()) for name, solid in limb.items()}
    sound = aside.submit(check_nesting, solids, wraps["muscle"])
    surfaces = [
        _surface(wraps["skin"], "skin", "air", "skin", assembly),
        _surface(wraps["adipose"], "adipose", "skin", "adipose", assembly),
        _surface(wraps["muscle"], "muscle", "adipose", "muscle", assembly),
    ]
    within = between(knee, assembly, solids, cartilage.result(), wraps["muscle"], wraps["intermuscular_fat"])
    sound.result()
    for tissue in within:
        surfaces.append(_sided(tissue.mesh, tissue.material, "muscle", tissue.name, assembly))
    for name, part in solids.items():
        density = texture_of(knee, name, shape.tables.spongy, assembly, placed[name].frame)
        surfaces.append(_surface(part.outer, "cortical_bone", "muscle", name, assembly))
        spongy = ("trabecular_bone", "cortical_bone", f"{name}_trabecular")
        surfaces.append(_surface(part.inner, *spongy, assembly, inside_density=density))
        if part.canal is not None:
            canal = ("marrow", "trabecular_bone", f"{name}_marrow")
            surfaces.append(_surface(part.canal, *canal, assembly, outside_density=density))
        for number, cyst in enumerate(cysts.get(name, ()), start=1):
            wall = ("cortical_bone", "trabecular_bone", f"{name}_cyst_{number}_wall")
            surfaces.append(_surface(cyst.wall, *wall, assembly, outside_density=density))
            surfaces.append(_surface(cyst.soft, "marrow", "cortical_bone", f"{name}_cyst_{number}", assembly))
    return surfaces


def _surface(solid: Manifold, inside: str, outside: str, name: str, at: KneeAssembly, **densities: Density) -> Surface:
    return _sided(mesh_of(checked(solid, name)), inside, outside, name, at, **densities)


def _sided(mesh: Mesh, inside: str, outside: str, name: str, at: KneeAssembly, **densities: Density) -> Surface:
    """The surface of a mesh, mirrored as the knee is."""
    return Surface(at.mirrored(mesh), inside=inside, outside=outside, name=name, **densities)
