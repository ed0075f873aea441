"""What every worker process keeps to, of this machine or of a cluster."""

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

# Of mallopt (malloc.h): up to so many bytes, free memory stays with the process and arrays are made in it.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _LARGE = -1, -3, 2**30
# Sides of a ball that has enough triangles for several threads.
_MANY = 400


class WorkersLostError(RuntimeError):
    """Workers were killed again and again, or a cluster was lost; what had come to stand by then stands."""


def keep_memory() -> None:
    """Let this process keep the memory of arrays that are gone for those that come, where the C library is GNU's.

    Of one radiograph after another a tenth of the time went into handing pages back and asking for them again.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(None)
            library.mallopt(_TRIM_THRESHOLD, _LARGE)
            library.mallopt(_MMAP_THRESHOLD, _LARGE)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread for BLAS: the last bit of a product hangs on how many share it, and its threads are in others' way."""
    with threadpool_limits(1, user_api="blas"):
        yield


@cache
def hold_to_one_thread() -> None:
    """Let manifold3d use one thread in this process, for good; once, before its first solid.

    It has no switch, and counts the cores when it first works on many triangles. Processes that have a core each would
    be in each other's way, for 3 % of their time.
    """
    with one_core():
        ball = Manifold.sphere(1.0, _MANY)
        (ball ^ ball.translate((0.5, 0.1, 0.2))).volume()


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for BLAS, OpenMP, SimpleITK and manifold3d, since there is a process for every core."""
    if parent_process() is not None:
        hold_to_one_thread()
    if find_spec("SimpleITK"):
        # As many threads as cores in every process would wait for each other.
        import SimpleITK as sitk  # noqa: N813

        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    # The order of a sum, hence its last bit, then does not hang on the machine either.
    with threadpool_limits(1):
        yield


@contextmanager
def one_core() -> Iterator[None]:
    """What counts the cores meanwhile counts one, where the system lets a process choose among them."""
    if not hasattr(os, "sched_getaffinity"):
        yield
        return
    every = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(every)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, every)
