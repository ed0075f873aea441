"""Built knee: the parameters of a knee, its closed surfaces and its labels in one object."""

from collections.abc import Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from manifold3d import Manifold

from ..core.checks import InputError
from ..core.keyword_arguments import check_keywords, renamed_attribute
from ..core.processes.worker_processes import limit_to_one_blas_thread
from ..data.anatomy.anatomy_tables import load_anatomy_tables
from ..data.knees.field_definitions import beam_angle_range_deg
from ..data.knees.oarsi_table import OarsiThresholds, load_oarsi_thresholds
from ..data.table_records import Pair
from ..geometry.density import Density
from ..geometry.mesh import Mesh
from ..geometry.scene import Scene, Surface
from ..geometry.view import View, resolve_view
from ..model.knee import Knee
from ..model.limb_axes import compute_alignment
from ..model.oarsi_grades import compute_oarsi_grades
from ..model.protocol import Posture, Protocol
from ..model.radiograph import Truth
from ..model.sampling.acquisition import describe_acquisition
from .bones import bone_shells
from .bones.bone_shells import Bone
from .bones.parameter_conflicts import explain_conflicts
from .bones.shell_checks import check_nesting
from .knee_trabeculae import build_bone_texture
from .labels.lateral_axial_labels import measure_lateral_axial_labels
from .labels.osteophyte_faces import select_osteophyte_faces
from .labels.radiograph_labels import build_osteophyte_meshes, measure_jsw_mm, measure_labels
from .labels.surgery_labels import (
    compute_labels_after_surgery,
    find_lost_joint_spaces,
    find_replaced_sides,
    require_visible_bone,
)
from .last_knee import recall_last_knee
from .meshing.solids import extract_mesh, require_valid_solid
from .posture.attrition import measure_attrition_mm
from .posture.knee_assembly import KneeAssembly, grow_bones, load_jsw_protocol, pose_knee
from .posture.placed_bones import PlacedBone, build_bones, place_bones
from .posture.plateau_margins import align_beam_with_plateau, measure_inter_margin_mm
from .soft_tissue import limb_layers
from .soft_tissue.joint_tissues import CoveredBone, build_joint_tissues
from .subchondral_cysts import CystSolids, build_cyst_meshes, place_cysts
from .surgery import SurgicalMethods, SurgicalStep, apply_surgery_to_parts
from .trabeculae.trabecular_density import BONES


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltKnee(SurgicalMethods):
    """A knee with its surfaces, from which all labels are measured.

    Construct it with `build`. The object is immutable, so its labels always match its scene.

    Attributes
    ----------
    knee : Knee
        Parameters of the knee.
    scene : Scene
        Closed surfaces between named materials in the knee frame, in mm.
    assembly : KneeAssembly
        Bones at template size and their pose.
    bones : dict of str to Bone
        Solids of femur, tibia, fibula and patella, and of the fabella if present. They are in the frame of the leg, in
        mm, before the rotation and mirroring that `assembly` specifies. Surgery does not change these solids.
    cysts : dict of str to list of CystSolids
        Cysts of each bone in the frame of the leg, before surgery.
    attrition : Mapping of str to float, or None
        Depth of wear of the medial and lateral plateau, in mm. None until the wear is measured.
    beam_range_deg : tuple of float
        Smallest and largest allowed tilt of the central ray, in degrees.
    oarsi_thresholds : OarsiThresholds
        Thresholds that convert measurements to OARSI grades.
    surgery : tuple of SurgicalStep
        Insertions and resections, in the order of the operations.
    """

    knee: Knee
    scene: Scene
    assembly: KneeAssembly
    bones: dict[str, bone_shells.Bone]
    cysts: dict[str, list[CystSolids]]
    attrition: Mapping[str, float] | None
    beam_range_deg: Pair
    oarsi_thresholds: OarsiThresholds
    surgery: tuple[SurgicalStep, ...] = ()

    # The deprecated names of these methods remain valid for one version.
    truth_in = renamed_attribute("compute_truth_in_view")
    measured_jsw_mm = renamed_attribute("measure_jsw_mm")
    osteophytes = renamed_attribute("osteophyte_meshes")
    solids = renamed_attribute("part_meshes")

    def truth(self, protocol: Protocol) -> Truth:
        """Measure labels and landmarks for a radiograph of this knee.

        Parameters
        ----------
        protocol : Protocol
            Acquisition protocol.

        Returns
        -------
        Truth
            Labels without masks; `simulate` renders the masks.

        Raises
        ------
        InputError
            If the protocol requests a beam along the plateau and no allowed beam angle is parallel to the plateau.
        """
        aimed = self.aim_beam(protocol)
        return replace(
            self.compute_truth_in_view(resolve_view(aimed)), acquisition=describe_acquisition(self.knee, aimed)
        )

    def compute_truth_in_view(self, view: View) -> Truth:
        """Measure labels and landmarks in a view.

        Parameters
        ----------
        view : View
            Source and detector.

        Returns
        -------
        Truth
            Labels without masks and without acquisition parameters.

        Warns
        -----
        SurgeryNotice
            If surgery makes some labels meaningless. These labels are absent from the result.
        """
        return (
            compute_labels_after_surgery(self, view)
            if self.surgery
            else self.compute_labels(self.scene, self.bones, view)
        )

    def compute_labels(self, scene: Scene, solids: dict[str, Bone], view: View) -> Truth:
        """Measure the labels in a view from the specified surfaces and bones, ignoring surgery.

        Parameters
        ----------
        scene : Scene
            Scene that contains the outer surfaces of femur and tibia.
        solids : dict of str to Bone
            Solids of the bones in the frame of the leg, in mm.
        view : View
            Source and detector.

        Returns
        -------
        Truth
            Labels without masks and without acquisition parameters.
        """
        readings = self._grade_readings
        if self.assembly.posture.is_frontal:
            truth = measure_labels(self.knee, self.assembly, scene, view)
            margin_mm = measure_inter_margin_mm(self.assembly, extract_mesh(solids["tibia"].outer), view)
            readings = {**readings, **truth.readings, "inter_margin_mm": round(margin_mm, 4)}
        else:
            truth = measure_lateral_axial_labels(self.knee, self.assembly, solids, view)
        return replace(truth, grade=int(readings["XRKL"]), attrition_mm=self._attrition_by_side_mm, readings=readings)

    @cached_property
    def _grade_readings(self) -> dict[str, float]:
        """Return OARSI grades and alignment angles, which do not depend on the view."""
        form = self.assembly.bone_parameters.tables
        return {
            **compute_oarsi_grades(self.knee, self._attrition_by_side_mm, self.oarsi_thresholds, form.trabecular_bone),
            **compute_alignment(self.knee, form.template.femur),
        }

    def aim_beam(self, protocol: Protocol) -> Protocol:
        """Align the beam with the medial plateau of this knee if the protocol requests an aligned beam.

        Parameters
        ----------
        protocol : Protocol
            Acquisition protocol.

        Returns
        -------
        Protocol
            Protocol with the beam angle for this knee, or unchanged `protocol` if its beam is horizontal.

        Raises
        ------
        InputError
            If no beam angle within `beam_range_deg` is parallel to the plateau.
        """
        if protocol.beam_along == "horizontal":
            return protocol
        return align_beam_with_plateau(
            self.assembly, extract_mesh(self.bones["tibia"].outer), protocol, self.beam_range_deg
        )

    def inter_margin_mm(self, protocol: Protocol) -> float:
        """Measure the height of the anterior margin of the medial plateau above its posterior margin.

        Parameters
        ----------
        protocol : Protocol
            Acquisition protocol with a frontal view.

        Returns
        -------
        float
            Vertical distance on the radiograph, in mm, scaled to the joint plane.

        Raises
        ------
        InputError
            If the view is not frontal, or if surgery has replaced the plateau.
        """
        require_visible_bone(self, find_replaced_sides(self), "plateau")
        return measure_inter_margin_mm(
            self.assembly, extract_mesh(self.bones["tibia"].outer), resolve_view(self.aim_beam(protocol))
        )

    @cached_property
    def _attrition_by_side_mm(self) -> Mapping[str, float]:
        """Return the depth of wear of the medial and lateral plateau, in mm."""
        # The wear is measured in the pose that defines JSW, so it is the same for every protocol.
        return measure_attrition_mm(self.assembly) if self.attrition is None else self.attrition

    def measure_jsw_mm(self, protocol: Protocol) -> tuple[float, float]:
        """Measure the JSW on the projected contours, including osteophytes.

        Parameters
        ----------
        protocol : Protocol
            Acquisition protocol with a frontal view.

        Returns
        -------
        tuple of float
            Medial and lateral JSW, in mm, scaled to the joint plane.

        Raises
        ------
        InputError
            If the view is not frontal, or if surgery has changed or covered the joint space.
        """
        if not self.assembly.posture.is_frontal:
            raise InputError(f"projection must be AP or PA to measure JSW, got {self.assembly.posture.projection!r}")
        view = resolve_view(self.aim_beam(protocol))
        require_visible_bone(self, find_lost_joint_spaces(self, view), "joint space")
        return measure_jsw_mm(self.knee, self.assembly, self.scene, view)

    def osteophyte_meshes(self) -> dict[str, Mesh]:
        """Build a mesh of the bone that the osteophytes add at each site, before surgery.

        Returns
        -------
        dict of str to Mesh
            Closed surface per site in the knee frame, in mm.
        """
        return build_osteophyte_meshes(self.knee, self.assembly)

    def cyst_meshes(self) -> dict[str, Mesh]:
        """Build a mesh of the cysts at each site, before surgery.

        Returns
        -------
        dict of str to Mesh
            Closed surface per site in the knee frame, in mm.
        """
        return build_cyst_meshes(self.cysts, self.assembly)

    def part_meshes(self) -> dict[str, Mesh]:
        """Build a closed mesh of each part of the knee.

        Returns
        -------
        dict of str to Mesh
            Closed surface of each bone, osteophyte, cyst site and implant in the knee frame, in mm. The meshes show the
            bones after surgery; a bone that surgery removes entirely is absent.
        """
        return apply_surgery_to_parts(self._collect_parts(self.osteophyte_meshes()), self.scene, self.surgery)

    def mask_meshes(self) -> dict[str, Mesh]:
        """Build the meshes whose silhouettes are the masks.

        Returns
        -------
        dict of str to Mesh
            Surface of each bone, osteophyte, cyst site and implant in the knee frame, in mm. The surface of an
            osteophyte that surgery does not cut is open: it consists of the bone faces that the osteophyte raises.
        """
        faces = {f"{site}_osteophyte": mesh for site, mesh in select_osteophyte_faces(self.knee, self.assembly).items()}
        if not self.surgery:
            return self._collect_parts({}) | faces
        # Surgery returns the same object for a mesh that it does not cut.
        before = self._collect_parts(self.osteophyte_meshes())
        after = apply_surgery_to_parts(before, self.scene, self.surgery)
        return {name: faces.get(name, mesh) if mesh is before.get(name) else mesh for name, mesh in after.items()}

    def _collect_parts(self, osteophytes: dict[str, Mesh]) -> dict[str, Mesh]:
        """Collect meshes by mask name: the bones of the scene, the osteophytes at each site, and the cysts."""
        parts = {surface.name: surface.mesh_arrays for surface in self.scene.surfaces if surface.name in BONES}
        parts |= {f"{site}_osteophyte": mesh for site, mesh in osteophytes.items()}
        return parts | {f"{site}_cyst": mesh for site, mesh in self.cyst_meshes().items()}

    def __copy__(self) -> "BuiltKnee":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "BuiltKnee":
        return self  # BuiltKnee is immutable, so a copy would be identical.

    def __reduce__(self) -> tuple[Any, ...]:
        # Solids of manifold3d cannot be pickled. The process that unpickles the knee therefore rebuilds the solids,
        # with identical bytes. The scene is pickled only if it differs from the scene that `build` makes.
        own = self.__dict__.get("_scene_as_built") is self.scene
        return build_in_posture, (self.knee, self.assembly.posture, None if own else self.scene, self.surgery)

    def __repr__(self) -> str:
        after = "".join(f", {step.name}" for step in self.surgery)
        return f"BuiltKnee({self.knee!r}, {len(self.scene.surfaces)} surfaces{after})"


@check_keywords()
def build(knee: Knee, protocol: Protocol | None = None) -> BuiltKnee:
    """Build a knee as closed surfaces.

    The surfaces are skin, fat, muscle, cartilage, menisci and tendons, and cortical bone, trabecular bone and marrow of
    each bone. They are named ``"femur"``, ``"femur_trabecular"``, ``"femur_marrow"``, ``"skin"`` and so on.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    protocol : Protocol, optional
        Protocol that sets the posture. None means the default posture: extended and frontal, as in most protocols.

    Returns
    -------
    BuiltKnee
        Knee with its scene in the knee frame, in mm.

    Raises
    ------
    InputError
        If `knee` is not a Knee or `protocol` is not a Protocol. Also if the parameters leave too little space for a
        solid; the message then names these parameters.

    Examples
    --------
    >>> import pssf
    >>> built = pssf.build(pssf.Knee())
    >>> built.scene.surfaces[0].name
    'skin'
    """
    if not isinstance(knee, Knee):
        raise InputError(f"knee must be a Knee, got {knee!r}")
    if not isinstance(protocol, Protocol | None):
        raise InputError(f"protocol must be a Protocol or None, got {protocol!r}: use load_protocol")
    posture = Posture() if protocol is None else protocol.posture
    with explain_conflicts(knee, posture):
        return build_in_posture(knee, posture)


@limit_to_one_blas_thread()
def build_in_posture(
    knee: Knee, posture: Posture, replacement_scene: Scene | None = None, surgery: tuple[SurgicalStep, ...] = ()
) -> BuiltKnee:
    """Build a knee in a posture, and optionally replace its scene by the scene after surgery.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    posture : Posture
        Posture and projection.
    replacement_scene : Scene, optional
        Scene that replaces the built scene. None keeps the built scene and ignores `surgery`.
    surgery : tuple of SurgicalStep, optional
        Surgical steps that led to `replacement_scene`.

    Returns
    -------
    BuiltKnee
        Knee with its scene in the knee frame, in mm.

    Raises
    ------
    InputError
        If the parameters leave too little space for a solid.
    """
    last = recall_last_knee(knee, load_anatomy_tables())
    # The thread pool runs only functions that do not create solids of the scene. If two threads created solids, the
    # order of the triangles would vary from run to run.
    with ThreadPoolExecutor(2) as aside:
        shells = None if last.unplaced else aside.submit(bone_shells.compute_cortex_depths_mm, last.bone_parameters)
        if last.grown is None:
            last.grown = grow_bones(knee, last.bone_parameters, load_jsw_protocol(knee))
        assembly = pose_knee(knee, last.grown, posture)
        cartilage = aside.submit(last.cover_bones, assembly)
        if shells is not None:
            last.unplaced = build_bones(knee, last.grown, shells.result(), aside)
        assert last.unplaced is not None
        placed = place_bones(knee, assembly, last.unplaced)
        solids = {name: part.solids for name, part in placed.items()}
        attrition = _find_attrition_mm(knee, assembly, placed["tibia"].is_worn)
        cysts = place_cysts(knee, assembly, solids, attrition)
        scene = Scene(_build_surfaces(knee, assembly, placed, cysts, cartilage, aside))
    built = BuiltKnee(
        knee=knee,
        scene=scene,
        assembly=assembly,
        bones=solids,
        cysts=cysts,
        attrition=attrition,
        beam_range_deg=beam_angle_range_deg(),
        oarsi_thresholds=load_oarsi_thresholds(),
    )
    object.__setattr__(built, "_scene_as_built", scene)
    return built if replacement_scene is None else replace(built, scene=replacement_scene, surgery=surgery)


def _find_attrition_mm(knee: Knee, assembly: KneeAssembly, is_worn: bool) -> Mapping[str, float] | None:
    """Return the wear of the medial and lateral plateau, in mm, or None if the wear is not needed yet.

    If no bone is worn, the wear is 0 without a measurement. Otherwise, the wear is measured only if the knee has cysts.
    """
    now, defined = assembly.pose.femur_to_tibia_transform(), assembly.jsw_pose.femur_to_tibia_transform()
    if not is_worn and np.array_equal(now, defined):
        return {"medial": 0.0, "lateral": 0.0}
    return measure_attrition_mm(assembly) if knee.cysts else None


def _build_surfaces(
    knee: Knee,
    assembly: KneeAssembly,
    placed_bones: dict[str, PlacedBone],
    cysts: dict[str, list[CystSolids]],
    cartilage: "Future[tuple[CoveredBone, CoveredBone]]",
    executor: Executor,
) -> list[Surface]:
    """Build all surfaces of the scene in an order in which each surface follows the surface that encloses it."""
    shape, pose = assembly.bone_parameters, assembly.pose
    solids = {name: part.solids for name, part in placed_bones.items()}
    points_mm = np.vstack([part.outer.to_mesh64().vert_properties[:, :3] for part in solids.values()])
    limb = limb_layers.build_soft_tissue_layers(
        knee, shape, pose.flexion_deg, points_mm @ pose.soft_tissue_transform()[:, :3]
    )
    wraps = {name: solid.transform(pose.soft_tissue_transform()) for name, solid in limb.items()}
    sound = executor.submit(check_nesting, solids, wraps["muscle"])
    surfaces = [
        _make_surface(wraps["skin"], "skin", "air", "skin", assembly),
        _make_surface(wraps["adipose"], "adipose", "skin", "adipose", assembly),
        _make_surface(wraps["muscle"], "muscle", "adipose", "muscle", assembly),
    ]
    within = build_joint_tissues(
        knee, assembly, solids, cartilage.result(), wraps["muscle"], wraps["intermuscular_fat"]
    )
    sound.result()
    for tissue in within:
        surfaces.append(_make_oriented_surface(tissue.mesh, tissue.material, "muscle", tissue.name, assembly))
    for name, part in solids.items():
        density = build_bone_texture(knee, name, shape.tables.trabecular_bone, assembly, placed_bones[name].frame)
        surfaces.append(_make_surface(part.outer, "cortical_bone", "muscle", name, assembly))
        spongy = ("trabecular_bone", "cortical_bone", f"{name}_trabecular")
        surfaces.append(_make_surface(part.inner, *spongy, assembly, inside_density=density))
        if part.canal is not None:
            canal = ("marrow", "trabecular_bone", f"{name}_marrow")
            surfaces.append(_make_surface(part.canal, *canal, assembly, outside_density=density))
        for number, cyst in enumerate(cysts.get(name, ()), start=1):
            wall = ("cortical_bone", "trabecular_bone", f"{name}_cyst_{number}_wall")
            surfaces.append(_make_surface(cyst.wall, *wall, assembly, outside_density=density))
            surfaces.append(_make_surface(cyst.contents, "marrow", "cortical_bone", f"{name}_cyst_{number}", assembly))
    return surfaces


def _make_surface(
    solid: Manifold, inside: str, outside: str, name: str, assembly: KneeAssembly, **densities: Density
) -> Surface:
    """Check a solid and convert it to a surface of the scene."""
    return _make_oriented_surface(
        extract_mesh(require_valid_solid(solid, name)), inside, outside, name, assembly, **densities
    )


def _make_oriented_surface(
    mesh: Mesh, inside: str, outside: str, name: str, assembly: KneeAssembly, **densities: Density
) -> Surface:
    """Rotate and mirror a mesh for the view and the side of the knee, and make a surface from it."""
    return Surface(assembly.orient_mesh(mesh), inside=inside, outside=outside, name=name, **densities)
