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

# M_TRIM_THRESHOLD of malloc.h: free memory up to this limit stays with the process.
_TRIM_THRESHOLD = -1
# M_MMAP_THRESHOLD of malloc.h: arrays up to this limit are allocated in memory that the process already has.
_MMAP_THRESHOLD = -3
# Value of both limits, in bytes.
_LARGE = 2**30
# Segments of a sphere that has enough triangles for manifold3d to use several threads.
_SPHERE_SEGMENTS = 400


class WorkersLostError(RuntimeError):
    """Report that workers were killed repeatedly or a cluster was lost; results delivered until then are kept."""


def retain_freed_memory() -> None:
    """Keep freed memory in this process for later arrays, if the C library is GNU's.

    Without this setting a series of radiographs spends a tenth of its time on returning and requesting memory pages.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(None)
            library.mallopt(_TRIM_THRESHOLD, _LARGE)
            library.mallopt(_MMAP_THRESHOLD, _LARGE)


@contextmanager
def limit_to_one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread while the context is open.

    The last bit of a matrix product depends on the number of threads, and the threads of several processes disturb each
    other.

    Yields
    ------
    None
        The earlier limit is restored at the end of the block.
    """
    with threadpool_limits(1, user_api="blas"):
        yield


@cache
def limit_manifold_to_one_thread() -> None:
    """Limit manifold3d to one thread for the lifetime of this process; call before its first solid.

    manifold3d has no such option: it counts the cores when it first works on many triangles. If every core has a
    process, the threads of manifold3d would cost about 3 % of the time.
    """
    with limit_to_one_core():
        ball = Manifold.sphere(1.0, _SPHERE_SEGMENTS)
        (ball ^ ball.translate((0.5, 0.1, 0.2))).volume()


@contextmanager
def limit_to_one_thread() -> Iterator[None]:
    """Limit BLAS, OpenMP, SimpleITK and manifold3d to one thread, since every core has a process of its own.

    Yields
    ------
    None
        Limits of BLAS and OpenMP are restored at the end of the block; the others remain.
    """
    if parent_process() is not None:
        limit_manifold_to_one_thread()
    if find_spec("SimpleITK"):
        # Each process would otherwise start as many threads as there are cores, and they would wait for each other.
        import SimpleITK as sitk  # noqa: N813

        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    # With one thread the order of a sum, and thus its last bit, is the same on every machine.
    with threadpool_limits(1):
        yield


@contextmanager
def limit_to_one_core() -> Iterator[None]:
    """Restrict this process to one core while the context is open, so that libraries count one core.

    There is no effect where the system offers no such restriction.

    Yields
    ------
    None
        The earlier set of cores is restored at the end of the block.
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
