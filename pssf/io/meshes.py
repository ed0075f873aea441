"""Scenes as mesh files: STL and PLY, one file a surface, GLB and 3MF, one object a surface with its name and colour."""

import io
import zipfile
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual.material import PBRMaterial

from ..core.checks import InputError, require, require_choice, require_path
from ..core.keywords import keywords
from ..geometry.repair import require_sound
from ..geometry.scene import Scene, Surface
from .atomic import folder, write_bytes
from .exported_scenes import NAMESPACE, described

FORMATS = ("stl", "ply", "glb", "3mf")
Colour = tuple[int, int, int, int]
# Half-transparent shells, so that the nesting is seen: red, green, blue, opacity.
_COLOURS = {
    "cortical_bone": (236, 226, 198, 140),
    "trabecular_bone": (214, 168, 120, 150),
    "marrow": (232, 196, 90, 200),
    "cartilage": (160, 200, 230, 160),
    "tendon": (226, 214, 206, 170),
    "muscle": (170, 60, 55, 60),
    "adipose": (240, 214, 120, 40),
    "skin": (224, 172, 140, 40),
    # Of a radiograph, beside the solids that it is of.
    "beam": (86, 180, 233, 14),
    "detector": (70, 84, 110, 170),
}
_MILLIMETRES, _M_PER_MM = "millimetres", 0.001
_OTHER = (150, 150, 160, 120)
_CONTENT_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="model" Target="/3D/3dmodel.model"
 Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""


@keywords()
def export_meshes(
    scene: Scene,
    directory: str | Path,
    *,
    formats: tuple[str, ...] = FORMATS,
    stem: str = "knee",
    tolerance_mm: float = 0.0,
) -> list[Path]:
    """Write the surfaces of a scene, in mm: <stem>.glb and .3mf with all of them, and <stem>-<surface>.stl and .ply.

    formats       any of "stl", "ply", "glb", "3mf"
    tolerance_mm  triangles may be merged as long as no surface moves by more, for smaller files; 0 keeps every one
    returns       the files written
    raises        InputError for another format, a stem that leads elsewhere, a mesh that bounds no solid, or a
                  disk that cannot be written
    """
    require_export(formats, tolerance_mm)
    if not isinstance(stem, str) or not stem.strip(".") or set(stem) & set("/\\\0"):
        raise InputError(f"stem = {stem!r}; allowed: how a file is called, without a folder")
    if not isinstance(scene, Scene):
        raise InputError(f"scene = {scene!r}; allowed: a Scene, such as build(knee).scene")
    scene = simplified(scene, tolerance_mm)
    directory = folder(require_path(directory, "folder"))
    written = []
    for kind in formats:
        for suffix, content in _contents(scene, kind):
            path = directory / f"{stem}{suffix}"
            write_bytes(path, content)
            written.append(path)
    return written


def require_export(formats: tuple[str, ...], tolerance_mm: float) -> None:
    """Refuse what `export_meshes` would.

    raises  InputError for another format, or a tolerance that is out of range
    """
    if isinstance(formats, str) or not isinstance(formats, Collection):
        raise InputError(f"formats = {formats!r}; allowed: any of {', '.join(FORMATS)}")
    for name in formats:
        require_choice("format", name, FORMATS)
    require("tolerance_mm", tolerance_mm, 0, 10, "mm")


def colour_of(material: str) -> Colour:
    """Red, green, blue and opacity, 0 to 255, in which a material is drawn; outer shells let more through."""
    return _COLOURS.get(material, _OTHER)


def simplified(scene: Scene, tolerance_mm: float) -> Scene:
    """The scene with triangles merged where no surface moves by more than tolerance_mm; 0 keeps every one.

    raises  InputError for a mesh that bounds no solid, or a tolerance that is out of range
    """
    require("tolerance_mm", tolerance_mm, 0, 10, "mm")
    for surface in scene.surfaces:
        require_sound(surface.solid)
    if tolerance_mm == 0:
        return scene
    return Scene([_reduced(surface, tolerance_mm) for surface in scene.surfaces], scene.ambient, scene.size_mm)


def unique_names(scene: Scene) -> list[str]:
    """The names of the surfaces in their order; where one comes again it gets a number."""
    names: list[str] = []
    for surface in scene.surfaces:
        name, count = surface.name, 2
        while name in names:
            name, count = f"{surface.name}_{count}", count + 1
        names.append(name)
    return names


def glb(scene: Scene) -> bytes:
    """The scene as binary glTF: one node a surface, innermost last, in mm below a root that scales them to metres.

    glTF 2.0, 3.3: "The units for all linear distances are meters."
    """
    nodes = trimesh.Scene(metadata={"ambient": scene.ambient})
    nodes.graph.update(frame_to=_MILLIMETRES, matrix=np.diag([_M_PER_MM] * 3 + [1.0]))
    for name, surface in zip(unique_names(scene), scene.surfaces, strict=True):
        nodes.add_geometry(_with_material(surface), node_name=name, geom_name=name, parent_node_name=_MILLIMETRES)
    return bytes(nodes.export(file_type="glb"))


def threemf(scene: Scene) -> bytes:
    """The scene as 3MF (core specification 1.3): millimetres, one named object a surface with material and colour.

    One assembly holds them, larger before smaller: where components overlap the last one's material holds, so that a
    consumer reads nested shells as the rays do. The same scene gives the same bytes.
    """
    buffer = io.BytesIO()
    parts = {"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONSHIPS, "3D/3dmodel.model": _model(scene)}
    with zipfile.ZipFile(buffer, "w") as package:
        for name, text in parts.items():
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            package.writestr(entry, text.encode("utf-8"))
    return buffer.getvalue()


def _contents(scene: Scene, kind: str) -> Iterator[tuple[str, bytes]]:
    """What the files of a format end on, and what they hold."""
    if kind == "glb":
        yield ".glb", glb(scene)
    elif kind == "3mf":
        yield ".3mf", threemf(scene)
    else:
        write = {"stl": _stl, "ply": _ply}[kind]
        for name, surface in zip(unique_names(scene), scene.surfaces, strict=True):
            yield f"-{name}.{kind}", write(surface)


def _mesh(surface: Surface) -> trimesh.Trimesh:
    """What the rays see of a surface."""
    return trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)


def _about(surface: Surface) -> str:
    return f"{surface.name}: {surface.inside} in {surface.outside}, mm"


def _stl(surface: Surface) -> bytes:
    """Binary STL; it has no colours, but 80 bytes for a remark, which must not begin with "solid"."""
    content = _mesh(surface).export(file_type="stl")
    assert isinstance(content, bytes)
    return f"STL {_about(surface)}".encode("ascii", "replace")[:80].ljust(80) + content[80:]


def _ply(surface: Surface) -> bytes:
    """Binary PLY; every vertex in the colour of the material, and a remark."""
    mesh = _mesh(surface)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(_rgba(surface), (len(mesh.vertices), 1)))
    content = mesh.export(file_type="ply")
    assert isinstance(content, bytes)
    remark = f"comment {_about(surface)}".encode("ascii", "replace")
    return content.replace(b"\nelement vertex", b"\n" + remark + b"\nelement vertex", 1)


def _rgba(surface: Surface) -> NDArray[np.uint8]:
    return np.array(colour_of(surface.inside), np.uint8)


def _model(scene: Scene) -> str:
    """The XML of a 3MF document."""
    names = unique_names(scene)
    materials = list(dict.fromkeys(surface.inside for surface in scene.surfaces))
    colours = {name: "#" + bytes(colour_of(name)).hex().upper() for name in materials}
    bases = [f"<base name={quoteattr(name)} displaycolor={quoteattr(colours[name])}/>" for name in materials]
    objects = []
    for number, (name, surface) in enumerate(zip(names, scene.surfaces, strict=True), start=2):
        kind = f'type="{_object_type(surface)}" name={quoteattr(name)} pid="1"'
        about = "".join(_metadata(f"pssf:{key}", value) for key, value in described(surface).items())
        group = f"<metadatagroup>{about}</metadatagroup>"
        objects.append(
            f'<object id="{number}" {kind} pindex="{materials.index(surface.inside)}">{group}{_xml(surface)}'
        )
    inwards = np.argsort([-_mesh(surface).volume for surface in scene.surfaces], kind="stable") + 2
    whole = len(names) + 2
    return "\n".join([
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<model unit="millimeter" xml:lang="en" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        f'xmlns:pssf="{NAMESPACE}">',
        _metadata("Title", ", ".join(names)), _metadata("Application", "pssf"),
        _metadata("pssf:ambient", scene.ambient),
        '<resources><basematerials id="1">', *bases, "</basematerials>", *objects,
        f'<object id="{whole}" type="model" name="scene"><components>',
        *(f'<component objectid="{number}"/>' for number in inwards),
        f'</components></object></resources><build><item objectid="{whole}"/></build></model>\n',
    ])  # fmt: skip


def _metadata(name: str, value: str | list[str]) -> str:
    return f'<metadata name="{name}">{escape(value if isinstance(value, str) else ", ".join(value))}</metadata>'


def _object_type(surface: Surface) -> str:
    """A 3MF "model" has two faces at every edge; a solid whose bodies share an edge is only a "surface" there."""
    faces = surface.solid.faces.astype(np.int64)
    start, end = (faces[:, order].ravel() for order in ([0, 1, 2], [1, 2, 0]))
    return "model" if len(np.unique(start * len(surface.solid.points) + end)) == len(start) else "surface"


def _xml(surface: Surface) -> str:
    """Mesh and end of a 3MF object; nine digits give back any float32, which is what most readers keep."""
    points = [f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in surface.solid.points.tolist()]
    faces = [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in surface.solid.faces.tolist()]
    parts = ["<mesh><vertices>", *points, "</vertices><triangles>", *faces, "</triangles></mesh></object>"]
    return "\n".join(parts)


def _reduced(surface: Surface, tolerance_mm: float) -> Surface:
    # Copies, because manifold3d takes no array that is read-only.
    mesh = manifold3d.Mesh64(np.array(surface.solid.points), surface.solid.faces.astype(np.uint64))
    reduced = manifold3d.Manifold(mesh).simplify(tolerance_mm).to_mesh64()
    faces = reduced.tri_verts.astype(np.int64)
    return replace(surface, mesh=trimesh.Trimesh(reduced.vert_properties[:, :3], faces, process=False))


def _with_material(surface: Surface) -> trimesh.Trimesh:
    material = PBRMaterial(
        name=surface.inside,
        baseColorFactor=_rgba(surface),
        alphaMode="BLEND",
        metallicFactor=0.0,
        roughnessFactor=0.7,
        doubleSided=True,
    )
    mesh = _mesh(surface)
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    mesh.metadata = described(surface)
    return mesh
