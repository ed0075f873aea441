"""Comparison of ray casting with gVirtualXray, which renders the same triangles with OpenGL.

Run time is the time to compute arrays of path lengths for all materials, fastest of three runs. The module needs
gVirtualXray from the dependency group ``peers``. ``tests/test_gvxr.py`` explains the differences.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ...anatomy import build
from ...core.checks import InputError
from ...geometry.scene import Scene
from ...geometry.view import View, resolve_view
from ...model.knee import Knee
from ...model.protocol import load_protocol
from ...raycast import trace
from .raycast_engines import Row, time_fastest_run
from .sphere_phantoms import make_nested_spheroids

_MM_PER_CM = 10.0
# Number of timed runs; the fastest is reported.
_RUNS = 3


def compare_with_gvxr(workers: int) -> list[Row]:
    """Compare path lengths and run time of the two ray-casting engines with gVirtualXray.

    Run times of the engines include the mesh check. Run times of gVirtualXray exclude the transfer of meshes. Scenes
    have no trabecular texture, because gVirtualXray does not support it.

    Parameters
    ----------
    workers : int
        Number of worker threads.

    Returns
    -------
    list of dict
        One row per scene: numbers of surfaces, triangles and pixels, and seconds of each engine and of gVirtualXray
        without and with artefact filter. ``p999_mm`` is the 99.9th percentile of path length differences without the
        filter, over pixels with material.

    Raises
    ------
    InputError
        gVirtualXray or its OpenGL context is not available.
    """
    gvxr = _open_gvxr_context()
    rows = [
        _compare_scene(gvxr, what, scene, side, workers)
        for what, scene, side in (
            ("5 nested surfaces", Scene(make_nested_spheroids(100_000)), 2048),
            ("the knee", build(Knee()).scene, 2048),
            ("5 nested surfaces", Scene(make_nested_spheroids(3_000_000)), 1024),
        )
    ]
    gvxr.destroy()
    return rows


def merge_meshes_by_material(scene: Scene) -> dict[str, trimesh.Trimesh]:
    """Merge all surfaces of a material into one mesh.

    gVirtualXray has no material outside a surface. The outside material is therefore added as a surface with reversed
    faces.

    Parameters
    ----------
    scene : Scene
        Scene to convert.

    Returns
    -------
    dict of str to trimesh.Trimesh
        Mesh of each material except the ambient material.
    """
    parts: dict[str, list[trimesh.Trimesh]] = {}
    for surface in scene.surfaces:
        vertices, faces = surface.mesh.vertices, surface.mesh.faces
        for material, turned in ((surface.inside, faces), (surface.outside, faces[:, ::-1])):
            parts.setdefault(material, []).append(trimesh.Trimesh(vertices, turned, process=False))
    whole: dict[str, Any] = {name: trimesh.util.concatenate(meshes) for name, meshes in parts.items()}
    return {name: mesh for name, mesh in whole.items() if name != scene.ambient}


def _compare_scene(gvxr: Any, scene_name: str, scene: Scene, side: int, workers: int) -> Row:
    """Compare the two engines with gVirtualXray on one scene."""
    protocol = dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=307.2 / side)
    view, seconds = resolve_view(protocol), dict[str, float]()
    ours = {}
    for engine in ("scanline", "embree"):

        def job(engine: str = engine) -> None:
            # Each run makes a new scene, so the run time includes the mesh check.
            fresh = Scene([dataclasses.replace(surface) for surface in scene.surfaces], scene.ambient)
            ours.update(trace(fresh, view, engine=engine, texture=False, workers=workers).path_mm)

        job()
        seconds[f"{engine}_s"] = round(time_fastest_run(job, _RUNS), 3)
    theirs = _make_gvxr_tracer(gvxr, merge_meshes_by_material(scene), view)
    for name, switch in (
        ("gvxr_s", gvxr.disableArtefactFiltering),
        ("gvxr_filter_s", gvxr.enableArtefactFilteringOnGPU),
    ):
        switch()
        seconds[name] = round(time_fastest_run(theirs, _RUNS), 3)
    gvxr.disableArtefactFiltering()
    apart = np.concatenate([np.abs(lengths - ours[name])[ours[name] > 0] for name, lengths in theirs().items()])
    gvxr.removePolygonMeshesFromXRayRenderer()
    gvxr.removePolygonMeshesFromSceneGraph()
    triangles = sum(len(surface.mesh.faces) for surface in scene.surfaces)
    scene_is = {"surfaces": len(scene.surfaces), "triangles": triangles, "pixels": side * side}
    return {"scene": scene_name, **scene_is, **seconds, "p999_mm": float(f"{np.percentile(apart, 99.9):.2g}")}


def _make_gvxr_tracer(
    gvxr: Any, meshes: dict[str, trimesh.Trimesh], view: View
) -> Callable[[], dict[str, NDArray[np.float64]]]:
    """Load meshes into gVirtualXray and return a function that computes path lengths.

    The returned function gives (rows, cols) path lengths by material, in mm.
    """
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
        # The first row of gVirtualXray is the lowest row of the detector.
        return {name: np.array(gvxr.computeLBuffer(name))[::-1] * _MM_PER_CM for name in meshes}

    return lengths


def _open_gvxr_context() -> Any:
    """Open an off-screen OpenGL context of gVirtualXray; raise InputError if it cannot be opened."""
    remedy = "use `uv run --group peers` on a system with OpenGL; see docs/validation/ray_casting.md"
    try:
        from gvxrPython3 import gvxr
    except ImportError as error:
        raise InputError(f"table gvxr needs gVirtualXray, which cannot be imported ({error}): {remedy}") from None
    try:
        gvxr.useLogFile("/dev/null")
        gvxr.createWindow(-1, 0, "EGL")
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"table gvxr needs OpenGL, which gVirtualXray does not find ({reason}): {remedy}") from None
    return gvxr
