"""Run functions on the workers of a Dask scheduler, on any number of machines (``cluster`` extra).

If a worker is killed, Dask gives its item to another worker. If several workers are killed on the same item,
the run stops with an error.
"""

import pickle
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from distributed import Client, as_completed
from distributed.comm import CommClosedError
from distributed.scheduler import KilledWorker

from ..checks import InputError
from .worker_processes import WorkersLostError, limit_to_one_thread

# Time limit for an answer of the scheduler, in s (assumed).
_CONNECT_TIMEOUT_S = 10
# Time limit for a worker to connect, in s (assumed; a restarted worker must first load all libraries).
_WORKER_WAIT_S = 30
# Pause between two queries of the workers, in s (assumed).
_RETRY_DELAY_S = 0.5
# Maximum number of queries of the workers (assumed).
_QUERY_ATTEMPTS = 10
# Lock that makes a worker with several threads process one item at a time, because thread limits apply to the process.
_ONE_ITEM_LOCK = threading.Lock()


def require_cluster_workers(address: str, modules: tuple[str, ...] = ()) -> None:
    """Require that a scheduler answers, and that its workers have the local version of pssf.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as "tcp://host:8786".
    modules : tuple of str, default ()
        Further modules that every worker must be able to import.

    Raises
    ------
    InputError
        If the address is malformed, or the scheduler does not answer or has no workers. If a worker has another version
        of pssf or lacks a module.
    """
    with _connect(address) as client:
        answers = _query_workers(client, modules)
    if not answers:
        raise InputError(f"scheduler must have one or more workers, got none at {address!r}")
    for answer in answers:
        if isinstance(answer, ModuleNotFoundError):
            raise InputError(
                f"scheduler {address!r} has a worker without pssf ({answer}): install pssf on every worker"
            )
        if isinstance(answer, Exception):
            raise answer
    here = version("pssf")
    there = sorted({release for release, _ in answers})
    lacking = sorted(set().union(*(names for _, names in answers)))
    if there != [here]:
        raise InputError(
            f"pssf on the workers of {address!r} must have the local version {here}, got {', '.join(there)}"
        )
    if lacking:
        raise InputError(
            f"scheduler {address!r} has a worker without {', '.join(lacking)}: install the extra 'study' on every "
            "worker"
        )


def run_on_cluster(
    function: Callable[..., Any],
    items: Sequence[Any],
    shared: dict[str, Any],
    address: str,
    on_result: Callable[[int, Any], None],
) -> None:
    """Call a function for every item on the workers of a Dask scheduler.

    Parameters
    ----------
    function : callable
        Function that is called as ``function(item, **shared)``; must be picklable.
    items : sequence
        Items; must be picklable.
    shared : dict of str to Any
        Keyword arguments that are the same for all items; must be picklable.
    address : str
        Address of the scheduler, such as "tcp://host:8786".
    on_result : callable
        Function that is called with the index and the result of each finished item.

    Raises
    ------
    InputError
        If the scheduler cannot be reached.
    WorkersLostError
        If several workers are killed on the same item, or the connection to the scheduler is lost.
    """
    with _connect(address) as client:
        try:
            # The shared arguments are submitted as a task, because Dask can repeat a task if its worker is lost. Items
            # and arguments are pickled, because Dask would otherwise search every list in them for tasks.
            held = client.submit(bytes, pickle.dumps(shared), pure=False)
            pickled = [pickle.dumps(item) for item in items]
            futures = client.map(_run_item, pickled, function=function, shared=held, pure=False)
            indices = {future: index for index, future in enumerate(futures)}
            for future in as_completed(futures, loop=client.loop):
                on_result(indices[future], future.result())
                # Dask would repeat a finished item if its worker died while the result was still referenced.
                future.release()
        except KilledWorker:
            raise WorkersLostError(
                "workers of the cluster were killed repeatedly, possibly for lack of memory; run fewer workers"
            ) from None
        except (CancelledError, CommClosedError):
            raise WorkersLostError(
                f"the connection to scheduler {address} was lost; restart the scheduler, then repeat the command"
            ) from None


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    """Connect to the scheduler while the context is open; raise InputError if it cannot be reached."""
    allowed = "scheduler must be the address of a running Dask scheduler, such as tcp://host:8786"
    if not re.fullmatch(r"(tcp|tls)://.+:\d+", address):
        raise InputError(f"{allowed}, got {address!r}")
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except OSError:
        raise InputError(f"{allowed}, got {address!r}: no answer within {_CONNECT_TIMEOUT_S} s") from None
    with client:
        yield client


def _query_workers(client: Client, modules: tuple[str, ...]) -> list[Any]:
    """Collect the replies of all workers; return an empty list if no worker answers."""
    for _ in range(_QUERY_ATTEMPTS):
        try:
            client.wait_for_workers(1, timeout=_WORKER_WAIT_S)
        except TimeoutError:
            break
        replies = client.run(_describe_worker, modules, on_error="return").values()
        # A worker that dies during the query gives an OSError, and is usually started again. Therefore the query is
        # repeated.
        answers = [reply for reply in replies if not isinstance(reply, OSError)]
        if answers:
            return answers
        time.sleep(_RETRY_DELAY_S)
    return []


def _describe_worker(modules: tuple[str, ...]) -> tuple[str, list[str]]:
    """Return the version of pssf on a worker, and the modules that the worker lacks."""
    return version("pssf"), [name for name in modules if find_spec(name) is None]


def _run_item(item: bytes, function: Callable[..., Any], shared: bytes) -> Any:
    """Process one pickled item on a worker, with one thread."""
    with _ONE_ITEM_LOCK, limit_to_one_thread():
        return function(pickle.loads(item), **pickle.loads(shared))
