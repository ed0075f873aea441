"""Worker process that answers the requests of the explore page sequentially and caches simulation stages."""

import signal
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from threading import Lock
from typing import Any

from ..core.checks import InputError
from ..core.processes.child_processes import start_without_working_folder
from ..core.processes.worker_processes import WorkersLostError, retain_freed_memory
from .request_schema import ResolvedRequest

# Time limit for a regular shutdown, in s. A process that still runs after this time is killed.
_SHUTDOWN_TIMEOUT_S = 2.0


class SupersededError(Exception):
    """Error raised when a newer request from the same browser tab supersedes a request."""


class Worker:
    """Worker process, which starts with the first request, and restarts with the next request if it was killed."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None
        self._stop: Any = None
        self._number = 0
        self._closed = False
        self._starting = Lock()
        self.start_count = 0

    @property
    def pid(self) -> int | None:
        """ID of the worker process; None if no process is running."""
        return None if self._process is None else self._process.pid

    def cancel_current(self) -> None:
        """Cancel the current request before its next simulation stage starts."""
        if self._stop is not None:
            with suppress(OSError):
                self._stop.send(self._number)

    def ask(self, job: str, wanted: ResolvedRequest | None) -> tuple[dict[str, Any], bytes]:
        """Send a request to the worker process and wait for the answer.

        Parameters
        ----------
        job : str
            Type of request, as a key of `handlers.HANDLERS`.
        wanted : ResolvedRequest or None
            Validated request from the page.

        Returns
        -------
        header : dict
            JSON-ready header of the answer.
        content : bytes
            Binary content of the answer.

        Raises
        ------
        InputError
            If the request contains an invalid value.
        SupersededError
            If the request was cancelled.
        WorkersLostError
            If the worker process was killed or has been closed.
        RuntimeError
            If the request caused an unexpected error.
        """
        with self._starting:
            if self._closed:
                raise WorkersLostError("the worker process has been closed")
            if self._process is None or not self._process.is_alive():
                self._start()
        self._number += 1
        try:
            self._pipe.send((self._number, job, wanted))
            outcome, header, content = self._pipe.recv()
        except (EOFError, OSError):
            self._kill_process()
            raise WorkersLostError("the worker process was killed") from None
        if outcome == "superseded":
            raise SupersededError
        if outcome == "error":
            raise InputError(header["error"])
        if outcome == "failed":
            raise RuntimeError(header["error"])
        return header, content

    def close(self) -> None:
        """End the worker process and release all threads that wait for an answer."""
        with self._starting:
            self._closed = True
        process = self._process
        if process is not None:
            self.cancel_current()
            # The pipe remains open, because another thread may be waiting for an answer from the pipe.
            with suppress(OSError):
                self._pipe.send(None)
            process.join(_SHUTDOWN_TIMEOUT_S)
            self._kill_process()

    def _start(self) -> None:
        """Start the worker process with new pipes."""
        # Pipes are used instead of shared locks, because a killed process would never release a lock.
        self._pipe, theirs = self._context.Pipe()
        heard, self._stop = self._context.Pipe(duplex=False)
        self._process = self._context.Process(target=run_worker, args=(theirs, heard), daemon=True)
        with start_without_working_folder():
            self._process.start()
        self.start_count += 1
        theirs.close()
        heard.close()

    def _kill_process(self) -> None:
        """Kill the worker process if it is still running."""
        process, self._process = self._process, None
        if process is not None and process.is_alive():
            process.kill()
            process.join()


def run_worker(pipe: Any, stop: Any) -> None:
    """Answer requests in the worker process until the pipe is closed or delivers None.

    Parameters
    ----------
    pipe : Connection
        Two-way connection. It delivers numbered requests, followed by None at shutdown, and accepts the answers.
    stop : Connection
        Connection that delivers the numbers of cancelled requests.
    """
    # Ctrl-C in the terminal also reaches the worker process. The signal is ignored, because the server ends the worker.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    retain_freed_memory()
    from .stage_cache import StageCache

    number = given_up = 0

    def step() -> None:
        nonlocal given_up
        while stop.poll():
            given_up = stop.recv()
        if given_up >= number:
            raise SupersededError

    warm = StageCache(step)
    while True:
        try:
            asked = pipe.recv()
        except (EOFError, OSError):
            return
        if asked is None:
            return
        number, job, wanted = asked
        pipe.send(_run_handler(lambda job=job, wanted=wanted: _handle_request(warm, job, wanted)))  # type: ignore[misc]


def _handle_request(cache: Any, job: str, request: ResolvedRequest | None) -> tuple[dict[str, Any], bytes]:
    """Run the handler for a type of request."""
    from .handlers import HANDLERS

    assert request is not None
    return HANDLERS[job](cache, request)


def _run_handler(handler: Callable[[], tuple[dict[str, Any], bytes]]) -> tuple[str, dict[str, Any], bytes]:
    """Run a handler and return its outcome, such as "done" or "error", with header and binary content."""
    try:
        return "done", *handler()
    except SupersededError:
        return "superseded", {}, b""
    except InputError as error:
        return "error", {"error": str(error)}, b""
    except Exception as error:  # The worker process must be able to answer the next request after any error.
        return "failed", {"error": f"{type(error).__name__}: {error}".splitlines()[0]}, b""
