"""What every worker process keeps to, of this machine or of a cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from threadpoolctl import threadpool_limits


class WorkersLostError(RuntimeError):
    """Workers were killed again and again, or a cluster was lost; what had come to stand by then stands."""


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for BLAS, OpenMP and SimpleITK, since there is a process for every core."""
    if find_spec("SimpleITK"):
        # As many threads as cores in every process would wait for each other.
        import SimpleITK as sitk  # noqa: N813

        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    # The order of a sum, hence its last bit, then does not hang on the machine either.
    with threadpool_limits(1):
        yield
