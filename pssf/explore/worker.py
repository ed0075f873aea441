"""The worker: one process that holds what is warm and answers one request after another."""

import signal
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from threading import Lock
from typing import Any

from ..core.checks import InputError
from ..core.child_processes import safe_start
from ..core.workers import WorkersLostError, keep_memory
from .asked import Wanted

# How long a process may take to end by itself, s.
_PATIENCE_S = 2.0


class SupersededError(Exception):
    """A newer request of the same tab came in between."""


class Worker:
    """A process that is started when it is first asked, and again where it was killed."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None
        self._stop: Any = None
        self._number = 0
        self._closed = False
        self._starting = Lock()
        self.started = 0

    @property
    def pid(self) -> int | None:
        """Of the process, where there is one."""
        return None if self._process is None else self._process.pid

    def give_up(self) -> None:
        """What is being worked on is no longer wanted, and is dropped before its next stage."""
        if self._stop is not None:
            with suppress(OSError):
                self._stop.send(self._number)

    def ask(self, job: str, wanted: Wanted | None) -> tuple[dict[str, Any], bytes]:
        """Header and bytes of an answer; blocks until it is there.

        raises  InputError as the job, SupersededError where it was given up, WorkersLostError where the process was
                killed or is closed, RuntimeError where it failed
        """
        with self._starting:
            if self._closed:
                raise WorkersLostError("the worker is closed")
            if self._process is None or not self._process.is_alive():
                self._start()
        self._number += 1
        try:
            self._pipe.send((self._number, job, wanted))
            outcome, header, content = self._pipe.recv()
        except (EOFError, OSError):
            self._drop()
            raise WorkersLostError("the worker was killed") from None
        if outcome == "superseded":
            raise SupersededError
        if outcome == "refused":
            raise InputError(header["error"])
        if outcome == "failed":
            raise RuntimeError(header["error"])
        return header, content

    def close(self) -> None:
        """End the process, and let go of who waits for its answer."""
        with self._starting:
            self._closed = True
        process = self._process
        if process is not None:
            self.give_up()
            # The pipe stays open, since who waits reads from it in another thread.
            with suppress(OSError):
                self._pipe.send(None)
            process.join(_PATIENCE_S)
            self._drop()

    def _start(self) -> None:
        # No lock is shared: a process that is killed would keep it.
        self._pipe, theirs = self._context.Pipe()
        heard, self._stop = self._context.Pipe(duplex=False)
        self._process = self._context.Process(target=work, args=(theirs, heard), daemon=True)
        with safe_start():
            self._process.start()
        self.started += 1
        theirs.close()
        heard.close()

    def _drop(self) -> None:
        process, self._process = self._process, None
        if process is not None and process.is_alive():
            process.kill()
            process.join()


def work(pipe: Any, stop: Any) -> None:
    """Answer until nothing is asked any more; what runs in the process.

    pipe  brings numbered requests, and None at the end; takes answers
    stop  brings the numbers of requests that are no longer wanted
    """
    # The terminal's Ctrl-C is the server's, which then says that it is the end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_memory()
    from .warm import Warm

    number = given_up = 0

    def step() -> None:
        nonlocal given_up
        while stop.poll():
            given_up = stop.recv()
        if given_up >= number:
            raise SupersededError

    warm = Warm(step)
    while True:
        try:
            asked = pipe.recv()
        except (EOFError, OSError):
            return
        if asked is None:
            return
        number, job, wanted = asked
        pipe.send(_outcome(lambda job=job, wanted=wanted: _answer(warm, job, wanted)))  # type: ignore[misc]


def _answer(warm: Any, job: str, wanted: Wanted | None) -> tuple[dict[str, Any], bytes]:
    from .answers import ANSWERS

    assert wanted is not None
    return ANSWERS[job](warm, wanted)


def _outcome(answer: Callable[[], tuple[dict[str, Any], bytes]]) -> tuple[str, dict[str, Any], bytes]:
    try:
        return "done", *answer()
    except SupersededError:
        return "superseded", {}, b""
    except InputError as error:
        return "refused", {"error": str(error)}, b""
    except Exception as error:  # the process goes on with the next request
        return "failed", {"error": f"{type(error).__name__}: {error}".splitlines()[0]}, b""
