"""A page to inspect a knee: its solids in 3D, layer by layer, beside its radiograph; one file that needs no other."""

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

from ..core.blocks import block_mean
from ..core.checks import Array
from ..detector import present
from ..geometry.scene import Scene, Surface
from ..geometry.view import View
from ..model.knee import knee_table
from ..model.protocol import protocol_table
from ..model.radiograph import Radiograph
from .atomic import write_bytes
from .meshes import colour_of, simplified, unique_names

TEMPLATE = Path(__file__).with_name("viewer.html")
# The radiograph is shown with at most this many pixels a side.
SIDE_PX = 1024
# Where a face is turned away from its neighbours by more, an edge is seen.
_CREASE_DEG = 40.0
# How far before the limb the beam is drawn from, and how thick the detector.
_BEFORE_MM, _PLATE_MM = 40.0, 6.0
Triples = NDArray[np.floating]


def write_viewer(
    scene: Scene, radiograph: Radiograph, path: str | Path, *, title: str = "Knee", tolerance_mm: float = 0.05
) -> Path:
    """Write the page; it needs a browser with WebGL 2 and no network.

    tolerance_mm  triangles may be merged as long as no surface moves by more, for a smaller page; 0 keeps every one
    returns       its path
    raises        InputError for a mesh that bounds no solid, a tolerance out of range, or a disk that cannot be written
    """
    content = {"radiograph": _picture(radiograph), "parameters": _parameters(radiograph)}
    page = _page(_solids(scene, tolerance_mm) | content, title, _facts(radiograph))
    write_bytes(Path(path), page.encode("utf-8"))
    return Path(path)


def solids_page(scene: Scene, view: View, *, tolerance_mm: float = 0.05) -> str:
    """The page with solids alone, and with the beam and the detector of a view among them.

    Arguments, and what it needs and raises, as `write_viewer`.
    """
    whole = Scene([*scene.surfaces, *_taken_by(view, scene.bounds_mm)], scene.ambient, scene.size_mm)
    return _page(_solids(whole, tolerance_mm) | {"radiograph": None, "parameters": {}}, "Solids", "")


def _page(content: dict[str, Any], title: str, facts: str) -> str:
    # "<" in a name must not end the script that it is in.
    data = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    page = TEMPLATE.read_text(encoding="utf-8")
    for mark, text in (("TITLE", escape(title)), ("FACTS", escape(facts)), ("DATA", data)):
        page = page.replace(f"[[{mark}]]", text)
    return page


def _solids(scene: Scene, tolerance_mm: float) -> dict[str, Any]:
    return {"bounds": scene.bounds_mm.round(3).tolist(), "layers": _layers(simplified(scene, tolerance_mm))}


def _taken_by(view: View, bounds_mm: Array) -> list[Surface]:
    """The detector as a plate, and the beam from shortly before the limb to it.

    bounds_mm  (2, 3)  of the limb
    """
    source, centre = np.array(view.source_mm), np.array(view.centre_mm)
    half = np.array([view.cols, view.rows]) / 2 * view.pixel_mm
    corners = [centre + np.array([x * half[0], 0.0, z * half[1]]) for x in (-1, 1) for z in (-1, 1)]
    near = (bounds_mm[0][1] - _BEFORE_MM - source[1]) / (centre[1] - source[1])
    fan = [source + share * (corner - source) for share in (max(near, 0.01), 0.999) for corner in corners]
    plate = [corner + np.array([0.0, depth, 0.0]) for depth in (0.0, _PLATE_MM) for corner in corners]
    hulls = {"beam": fan, "detector": plate}
    return [Surface(trimesh.convex.convex_hull(np.array(at)), name, "air", name=name) for name, at in hulls.items()]


def shaded(mesh: trimesh.Trimesh) -> tuple[Triples, Triples, NDArray[np.int64]]:
    """Corners and normals for drawing: smooth where faces bend little, with a vertex for each side of a crease.

    returns  (n, 3) points in mm, (n, 3) normals in steps of 1/127, (m, 3) vertex numbers
    """
    smooth, flat = mesh.vertex_normals[mesh.faces], mesh.face_normals[:, None, :]
    bends = (smooth * flat).sum(axis=2, keepdims=True) < np.cos(np.deg2rad(_CREASE_DEG))
    steps = np.rint(127 * np.where(bends, flat, smooth)).astype(np.int64).reshape(-1, 3)
    corner = mesh.faces.ravel().astype(np.int64)
    key = corner << 24 | (steps + 128) @ np.array([1 << 16, 1 << 8, 1])
    _, first, faces = np.unique(key, return_index=True, return_inverse=True)
    return mesh.vertices[corner[first]], steps[first] / 127, faces.reshape(-1, 3)


def _layers(scene: Scene) -> list[dict[str, Any]]:
    """Every surface with its colour, its place in the list of layers and its mesh, the largest first."""
    # What differs by a number only shares a row: "screw_1", "screw_2".
    rows = [re.sub(r"_\d+$", "", name) for name in unique_names(scene)]
    places = [_place(row, rows) for row in rows]
    shared = Counter((group, surface.inside) for (group, _), surface in zip(places, scene.surfaces, strict=True))
    # Materials come from the outside in.
    nesting = scene.materials.index
    layers = []
    for (group, row), surface in zip(places, scene.surfaces, strict=True):
        material = _words(surface.inside)
        alone = group and shared[group, surface.inside] == 1
        layer = {"group": _words(group), "label": material if alone else row, "material": material}
        drawn = {"colour": colour_of(surface.inside), "nesting": nesting(surface.outside)}
        layers.append(layer | drawn | _packed(surface))
    return sorted(layers, key=lambda layer: -layer["volume"])


def _place(row: str, rows: Collection[str]) -> tuple[str, str]:
    """Group and row of a surface in the list: "femur_marrow" belongs to "femur", where there is one."""
    hosts = [host for host in rows if row.startswith(f"{host}_")]
    if hosts:
        group = min(hosts, key=len)
        return group, _words(row[len(group) + 1 :])
    return (row if any(other.startswith(f"{row}_") for other in rows) else ""), _words(row)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _packed(surface: Surface) -> dict[str, Any]:
    """A mesh as text: corners in 16 bits across its box, normals in 8 bits, vertex numbers in 16 or 32."""
    mesh = trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)
    points, normals, faces = shaded(mesh)
    low, high = surface.bounds_mm
    step = np.maximum(high - low, 1e-9) / 65535
    wide = len(points) > 65536
    return {
        "volume": round(float(mesh.volume), 3),
        "low": low.tolist(),
        "step": step.tolist(),
        "points": _text(np.rint((points - low) / step).astype("<u2")),
        "normals": _text(np.rint(127 * normals).astype(np.int8)),
        "faces": _text(faces.astype("<u4" if wide else "<u2")),
        "wide": int(wide),
    }


def _text(values: NDArray[Any]) -> str:
    return b64encode(values.tobytes()).decode("ascii")


def _picture(radiograph: Radiograph) -> dict[str, Any]:
    """The radiograph for eyes, bone bright, and where its landmarks are on it, as parts of its height and width."""
    shown = present(radiograph.pixels, detector=radiograph.protocol.detector)
    rows, cols = shown.shape
    step = -(-max(rows, cols) // SIDE_PX)
    rows, cols = rows // step * step, cols // step * step
    small = np.rint(block_mean(shown[:rows, :cols], step)).astype(np.uint8)
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
        "landmarks": {_words(name): [(row + 0.5) / rows, (col + 0.5) / cols] for name, (row, col) in spots.items()},
    }


def _parameters(radiograph: Radiograph) -> dict[str, dict[str, str]]:
    """What the radiograph was made from, as tables of text."""
    tables = {} if radiograph.knee is None else {"Knee": knee_table(radiograph.knee)}
    tables["Protocol"] = protocol_table(radiograph.protocol)
    return {title: {name: _as_text(value) for name, value in table.items()} for title, table in tables.items()}


def _as_text(value: Any) -> str:
    if isinstance(value, Mapping):
        return " ".join(_as_text(part) for part in value.values())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_as_text, value)) or "none"
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _facts(radiograph: Radiograph) -> str:
    """What is known about the knee, in one line."""
    knee = radiograph.knee
    if knee is None:
        return "Own meshes"
    facts = [f"{knee.side} knee, {knee.sex}".capitalize()]
    facts += [] if knee.grade is None else [f"KL-like grade {knee.grade}"]
    truth = radiograph.truth
    if truth is not None and truth.jsw_medial_mm is not None and truth.jsw_lateral_mm is not None:
        facts.append(f"joint space {truth.jsw_medial_mm:.1f} mm medial, {truth.jsw_lateral_mm:.1f} mm lateral")
    return " · ".join(facts)
