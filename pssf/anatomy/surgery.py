"""Surgery: implants inserted into a built knee and bone resected from it by Boolean operations.

The volume of an implant is subtracted from every surface that intersects it, and the implant gets its own surface. All
surfaces therefore stay closed and nested, and ray casting, scatter simulation and exports treat implants like other
surfaces. Surfaces that contain the implant entirely stay unchanged. The innermost of these surfaces determines the
material and the density around the implant.
"""

import re
import reprlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import manifold3d
import numpy as np
from manifold3d import Manifold

from ..core.checks import InputError
from ..geometry.mesh import Mesh, is_mesh
from ..geometry.mesh_repair import require_usable_solid
from ..geometry.scene import Scene, Surface
from .bones.bone_shells import Bone
from .meshing.solids import build_solid, extract_mesh
from .meshing.uncut_faces import restore_uncut_faces
from .posture.knee_assembly import KneeAssembly
from .trabeculae.trabecular_density import BONES

if TYPE_CHECKING:
    import trimesh

    from ..geometry.view import View
    from ..model.knee import Knee
    from ..model.radiograph import Truth


# Largest overlap of the connected components of a mesh that counts as a rounding error, in mm3.
_MAX_OVERLAP_MM3 = 1e-6
# Pieces up to this volume, in mm3, are removed as splinters. They are thinner than the rounding error of a path length.
_SPLINTER_MM3 = 1e-7
# Regular expression for allowed names of implants and resections.
_NAME_PATTERN = r"[A-Za-z0-9][\w-]{0,49}"
# Suffixes of the mask names of osteophytes and cysts; names of implants must not end with them.
_RESERVED_SUFFIXES = ("_osteophyte", "_cyst")
# Surfaces of the menisci, which a resection removes together with bone.
_MENISCI = ("medial_meniscus", "lateral_meniscus")


@dataclass(frozen=True, eq=False, kw_only=True)
class SurgicalStep:
    """One inserted implant or one resected volume.

    Attributes
    ----------
    surface : Surface
        Closed mesh in the knee frame, in mm, as specified by the user, with its name.
    material : str or None
        Material of the implant; None for a resection.
    """

    surface: Surface
    material: str | None

    @property
    def name(self) -> str:
        """Name of the implant or the resection."""
        return self.surface.name

    @cached_property
    def solid(self) -> Manifold:
        """Solid that the mesh bounds, after the repair that is applied to every mesh in a scene."""
        return _convert_to_solid(self.surface)

    def __getstate__(self) -> dict[str, Any]:
        # Solids of manifold3d cannot be pickled. The process that unpickles the step rebuilds the solid.
        return {name: value for name, value in self.__dict__.items() if name != "solid"}

    def table(self) -> dict[str, Any]:
        """Describe the step for the metadata of a radiograph.

        Returns
        -------
        dict
            Kind of step, name, material, and size and SHA-256 hash of the mesh; JSON-ready.
        """
        of_mesh = self.surface.table()
        return {
            "step": "resect" if self.material is None else "insert",
            "name": self.name,
            "material": self.material,
            **{key: of_mesh[key] for key in ("vertices", "faces", "sha256")},
        }


class SurgicalMethods:
    """Surgical methods of a built knee; `BuiltKnee` inherits them."""

    if TYPE_CHECKING:
        scene: Scene
        assembly: KneeAssembly
        bones: dict[str, Bone]
        surgery: tuple[SurgicalStep, ...]
        knee: Knee

        def compute_labels(self, scene: Scene, solids: dict[str, Bone], view: View) -> Truth: ...
        def osteophyte_meshes(self) -> dict[str, Mesh]: ...
        def cyst_meshes(self) -> dict[str, Mesh]: ...

    @cached_property
    def remaining_bones(self) -> dict[str, Bone]:
        """Bones after surgery: `bones` without the volume that surgery has removed from the outer solids."""
        mirror, turn = np.array(self.assembly.mirror), self.assembly.view_rotation
        left = dict(self.bones)
        for step in self.surgery:
            vertices, faces = extract_mesh(step.solid)
            # The points are mapped back to the frame of the leg: the inverse of `KneeAssembly.orient_points`.
            points = vertices * mirror if turn is None else (vertices * mirror) @ turn
            taken = build_solid(points, faces if np.prod(mirror) > 0 else faces[:, ::-1], step.name)
            for name, bone in left.items():
                if not (bone.outer ^ taken).is_empty():
                    left[name] = replace(bone, outer=_subtract_solid(bone.outer, taken, name))
        return left

    def surgery_table(self, prefix: str = "") -> tuple[dict[str, Any], ...]:
        """Describe all insertions and resections for the metadata of a radiograph.

        Parameters
        ----------
        prefix : str, default ""
            Prefix of all names, such as ``"right_"``.

        Returns
        -------
        tuple of dict
            One JSON-ready description per step.
        """
        return tuple({**(table := step.table()), "name": f"{prefix}{table['name']}"} for step in self.surgery)

    def insert(self, mesh: "trimesh.Trimesh | Mesh", material: str, *, name: str = "implant") -> Self:
        """Insert an implant into the knee: a screw, plate, nail or component of a total knee replacement.

        The implant displaces all materials within its volume: bone with its trabecular density, soft tissue, air and
        earlier implants.

        Parameters
        ----------
        mesh : trimesh.Trimesh or Mesh
            Closed surface in the frame of the scene, in mm. In this frame, a left knee is the mirror image of a right
            knee. The mesh is checked and repaired like every mesh of a scene. Its connected components must not
            overlap.
        material : str
            Material as in `Surface`, such as ``"titanium_alloy"``, ``"cobalt_chromium"``, ``"polyethylene"``,
            ``"bone_cement"`` or ``"Ti@4.51"``.
        name : str, default "implant"
            Name of the surface, the mask and the entry in `Radiograph.surgery`: up to 50 letters, digits, ``_`` and
            ``-``.

        Returns
        -------
        BuiltKnee
            New knee with the implant. Labels that the implant makes meaningless are absent from its `truth`.

        Raises
        ------
        InputError
            If the mesh does not bound a solid, if its connected components overlap, or if the name is in use.

        Warns
        -----
        MeshNotice
            When rays are cast through the knee, if the mesh needed repair.

        Examples
        --------
        >>> import pssf, trimesh
        >>> built = pssf.build(pssf.Knee())
        >>> nail = trimesh.creation.cylinder(radius=4.5, segment=[[0, 4, -170], [0, 4, -40]])
        >>> built.insert(nail, "titanium_alloy", name="nail").surgery[0].name
        'nail'
        """
        if not isinstance(material, str) or not material:
            raise InputError(f"material must be the name of a material, got {material!r}")
        step = SurgicalStep(surface=_make_user_surface(self, mesh, material, name), material=material)
        return self._add_step(step, insert_body(self.scene, step))

    def resect(self, mesh: "trimesh.Trimesh | Mesh", *, name: str = "resection") -> Self:
        """Remove bone, cartilage and menisci within a volume and fill it with soft tissue.

        Parameters
        ----------
        mesh : trimesh.Trimesh or Mesh
            Closed surface of the volume, in mm. It must meet the requirements of `insert`. Implants within the volume
            are not removed.
        name : str, default "resection"
            Name of the step in `Radiograph.surgery`. It must meet the requirements of `insert`.

        Returns
        -------
        BuiltKnee
            New knee without the resected bone.

        Raises
        ------
        InputError
            If the mesh or the name does not meet the requirements of `insert`, or if the volume contains no bone,
            cartilage or meniscus.
        """
        step = SurgicalStep(surface=_make_user_surface(self, mesh, "muscle", name), material=None)
        scene = resect_bone(self.scene, step, {one.name for one in self.surgery})
        return self._add_step(step, scene)

    def _add_step(self, step: SurgicalStep, scene: Scene) -> Self:
        """Return a copy of the knee with the new scene and one more surgical step."""
        changed: Self = replace(self, scene=scene, surgery=(*self.surgery, step))  # type: ignore[type-var]
        return changed


def insert_body(scene: Scene, step: SurgicalStep) -> Scene:
    """Insert the implant of a surgical step into a scene.

    Parameters
    ----------
    scene : Scene
        Scene of the knee.
    step : SurgicalStep
        Insertion of an implant: a step with a material.

    Returns
    -------
    Scene
        Scene with the implant.

    Raises
    ------
    InputError
        If a surface does not bound a solid.
    """
    body, box = step.solid, step.surface.bounds_mm
    around: dict[int, float] = {}
    met = {}
    for number, surface in enumerate(scene.surfaces):
        low, high = surface.bounds_mm
        if (box[1] <= low).any() or (high <= box[0]).any():
            continue
        host = _convert_to_solid(surface)
        if not (host ^ body).is_empty():
            met[number] = host
            if _subtract_solid(body, host, step.name).is_empty():
                around[number] = host.volume()
    # Visit the surfaces that contain the implant from outside to inside. A surface counts only if the previous surface
    # directly encloses it.
    outside, density = scene.ambient, None
    for number in sorted(around, key=lambda number: -around[number]):
        surface = scene.surfaces[number]
        if surface.outside == outside:
            outside, density = surface.inside, surface.inside_density
            del met[number]
    left = {number: _subtract_solid(host, body, scene.surfaces[number].name) for number, host in met.items()}
    assert step.material is not None
    own = Surface(step.surface.mesh_arrays, step.material, outside, step.name, outside_density=density)
    return replace_surfaces(scene, left, own)


def resect_bone(scene: Scene, step: SurgicalStep, implants: Iterable[str] = ()) -> Scene:
    """Remove the bone, cartilage and menisci within the volume of a surgical step.

    Parameters
    ----------
    scene : Scene
        Scene of the knee.
    step : SurgicalStep
        Resection: a step without a material.
    implants : iterable of str, optional
        Names of the implants, whose surfaces stay unchanged.

    Returns
    -------
    Scene
        Scene without the resected tissue.

    Raises
    ------
    InputError
        If the volume intersects no bone, cartilage or meniscus.
    """
    kept, left = set(implants), {}
    # The implants are excluded from the resected volume, because each implant surface stores the bone around it as its
    # outside material.
    bodies = [_convert_to_solid(surface) for surface in scene.surfaces if surface.name in kept]
    volume = Manifold.batch_boolean([step.solid, *bodies], manifold3d.OpType.Subtract)
    for number, surface in enumerate(scene.surfaces):
        part = surface.name.split("_")[0] in BONES or surface.name in _MENISCI
        if part and surface.name not in kept:
            host = _convert_to_solid(surface)
            if not (host ^ volume).is_empty():
                left[number] = _subtract_solid(host, volume, surface.name)
    if not left:
        low, high = step.surface.bounds_mm.round(1).tolist()
        raise InputError(
            f"{step.name}: mesh must intersect bone, cartilage or a meniscus, got none between {low} and {high} mm"
        )
    return replace_surfaces(scene, left)


def replace_surfaces(scene: Scene, remaining: dict[int, Manifold], *new_surfaces: Surface) -> Scene:
    """Replace some surfaces of a scene with new solids and append new surfaces.

    Parameters
    ----------
    scene : Scene
        Scene of the knee.
    remaining : dict of int to Manifold
        Remaining solid of each changed surface, keyed by surface index. A surface with an empty solid is removed.
    *new_surfaces : Surface
        Surfaces to append.

    Returns
    -------
    Scene
        Changed scene.
    """
    surfaces = []
    for number, surface in enumerate(scene.surfaces):
        if number not in remaining:
            surfaces.append(surface)
        elif not remaining[number].is_empty():
            whole = Mesh(surface.solid.points, surface.solid.faces)
            surfaces.append(replace(surface, mesh=restore_uncut_faces(extract_mesh(remaining[number]), whole)))
    return Scene([*surfaces, *new_surfaces], scene.ambient, scene.size_mm, scene.overlap)


def apply_surgery_to_parts(solids: dict[str, Mesh], scene: Scene, steps: Sequence[SurgicalStep]) -> dict[str, Mesh]:
    """Subtract the volumes of surgical steps from the meshes of bones, osteophytes and cysts, and add the implants.

    Parameters
    ----------
    solids : dict of str to Mesh
        Closed surface of each bone, osteophyte and cyst site in the knee frame, in mm.
    scene : Scene
        Scene after surgery.
    steps : sequence of SurgicalStep
        Surgical steps.

    Returns
    -------
    dict of str to Mesh
        Remaining meshes and implants; meshes that are removed entirely are absent.
    """
    left = {}
    for name, mesh in solids.items() if steps else ():
        whole = part = build_solid(mesh.vertices, mesh.faces, name)
        for solid in (step.solid for step in steps):
            part = part if (part ^ solid).is_empty() else _subtract_solid(part, solid, name)
        if not part.is_empty():
            left[name] = mesh if part is whole else extract_mesh(part)
    implants = {step.name for step in steps if step.material is not None}
    bodies = {surface.name: surface.solid for surface in scene.surfaces if surface.name in implants}
    return (left if steps else solids) | {name: Mesh(body.points, body.faces) for name, body in bodies.items()}


def _make_user_surface(built: SurgicalMethods, mesh: Any, material: str, name: str) -> Surface:
    """Check the mesh and the name specified by the user, and make a surface with a copy of the arrays."""
    if (
        not isinstance(name, str)
        or not re.fullmatch(_NAME_PATTERN, name, re.ASCII)
        or name.endswith(_RESERVED_SUFFIXES)
    ):
        allowed = f"1 to 50 letters, digits, _ or -, not ending with {' or '.join(_RESERVED_SUFFIXES)}"
        raise InputError(f"name must be {allowed}, got {name!r}")
    used = [surface.name for surface in built.scene.surfaces] + [step.name for step in built.surgery]
    if name in used:
        raise InputError(f"name must be unused in the knee, got {name!r}: names in use are {', '.join(used)}")
    if not is_mesh(mesh):
        raise InputError(f"{name}: mesh must be a trimesh.Trimesh, got {reprlib.repr(mesh)}")
    own = Mesh(np.array(mesh.vertices, np.float64), np.array(mesh.faces))
    surface = Surface(own, material, "muscle", name)
    require_usable_solid(surface.solid)
    _require_disjoint_bodies(surface)
    return surface


def _require_disjoint_bodies(surface: Surface) -> None:
    """Raise InputError if connected components of a mesh overlap, because rays would count the overlap twice."""
    bodies = [body for body in _convert_to_solid(surface).decompose() if body.volume() > 0]
    whole = sum(body.volume() for body in bodies)
    shared = whole - Manifold.batch_boolean(bodies, manifold3d.OpType.Add).volume()
    if len(bodies) > 1 and shared > _MAX_OVERLAP_MM3 + 1e-9 * whole:
        raise InputError(
            f"{surface.name}: connected components of the mesh must not overlap, got {len(bodies)} components with "
            f"{shared:.3g} mm3 of overlap: insert them one by one or unite them"
        )


def _convert_to_solid(surface: Surface) -> Manifold:
    """Convert the repaired mesh of a surface to a solid."""
    require_usable_solid(surface.solid)
    return build_solid(surface.solid.points, surface.solid.faces, surface.name)


def _subtract_solid(one: Manifold, other: Manifold, name: str) -> Manifold:
    """Subtract one solid from another and remove splinters that remain where their faces coincide."""
    left = one - other
    if left.status() != manifold3d.Error.NoError:
        raise InputError(
            f"solid {name}: a Boolean operation failed with status {left.status().name}; check the mesh for defects"
        )
    pieces = left.decompose()
    large = [piece for piece in pieces if abs(piece.volume()) > _SPLINTER_MM3]
    return left if len(large) == len(pieces) else Manifold.compose(large)
