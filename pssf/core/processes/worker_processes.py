"""Thread and memory settings of a worker process, on this machine or on a cluster."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from multiprocessing import parent_process

from manifold3d import Manifold
from threadpoolctl import threadpool_limits

# Code of the option M_TRIM_THRESHOLD in malloc.h; the option sets how much freed memory a process retains.
_TRIM_THRESHOLD = -1
# Code of the option M_MMAP_THRESHOLD in malloc.h; up to the array size in this option, a process reuses its memory.
_MMAP_THRESHOLD = -3
# Code of the option M_ARENA_MAX in malloc.h; the option sets the number of memory pools of a process.
_ARENA_MAX = -8
# Amount of freed memory that a process retains at the end of its pool, in bytes (assumed).
_RETAINED_BYTES = 2**26
# Largest array whose memory a process reuses, in bytes: the largest value that the GNU C library accepts.
_REUSED_BYTES = 2**25
# Number of segments of a sphere (assumed). The sphere has so many triangles that manifold3d determines its number of
# threads.
_SPHERE_SEGMENTS = 400


class WorkersLostError(RuntimeError):
    """Report that workers were killed repeatedly or that a cluster was lost; earlier results remain valid."""


def retain_freed_memory() -> None:
    """Retain freed memory in this process for later arrays, if the C library is the GNU C library.

    Without this setting, the simulation of many radiographs spends a tenth of its time on releasing and requesting
    memory pages. All threads share one memory pool, because every pool retains memory of its own: with one pool, a
    worker that makes radiographs of 512 x 512 pixels needs at most 550 MB instead of 690 MB.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(None)
            library.mallopt(_ARENA_MAX, 1)
            library.mallopt(_TRIM_THRESHOLD, _RETAINED_BYTES)
            library.mallopt(_MMAP_THRESHOLD, _REUSED_BYTES)


@contextmanager
def limit_to_one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread while the context is open.

    The last bit of a matrix product depends on the number of threads. BLAS threads of several processes also slow each
    other down.

    Yields
    ------
    None
        The previous limit is restored at the end of the block.
    """
    with threadpool_limits(1, user_api="blas"):
        yield


@cache
def limit_manifold_to_one_thread() -> None:
    """Limit manifold3d to one thread for the lifetime of this process; call it before manifold3d builds a solid.

    manifold3d has no option for the number of threads. It counts the cores when it first processes many triangles. If
    every core already runs a process, additional threads of manifold3d increase the run time by about 3 %.
    """
    with limit_to_one_core():
        ball = Manifold.sphere(1.0, _SPHERE_SEGMENTS)
        (ball ^ ball.translate((0.5, 0.1, 0.2))).volume()


@contextmanager
def limit_to_one_thread() -> Iterator[None]:
    """Limit BLAS, OpenMP, SimpleITK and manifold3d to one thread, because every core runs a separate process.

    Yields
    ------
    None
        The limits of BLAS and OpenMP are restored at the end of the block; the limits of the other libraries remain.
    """
    if parent_process() is not None:
        limit_manifold_to_one_thread()
    if find_spec("SimpleITK"):
        # By default, SimpleITK starts one thread per core in every process, and the processes would compete.
        import SimpleITK as sitk  # noqa: N813

        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    # With one thread, sums are computed in the same order, and have the same last bit, on every machine.
    with threadpool_limits(1):
        yield


@contextmanager
def limit_to_one_core() -> Iterator[None]:
    """Restrict this process to one core while the context is open, so that libraries count one core.

    The function has no effect on systems that cannot assign a process to selected cores.

    Yields
    ------
    None
        The previous set of cores is restored at the end of the block.
    """
    if not hasattr(os, "sched_getaffinity"):
        yield
        return
    every = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(every)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, every)
