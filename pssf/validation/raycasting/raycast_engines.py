"""Run time, memory and error of ray-casting engines by number of triangles, number of pixels and float precision."""

import dataclasses
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np

from ...core.processes.child_processes import start_without_working_folder
from ...geometry.scene import Scene, Surface
from ...geometry.view import View, resolve_view
from ...model.protocol import load_protocol
from ...raycast import (
    ENGINES,
    PRECISIONS,
    Paths,
    trace,
)
from .sphere_phantoms import (
    make_nested_spheroids,
    make_sphere_polyhedron,
    polyhedron_chords_mm,
    sphere_chords_mm,
)

Row = dict[str, Any]
# Approximate numbers of triangles of the polyhedral spheres.
TRIANGLES = (1_000, 10_000, 100_000, 1_000_000, 3_000_000)
# Numbers of detector pixels per side.
DETECTOR_SIDES_PX = (256, 512, 1024, 2048, 4096)

# Radius of the sphere, in mm.
_RADIUS_MM = 60.0
# Edge length of the field at the detector, in mm.
_FIELD_MM = 160.0
# Path length difference above which a ray has a missing or a false surface crossing, in mm.
_LEAK_MM = 0.01


def measure_engines(
    workers: int, triangles: tuple[int, ...] = TRIANGLES, sides: tuple[int, ...] = DETECTOR_SIDES_PX, runs: int = 3
) -> list[Row]:
    """Measure run time, memory and error of each ray-casting engine on a polyhedral sphere of 60 mm radius.

    Parameters
    ----------
    workers : int
        Number of worker threads.
    triangles : tuple of int
        Approximate numbers of triangles of the polyhedra.
    sides : tuple of int
        Numbers of detector pixels per side.
    runs : int, default 3
        Number of timed runs; the fastest is reported.

    Returns
    -------
    list of dict
        One row per engine, mesh, detector size and precision.

    Notes
    -----
    The rows have these columns:

    ``seconds``, ``million_rays_per_s``
        Run time of the fastest run, from meshes to path lengths, including the mesh check.
    ``peak_mb``
        Peak memory of a process that traces an image after all smaller images.
    ``engine_error_mm``
        Largest difference from the exact chord length of the polyhedron, in a sample of pixels.
    ``tessellation_rms_mm``, ``tessellation_max_mm``
        Difference between the chord lengths of polyhedron and sphere, in the same pixels.
    ``differs_mm``
        Largest path length difference from the other engine over all pixels.
    ``leaked``
        Number of pixels that differ from the other engine by more than 0.01 mm, plus number of unrepaired rays.
    """
    rows = []
    for engine in ENGINES:
        for count in triangles:
            # Each mesh and engine is measured in a new process, so that peak memory excludes earlier measurements.
            with start_without_working_folder(), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                rows += pool.submit(_measure_mesh, engine, count, sides, workers, runs).result()
    return rows


def measure_nested_spheroids(workers: int, runs: int = 3) -> list[Row]:
    """Measure run time and memory of each ray-casting engine on five nested spheroids.

    The spheroids, with radii of 30 to 75 mm before scaling, represent leg, cortex, trabecular bone, marrow and water.
    Together they have 100 000 triangles for 2048 x 2048 pixels, and 3 million triangles for 1024 x 1024 pixels.

    Parameters
    ----------
    workers : int
        Number of worker threads.
    runs : int, default 3
        Number of timed runs; the fastest is reported.

    Returns
    -------
    list of dict
        One row per engine and number of triangles, with columns as in :func:`measure_engines`.
    """
    rows = []
    for engine in ENGINES:
        for triangles, side in ((100_000, 2048), (3_000_000, 1024)):
            with start_without_working_folder(), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                rows.append(pool.submit(_measure_nested_case, engine, triangles, side, workers, runs).result())
    return rows


def _measure_nested_case(engine: str, triangles: int, side: int, workers: int, runs: int) -> Row:
    """Measure one engine on five nested spheroids."""
    view = resolve_view(dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=307.2 / side))
    surfaces = make_nested_spheroids(triangles)

    def job() -> Paths:
        return trace(Scene([dataclasses.replace(one) for one in surfaces]), view, engine=engine, workers=workers)

    audit = job().audit
    peak, seconds = peak_memory_mb(), time_fastest_run(job, runs)
    return {
        "engine": engine, "triangles": sum(len(one.mesh.faces) for one in surfaces), "pixels": side * side,
        "seconds": round(seconds, 4), "peak_mb": peak, "repaired": audit.repaired, "unrepaired": audit.unrepaired,
    }  # fmt: skip


def compute_growth_exponents(engine_results: list[Row]) -> list[Row]:
    """Compute growth exponents of the run time with the number of pixels and with the number of triangles.

    Parameters
    ----------
    engine_results : list of dict
        Rows of :func:`measure_engines`.

    Returns
    -------
    list of dict
        One row per engine and pair of successive numbers of pixels or triangles.
    """
    rows = []
    for engine in ENGINES:
        for by, held, at in (("pixels", "triangles", 100_000), ("triangles", "pixels", 1024**2)):
            held_at = min((row[held] for row in engine_results), key=lambda value: abs(value - at), default=0)
            chosen = [
                r for r in engine_results if (r["engine"], r[held], r["precision"]) == (engine, held_at, "float32")
            ]
            for one, other in pairwise(chosen):
                exponent = np.log(other["seconds"] / one["seconds"]) / np.log(other[by] / one[by])
                rows.append({
                    "engine": engine, "at": f"{held_at} {held}", "grows_with": by, "from": one[by], "to": other[by],
                    "seconds_from": one["seconds"], "seconds_to": other["seconds"], "exponent": round(exponent, 2),
                })  # fmt: skip
    return rows


def _measure_mesh(engine: str, triangles: int, sides: tuple[int, ...], workers: int, runs: int) -> list[Row]:
    """Measure one engine on one mesh for every detector size and precision."""
    mesh = make_sphere_polyhedron(triangles, _RADIUS_MM)
    samples = int(np.clip(4e8 / len(mesh.faces), 100, 2000))
    _make_sphere_scene(make_sphere_polyhedron(100, _RADIUS_MM)).surfaces[0].solid  # noqa: B018  loads compiled code
    rows = []
    for side in sides:
        view = resolve_view(
            dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=_FIELD_MM / side)
        )
        pixels = np.random.default_rng(side).integers(0, side, (samples, 2))
        exact, ideal = polyhedron_chords_mm(mesh, pixels, view), sphere_chords_mm(_RADIUS_MM, pixels, view)
        timed = [_time_trace(mesh, view, engine, precision, workers, runs) for precision in PRECISIONS]
        other = trace(
            _make_sphere_scene(mesh), view, engine=_select_other_engine(engine), precision="float64", workers=workers
        ).path_mm["water"]
        for precision, (seconds, peak, paths) in zip(PRECISIONS, timed, strict=True):
            path_mm = paths.path_mm["water"]
            apart = abs(path_mm - other)
            sampled = path_mm[pixels[:, 0], pixels[:, 1]]
            rows.append({
                "engine": engine, "triangles": len(mesh.faces), "pixels": side * side, "precision": precision,
                "seconds": round(seconds, 4), "million_rays_per_s": round(side * side / seconds / 1e6, 2),
                "peak_mb": peak, "engine_error_mm": _round_to_two_digits(abs(sampled - exact).max()),
                "tessellation_rms_mm": _round_to_two_digits(((exact - ideal) ** 2).mean() ** 0.5),
                "tessellation_max_mm": _round_to_two_digits(abs(exact - ideal).max()),
                "differs_mm": _round_to_two_digits(apart.max()),
                "leaked": int((apart > _LEAK_MM).sum()) + paths.audit.unrepaired, "repaired": paths.audit.repaired,
            })  # fmt: skip
    return rows


def _time_trace(
    mesh: Any, view: View, engine: str, precision: str, workers: int, runs: int
) -> tuple[float, int, Paths]:
    """Time a ray trace after a warm-up run; return seconds of the fastest run, peak memory in MB, and path lengths."""

    def job() -> Paths:
        return trace(_make_sphere_scene(mesh), view, engine=engine, precision=precision, workers=workers)

    paths = job()
    peak = peak_memory_mb()
    return time_fastest_run(job, runs), peak, paths


def peak_memory_mb() -> int:
    """Return the peak memory of this process.

    Returns
    -------
    int
        Peak memory in MB; 0 if the system does not report it (Windows).
    """
    try:
        import resource
    except ImportError:
        return 0
    unit = 1024**2 if sys.platform == "darwin" else 1024
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)


def time_fastest_run(job: Callable[[], object], runs: int) -> float:
    """Return the shortest wall time of several runs.

    Parameters
    ----------
    job : callable
        Function to run, without arguments.
    runs : int
        Number of timed runs.

    Returns
    -------
    float
        Shortest wall time in seconds.
    """
    least = np.inf
    for _ in range(runs):
        start = perf_counter()
        job()
        least = min(least, perf_counter() - start)
    return float(least)


def _make_sphere_scene(mesh: Any) -> Scene:
    """Make a scene with one water-filled surface in air."""
    return Scene([Surface(mesh, inside="water", outside="air", name="sphere")])


def _select_other_engine(engine: str) -> str:
    """Return the name of the other engine."""
    return ENGINES[1 - ENGINES.index(engine)]


def _round_to_two_digits(value: float) -> float:
    """Round a value to two significant digits."""
    return float(f"{value:.2g}")
