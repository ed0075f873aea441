"""Write a 3D viewer page: one self-contained HTML file that shows the solids of a knee beside its radiograph."""

import io
import json
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from ...core.checks import Array
from ...core.resample import downsample_by_blocks
from ...detector import render_for_display
from ...geometry.scene import Scene, Surface
from ...geometry.view import View
from ...model.knee import knee_to_dict
from ...model.protocol import protocol_to_dict
from ...model.radiograph import Radiograph
from ..atomic_write import write_bytes
from .mesh_export import material_colour, simplify_scene, unique_names

TEMPLATE = Path(__file__).with_name("viewer.html")
# Largest number of rows or columns of the displayed radiograph.
MAX_SIDE_PX = 1024
# Angle between a face normal and a vertex normal above which a mesh edge is rendered sharp, in degrees.
_CREASE_DEG = 40.0
_BEFORE_MM = 40.0  # distance between the limb and the start of the displayed beam, towards the source
_PLATE_MM = 6.0  # thickness of the displayed detector
Triples = NDArray[np.floating]


def write_viewer(
    scene: Scene, radiograph: Radiograph, path: str | Path, *, title: str = "Knee", tolerance_mm: float = 0.05
) -> Path:
    """Write the viewer page of a scene and its radiograph; the page needs a browser with WebGL 2 and no network.

    Parameters
    ----------
    scene : Scene
        Scene to show.
    radiograph : Radiograph
        Radiograph of the scene.
    path : str or Path
        HTML file to write.
    title : str
        Title of the page.
    tolerance_mm : float
        Largest surface displacement that mesh simplification may cause, 0 to 10 mm; 0 keeps every triangle.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    InputError
        A mesh is not a closed solid, the tolerance is out of range, or the file cannot be written.
    """
    content = {"radiograph": _encode_radiograph(radiograph), "parameters": _format_parameters(radiograph)}
    page = _fill_template(_encode_solids(scene, tolerance_mm) | content, title, _format_facts(radiograph))
    write_bytes(Path(path), page.encode("utf-8"))
    return Path(path)


def build_solids_page(scene: Scene, view: View, *, tolerance_mm: float = 0.05) -> str:
    """Build the viewer page of a scene without a radiograph, with the beam and the detector of a view.

    Parameters
    ----------
    scene : Scene
        Scene to show.
    view : View
        Projection whose beam and detector are shown.
    tolerance_mm : float
        Largest surface displacement that mesh simplification may cause, 0 to 10 mm; 0 keeps every triangle.

    Returns
    -------
    str
        HTML page, which needs a browser with WebGL 2 and no network.

    Raises
    ------
    InputError
        A mesh is not a closed solid, or the tolerance is out of range.
    """
    whole = Scene([*scene.surfaces, *_build_beam_and_detector(view, scene.bounds_mm)], scene.ambient, scene.size_mm)
    return _fill_template(_encode_solids(whole, tolerance_mm) | {"radiograph": None, "parameters": {}}, "Solids", "")


def _fill_template(content: dict[str, Any], title: str, facts: str) -> str:
    """Insert the content, title and knee description of a page into the HTML template."""
    # "<" is escaped, because "</script>" in a name would end the script element that contains the data.
    data = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    page = TEMPLATE.read_text(encoding="utf-8")
    for mark, text in (("TITLE", escape(title)), ("FACTS", escape(facts)), ("DATA", data)):
        page = page.replace(f"[[{mark}]]", text)
    return page


def _encode_solids(scene: Scene, tolerance_mm: float) -> dict[str, Any]:
    """Encode the bounding box and the surface layers of a scene for the viewer page."""
    return {"bounds": scene.bounds_mm.round(3).tolist(), "layers": _encode_layers(simplify_scene(scene, tolerance_mm))}


def _build_beam_and_detector(view: View, bounds_mm: Array) -> list[Surface]:
    """Build surfaces for the detector and for the beam, which starts a short distance in front of the limb.

    `bounds_mm` (2, 3) is the bounding box of the limb.
    """
    source, centre = np.array(view.source_mm), np.array(view.centre_mm)
    half = np.array([view.cols, view.rows]) / 2 * view.pixel_mm
    corners = [centre + np.array([x * half[0], 0.0, z * half[1]]) for x in (-1, 1) for z in (-1, 1)]
    near = (bounds_mm[0][1] - _BEFORE_MM - source[1]) / (centre[1] - source[1])
    fan = [source + share * (corner - source) for share in (max(near, 0.01), 0.999) for corner in corners]
    plate = [corner + np.array([0.0, depth, 0.0]) for depth in (0.0, _PLATE_MM) for corner in corners]
    hulls = {"beam": fan, "detector": plate}
    return [Surface(trimesh.convex.convex_hull(np.array(at)), name, "air", name=name) for name, at in hulls.items()]


def split_creases(mesh: trimesh.Trimesh) -> tuple[Triples, Triples, NDArray[np.int64]]:
    """Compute vertices and normals for rendering; duplicate vertices at creases, so that shading is smooth elsewhere.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Mesh in mm.

    Returns
    -------
    points : (n, 3) array
        Vertices, in mm, with one copy per adjacent region at a crease.
    normals : (n, 3) array
        Unit normals in steps of 1/127, dimensionless.
    faces : (m, 3) int array
        Vertex indices of the triangles.
    """
    smooth, flat = mesh.vertex_normals[mesh.faces], mesh.face_normals[:, None, :]
    bends = (smooth * flat).sum(axis=2, keepdims=True) < np.cos(np.deg2rad(_CREASE_DEG))
    steps = np.rint(127 * np.where(bends, flat, smooth)).astype(np.int64).reshape(-1, 3)
    corner = mesh.faces.ravel().astype(np.int64)
    key = corner << 24 | (steps + 128) @ np.array([1 << 16, 1 << 8, 1])
    _, first, faces = np.unique(key, return_index=True, return_inverse=True)
    return mesh.vertices[corner[first]], steps[first] / 127, faces.reshape(-1, 3)


def _encode_layers(scene: Scene) -> list[dict[str, Any]]:
    """Encode the colour, group, label and mesh of every surface, sorted from the largest to the smallest volume."""
    # Names that differ only by a number, such as "screw_1" and "screw_2", share one row in the layer list.
    rows = [re.sub(r"_\d+$", "", name) for name in unique_names(scene)]
    places = [_find_group_and_label(row, rows) for row in rows]
    shared = Counter((group, surface.inside) for (group, _), surface in zip(places, scene.surfaces, strict=True))
    # The index of a material is its nesting depth, because `materials` lists them from outside to inside.
    nesting = scene.materials.index
    layers = []
    for (group, row), surface in zip(places, scene.surfaces, strict=True):
        material = _format_name(surface.inside)
        alone = group and shared[group, surface.inside] == 1
        layer = {"group": _format_name(group), "label": material if alone else row, "material": material}
        drawn = {"colour": material_colour(surface.inside), "nesting": nesting(surface.outside)}
        layers.append(layer | drawn | _encode_mesh(surface))
    return sorted(layers, key=lambda layer: -layer["volume"])


def _find_group_and_label(row: str, rows: Collection[str]) -> tuple[str, str]:
    """Return the group and label of a surface for the layer list of the viewer page.

    "femur_marrow" belongs to the group "femur" if there is a surface "femur".
    """
    hosts = [host for host in rows if row.startswith(f"{host}_")]
    if hosts:
        group = min(hosts, key=len)
        return group, _format_name(row[len(group) + 1 :])
    return (row if any(other.startswith(f"{row}_") for other in rows) else ""), _format_name(row)


def _format_name(name: str) -> str:
    """Replace underscores in a name with spaces."""
    return name.replace("_", " ")


def _encode_mesh(surface: Surface) -> dict[str, Any]:
    """Encode a mesh as base64 text.

    Vertex coordinates have 16 bits over the bounding box of the surface, normals have 8 bits, and vertex indices have
    16 or 32 bits.
    """
    mesh = trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)
    points, normals, faces = split_creases(mesh)
    low, high = surface.bounds_mm
    step = np.maximum(high - low, 1e-9) / 65535
    wide = len(points) > 65536
    return {
        "volume": round(float(mesh.volume), 3),
        "low": low.tolist(),
        "step": step.tolist(),
        "points": _encode_base64(np.rint((points - low) / step).astype("<u2")),
        "normals": _encode_base64(np.rint(127 * normals).astype(np.int8)),
        "faces": _encode_base64(faces.astype("<u4" if wide else "<u2")),
        "wide": int(wide),
    }


def _encode_base64(values: NDArray[Any]) -> str:
    """Encode the bytes of an array as base64 text."""
    return b64encode(values.tobytes()).decode("ascii")


def _encode_radiograph(radiograph: Radiograph) -> dict[str, Any]:
    """Encode a radiograph processed for display, with bone bright, and the positions of its landmarks.

    Positions are fractions of the height and width of the radiograph.
    """
    shown = render_for_display(radiograph.pixels, detector=radiograph.protocol.detector)
    rows, cols = shown.shape
    step = -(-max(rows, cols) // MAX_SIDE_PX)
    rows, cols = rows // step * step, cols // step * step
    small = np.rint(downsample_by_blocks(shown[:rows, :cols], step)).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(small).save(buffer, format="PNG", optimize=True)
    truth = radiograph.truth
    spots = {} if truth is None else truth.landmarks_px
    protocol = radiograph.protocol
    return {
        "png": "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii"),
        "width": cols // step,
        "height": rows // step,
        "caption": f"{protocol.name}, {protocol.tube_kv:g} kV, {protocol.mas:g} mAs, seed {radiograph.seed}",
        "landmarks": {
            _format_name(name): [(row + 0.5) / rows, (col + 0.5) / cols] for name, (row, col) in spots.items()
        },
    }


def _format_parameters(radiograph: Radiograph) -> dict[str, dict[str, str]]:
    """Format the knee and protocol parameters as tables of strings."""
    tables = {} if radiograph.knee is None else {"Knee": knee_to_dict(radiograph.knee)}
    tables["Protocol"] = protocol_to_dict(radiograph.protocol)
    return {title: {name: _format_value(value) for name, value in table.items()} for title, table in tables.items()}


def _format_value(value: Any) -> str:
    """Format the value of a parameter as text."""
    if isinstance(value, Mapping):
        return " ".join(_format_value(part) for part in value.values())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_format_value, value)) or "none"
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _format_facts(radiograph: Radiograph) -> str:
    """Describe the knee of a radiograph in one line: side, sex, grade and joint space widths."""
    knee = radiograph.knee
    if knee is None:
        return "Own meshes"
    facts = [f"{knee.side} knee, {knee.sex}".capitalize()]
    facts += [] if knee.grade is None else [f"KL-like grade {knee.grade}"]
    truth = radiograph.truth
    if truth is not None and truth.jsw_medial_mm is not None and truth.jsw_lateral_mm is not None:
        facts.append(f"joint space {truth.jsw_medial_mm:.1f} mm medial, {truth.jsw_lateral_mm:.1f} mm lateral")
    return " · ".join(facts)
