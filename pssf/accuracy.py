"""Error against run time, measured on the user's own machine: ray casting, spectrum, and the stages of simulate."""

import dataclasses
import os
import platform
import resource
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from .checks import Array
from .detector.materials import attenuation_per_mm
from .detector.spectrum import beam_of
from .files.atomic import empty_folder
from .files.records import write_csv, write_json
from .geometry import View, view_of
from .knee import Knee
from .protocol import load_protocol
from .raycast import trace
from .scene import Scene, Surface
from .simulate import simulate, versions
from .validation import knee_rows, physics_rows

Row = dict[str, Any]
_RADIUS_MM = 60.0
_SAMPLES = 2000


def measure(out: Path, *, workers: int = 2) -> list[Path]:
    """Measure and write engines, spectrum, stages, physics and knees as CSV, and machine.json; returns their paths."""
    tables = {
        "engines": engine_rows(workers),
        "spectrum": spectrum_rows(),
        "stages": stage_rows(workers),
        "physics": physics_rows(),
        "knees": knee_rows(),
    }
    paths = []
    for name, rows in tables.items():
        paths.append(out / f"{name}.csv")
        write_csv(paths[-1], rows)
    paths.append(out / "machine.json")
    write_json(
        paths[-1], {"machine": platform.processor() or platform.machine(), "cores": os.cpu_count(), **versions()}
    )
    return paths


def engine_rows(
    workers: int, subdivisions: tuple[int, ...] = (3, 4, 5, 6), sides: tuple[int, ...] = (512, 1024, 2048)
) -> list[Row]:
    """One row for each engine, mesh and detector: seconds, rays a second, errors in mm, rays left unrepaired.

    The scene is a sphere of 60 mm as a polyhedron. engine_error_mm is against the polyhedron's exact chord, and
    tessellation_error_mm is the polyhedron's against the sphere's, over 2000 random pixels.
    """
    rows = []
    for level in subdivisions:
        mesh = trimesh.creation.icosphere(subdivisions=level, radius=_RADIUS_MM)
        scene = Scene([Surface(mesh, inside="water", outside="air", name="sphere")])
        for side in sides:
            view = view_of(dataclasses.replace(load_protocol("reference"), rows=side, cols=side, pixel_mm=160.0 / side))
            pixels = np.random.default_rng(side).integers(0, side, (_SAMPLES, 2))
            exact, ideal = polyhedron_chords(mesh, pixels, view), sphere_chords(_RADIUS_MM, pixels, view)
            for engine in ("embree", "scanline"):
                seconds, paths = _best_of(lambda e=engine, s=scene, v=view: trace(s, v, engine=e, workers=workers))
                found = paths.path_mm["water"][pixels[:, 0], pixels[:, 1]]
                rows.append({
                    "engine": engine, "triangles": len(mesh.faces), "pixels": side * side, "seconds": round(seconds, 4),
                    "million_rays_per_s": round(side * side / seconds / 1e6, 2),
                    "engine_error_mm": float(f"{abs(found - exact).max():.2g}"),
                    "tessellation_error_mm": float(f"{abs(exact - ideal).max():.2g}"),
                    "repaired": paths.audit.repaired, "unrepaired": paths.audit.unrepaired,
                })  # fmt: skip
    return rows


def spectrum_rows(nodes: tuple[int, ...] = (4, 8, 12, 18, 28, 56)) -> list[Row]:
    """One row a number of nodes: greatest relative error of the signal, 0-150 mm of tissue with 0-15 mm of cortex."""
    protocol = load_protocol("reference")

    def signal(count: int) -> Array:
        beam = beam_of(protocol, nodes=count)
        soft, bone = np.meshgrid(np.linspace(0, 150, 31), np.linspace(0, 15, 16))
        mu = [attenuation_per_mm(m, beam.energies_kev) for m in ("muscle", "cortical_bone")]
        exponent = soft[..., None] * mu[0] + bone[..., None] * mu[1]
        return np.asarray((beam.photons_per_mm2 * beam.signal_kev * np.exp(-exponent)).sum(axis=-1))

    full = signal(100_000)
    rows = []
    for count in nodes:
        folded = signal(count)
        rows.append({"nodes": count, "max_relative_error": float(f"{abs(folded / full - 1).max():.2g}")})
    return rows


def stage_rows(workers: int) -> list[Row]:
    """One row an engine and run: seconds of each stage of simulate, full knee, protocol reference; peak memory in MB.

    Each engine has processes of its own. A "cold" run, the first after installation, compiles; the "first" of a process
    loads libraries and compiled code; the "second" is what one more radiograph costs.
    """
    rows = []
    for engine in ("embree", "scanline"):
        with empty_folder() as folder, _environment(NUMBA_CACHE_DIR=str(folder)):
            rows += _in_a_new_process(engine, workers, ("cold",))
        rows += _in_a_new_process(engine, workers, ("first", "second"))
    return rows


@contextmanager
def _environment(**variables: str) -> Iterator[None]:
    """Environment variables for processes that are started within."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _in_a_new_process(engine: str, workers: int, runs: tuple[str, ...]) -> list[Row]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_timed_runs, engine, workers, runs).result()


def _timed_runs(engine: str, workers: int, runs: tuple[str, ...]) -> list[Row]:
    protocol, rows = load_protocol("reference"), []
    for run in runs:
        start = perf_counter()
        radiograph = simulate(Knee(), protocol, seed=1, engine=engine, workers=workers)
        total = perf_counter() - start
        stages = {name: round(seconds, 3) for name, seconds in radiograph.seconds.items()}
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append({"engine": engine, "run": run, "seconds": round(total, 3), "peak_mb": round(peak), **stages})
    return rows


def polyhedron_chords(mesh: trimesh.Trimesh, pixels: NDArray[np.int64], view: View) -> Array:
    """(n,)  exact chords of a convex polyhedron, by clipping each ray against the half-space of every face

    pixels  (n, 2)  rows and columns
    """
    source, directions = _rays(pixels, view)
    near, far = np.zeros(len(pixels)), np.full(len(pixels), np.inf)
    for normal, corner in zip(mesh.face_normals, mesh.triangles[:, 0], strict=True):
        along, ahead = directions @ normal, normal @ (corner - source)
        cut = np.divide(ahead, along, out=np.full(len(pixels), np.nan), where=along != 0)
        far = np.where(along > 0, np.minimum(far, cut), far)
        near = np.where(along < 0, np.maximum(near, cut), near)
        far = np.where((along == 0) & (ahead < 0), -np.inf, far)
    return np.maximum(far - near, 0.0)


def sphere_chords(radius_mm: float, pixels: NDArray[np.int64], view: View) -> Array:
    """(n,)  exact chords of a sphere about the origin"""
    source, directions = _rays(pixels, view)
    closest = -directions @ source
    squared = radius_mm**2 - (source @ source - closest**2)
    return np.asarray(2 * np.sqrt(np.maximum(squared, 0.0)))


def _rays(pixels: NDArray[np.int64], view: View) -> tuple[Array, Array]:
    """Source (3,) and unit directions (n, 3) of the rays to pixels."""
    corner = np.asarray(view.corner_mm)
    rows, cols = np.asarray(pixels, np.float64).T
    depth = np.full(len(rows), corner[1])
    places = np.column_stack((corner[0] + cols * view.pixel_mm, depth, corner[2] - rows * view.pixel_mm))
    source = np.asarray(view.source_mm)
    offset = places - source
    return source, offset / np.linalg.norm(offset, axis=1, keepdims=True)


def _best_of(job: Any, runs: int = 3) -> tuple[float, Any]:
    """Least wall time of a few runs, after one that loads compiled code, and the result."""
    result = job()
    least = np.inf
    for _ in range(runs):
        start = perf_counter()
        result = job()
        least = min(least, perf_counter() - start)
    return least, result
