"""Ray casting, measured: engine x triangles x pixels x precision -> seconds, rays a second, memory, error, leaks."""

import dataclasses
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np

from ..core.child_processes import safe_start
from ..geometry.scene import Scene, Surface
from ..geometry.view import View, view_of
from ..model.protocol import load_protocol
from ..raycast import ENGINES, PRECISIONS, Paths, trace
from .solids import globe, nested_spheroids, polyhedron_chords, sphere_chords

Row = dict[str, Any]
TRIANGLES = (1_000, 10_000, 100_000, 1_000_000, 3_000_000)
SIDES = (256, 512, 1024, 2048, 4096)

_RADIUS_MM = 60.0
_FIELD_MM = 160.0
# A ray whose path is off by more than this has missed a crossing, or met one that is not there.
_LEAK_MM = 0.01


def engine_rows(
    workers: int, triangles: tuple[int, ...] = TRIANGLES, sides: tuple[int, ...] = SIDES, runs: int = 3
) -> list[Row]:
    """One row for each engine, mesh, detector and precision. The scene is a sphere of 60 mm as a polyhedron.

    seconds, million_rays_per_s  least of `runs`, from meshes to path lengths, the check of the meshes included
    peak_mb                      of a process that has made this image and those before it, smaller ones
    engine_error_mm              greatest difference from the polyhedron's exact chord, on a sample of pixels
    tessellation_rms_mm          the polyhedron's own error against the sphere, on the same sample
    differs_mm                   greatest difference from the other engine, at every pixel
    leaked                       pixels at which it differs by more than 0.01 mm; and rays left unrepaired
    """
    rows = []
    for engine in ENGINES:
        for count in triangles:
            # A process of its own, so that its peak is of this mesh and engine.
            with safe_start(), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                rows += pool.submit(_rows_of_mesh, engine, count, sides, workers, runs).result()
    return rows


def nested_rows(workers: int, runs: int = 3) -> list[Row]:
    """Five nested spheroids of 30 to 75 mm, leg, cortex, trabeculae, marrow, water: seconds and memory of each engine.

    100 k triangles in all on 2048 x 2048 pixels, and 3 M on 1024 x 1024; columns as in `engine_rows`
    """
    rows = []
    for engine in ENGINES:
        for triangles, side in ((100_000, 2048), (3_000_000, 1024)):
            with safe_start(), ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                rows.append(pool.submit(_nested_row, engine, triangles, side, workers, runs).result())
    return rows


def _nested_row(engine: str, triangles: int, side: int, workers: int, runs: int) -> Row:
    view = view_of(dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=307.2 / side))
    surfaces = nested_spheroids(triangles)

    def job() -> Paths:
        return trace(Scene([dataclasses.replace(one) for one in surfaces]), view, engine=engine, workers=workers)

    audit = job().audit
    peak, seconds = peak_mb(), least_seconds(job, runs)
    return {
        "engine": engine, "triangles": sum(len(one.mesh.faces) for one in surfaces), "pixels": side * side,
        "seconds": round(seconds, 4), "peak_mb": peak, "repaired": audit.repaired, "unrepaired": audit.unrepaired,
    }  # fmt: skip


def growth_rows(engines: list[Row]) -> list[Row]:
    """How the seconds of `engine_rows` grow: exponents between neighbours, in pixels and in triangles."""
    rows = []
    for engine in ENGINES:
        for by, held, at in (("pixels", "triangles", 100_000), ("triangles", "pixels", 1024**2)):
            held_at = min((row[held] for row in engines), key=lambda value: abs(value - at), default=0)
            chosen = [r for r in engines if (r["engine"], r[held], r["precision"]) == (engine, held_at, "float32")]
            for one, other in pairwise(chosen):
                exponent = np.log(other["seconds"] / one["seconds"]) / np.log(other[by] / one[by])
                rows.append({
                    "engine": engine, "at": f"{held_at} {held}", "grows_with": by, "from": one[by], "to": other[by],
                    "seconds_from": one["seconds"], "seconds_to": other["seconds"], "exponent": round(exponent, 2),
                })  # fmt: skip
    return rows


def _rows_of_mesh(engine: str, triangles: int, sides: tuple[int, ...], workers: int, runs: int) -> list[Row]:
    mesh = globe(triangles, _RADIUS_MM)
    samples = int(np.clip(4e8 / len(mesh.faces), 100, 2000))
    _scene(globe(100, _RADIUS_MM)).surfaces[0].solid  # noqa: B018  loads compiled code
    rows = []
    for side in sides:
        view = view_of(dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=_FIELD_MM / side))
        pixels = np.random.default_rng(side).integers(0, side, (samples, 2))
        exact, ideal = polyhedron_chords(mesh, pixels, view), sphere_chords(_RADIUS_MM, pixels, view)
        timed = [_timed(mesh, view, engine, precision, workers, runs) for precision in PRECISIONS]
        other = trace(_scene(mesh), view, engine=_other(engine), precision="float64", workers=workers).path_mm["water"]
        for precision, (seconds, peak, paths) in zip(PRECISIONS, timed, strict=True):
            path_mm = paths.path_mm["water"]
            apart = abs(path_mm - other)
            sampled = path_mm[pixels[:, 0], pixels[:, 1]]
            rows.append({
                "engine": engine, "triangles": len(mesh.faces), "pixels": side * side, "precision": precision,
                "seconds": round(seconds, 4), "million_rays_per_s": round(side * side / seconds / 1e6, 2),
                "peak_mb": peak, "engine_error_mm": _short(abs(sampled - exact).max()),
                "tessellation_rms_mm": _short(((exact - ideal) ** 2).mean() ** 0.5),
                "tessellation_max_mm": _short(abs(exact - ideal).max()), "differs_mm": _short(apart.max()),
                "leaked": int((apart > _LEAK_MM).sum()) + paths.audit.unrepaired, "repaired": paths.audit.repaired,
            })  # fmt: skip
    return rows


def _timed(mesh: Any, view: View, engine: str, precision: str, workers: int, runs: int) -> tuple[float, int, Paths]:
    """Least seconds of a few runs after one that loads compiled code, peak memory in MB, and the result."""

    def job() -> Paths:
        return trace(_scene(mesh), view, engine=engine, precision=precision, workers=workers)

    paths = job()
    peak = peak_mb()
    return least_seconds(job, runs), peak, paths


def peak_mb() -> int:
    """Most memory that this process has held, MB; 0 where the system does not tell (Windows)."""
    try:
        import resource
    except ImportError:
        return 0
    unit = 1024**2 if sys.platform == "darwin" else 1024
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)


def least_seconds(job: Callable[[], object], runs: int) -> float:
    """Least wall time of a few runs."""
    least = np.inf
    for _ in range(runs):
        start = perf_counter()
        job()
        least = min(least, perf_counter() - start)
    return float(least)


def _scene(mesh: Any) -> Scene:
    return Scene([Surface(mesh, inside="water", outside="air", name="sphere")])


def _other(engine: str) -> str:
    return ENGINES[1 - ENGINES.index(engine)]


def _short(value: float) -> float:
    return float(f"{value:.2g}")
