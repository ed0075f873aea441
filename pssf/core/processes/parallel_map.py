"""Map a function over items in several processes; the results do not depend on the number of processes."""

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from multiprocessing import active_children, current_process, get_context, parent_process
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Barrier
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from ..checks import InputError
from .child_processes import start_without_working_folder
from .worker_processes import WorkersLostError, limit_to_one_thread, retain_freed_memory

Item = TypeVar("Item")
Result = TypeVar("Result")

# Number of consecutive worker kills without a new result after which the run stops with an error (assumed).
_MAX_KILLS_IN_A_ROW = 3

# Global variable of a worker process: keyword arguments that are the same for all items.
_shared: dict[str, Any] = {}
# Global variable of a worker process: barrier that waits until all workers have received the shared arguments.
_shared_barriers: list[Barrier] = []


def count_cores() -> int:
    """Count the cores that this process may use.

    Returns
    -------
    int
        Number of cores, at most 256; 1 in a daemonic process, which cannot start other processes.
    """
    if current_process().daemon:
        return 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, 256)


def map_in_parallel(
    function: Callable[..., Result],
    items: Sequence[Item],
    *,
    shared: dict[str, Any],
    workers: int = 1,
    scheduler: str | None = None,
    on_result: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """Compute ``[function(item, **shared) for item in items]`` in several processes or on a Dask cluster.

    If a worker is killed, another worker repeats its item.

    Parameters
    ----------
    function : callable
        Function that is called as ``function(item, **shared)``.
    items : sequence
        Items to process.
    shared : dict of str to Any
        Keyword arguments that are the same for all items. They are sent to every worker once. With more than one
        worker, shared arguments, function and items must be picklable.
    workers : int, default 1
        Number of local processes.
    scheduler : str or None, default None
        Address of a Dask scheduler, such as "tcp://host:8786", whose workers process the items. None uses local
        processes.
    on_result : callable or None, default None
        Function that is called with the index and the result of each finished item. Items may finish in any order.

    Returns
    -------
    list
        Results in the order of the items.

    Raises
    ------
    InputError
        If the scheduler cannot be used, or more than one worker is requested in a daemonic process.
    WorkersLostError
        If workers are killed repeatedly, or the connection to the cluster is lost.
    """
    results: dict[int, Result] = {}

    def take(index: int, result: Result) -> None:
        results[index] = result
        if on_result is not None:
            on_result(index, result)

    if scheduler is not None:
        require_scheduler(scheduler)
        from .cluster import run_on_cluster

        run_on_cluster(function, items, shared, scheduler, take)
    elif workers <= 1 or len(items) <= 1:
        for index, item in enumerate(items):
            with threadpool_limits(1):
                result = function(item, **shared)
            take(index, result)
    else:
        if current_process().daemon:
            raise InputError(
                f"workers must be 1 in a daemonic process (of multiprocessing.Pool or Dask), got {workers}: a daemonic "
                "process cannot start other processes"
            )
        _run_in_processes(function, items, shared, workers, take)
    return [results[index] for index in range(len(items))]


def require_scheduler(address: str, modules: tuple[str, ...] = ()) -> None:
    """Check a Dask scheduler and its workers before any file is written.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as "tcp://host:8786".
    modules : tuple of str, default ()
        Modules that the workers must be able to import, in addition to pssf.

    Raises
    ------
    InputError
        If the package distributed is missing, or the address is malformed. If the scheduler does not answer, or a
        worker lacks pssf, has another version of pssf, or lacks a module.
    """
    if find_spec("distributed") is None:
        raise InputError(
            f"scheduler {address!r} needs the package distributed, which is not installed: run "
            "pip install '.[cluster]' in the source folder"
        )
    from .cluster import require_cluster_workers

    require_cluster_workers(address, modules)


def _run_in_processes(
    function: Callable[..., Result],
    items: Sequence[Item],
    shared: dict[str, Any],
    workers: int,
    on_result: Callable[[int, Result], None],
) -> None:
    """Process all items in a pool of processes; start a new pool after a worker has been killed."""
    left = list(range(len(items)))

    def arrived(index: int, result: Result) -> None:
        left.remove(index)
        on_result(index, result)

    killed = 0
    while left:
        before = len(left)
        # If a worker is killed, the entire pool ends, and all items in progress are lost. If the pool returned no
        # result, the next pool receives a single item. After a result, the next pool receives all remaining items.
        batch = left[:1] if killed else left
        try:
            _run_pool(function, {index: items[index] for index in batch}, shared, workers, arrived)
            killed = 0
        except BrokenProcessPool:
            killed = killed + 1 if len(left) == before else 0
            if killed == _MAX_KILLS_IN_A_ROW:
                raise WorkersLostError(
                    f"worker processes were killed {killed} times in a row; memory may be insufficient, or a script "
                    'starts workers outside of `if __name__ == "__main__"`'
                ) from None
            if killed:
                in_hand = 1 if killed > 1 else workers
                left[:] = left[in_hand:] + left[:in_hand]


def _run_pool(
    function: Callable[..., Result],
    items: dict[int, Item],
    shared: dict[str, Any],
    workers: int,
    on_result: Callable[[int, Result], None],
) -> None:
    """Process items in the pool until all are done or a worker is killed.

    If a worker was killed, BrokenProcessPool is raised after all finished results are delivered.
    """
    broken: BrokenProcessPool | None = None
    futures: dict[Future[Result], int] = {}
    others = set(active_children()) - _pool_state.children
    try:
        pool = _open_pool(workers)
        _share_with_workers(shared, pool, workers)
        _pool_state.children = set(active_children()) - others
        futures = {pool.submit(_run_item, function, item): index for index, item in items.items()}
        for future in as_completed(futures):
            try:
                result = future.result()
            except BrokenProcessPool as error:
                broken = error
            else:
                on_result(futures[future], result)
        if broken is not None:
            raise broken
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            for child in set(active_children()) - others:
                child.terminate()
        for future in futures:
            future.cancel()
        _shut_down_pool()
        raise


@dataclass
class _PoolState:
    """Keep the process pool between calls, because a new process takes seconds to start and to import libraries."""

    pool_key: tuple[Any, ...] = ()
    pool: ProcessPoolExecutor | None = None
    children: set[BaseProcess] = field(default_factory=set)


_pool_state = _PoolState()


def _open_pool(workers: int) -> ProcessPoolExecutor:
    """Return the existing pool if its settings are still valid; otherwise, start a new pool."""
    now = (workers, os.getcwd(), tuple(sys.path), tuple(sorted(os.environ.items())))
    if _pool_state.pool is None or _pool_state.pool_key != now:
        _shut_down_pool()
        # Workers are spawned, because a forked copy of a process with threads (ITK, OpenMP) may hang.
        context = get_context("spawn")
        with start_without_working_folder():  # The first barrier also starts the resource tracker, which is a process.
            _pool_state.pool = ProcessPoolExecutor(workers, context, _initialise_worker, (context.Barrier(workers),))
        _pool_state.pool_key = now
    return _pool_state.pool


def _shut_down_pool() -> None:
    """Shut down the pool, if there is one.

    Items are not cancelled here: with `cancel_futures`, a pool of Python 3.11 waits forever if pickling an item fails
    after the cancellation.
    """
    if _pool_state.pool is not None:
        _pool_state.pool.shutdown()
    _pool_state.pool, _pool_state.children = None, set()


def _share_with_workers(shared: dict[str, Any], pool: ProcessPoolExecutor, workers: int) -> None:
    """Send the shared arguments to every worker exactly once: each worker waits until all have received them."""
    packed = pickle.dumps(shared)
    with _block_interrupts(), start_without_working_folder():
        taken = [pool.submit(_receive_shared, packed) for _ in range(workers)]
    for one in taken:
        one.result()


@contextmanager
def _block_interrupts() -> Iterator[None]:
    """Block the interrupt signal for processes that start in this context.

    On Ctrl-C, a terminal sends the interrupt signal to all processes. The workers ignore it, because the parent process
    terminates them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _initialise_worker(barrier: Barrier) -> None:
    """Prepare a new worker process: memory settings, a thread that watches the parent, and the barrier."""
    retain_freed_memory()
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    _shared_barriers.append(barrier)


def _receive_shared(packed: bytes) -> None:
    """Unpickle the shared arguments in a worker, then wait until all workers have them."""
    _shared.clear()
    try:
        _shared.update(pickle.loads(packed))
    finally:
        _shared_barriers[0].wait()


def _exit_with_parent() -> None:
    """End the worker if its parent was killed; otherwise the worker would wait forever and keep its memory."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _run_item(function: Callable[..., Result], item: Any) -> Result:
    """Process one item in a worker, with one thread."""
    with limit_to_one_thread():
        return function(item, **_shared)
