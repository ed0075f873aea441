"""The ray caster beside gVirtualXray, which has OpenGL draw the same triangles (needs gvxr, of the group "peers").

Seconds to path lengths as arrays, of every material; least of a few runs. tests/test_gvxr.py shows where and why
the two differ.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ..anatomy import build
from ..core.checks import InputError
from ..geometry.scene import Scene
from ..geometry.view import View, view_of
from ..model.knee import Knee
from ..model.protocol import load_protocol
from ..raycast import trace
from .engines import Row, least_seconds
from .solids import nested_spheroids

_MM_PER_CM = 10.0
_RUNS = 3


def gvxr_rows(workers: int) -> list[Row]:
    """One row a scene: surfaces, triangles, pixels, seconds of both engines and gVirtualXray without and with filter.

    Ours include the check of the meshes; theirs are without handing the meshes over. No trabeculae, which it has not.
    p999_mm  difference of its path lengths, without filter, from ours: 99.9th percentile of the pixels with material
    raises   InputError where gVirtualXray or its OpenGL context is missing
    """
    gvxr = _context()
    rows = [
        _row(gvxr, what, scene, side, workers)
        for what, scene, side in (
            ("5 nested surfaces", Scene(nested_spheroids(100_000)), 2048),
            ("the knee", build(Knee()).scene, 2048),
            ("5 nested surfaces", Scene(nested_spheroids(3_000_000)), 1024),
        )
    ]
    gvxr.destroy()
    return rows


def meshes_by_material(scene: Scene) -> dict[str, trimesh.Trimesh]:
    """Material -> all of it as one mesh: gVirtualXray knows no `outside`, so a hole is a surface turned inside out."""
    parts: dict[str, list[trimesh.Trimesh]] = {}
    for surface in scene.surfaces:
        vertices, faces = surface.mesh.vertices, surface.mesh.faces
        for material, turned in ((surface.inside, faces), (surface.outside, faces[:, ::-1])):
            parts.setdefault(material, []).append(trimesh.Trimesh(vertices, turned, process=False))
    whole: dict[str, Any] = {name: trimesh.util.concatenate(meshes) for name, meshes in parts.items()}
    return {name: mesh for name, mesh in whole.items() if name != scene.ambient}


def _row(gvxr: Any, what: str, scene: Scene, side: int, workers: int) -> Row:
    protocol = dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=307.2 / side)
    view, seconds = view_of(protocol), dict[str, float]()
    ours = {}
    for engine in ("scanline", "embree"):

        def job(engine: str = engine) -> None:
            # A scene of its own each time: the check of its meshes is part of the time.
            fresh = Scene([dataclasses.replace(surface) for surface in scene.surfaces], scene.ambient)
            ours.update(trace(fresh, view, engine=engine, texture=False, workers=workers).path_mm)

        job()
        seconds[f"{engine}_s"] = round(least_seconds(job, _RUNS), 3)
    theirs = _path_lengths(gvxr, meshes_by_material(scene), view)
    for name, switch in (
        ("gvxr_s", gvxr.disableArtefactFiltering),
        ("gvxr_filter_s", gvxr.enableArtefactFilteringOnGPU),
    ):
        switch()
        seconds[name] = round(least_seconds(theirs, _RUNS), 3)
    gvxr.disableArtefactFiltering()
    apart = np.concatenate([np.abs(lengths - ours[name])[ours[name] > 0] for name, lengths in theirs().items()])
    gvxr.removePolygonMeshesFromXRayRenderer()
    gvxr.removePolygonMeshesFromSceneGraph()
    triangles = sum(len(surface.mesh.faces) for surface in scene.surfaces)
    scene_is = {"surfaces": len(scene.surfaces), "triangles": triangles, "pixels": side * side}
    return {"scene": what, **scene_is, **seconds, "p999_mm": float(f"{np.percentile(apart, 99.9):.2g}")}


def _path_lengths(
    gvxr: Any, meshes: dict[str, trimesh.Trimesh], view: View
) -> Callable[[], dict[str, NDArray[np.float64]]]:
    """What makes material -> (rows, cols) path lengths by gVirtualXray, mm, of meshes that it is given here."""
    gvxr.usePointSource()
    gvxr.setSourcePosition(*view.source_mm, "mm")
    gvxr.setDetectorPosition(*view.centre_mm, "mm")
    gvxr.setDetectorUpVector(0, 0, 1)
    gvxr.setDetectorNumberOfPixels(view.cols, view.rows)
    gvxr.setDetectorPixelSize(view.pixel_mm, view.pixel_mm, "mm")
    gvxr.setMonoChromatic(60, "keV", 1)
    for name, mesh in meshes.items():
        gvxr.makeTriangularMesh(name, mesh.vertices.ravel().tolist(), mesh.faces.ravel().tolist(), "mm")
        gvxr.setElement(name, "H")
        gvxr.addPolygonMeshAsInnerSurface(name)

    def lengths() -> dict[str, NDArray[np.float64]]:
        # Its first row is the lowest one of the detector.
        return {name: np.array(gvxr.computeLBuffer(name))[::-1] * _MM_PER_CM for name in meshes}

    return lengths


def _context() -> Any:
    """gVirtualXray with an OpenGL context, without a display.

    raises  InputError
    """
    allowed = "allowed: `uv run --group peers`, with the system's OpenGL; see tests/README.md"
    try:
        from gvxrPython3 import gvxr
    except ImportError as error:
        raise InputError(f"table gvxr: gVirtualXray cannot be loaded ({error}); {allowed}") from None
    try:
        gvxr.useLogFile("/dev/null")
        gvxr.createWindow(-1, 0, "EGL")
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"table gvxr: no OpenGL context ({reason}); {allowed}") from None
    return gvxr
