"""read_exported: scenes that `export_meshes` wrote as GLB or 3MF, with the names and materials of their surfaces."""

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

from ..core.checks import InputError
from ..data.userfiles import read_bytes
from ..geometry.mesh import Mesh
from ..geometry.scene import MeshNotice, Scene, Surface
from .mesh_faults import require_whole

SUFFIXES = (".glb", ".3mf")
# Of this package's own names in a 3MF, which must have a namespace there.
NAMESPACE = "https://pypi.org/project/pssf"
_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_ALLOWED = "what export_meshes wrote, or a TOML file that names meshes and their materials"
# What is known of a scene, what of its surfaces, and their meshes.
_Parts = tuple[dict[str, Any], list[tuple[dict[str, Any], Mesh]]]


def described(surface: Surface) -> dict[str, Any]:
    """Give what a file keeps of a surface beside its mesh: names, and what its densities are, which no file holds."""
    densities = (surface.inside_density, surface.outside_density)
    varying = [type(density).__name__ for density in densities if density is not None]
    return {
        **{"name": surface.name, "inside": surface.inside, "outside": surface.outside, "unit": "mm"},
        **({"densities": varying} if varying else {}),
    }


def read_exported(path: Path) -> Scene:
    """Read a scene from a GLB or 3MF that `export_meshes` wrote.

    Raises
    ------
    InputError
        The file cannot be read, is cut off, or names no materials.

    Warns
    -----
    MeshNotice
        Densities that varied within a surface are not in the file.
    """
    content = read_bytes(path, allowed=_ALLOWED)
    require_whole(content, path)
    try:
        about, parts = _of_glb(content) if path.suffix.lower() == ".glb" else _of_3mf(content)
    except Exception as error:  # a damaged file can fail anywhere in its readers
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise InputError(f"file {path} must be a whole {path.suffix[1:].upper()}, got {reason}") from None
    named = [(known, mesh) for known, mesh in parts if {"inside", "outside"} <= set(known)]
    if not named or len(named) < len(parts):
        raise InputError(f"file {path} must name materials of its {len(parts)} meshes, got {len(named)}: {_ALLOWED}")
    lost = [str(known.get("name", "surface")) for known, _ in named if known.get("densities")]
    if lost:
        warnings.warn(
            f"file {path}: densities within {', '.join(lost)} are not in it; they are uniform now; build the knee "
            "again for its trabecular bone",
            MeshNotice,
            stacklevel=3,
        )
    surfaces = [
        Surface(mesh, known["inside"], known["outside"], str(known.get("name", "surface"))) for known, mesh in named
    ]
    return Scene(surfaces, str(about.get("ambient", "air")))


def materials_of(content: bytes) -> int:
    """Count the meshes of a GLB that name what is inside and outside of them, as this package writes it."""
    length = int.from_bytes(content[12:16], "little")
    try:
        meshes = json.loads(content[20 : 20 + length]).get("meshes", [])
        return sum("inside" in mesh.get("extras", {}) for mesh in meshes)
    except (ValueError, RecursionError, AttributeError, TypeError):
        return 0


def _of_glb(content: bytes) -> _Parts:
    nodes = trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)
    parts, order = [], list(nodes.geometry)
    # The graph has its nodes in no order.
    for node in sorted(nodes.graph.nodes_geometry, key=lambda node: (order.index(nodes.graph[node][1]), node)):
        to_metres, name = nodes.graph[node]
        mesh = nodes.geometry[name]
        to_mm = 1000.0 * to_metres[:3]
        # Not multiplied where nothing would change, so that every bit stays.
        still = np.array_equal(to_mm, np.eye(3, 4))
        points = np.asarray(mesh.vertices, np.float64)
        points = points if still else points @ to_mm[:, :3].T + to_mm[:, 3]
        parts.append(({"name": node, **mesh.metadata}, Mesh(points, np.asarray(mesh.faces))))
    return nodes.metadata, parts


def _of_3mf(content: bytes) -> _Parts:
    with zipfile.ZipFile(io.BytesIO(content)) as package:
        root = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    materials = [base.get("name") for base in root.iter(f"{_CORE}base")]
    parts = [(_known(one, materials), _mesh(mesh)) for one, mesh in _objects(root)]
    return _said(root), parts


def _objects(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, ElementTree.Element]]:
    for one in root.iter(f"{_CORE}object"):
        mesh = one.find(f"{_CORE}mesh")
        if mesh is not None:
            yield one, mesh


def _known(one: ElementTree.Element, materials: list[str | None]) -> dict[str, Any]:
    group = one.find(f"{_CORE}metadatagroup")
    known: dict[str, Any] = {"name": one.get("name"), "inside": materials[int(one.get("pindex", -1))]}
    return known | ({} if group is None else _said(group))


def _said(element: ElementTree.Element) -> dict[str, Any]:
    """This package's own metadata of a model or an object."""
    entries = {entry.get("name", ""): entry.text or "" for entry in element.findall(f"{_CORE}metadata")}
    return {name.removeprefix("pssf:"): text for name, text in entries.items() if name.startswith("pssf:")}


def _mesh(element: ElementTree.Element) -> Mesh:
    vertices, triangles = (list(element.iter(f"{_CORE}{name}")) for name in ("vertex", "triangle"))
    points = [[float(vertex.attrib[axis]) for axis in "xyz"] for vertex in vertices]
    faces = [[int(triangle.attrib[corner]) for corner in ("v1", "v2", "v3")] for triangle in triangles]
    return Mesh(np.array(points, np.float64).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3))
