"""Export scenes as mesh files: STL and PLY with one file per surface, GLB and 3MF with one object per surface."""

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

from ...core.checks import (
    InputError,
    require_choice,
    require_in_range,
    require_path,
)
from ...core.keyword_arguments import check_keywords
from ...geometry.mesh_repair import require_usable_solid
from ...geometry.scene import Scene, Surface
from ..atomic_write import make_folder, write_bytes
from .exported_scenes import NAMESPACE, describe_surface

FORMATS = ("stl", "ply", "glb", "3mf")
Colour = tuple[int, int, int, int]
# Red, green, blue and opacity of each material, 0 to 255. Outer solids are translucent to show inner solids.
_COLOURS = {
    "cortical_bone": (236, 226, 198, 140),
    "trabecular_bone": (214, 168, 120, 150),
    "marrow": (232, 196, 90, 200),
    "cartilage": (160, 200, 230, 160),
    "tendon": (226, 214, 206, 170),
    "muscle": (170, 60, 55, 60),
    "adipose": (240, 214, 120, 40),
    "skin": (224, 172, 140, 40),
    # Colours of the beam and the detector on the viewer page.
    "beam": (86, 180, 233, 14),
    "detector": (70, 84, 110, 170),
}
_MILLIMETRES = "millimetres"  # name of the GLB root node, which scales millimetres to metres
_M_PER_MM = 0.001  # metres per millimetre
# Red, green, blue and opacity, 0 to 255, of materials that are not in `_COLOURS`.
_OTHER_COLOUR = (150, 150, 160, 120)
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


@check_keywords()
def export_meshes(
    scene: Scene,
    directory: str | Path,
    *,
    formats: tuple[str, ...] = FORMATS,
    stem: str = "knee",
    tolerance_mm: float = 0.0,
) -> list[Path]:
    """Write the surfaces of a scene as mesh files, in mm.

    GLB and 3MF have all surfaces in one file, STEM.glb or STEM.3mf. STL and PLY have one file per surface,
    STEM-SURFACE.stl or STEM-SURFACE.ply.

    Parameters
    ----------
    scene : Scene
        Scene to write, such as ``build(knee).scene``.
    directory : str or Path
        Folder into which the files are written; created if it does not exist.
    formats : tuple of str
        One or more of "stl", "ply", "glb" and "3mf".
    stem : str
        Prefix of the file names, without a folder.
    tolerance_mm : float
        Largest surface displacement that mesh simplification may cause, 0 to 10 mm; 0 keeps every triangle.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    InputError
        A format, stem or tolerance is not allowed, a mesh is not a closed solid, or a file cannot be written.

    See Also
    --------
    read_scene : Read a GLB or 3MF with the materials of its surfaces.
    read_mesh : Read a single mesh.

    Examples
    --------
    >>> import tempfile
    >>> import pssf, trimesh
    >>> sphere = pssf.Surface(trimesh.creation.icosphere(radius=40.0), "water", "air", "sphere")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = pssf.export_meshes(pssf.Scene([sphere]), folder, formats=("stl", "glb"), stem="phantom")
    >>> [path.name for path in paths]
    ['phantom-sphere.stl', 'phantom.glb']
    """
    require_export_options(formats, tolerance_mm)
    if not isinstance(stem, str) or not stem.strip(".") or set(stem) & set("/\\\0"):
        raise InputError(f"stem must be a file name without a folder, got {stem!r}")
    if not isinstance(scene, Scene):
        raise InputError(f"scene must be a Scene, such as build(knee).scene, got {scene!r}")
    scene = simplify_scene(scene, tolerance_mm)
    directory = make_folder(require_path(directory, "folder"))
    written = []
    for kind in formats:
        for suffix, content in _encode_files(scene, kind):
            path = directory / f"{stem}{suffix}"
            write_bytes(path, content)
            written.append(path)
    return written


def require_export_options(formats: tuple[str, ...], tolerance_mm: float) -> None:
    """Check the formats and the tolerance of `export_meshes`.

    Parameters
    ----------
    formats : tuple of str
        One or more of "stl", "ply", "glb" and "3mf".
    tolerance_mm : float
        Simplification tolerance, 0 to 10 mm.

    Raises
    ------
    InputError
        A format is not supported, or the tolerance is out of range.
    """
    if isinstance(formats, str) or not isinstance(formats, Collection):
        raise InputError(f"formats must be a tuple of one or more of {', '.join(FORMATS)}, got {formats!r}")
    for name in formats:
        require_choice("format", name, FORMATS)
    require_in_range("tolerance_mm", tolerance_mm, 0, 10, "mm")


def material_colour(material: str) -> Colour:
    """Return the display colour of a material; outer tissues are more transparent.

    Parameters
    ----------
    material : str
        Name of the material.

    Returns
    -------
    tuple of int
        Red, green, blue and opacity, 0 to 255; grey for a material without a defined colour.
    """
    return _COLOURS.get(material, _OTHER_COLOUR)


def simplify_scene(scene: Scene, tolerance_mm: float) -> Scene:
    """Simplify the triangle meshes of a scene without moving any surface by more than a tolerance.

    Parameters
    ----------
    scene : Scene
        Scene to simplify.
    tolerance_mm : float
        Largest allowed surface displacement, 0 to 10 mm; 0 keeps every triangle.

    Returns
    -------
    Scene
        Simplified scene; the same object if the tolerance is 0.

    Raises
    ------
    InputError
        A mesh is not a closed solid, or the tolerance is out of range.
    """
    require_in_range("tolerance_mm", tolerance_mm, 0, 10, "mm")
    for surface in scene.surfaces:
        require_usable_solid(surface.solid)
    if tolerance_mm == 0:
        return scene
    return Scene(
        [_simplify_surface(surface, tolerance_mm) for surface in scene.surfaces],
        scene.ambient,
        scene.size_mm,
        scene.overlap,
    )


def unique_names(scene: Scene) -> list[str]:
    """Return the names of the surfaces of a scene, with a number added to repeated names.

    Parameters
    ----------
    scene : Scene
        Scene whose surfaces are named.

    Returns
    -------
    list of str
        Unique names, in the order of the surfaces.
    """
    names: list[str] = []
    for surface in scene.surfaces:
        name, count = surface.name, 2
        while name in names:
            name, count = f"{surface.name}_{count}", count + 1
        names.append(name)
    return names


def encode_glb(scene: Scene) -> bytes:
    """Encode a scene as binary glTF, with one node per surface.

    Vertices are in mm, and a root node scales them to metres. glTF 2.0, 3.3: "The units for all linear distances
    are meters."

    Parameters
    ----------
    scene : Scene
        Scene to encode.

    Returns
    -------
    bytes
        Content of a GLB file.
    """
    nodes = trimesh.Scene(metadata={"ambient": scene.ambient})
    nodes.graph.update(frame_to=_MILLIMETRES, matrix=np.diag([_M_PER_MM] * 3 + [1.0]))
    for name, surface in zip(unique_names(scene), scene.surfaces, strict=True):
        nodes.add_geometry(_make_coloured_mesh(surface), node_name=name, geom_name=name, parent_node_name=_MILLIMETRES)
    return bytes(nodes.export(file_type="glb"))


def encode_3mf(scene: Scene) -> bytes:
    """Encode a scene as 3MF (core specification 1.3), in mm, with one named and coloured object per surface.

    One assembly contains the objects, sorted from the largest to the smallest volume. In 3MF the last of two
    overlapping components determines the material, so solids are nested as in the ray caster. The output bytes are
    identical for the same scene.

    Parameters
    ----------
    scene : Scene
        Scene to encode.

    Returns
    -------
    bytes
        Content of a 3MF file.
    """
    buffer = io.BytesIO()
    parts = {
        "[Content_Types].xml": _CONTENT_TYPES,
        "_rels/.rels": _RELATIONSHIPS,
        "3D/3dmodel.model": _format_3mf_model(scene),
    }
    with zipfile.ZipFile(buffer, "w") as package:
        for name, text in parts.items():
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            package.writestr(entry, text.encode("utf-8"))
    return buffer.getvalue()


def _encode_files(scene: Scene, kind: str) -> Iterator[tuple[str, bytes]]:
    """Yield the file-name suffix and the content of every file that a format requires."""
    if kind == "glb":
        yield ".glb", encode_glb(scene)
    elif kind == "3mf":
        yield ".3mf", encode_3mf(scene)
    else:
        write = {"stl": _encode_stl, "ply": _encode_ply}[kind]
        for name, surface in zip(unique_names(scene), scene.surfaces, strict=True):
            yield f"-{name}.{kind}", write(surface)


def _make_mesh(surface: Surface) -> trimesh.Trimesh:
    """Make a trimesh from the repaired solid of a surface, which the ray caster also uses."""
    return trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)


def _format_remark(surface: Surface) -> str:
    """Describe a surface in one line: its name, its materials and the unit."""
    return f"{surface.name}: {surface.inside} in {surface.outside}, mm"


def _encode_stl(surface: Surface) -> bytes:
    """Encode a surface as binary STL, with a description in the header of 80 bytes.

    The header begins with "STL", because "solid" would mark an ASCII file.
    """
    content = _make_mesh(surface).export(file_type="stl")
    assert isinstance(content, bytes)
    return f"STL {_format_remark(surface)}".encode("ascii", "replace")[:80].ljust(80) + content[80:]


def _encode_ply(surface: Surface) -> bytes:
    """Encode a surface as binary PLY, with a comment line and the colour of the material at every vertex."""
    mesh = _make_mesh(surface)
    mesh.visual = trimesh.visual.ColorVisuals(
        mesh, vertex_colors=np.tile(_material_rgba(surface), (len(mesh.vertices), 1))
    )
    content = mesh.export(file_type="ply")
    assert isinstance(content, bytes)
    remark = f"comment {_format_remark(surface)}".encode("ascii", "replace")
    return content.replace(b"\nelement vertex", b"\n" + remark + b"\nelement vertex", 1)


def _material_rgba(surface: Surface) -> NDArray[np.uint8]:
    """Return the RGBA colour of the material inside a surface as a (4,) uint8 array."""
    return np.array(material_colour(surface.inside), np.uint8)


def _format_3mf_model(scene: Scene) -> str:
    """Format the XML model of a 3MF file."""
    names = unique_names(scene)
    materials = list(dict.fromkeys(surface.inside for surface in scene.surfaces))
    colours = {name: "#" + bytes(material_colour(name)).hex().upper() for name in materials}
    bases = [f"<base name={quoteattr(name)} displaycolor={quoteattr(colours[name])}/>" for name in materials]
    objects = []
    for number, (name, surface) in enumerate(zip(names, scene.surfaces, strict=True), start=2):
        kind = f'type="{_object_type(surface)}" name={quoteattr(name)} pid="1"'
        about = "".join(_format_metadata(f"pssf:{key}", value) for key, value in describe_surface(surface).items())
        group = f"<metadatagroup>{about}</metadatagroup>"
        objects.append(
            f'<object id="{number}" {kind} pindex="{materials.index(surface.inside)}">'
            f"{group}{_format_mesh_xml(surface)}"
        )
    inwards = np.argsort([-_make_mesh(surface).volume for surface in scene.surfaces], kind="stable") + 2
    whole = len(names) + 2
    return "\n".join([
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<model unit="millimeter" xml:lang="en" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        f'xmlns:pssf="{NAMESPACE}">',
        _format_metadata("Title", ", ".join(names)), _format_metadata("Application", "pssf"),
        _format_metadata("pssf:ambient", scene.ambient),
        '<resources><basematerials id="1">', *bases, "</basematerials>", *objects,
        f'<object id="{whole}" type="model" name="scene"><components>',
        *(f'<component objectid="{number}"/>' for number in inwards),
        f'</components></object></resources><build><item objectid="{whole}"/></build></model>\n',
    ])  # fmt: skip


def _format_metadata(name: str, value: str | list[str]) -> str:
    """Format a metadata element of a 3MF file."""
    return f'<metadata name="{name}">{escape(value if isinstance(value, str) else ", ".join(value))}</metadata>'


def _object_type(surface: Surface) -> str:
    """Return the 3MF object type: "model" if every edge has two faces, else "surface".

    A mesh edge that two bodies of a solid share has four faces.
    """
    faces = surface.solid.faces.astype(np.int64)
    start, end = (faces[:, order].ravel() for order in ([0, 1, 2], [1, 2, 0]))
    return "model" if len(np.unique(start * len(surface.solid.points) + end)) == len(start) else "surface"


def _format_mesh_xml(surface: Surface) -> str:
    """Format the mesh element of a 3MF object and the end tag of the object.

    Nine digits preserve any float32. Most readers use this precision.
    """
    points = [f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in surface.solid.points.tolist()]
    faces = [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in surface.solid.faces.tolist()]
    parts = ["<mesh><vertices>", *points, "</vertices><triangles>", *faces, "</triangles></mesh></object>"]
    return "\n".join(parts)


def _simplify_surface(surface: Surface, tolerance_mm: float) -> Surface:
    """Simplify the mesh of a surface without moving the surface by more than the tolerance."""
    # The vertices are copied, because manifold3d rejects read-only arrays.
    mesh = manifold3d.Mesh64(np.array(surface.solid.points), surface.solid.faces.astype(np.uint64))
    reduced = manifold3d.Manifold(mesh).simplify(tolerance_mm).to_mesh64()
    faces = reduced.tri_verts.astype(np.int64)
    return replace(surface, mesh=trimesh.Trimesh(reduced.vert_properties[:, :3], faces, process=False))


def _make_coloured_mesh(surface: Surface) -> trimesh.Trimesh:
    """Make the mesh of a surface with its GLB material and metadata."""
    material = PBRMaterial(
        name=surface.inside,
        baseColorFactor=_material_rgba(surface),
        alphaMode="BLEND",
        metallicFactor=0.0,
        roughnessFactor=0.7,
        doubleSided=True,
    )
    mesh = _make_mesh(surface)
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    mesh.metadata = describe_surface(surface)
    return mesh
