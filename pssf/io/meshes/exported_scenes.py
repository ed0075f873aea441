"""Read scenes that `export_meshes` wrote as GLB or 3MF, with the names and materials of their surfaces."""

import io
import json
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from ...core.checks import InputError
from ...data.user_files import read_bytes
from ...geometry.mesh import Mesh
from ...geometry.scene import MeshNotice, Scene, Surface
from .mesh_faults import require_complete_mesh_file

SUFFIXES = (".glb", ".3mf")
# XML namespace of the metadata that this package writes; 3MF requires a namespace for custom metadata.
NAMESPACE = "https://pypi.org/project/pssf"
_CORE_NAMESPACE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_ALLOWED = "a GLB or 3MF file from export_meshes, or a TOML file that names meshes and their materials"
# Scene metadata, and a list of (metadata, mesh) pairs, one pair per surface.
_SceneParts = tuple[dict[str, Any], list[tuple[dict[str, Any], Mesh]]]


def describe_surface(surface: Surface) -> dict[str, Any]:
    """Return the metadata that a mesh file stores for a surface: name, materials and unit.

    Parameters
    ----------
    surface : Surface
        Surface to describe.

    Returns
    -------
    dict of str to object
        JSON-compatible entries name, inside, outside and unit. If the density within a material varies, the entry
        densities lists the class names of the density models. The density values are not exported.
    """
    densities = (surface.inside_density, surface.outside_density)
    varying = [type(density).__name__ for density in densities if density is not None]
    return {
        **{"name": surface.name, "inside": surface.inside, "outside": surface.outside, "unit": "mm"},
        **({"densities": varying} if varying else {}),
    }


def read_exported_scene(path: Path) -> Scene:
    """Read a scene from a GLB or 3MF that `export_meshes` wrote.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    Scene
        Scene with the names and materials of its surfaces.

    Raises
    ------
    InputError
        The file cannot be read, is incomplete, or does not specify the materials of its surfaces.

    Warns
    -----
    MeshNotice
        A material of the exported scene had a varying density, which the file does not contain.
    """
    content = read_bytes(path, allowed=_ALLOWED)
    require_complete_mesh_file(content, path)
    try:
        about, parts = _read_glb(content) if path.suffix.lower() == ".glb" else _read_3mf(content)
    except Exception as error:  # The GLB and 3MF readers raise many kinds of errors for a damaged file.
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise InputError(f"file {path} must be a complete {path.suffix[1:].upper()}, got {reason}") from None
    named = [(known, mesh) for known, mesh in parts if {"inside", "outside"} <= set(known)]
    if not named or len(named) < len(parts):
        raise InputError(
            f"file {path} must specify the materials of all {len(parts)} meshes, got materials of {len(named)}: "
            f"use {_ALLOWED}"
        )
    lost = [str(known.get("name", "surface")) for known, _ in named if known.get("densities")]
    if lost:
        warnings.warn(
            f"file {path} does not contain the varying densities within {', '.join(lost)}, so each material "
            "gets a uniform density; build the scene from the knee parameters to keep the trabecular structure",
            MeshNotice,
            stacklevel=3,
        )
    surfaces = [
        Surface(mesh, known["inside"], known["outside"], str(known.get("name", "surface"))) for known, mesh in named
    ]
    return Scene(surfaces, str(about.get("ambient", "air")))


def count_described_meshes(content: bytes) -> int:
    """Count the meshes of a GLB that have the material metadata of this package.

    Parameters
    ----------
    content : bytes
        Content of a GLB file.

    Returns
    -------
    int
        Number of meshes; 0 if the content is not a GLB.
    """
    length = int.from_bytes(content[12:16], "little")
    try:
        meshes = json.loads(content[20 : 20 + length]).get("meshes", [])
        return sum("inside" in mesh.get("extras", {}) for mesh in meshes)
    except (ValueError, RecursionError, AttributeError, TypeError):
        return 0


def _read_glb(content: bytes) -> _SceneParts:
    """Read the scene data and the surfaces of a GLB, in the order of the file."""
    nodes = trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)
    parts, order = [], list(nodes.geometry)
    # Nodes are sorted, because the scene graph of trimesh does not keep their order.
    for node in sorted(nodes.graph.nodes_geometry, key=lambda node: (order.index(nodes.graph[node][1]), node)):
        to_metres, name = nodes.graph[node]
        mesh = nodes.geometry[name]
        to_mm = 1000.0 * to_metres[:3]
        # An identity transformation is not applied, so that vertices stay bit-identical.
        still = np.array_equal(to_mm, np.eye(3, 4))
        points = np.asarray(mesh.vertices, np.float64)
        points = points if still else points @ to_mm[:, :3].T + to_mm[:, 3]
        parts.append(({"name": node, **mesh.metadata}, Mesh(points, np.asarray(mesh.faces))))
    return nodes.metadata, parts


def _read_3mf(content: bytes) -> _SceneParts:
    """Read the scene data and the surfaces of a 3MF, in the order of the file."""
    with zipfile.ZipFile(io.BytesIO(content)) as package:
        root = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    materials = [base.get("name") for base in root.iter(f"{_CORE_NAMESPACE}base")]
    parts = [(_read_object_metadata(one, materials), _read_mesh_element(mesh)) for one, mesh in _find_objects(root)]
    return _read_metadata(root), parts


def _find_objects(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, ElementTree.Element]]:
    """Yield the objects of a 3MF that contain a mesh, each with its mesh element."""
    for one in root.iter(f"{_CORE_NAMESPACE}object"):
        mesh = one.find(f"{_CORE_NAMESPACE}mesh")
        if mesh is not None:
            yield one, mesh


def _read_object_metadata(element: ElementTree.Element, materials: list[str | None]) -> dict[str, Any]:
    """Read the name, material and metadata of a 3MF object."""
    group = element.find(f"{_CORE_NAMESPACE}metadatagroup")
    known: dict[str, Any] = {"name": element.get("name"), "inside": materials[int(element.get("pindex", -1))]}
    return known | ({} if group is None else _read_metadata(group))


def _read_metadata(element: ElementTree.Element) -> dict[str, Any]:
    """Read the metadata that this package wrote into a model or object of a 3MF."""
    entries = {entry.get("name", ""): entry.text or "" for entry in element.findall(f"{_CORE_NAMESPACE}metadata")}
    return {name.removeprefix("pssf:"): text for name, text in entries.items() if name.startswith("pssf:")}


def _read_mesh_element(element: ElementTree.Element) -> Mesh:
    """Build the mesh of a 3MF mesh element; vertices are in mm."""
    vertices, triangles = (list(element.iter(f"{_CORE_NAMESPACE}{name}")) for name in ("vertex", "triangle"))
    points = [[float(vertex.attrib[axis]) for axis in "xyz"] for vertex in vertices]
    faces = [[int(triangle.attrib[corner]) for corner in ("v1", "v2", "v3")] for triangle in triangles]
    return Mesh(np.array(points, np.float64).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3))
