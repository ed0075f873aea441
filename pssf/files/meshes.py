"""Scenes as mesh files: STL and PLY, one file a surface, and GLB, one node a surface with name, material and colour."""

from dataclasses import replace
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial

from ..checks import InputError, require, require_choice
from ..mending import require_sound
from ..scene import Scene, Surface
from .atomic import folder, write_bytes

FORMATS = ("stl", "ply", "glb")
# Half-transparent shells, so that the nesting is seen: red, green, blue, opacity.
_COLOURS = {
    "cortical_bone": (236, 226, 198, 140),
    "trabecular_bone": (214, 168, 120, 150),
    "marrow": (232, 196, 90, 200),
    "cartilage": (160, 200, 230, 160),
    "muscle": (170, 60, 55, 60),
    "adipose": (240, 214, 120, 40),
    "skin": (224, 172, 140, 40),
}
_OTHER = (150, 150, 160, 120)


def export_meshes(
    scene: Scene,
    directory: str | Path,
    *,
    formats: tuple[str, ...] = FORMATS,
    stem: str = "knee",
    tolerance_mm: float = 0.0,
) -> list[Path]:
    """Write the surfaces of a scene, in mm: <stem>.glb with one named node each, and <stem>-<surface>.stl and .ply.

    formats       any of "stl", "ply", "glb"
    tolerance_mm  triangles may be merged as long as no surface moves by more, for smaller files; 0 keeps every one
    returns       the files written
    raises        InputError for another format, a mesh that bounds no solid, or a disk that cannot be written
    """
    require("tolerance_mm", tolerance_mm, 0, 10, "mm")
    for name in formats:
        require_choice("format", name, FORMATS)
    for surface in scene.surfaces:
        require_sound(surface.solid)
    directory = folder(Path(directory))
    if tolerance_mm > 0:
        scene = Scene([_simplified(surface, tolerance_mm) for surface in scene.surfaces], scene.ambient)
    names = _unique_names(scene)
    written = []
    for kind in formats:
        if kind == "glb":
            path = directory / f"{stem}.glb"
            write_bytes(path, glb(scene))
            written.append(path)
            continue
        for name, surface in zip(names, scene.surfaces, strict=True):
            path = directory / f"{stem}-{name}.{kind}"
            content = _mesh(surface).export(file_type=kind)
            assert isinstance(content, bytes)
            write_bytes(path, content)
            written.append(path)
    return written


def glb(scene: Scene) -> bytes:
    """The scene as binary glTF; millimetres, one node a surface, innermost last."""
    nodes = trimesh.Scene()
    for name, surface in zip(_unique_names(scene), scene.surfaces, strict=True):
        nodes.add_geometry(_coloured(surface), node_name=name, geom_name=name)
    return bytes(nodes.export(file_type="glb"))


def read_mesh(path: str | Path) -> trimesh.Trimesh:
    """A mesh file (STL, PLY, OBJ, GLB ...), millimetres; equal corners are welded, as STL needs it.

    raises  InputError for a file that is missing or not a mesh
    """
    path = Path(path)
    try:
        mesh = trimesh.load_mesh(path, process=True)
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable mesh file") from None
    except Exception as error:  # mesh readers fail in many ways on a damaged file
        raise InputError(f"file {path}: not a mesh ({type(error).__name__}); allowed: STL, PLY, OBJ or GLB") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"file {path}: holds no faces; allowed: STL, PLY, OBJ or GLB with a closed mesh")
    return mesh


def _mesh(surface: Surface) -> trimesh.Trimesh:
    """What the rays see of a surface."""
    return trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)


def _simplified(surface: Surface, tolerance_mm: float) -> Surface:
    mesh = manifold3d.Mesh64(surface.solid.points, surface.solid.faces.astype(np.uint64))
    reduced = manifold3d.Manifold(mesh).simplify(tolerance_mm).to_mesh64()
    faces = reduced.tri_verts.astype(np.int64)
    return replace(surface, mesh=trimesh.Trimesh(reduced.vert_properties[:, :3], faces, process=False))


def _coloured(surface: Surface) -> trimesh.Trimesh:
    red, green, blue, opacity = _COLOURS.get(surface.inside, _OTHER)
    material = PBRMaterial(
        name=surface.inside,
        baseColorFactor=[red, green, blue, opacity],
        alphaMode="BLEND",
        metallicFactor=0.0,
        roughnessFactor=0.7,
        doubleSided=True,
    )
    mesh = _mesh(surface)
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    mesh.metadata = {"inside": surface.inside, "outside": surface.outside, "unit": "mm"}
    return mesh


def _unique_names(scene: Scene) -> list[str]:
    names: list[str] = []
    for surface in scene.surfaces:
        name, count = surface.name, 2
        while name in names:
            name, count = f"{surface.name}_{count}", count + 1
        names.append(name)
    return names
