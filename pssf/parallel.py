"""Work on several processes whose results do not depend on how many there are."""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.util import find_spec
from multiprocessing import get_context, parent_process
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")

_shared: dict[str, Any] = {}  # of a worker process: set once when it starts, read only afterwards


def ordered_map(
    function: Callable[..., Result],
    items: Sequence[Item],
    *,
    shared: dict[str, Any],
    workers: int = 1,
    arrived: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """[function(item, **shared) for item in items], on `workers` processes.

    shared   sent to every worker once; with more than one worker it, the function and the items must be picklable
    arrived  is told index and result of each item as it ends, in whatever order that happens
    returns  results in the order of the items
    """
    results: dict[int, Result] = {}

    def take(index: int, result: Result) -> None:
        results[index] = result
        if arrived is not None:
            arrived(index, result)

    if workers <= 1 or len(items) <= 1:
        for index, item in enumerate(items):
            with threadpool_limits(1):
                result = function(item, **shared)
            take(index, result)
        return [results[index] for index in range(len(items))]
    # spawn: a forked copy of a process that has threads (ITK, OpenMP) may hang.
    pool = ProcessPoolExecutor(min(workers, len(items)), get_context("spawn"), _begin, (shared,))
    try:
        futures = {pool.submit(_call, function, item): index for index, item in enumerate(items)}
        for future in as_completed(futures):
            take(futures[future], future.result())
    finally:
        pool.shutdown(cancel_futures=True)
    return [results[index] for index in range(len(items))]


def _begin(shared: dict[str, Any]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if find_spec("SimpleITK"):
        # As many threads as cores in every process would wait for each other.
        import SimpleITK as sitk  # noqa: N813

        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    _shared.update(shared)


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever, with all its memory."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _call(function: Callable[..., Result], item: Any) -> Result:
    # One thread for BLAS and OpenMP too; the order of a sum, hence its last bit, then does not hang on the machine.
    with threadpool_limits(1):
        return function(item, **_shared)
