"""Work on several processes, of this machine or of a cluster, whose results do not depend on how many there are."""

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from multiprocessing import active_children, current_process, get_context, parent_process
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Barrier
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from .checks import InputError
from .child_processes import safe_start
from .workers import WorkersLostError, keep_memory, one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")

# How often in a row, without a result between, workers may be killed before the work is given up.
_PATIENCE = 3

# Of a worker process: what is shared by the items of one call, and where it waits until all processes have that.
_shared: dict[str, Any] = {}
_all_here: list[Barrier] = []


def cores() -> int:
    """Count the cores that this process may use: one where it is daemonic, and may start no other process."""
    if current_process().daemon:
        return 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, 256)


def ordered_map(
    function: Callable[..., Result],
    items: Sequence[Item],
    *,
    shared: dict[str, Any],
    workers: int = 1,
    scheduler: str | None = None,
    arrived: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """[function(item, **shared) for item in items], on `workers` processes, or on those of a Dask scheduler.

    shared     sent to every worker; with more than one worker it, the function and the items must be picklable
    scheduler  address such as "tcp://host:8786", whose workers do the work instead; None: processes of this machine
    arrived    is told index and result of each item as it ends, in whatever order that happens
    returns    results in the order of the items; what a killed worker had in hand is done again by another
    raises     WorkersLostError when workers keep being killed; InputError for a scheduler that cannot be used, and for
               more than one worker in a daemonic process
    """
    results: dict[int, Result] = {}

    def take(index: int, result: Result) -> None:
        results[index] = result
        if arrived is not None:
            arrived(index, result)

    if scheduler is not None:
        require_scheduler(scheduler)
        from .cluster import spread

        spread(function, items, shared, scheduler, take)
    elif workers <= 1 or len(items) <= 1:
        for index, item in enumerate(items):
            with threadpool_limits(1):
                result = function(item, **shared)
            take(index, result)
    else:
        if current_process().daemon:
            raise InputError(
                f"workers must be 1 in a daemonic process (of multiprocessing.Pool or Dask), got {workers}: it may "
                "start no other process"
            )
        _in_processes(function, items, shared, workers, take)
    return [results[index] for index in range(len(items))]


def require_scheduler(address: str, modules: tuple[str, ...] = ()) -> None:
    """Refuse a scheduler that cannot be used, before anything is written.

    modules  that its workers must be able to import, beside this package
    raises   InputError for an address that is none or does not answer, a scheduler without workers, a missing library
    """
    if find_spec("distributed") is None:
        raise InputError(
            f"scheduler = {address!r} needs distributed; bring it, in the source folder, with: pip install '.[cluster]'"
        )
    from .cluster import require_workers

    require_workers(address, modules)


def _in_processes(
    function: Callable[..., Result],
    items: Sequence[Item],
    shared: dict[str, Any],
    workers: int,
    take: Callable[[int, Result], None],
) -> None:
    left = list(range(len(items)))

    def arrived(index: int, result: Result) -> None:
        left.remove(index)
        take(index, result)

    killed = 0
    while left:
        before = len(left)
        # What kills its worker ends the whole pool, and with it what the others had in hand: after a pool without a
        # result one item is tried by itself, then the pool is of all that is left again.
        batch = left[:1] if killed else left
        try:
            _one_pool(function, {index: items[index] for index in batch}, shared, workers, arrived)
            killed = 0
        except BrokenProcessPool:
            killed = killed + 1 if len(left) == before else 0
            if killed == _PATIENCE:
                raise WorkersLostError(
                    f"a worker process was killed {killed} times over (memory? or a script that starts workers outside "
                    'of `if __name__ == "__main__"`?)'
                ) from None
            if killed:
                in_hand = 1 if killed > 1 else workers
                left[:] = left[in_hand:] + left[:in_hand]


def _one_pool(
    function: Callable[..., Result],
    items: dict[int, Item],
    shared: dict[str, Any],
    workers: int,
    arrived: Callable[[int, Result], None],
) -> None:
    """As far as a pool comes; raises BrokenProcessPool after all that its workers finished has arrived."""
    broken: BrokenProcessPool | None = None
    others = set(active_children()) - _standing.children
    try:
        pool = _pool(workers)
        _give(shared, pool, workers)
        _standing.children = set(active_children()) - others
        futures = {pool.submit(_call, function, item): index for index, item in items.items()}
        for future in as_completed(futures):
            try:
                result = future.result()
            except BrokenProcessPool as error:
                broken = error
            else:
                arrived(futures[future], result)
        if broken is not None:
            raise broken
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            for child in set(active_children()) - others:
                child.terminate()
        _end_pool()
        raise


@dataclass
class _Standing:
    """The pool that stands between calls, since a process takes seconds to start and to load what it computes with."""

    made_for: tuple[Any, ...] = ()
    pool: ProcessPoolExecutor | None = None
    children: set[BaseProcess] = field(default_factory=set)


_standing = _Standing()


def _pool(workers: int) -> ProcessPoolExecutor:
    """The pool that stands, if a new one would be the same; else a new one."""
    now = (workers, os.getcwd(), tuple(sys.path), tuple(sorted(os.environ.items())))
    if _standing.pool is None or _standing.made_for != now:
        _end_pool()
        # spawn: a forked copy of a process that has threads (ITK, OpenMP) may hang.
        context = get_context("spawn")
        with safe_start():  # the first lock starts a process that looks after locks
            _standing.pool = ProcessPoolExecutor(workers, context, _begin, (context.Barrier(workers),))
        _standing.made_for = now
    return _standing.pool


def _end_pool() -> None:
    if _standing.pool is not None:
        _standing.pool.shutdown(cancel_futures=True)
    _standing.pool, _standing.children = None, set()


def _give(shared: dict[str, Any], pool: ProcessPoolExecutor, workers: int) -> None:
    """What is shared to every process once: none takes it twice, since each waits until all have it."""
    packed = pickle.dumps(shared)
    with _deaf(), safe_start():
        taken = [pool.submit(_take, packed) for _ in range(workers)]
    for one in taken:
        one.result()


@contextmanager
def _deaf() -> Iterator[None]:
    """Processes that are started meanwhile hear no interrupt, which a terminal sends to all: their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(barrier: Barrier) -> None:
    keep_memory()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _all_here.append(barrier)


def _take(packed: bytes) -> None:
    _shared.clear()
    try:
        _shared.update(pickle.loads(packed))
    finally:
        _all_here[0].wait()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever, with all its memory."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _call(function: Callable[..., Result], item: Any) -> Result:
    with one_thread():
        return function(item, **_shared)
