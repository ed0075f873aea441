"""compiling_aside: the kernels of rays, compiled in a process of their own while a knee is built.

numba compiles one function at a time in a process. After an installation a radiograph waits for some thirty, half of
them of its rays; two processes have them in little more than half the time. What the other one has compiled, this one
reads from numba's cache. Where that fails, it compiles itself.
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

from .anatomy.trabeculae import Trabeculae, healthy_tibia
from .core.aside import beside, can_run_beside
from .data.spongy import TrabecularBone, trabecular_bone
from .geometry.repair import Solid, repair
from .geometry.view import View
from .model.protocol import load_protocol
from .raycast import crossings, scanline
from .raycast.sheets import Sheet, sheet_of
from .xray.primary import transmit
from .xray.spectrum import Beam
from .xray.technique import technique_of

# What rays need of each engine, and for texture.
_OF = {
    "scanline": ("raycast.scanline._find_spans", "raycast.scanline._scan"),
    "embree": (
        *("raycast.scanline._find_spans", "raycast.spread.across_edges", "raycast.casting.advance"),
        *("raycast.spread.spread", "raycast.spread.walk_on", "raycast.crossings._sum_depths"),
    ),
    "texture": (
        *("raycast.scanline._list", "raycast.crossings._append", "raycast.crossings.order"),
        *("raycast.crossings._sum_depths", "raycast.crossings._segments", "anatomy.integrate.integrate_density"),
    ),
}
# The other process is done a second or two after this one, or it is not to be waited for.
_PATIENCE_S = 20.0
_VIEW = View(source_mm=(0.0, -1000.0, 0.0), centre_mm=(0.0, 100.0, 0.0), rows=2, cols=2, pixel_mm=1.0)
# A tetrahedron that covers all of its pixels.
_CORNERS = np.array([[-90.0, 0.0, -90.0], [90.0, 0.0, -90.0], [0.0, 0.0, 90.0], [0.0, 50.0, 0.0]])
_FACES = np.array([[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]], np.int32)
_tried = set[tuple[str, bool]]()


def kernels(engine: str, textured: bool) -> list[Any]:
    """Compiled functions that a knee's rays need."""
    names = dict.fromkeys((*_OF[engine], *(_OF["texture"] if textured else ())))
    parts = [name.rpartition(".") for name in names]
    return [getattr(import_module(f".{module}", __package__), name) for module, _, name in parts]


def is_compiled(kernel: Any) -> bool:
    """Whether numba's cache has code of a kernel, of this source and for this processor; also where nobody knows."""
    with suppress(Exception):  # of numba's insides, which may change
        known = kernel._cache._cache_file._load_index()
        processor = kernel.targetctx.codegen().magic_tuple()
        return bool(kernel.signatures) or any(key[1] == processor for key in known)
    return True


@contextmanager
def compiling_aside(engine: str, *, textured: bool, workers: int) -> Iterator[None]:
    """Compile meanwhile what rays need and numba's cache has not; when the block ends it has, or it is compiled later.

    Nothing is started where all is there, for one worker, in a worker of a pool, and where it could not be kept.
    engine    embree or scanline
    textured  whether density is integrated
    workers   threads
    """
    what = (engine, textured)
    settings: Any = config  # whose names numba gives while it runs
    if what in _tried or workers < 2 or settings.DISABLE_JIT or not can_run_beside():
        yield
        return
    _tried.add(what)
    left = [kernel for kernel in kernels(*what) if not is_compiled(kernel)]
    if not left or not all(os.access(kernel.stats.cache_path or "", os.W_OK) for kernel in left):
        yield
        return
    folder = settings.CACHE_DIR
    environment = os.environ | ({"NUMBA_CACHE_DIR": folder} if folder else {})
    arguments = (engine, "trabecular" if textured else "none")
    with (
        beside(__name__, "compile_rays", *arguments, environment=environment, patience_s=_PATIENCE_S),
        _no_collection(),
    ):
        yield
        compile_others()  # while the other one is still at it


@contextmanager
def _no_collection() -> Iterator[None]:
    """A compiler makes millions of objects that stay: to look through them for garbage takes a sixth of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def compile_rays(engine: str, texture: str) -> None:
    """Compile all of them, by rays to a few pixels through a tetrahedron."""
    with _no_collection():
        solid = Solid(points=_CORNERS, faces=_FACES, vertices=np.arange(4))
        _trace(engine, sheet_of(solid, _VIEW), None if texture == "none" else _tibia(trabecular_bone()))


def compile_others() -> None:
    """Compile what comes before rays and after them: what mends meshes, and what attenuates."""
    repair(_CORNERS, _FACES, "tetrahedron")
    tissue_mm = {"muscle": np.ones((_VIEW.rows, _VIEW.cols), np.float32)}
    transmit(tissue_mm, Beam(*np.ones((4, 1))), technique_of(load_protocol("reference")), 1, _VIEW)


def _trace(engine: str, sheet: Sheet, density: Trabeculae | None) -> None:
    caster: Any
    if engine == "embree":
        from .raycast.embree import Caster

        caster = Caster(sheet, 0)
    else:
        caster = scanline.Caster(sheet, 0)
    caster.chords(0, _VIEW.rows)
    if density is not None:
        listed = scanline.crossings(sheet, 0, _VIEW.rows)
        crossings.chords(listed)
        crossings.integrals(crossings.joined([(listed, 1), (listed, 1)]), sheet.frame, density)


def _tibia(table: TrabecularBone) -> Trabeculae:
    """A tibia's density of a small lattice, which is soon made."""
    small = structs.replace(table.lattice, voxels=(32, 32, 32))
    return healthy_tibia(structs.replace(table, lattice=small), seed=0)
