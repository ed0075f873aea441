"""cluster.spread: work on the workers of a Dask scheduler, which may be on other machines (needs the extra `cluster`).

What a killed worker had in hand, Dask gives to another; it gives up on work under which several workers died.
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

from .checks import InputError
from .workers import WorkersLostError, one_thread

_REACH_SECONDS = 10
# Workers that have been killed are back only when they have loaded everything again.
_WORKERS_SECONDS = 30
_AGAIN_SECONDS = 0.5
_ASKED_TIMES = 10
# A worker with several threads must not work on two knees at once: what limits threads is of the whole process.
_ALONE = threading.Lock()


def require_workers(address: str, modules: tuple[str, ...] = ()) -> None:
    """Refuse an address that is none or does not answer, and a scheduler without workers.

    raises  InputError
    """
    with _connected(address) as client:
        answers = _answers(client, modules)
    if not answers:
        raise InputError(f"scheduler = {address!r} has no workers; allowed: one or more")
    for answer in answers:
        if isinstance(answer, ModuleNotFoundError):
            raise InputError(f"scheduler = {address!r}: a worker has {answer}; allowed: pssf on every worker")
        if isinstance(answer, Exception):
            raise answer
    here = version("pssf")
    there = sorted({release for release, _ in answers})
    lacking = sorted(set().union(*(names for _, names in answers)))
    if there != [here]:
        raise InputError(f"scheduler = {address!r}: workers have pssf {', '.join(there)}; allowed: {here}, as here")
    if lacking:
        raise InputError(
            f"scheduler = {address!r}: a worker lacks {', '.join(lacking)}; allowed: the extra study on every worker"
        )


def spread(
    function: Callable[..., Any],
    items: Sequence[Any],
    shared: dict[str, Any],
    address: str,
    take: Callable[[int, Any], None],
) -> None:
    """Have function(item, **shared) done for every item; `take` is told index and result of each as it ends.

    raises  WorkersLostError when workers keep being killed under an item, or the scheduler is lost
    """
    with _connected(address) as client:
        try:
            # By a task, since what is merely scattered is gone with the worker that holds it. Pickled, since Dask looks
            # for work of its own in whatever lists it is given.
            held = client.submit(bytes, pickle.dumps(shared), pure=False)
            pickled = [pickle.dumps(item) for item in items]
            futures = client.map(_call, pickled, function=function, shared=held, pure=False)
            indices = {future: index for index, future in enumerate(futures)}
            for future in as_completed(futures, loop=client.loop):
                take(indices[future], future.result())
                future.release()  # what is still wanted of a worker that dies would be done once more
        except KilledWorker:
            raise WorkersLostError("workers of the cluster were killed again and again (memory?)") from None
        except (CancelledError, CommClosedError):
            raise WorkersLostError(f"scheduler {address} was lost") from None


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    allowed = "allowed: the address of a Dask scheduler that runs, such as tcp://host:8786"
    if not re.fullmatch(r"(tcp|tls)://.+:\d+", address):
        raise InputError(f"scheduler = {address!r}; {allowed}")
    try:
        client = Client(address, timeout=_REACH_SECONDS, set_as_default=False)
    except OSError:
        raise InputError(f"scheduler = {address!r} does not answer within {_REACH_SECONDS} s; {allowed}") from None
    with client:
        yield client


def _answers(client: Client, modules: tuple[str, ...]) -> list[Any]:
    """What every worker says of itself; nothing when there has been none that answers."""
    for _ in range(_ASKED_TIMES):
        try:
            client.wait_for_workers(1, timeout=_WORKERS_SECONDS)
        except TimeoutError:
            break
        replies = client.run(_about, modules, on_error="return").values()
        # One that dies as it is asked (its connection is lost, or for Dask's 30 s there is none) is seldom the last:
        # whatever started it starts another.
        answers = [reply for reply in replies if not isinstance(reply, OSError)]
        if answers:
            return answers
        time.sleep(_AGAIN_SECONDS)
    return []


def _about(modules: tuple[str, ...]) -> tuple[str, list[str]]:
    """Version of this package at a worker, and what it lacks of the modules."""
    return version("pssf"), [name for name in modules if find_spec(name) is None]


def _call(item: bytes, function: Callable[..., Any], shared: bytes) -> Any:
    with _ALONE, one_thread():
        return function(pickle.loads(item), **pickle.loads(shared))
