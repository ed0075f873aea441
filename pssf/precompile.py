"""Compilation of the ray kernels in a second process, while a knee is built.

numba compiles one function at a time per process. After an installation, a radiograph needs about thirty compiled
functions, half of them for its rays. Two processes take little more than half the time of one. This process reads the
functions of the other one from the cache of numba. If that fails, it compiles them itself.
"""

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

import numpy as np
from msgspec import structs
from numba.core import config

from .anatomy.trabeculae.trabecular_density import Trabeculae, build_healthy_tibia_trabeculae
from .core.processes.background_process import can_run_in_background, run_in_background
from .data.anatomy.trabecular_table import TrabecularBone, load_trabecular_bone
from .geometry.mesh_repair import Solid, repair_mesh
from .geometry.view import View
from .model.protocol import load_protocol
from .raycast.engines import crossings, scanline
from .raycast.engines.projected_surface import ProjectedSurface, project_surface
from .xray.primary_beam import transmit
from .xray.resolved_technique import resolve_technique
from .xray.spectrum import Beam

# Compiled functions that rays need, for each engine and for texture.
_KERNELS_BY_USE = {
    "scanline": ("raycast.engines.scanline._find_spans", "raycast.engines.scanline._accumulate_depths"),
    "embree": (
        *(
            "raycast.engines.scanline._find_spans",
            "raycast.engines.neighbour_reuse.find_adjacent_faces",
            "raycast.engines.ray_state.advance_rays",
        ),
        *(
            "raycast.engines.neighbour_reuse.reuse_from_grid",
            "raycast.engines.neighbour_reuse.reuse_from_neighbours",
            "raycast.engines.crossings._sum_depths",
        ),
    ),
    "texture": (
        *(
            "raycast.engines.scanline._write_crossings",
            "raycast.engines.crossings._append_crossings",
            "raycast.engines.crossings.sort_crossings",
        ),
        *(
            "raycast.engines.crossings._sum_depths",
            "raycast.engines.crossings._find_segments",
            "anatomy.trabeculae.density_integral.integrate_density",
        ),
    ),
}
# Longest wait for the other process, in s; it usually finishes one or two seconds after this one.
_TIMEOUT_S = 20.0
# View of four pixels for the test rays.
_VIEW = View(source_mm=(0.0, -1000.0, 0.0), centre_mm=(0.0, 100.0, 0.0), rows=2, cols=2, pixel_mm=1.0)
# Vertices of a tetrahedron that covers all pixels of the view, in mm.
_CORNERS = np.array([[-90.0, 0.0, -90.0], [90.0, 0.0, -90.0], [0.0, 0.0, 90.0], [0.0, 50.0, 0.0]])
# Faces of the tetrahedron.
_FACES = np.array([[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]], np.int32)
# Engine and texture for which compilation was already attempted in this process.
_attempted = set[tuple[str, bool]]()


def list_kernels(engine: str, textured: bool) -> list[Any]:
    """List the compiled functions that the rays of a knee need.

    Parameters
    ----------
    engine : {"embree", "scanline"}
        Ray caster.
    textured : bool
        True if a density is integrated along the rays.

    Returns
    -------
    list of callable
        Functions compiled by numba.
    """
    names = dict.fromkeys((*_KERNELS_BY_USE[engine], *(_KERNELS_BY_USE["texture"] if textured else ())))
    parts = [name.rpartition(".") for name in names]
    return [getattr(import_module(f".{module}", __package__), name) for module, _, name in parts]


def is_compiled(kernel: Any) -> bool:
    """Check whether a compiled function is in the cache of numba, for its present source and this processor.

    Parameters
    ----------
    kernel : callable
        Function compiled by numba.

    Returns
    -------
    bool
        True if it is in the cache, or if the cache cannot be read.
    """
    with suppress(Exception):  # Private parts of numba may change between versions.
        known = kernel._cache._cache_file._load_index()
        processor = kernel.targetctx.codegen().magic_tuple()
        return bool(kernel.signatures) or any(key[1] == processor for key in known)
    return True


@contextmanager
def precompile_in_background(engine: str, *, textured: bool, workers: int) -> Iterator[None]:
    """Compile the functions that rays need in the background, while the body of the ``with`` statement runs.

    Nothing is compiled if all functions are in the cache of numba, or if the cache is read-only. The same holds for one
    worker, and inside a worker of a pool. Functions that are not ready at the end are compiled later, when they are
    called.

    Parameters
    ----------
    engine : {"embree", "scanline"}
        Ray caster.
    textured : bool
        True if a density is integrated along the rays.
    workers : int
        Number of threads of the simulation.

    Yields
    ------
    None
        The body of the ``with`` statement runs in the meantime.
    """
    what = (engine, textured)
    settings: Any = config  # numba defines the names of its settings at run time, so that their types are unknown.
    if what in _attempted or workers < 2 or settings.DISABLE_JIT or not can_run_in_background():
        yield
        return
    _attempted.add(what)
    left = [kernel for kernel in list_kernels(*what) if not is_compiled(kernel)]
    if not left or not all(os.access(kernel.stats.cache_path or "", os.W_OK) for kernel in left):
        yield
        return
    folder = settings.CACHE_DIR
    environment = os.environ | ({"NUMBA_CACHE_DIR": folder} if folder else {})
    arguments = (engine, "trabecular" if textured else "none")
    with (
        run_in_background(__name__, "compile_ray_kernels", *arguments, environment=environment, timeout_s=_TIMEOUT_S),
        _pause_garbage_collection(),
    ):
        yield
        compile_other_kernels()  # The other process is still busy at this point.


@contextmanager
def _pause_garbage_collection() -> Iterator[None]:
    """Pause garbage collection, which takes a sixth of the time of a compiler.

    A compiler makes millions of permanent objects that the collector would scan.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def compile_ray_kernels(engine: str, texture: str) -> None:
    """Compile the functions that rays need, by casting rays through a tetrahedron.

    Parameters
    ----------
    engine : {"embree", "scanline"}
        Ray caster.
    texture : {"trabecular", "none"}
        Whether a density is integrated along the rays.
    """
    with _pause_garbage_collection():
        solid = Solid(points=_CORNERS, faces=_FACES, source_vertices=np.arange(4))
        _trace_test_rays(
            engine,
            project_surface(solid, _VIEW),
            None if texture == "none" else _make_small_tibia(load_trabecular_bone()),
        )


def compile_other_kernels() -> None:
    """Compile the functions used before and after ray casting: mesh repair and attenuation."""
    repair_mesh(_CORNERS, _FACES, "tetrahedron")
    tissue_mm = {"muscle": np.ones((_VIEW.rows, _VIEW.cols), np.float32)}
    transmit(tissue_mm, Beam(*np.ones((4, 1))), resolve_technique(load_protocol("reference")), 1, _VIEW)


def _trace_test_rays(engine: str, sheet: ProjectedSurface, density: Trabeculae | None) -> None:
    """Cast rays through the test surface, and integrate a density along them if there is one."""
    caster: Any
    if engine == "embree":
        from .raycast.engines.embree import Caster

        caster = Caster(sheet, 0)
    else:
        caster = scanline.Caster(sheet, 0)
    caster.trace_chords(0, _VIEW.rows)
    if density is not None:
        listed = scanline.find_crossings(sheet, 0, _VIEW.rows)
        crossings.chord_fractions(listed)
        crossings.integrate_along_rays(crossings.merge_crossings([(listed, 1), (listed, 1)]), sheet.frame, density)


def _make_small_tibia(table: TrabecularBone) -> Trabeculae:
    """Make the trabecular density of a tibia with a small lattice, which takes little time."""
    small = structs.replace(table.lattice, voxels=(32, 32, 32))
    return build_healthy_tibia_trabeculae(structs.replace(table, lattice=small), seed=0)
