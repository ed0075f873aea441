"""Surgery: bodies put into the scene of a built knee, and bone taken out of it, by booleans.

Every surface that a body meets loses what lies in the body, and the body has one surface of its own. So surfaces stay
closed and nested, and the ray sum, the scatter and the exports need to know nothing of implants. Surfaces that hold a
body entirely are left as they are: the innermost of them gives what surrounds the body, and its density.
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
from ..geometry.repair import require_sound
from ..geometry.scene import Scene, Surface
from .bones import Bone
from .joint import KneeAssembly
from .solids import mesh_of, solid_of
from .trabeculae import BONES
from .uncut_faces import with_uncut_faces

if TYPE_CHECKING:
    import trimesh


# Bodies of one mesh that share more than this overlap; less is rounding.
_SHARED_MM3 = 1e-6
# Pieces of no more than this are splinters: as long as they are wide, they are thinner than a path's own rounding.
_SPLINTER_MM3 = 1e-7
_NAME = r"[A-Za-z0-9][\w-]{0,49}"
# Endings by which masks of a knee are known.
_KEPT_ENDINGS = ("_osteophyte", "_cyst")
_MENISCI = ("medial_meniscus", "lateral_meniscus")


@dataclass(frozen=True, eq=False, kw_only=True)
class SurgicalStep:
    """A body put into a knee, or a volume in which bone is taken away.

    surface   its closed mesh in the knee frame, mm, as it was given, and its name
    material  of the body; None where bone is taken away
    """

    surface: Surface
    material: str | None

    @property
    def name(self) -> str:
        """Name of the body or of the resection."""
        return self.surface.name

    @cached_property
    def solid(self) -> Manifold:
        """The mesh, mended as every mesh of a scene is, as a solid."""
        return _solid(self.surface)

    def __getstate__(self) -> dict[str, Any]:
        # A solid of manifold3d cannot be sent to a process; it is made again there.
        return {name: value for name, value in self.__dict__.items() if name != "solid"}

    def table(self) -> dict[str, Any]:
        """Describe the step by name, material, size and hash of the mesh, JSON-ready."""
        of_mesh = self.surface.table()
        return {
            "step": "resect" if self.material is None else "insert",
            "name": self.name,
            "material": self.material,
            **{key: of_mesh[key] for key in ("vertices", "faces", "sha256")},
        }


class Operable:
    """The surgical methods of a built knee."""

    if TYPE_CHECKING:
        scene: Scene
        assembly: KneeAssembly
        bones: dict[str, Bone]
        surgery: tuple[SurgicalStep, ...]

    @cached_property
    def bones_left(self) -> dict[str, Bone]:
        """The bones as `bones` has them, without what surgery has taken of their outer solids."""
        mirror, turn = np.array(self.assembly.mirror), self.assembly.turn
        left = dict(self.bones)
        for step in self.surgery:
            vertices, faces = mesh_of(step.solid)
            # The way back of `KneeAssembly.seen`.
            points = vertices * mirror if turn is None else (vertices * mirror) @ turn
            taken = solid_of(points, faces if np.prod(mirror) > 0 else faces[:, ::-1], step.name)
            for name, bone in left.items():
                if not (bone.outer ^ taken).is_empty():
                    left[name] = replace(bone, outer=_difference(bone.outer, taken, name))
        return left

    def surgery_table(self, prefix: str = "") -> tuple[dict[str, Any], ...]:
        """Describe all insertions and resections, JSON-ready; names with a prefix before them."""
        return tuple({**(table := step.table()), "name": f"{prefix}{table['name']}"} for step in self.surgery)

    def insert(self, mesh: "trimesh.Trimesh | Mesh", material: str, *, name: str = "implant") -> Self:
        """Put a body into the knee: a screw, a plate, a nail, a component of a total knee replacement.

        The body displaces whatever lies in it: bone, its trabecular density, soft tissue, air, and earlier implants.

        Parameters
        ----------
        mesh : trimesh.Trimesh or Mesh
            Closed surface in mm, in the frame of this knee's scene, where a left knee is the mirror image of a right
            one. It is mended or refused as every mesh of a scene is. Its bodies must not overlap.
        material : str
            A material as in `Surface`: "titanium_alloy", "cobalt_chromium", "polyethylene", "bone_cement", "Ti@4.51".
        name : str
            Name of its surface, its mask and its entry in `Radiograph.surgery`: up to 50 letters, digits, _ and -.

        Returns
        -------
        BuiltKnee
            Another knee with the body in it. Labels that the body makes meaningless are absent from its truth.

        Raises
        ------
        InputError
            For a mesh that bounds no solid, bodies that overlap, or a name that is taken.

        Warns
        -----
        MeshNotice
            When the knee is traced, for a mesh that had to be mended.

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
        step = SurgicalStep(surface=_given(self, mesh, material, name), material=material)
        return self._after(step, inserted(self.scene, step))

    def resect(self, mesh: "trimesh.Trimesh | Mesh", *, name: str = "resection") -> Self:
        """Take bone, cartilage and menisci away within a volume; soft tissue fills it.

        Parameters
        ----------
        mesh : trimesh.Trimesh or Mesh
            Closed surface of the volume, in mm, as in `insert`. Implants within it stay.
        name : str
            Name of the step in `Radiograph.surgery`, as in `insert`.

        Returns
        -------
        BuiltKnee
            Another knee without that bone.

        Raises
        ------
        InputError
            As `insert`, and for a volume without bone, cartilage or meniscus in it.
        """
        step = SurgicalStep(surface=_given(self, mesh, "muscle", name), material=None)
        scene = resected(self.scene, step, {one.name for one in self.surgery})
        return self._after(step, scene)

    def _after(self, step: SurgicalStep, scene: Scene) -> Self:
        changed: Self = replace(self, scene=scene, surgery=(*self.surgery, step))  # type: ignore[type-var]
        return changed


def inserted(scene: Scene, step: SurgicalStep) -> Scene:
    """The scene with the body of a step in it.

    raises  InputError for a surface that is no solid
    """
    body, box = step.solid, step.surface.bounds_mm
    around: dict[int, float] = {}
    met = {}
    for number, surface in enumerate(scene.surfaces):
        low, high = surface.bounds_mm
        if (box[1] <= low).any() or (high <= box[0]).any():
            continue
        host = _solid(surface)
        if not (host ^ body).is_empty():
            met[number] = host
            if _difference(body, host, step.name).is_empty():
                around[number] = host.volume()
    # From the outside in, as long as each says that it is in the one before.
    outside, density = scene.ambient, None
    for number in sorted(around, key=lambda number: -around[number]):
        surface = scene.surfaces[number]
        if surface.outside == outside:
            outside, density = surface.inside, surface.inside_density
            del met[number]
    left = {number: _difference(host, body, scene.surfaces[number].name) for number, host in met.items()}
    assert step.material is not None
    own = Surface(step.surface.arrays, step.material, outside, step.name, outside_density=density)
    return replace_surfaces(scene, left, own)


def resected(scene: Scene, step: SurgicalStep, implants: Iterable[str] = ()) -> Scene:
    """The scene without the bone, cartilage and menisci that lie in the volume of a step.

    implants  names of surfaces that stay
    raises    InputError for a volume that meets none of them
    """
    kept, left = set(implants), {}
    # What bone holds an implant stays bone there to the ray sum, since the implant's surface says that it is within it.
    bodies = [_solid(surface) for surface in scene.surfaces if surface.name in kept]
    volume = Manifold.batch_boolean([step.solid, *bodies], manifold3d.OpType.Subtract)
    for number, surface in enumerate(scene.surfaces):
        part = surface.name.split("_")[0] in BONES or surface.name in _MENISCI
        if part and surface.name not in kept:
            host = _solid(surface)
            if not (host ^ volume).is_empty():
                left[number] = _difference(host, volume, surface.name)
    if not left:
        low, high = step.surface.bounds_mm.round(1).tolist()
        raise InputError(f"{step.name}: mesh must meet bone, cartilage or a meniscus, got none from {low} to {high} mm")
    return replace_surfaces(scene, left)


def replace_surfaces(scene: Scene, left: dict[int, Manifold], *more: Surface) -> Scene:
    """The scene with solids in the place of some of its surfaces, by number, and with more surfaces; empty ones go."""
    surfaces = []
    for number, surface in enumerate(scene.surfaces):
        if number not in left:
            surfaces.append(surface)
        elif not left[number].is_empty():
            whole = Mesh(surface.solid.points, surface.solid.faces)
            surfaces.append(replace(surface, mesh=with_uncut_faces(mesh_of(left[number]), whole)))
    return Scene([*surfaces, *more], scene.ambient, scene.size_mm)


def after_surgery(solids: dict[str, Mesh], scene: Scene, steps: Sequence[SurgicalStep]) -> dict[str, Mesh]:
    """Parts of a knee, by name, without what surgical steps have taken of them, and the implants of its scene."""
    left = {}
    for name, mesh in solids.items() if steps else ():
        whole = part = solid_of(mesh.vertices, mesh.faces, name)
        for solid in (step.solid for step in steps):
            part = part if (part ^ solid).is_empty() else _difference(part, solid, name)
        if not part.is_empty():
            left[name] = mesh if part is whole else mesh_of(part)
    implants = {step.name for step in steps if step.material is not None}
    bodies = {surface.name: surface.solid for surface in scene.surfaces if surface.name in implants}
    return (left if steps else solids) | {name: Mesh(body.points, body.faces) for name, body in bodies.items()}


def _given(built: Operable, mesh: Any, material: str, name: str) -> Surface:
    """The surface of a mesh that a user gives, with arrays of its own."""
    if not isinstance(name, str) or not re.fullmatch(_NAME, name, re.ASCII) or name.endswith(_KEPT_ENDINGS):
        allowed = f"1 to 50 letters, digits, _ and -, without {' or '.join(_KEPT_ENDINGS)} at its end"
        raise InputError(f"name must be {allowed}, got {name!r}")
    used = [surface.name for surface in built.scene.surfaces] + [step.name for step in built.surgery]
    if name in used:
        raise InputError(f"name must be new to the knee, got {name!r}: it has {', '.join(used)}")
    if not is_mesh(mesh):
        raise InputError(f"{name}: mesh must be a trimesh.Trimesh, got {reprlib.repr(mesh)}")
    own = Mesh(np.array(mesh.vertices, np.float64), np.array(mesh.faces))
    surface = Surface(own, material, "muscle", name)
    require_sound(surface.solid)
    _require_apart(surface)
    return surface


def _require_apart(surface: Surface) -> None:
    """Refuse bodies of one mesh that overlap: a ray would count the overlap twice."""
    bodies = [body for body in _solid(surface).decompose() if body.volume() > 0]
    whole = sum(body.volume() for body in bodies)
    shared = whole - Manifold.batch_boolean(bodies, manifold3d.OpType.Add).volume()
    if len(bodies) > 1 and shared > _SHARED_MM3 + 1e-9 * whole:
        raise InputError(
            f"{surface.name}: mesh must be of bodies that do not overlap, got {len(bodies)} that share {shared:.3g} "
            "mm3: insert them one by one, or unite them"
        )


def _solid(surface: Surface) -> Manifold:
    require_sound(surface.solid)
    return solid_of(surface.solid.points, surface.solid.faces, surface.name)


def _difference(one: Manifold, other: Manifold, name: str) -> Manifold:
    """One solid without another, and without splinters that are left where faces of both coincide."""
    left = one - other
    if left.status() != manifold3d.Error.NoError:
        raise InputError(f"solid {name}: status {left.status().name} of a boolean; allowed: NoError")
    pieces = left.decompose()
    large = [piece for piece in pieces if abs(piece.volume()) > _SPLINTER_MM3]
    return left if len(large) == len(pieces) else Manifold.compose(large)
