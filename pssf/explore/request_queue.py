"""Queue of requests from all browser tabs to one worker; a new request supersedes older requests of the tab."""

import asyncio
from dataclasses import dataclass
from typing import Any

from ..core.checks import InputError
from ..core.processes.worker_processes import WorkersLostError
from .page_worker import SupersededError, Worker
from .request_schema import ResolvedRequest

# Request types in order of priority; types that are answered quickly are first.
PRIORITY = ("probe", "radiograph", "masks", "file", "solids")
# Request types that a new radiograph request from the same tab supersedes.
_SUPERSEDED_BY_RADIOGRAPH = ("masks", "solids")
# Maximum number of waiting requests.
_MAX_WAITING = 64
# Maximum number of attempts to answer a request if the worker process is killed.
_MAX_TRIES = 2
Answer = tuple[dict[str, Any], bytes]


@dataclass(eq=False)
class _Job:
    """Request, with the future that receives the answer."""

    tab: str
    kind: str
    resolved_request: ResolvedRequest
    answer: "asyncio.Future[Answer]"

    def is_superseded_by(self, newer: "_Job") -> bool:
        """Report whether a newer request supersedes the present request; file requests are never superseded."""
        kinds = (newer.kind, *(_SUPERSEDED_BY_RADIOGRAPH if newer.kind == "radiograph" else ()))
        return self.tab == newer.tab and self.kind in kinds and self.kind != "file"


class Dispatcher:
    """Queue of waiting requests, with the request that is being answered.

    Parameters
    ----------
    worker : Worker
        Worker process that answers the requests.
    """

    def __init__(self, worker: Worker) -> None:
        self.worker = worker
        self._waiting: list[_Job] = []
        self._running: _Job | None = None
        self._task: asyncio.Task[None] | None = None

    async def ask(self, kind: str, tab: str, wanted: ResolvedRequest) -> Answer:
        """Add a request to the queue and wait for the answer.

        Parameters
        ----------
        kind : str
            Type of request, one of `PRIORITY`.
        tab : str
            Name of the browser tab.
        wanted : ResolvedRequest
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
            If the request contains an invalid value, or too many requests are waiting.
        SupersededError
            If a newer request from the same tab supersedes the request.
        WorkersLostError
            If the worker process was killed or has been closed.
        RuntimeError
            If the worker cannot answer the request because of an unexpected error.
        """
        job = _Job(tab, kind, wanted, asyncio.get_running_loop().create_future())
        for old in [old for old in self._waiting if old.is_superseded_by(job)]:
            self._waiting.remove(old)
            _fail(old, SupersededError())
        if self._running is not None and self._running.is_superseded_by(job):
            self.worker.cancel_current()
        if len(self._waiting) >= _MAX_WAITING:
            raise InputError(f"number of waiting requests must be less than {_MAX_WAITING}, got {len(self._waiting)}")
        self._waiting.append(job)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._run_jobs())
        return await job.answer

    async def _run_jobs(self) -> None:
        """Answer all waiting requests in order of priority."""
        while self._waiting:
            job = min(self._waiting, key=lambda job: PRIORITY.index(job.kind))
            self._waiting.remove(job)
            self._running = job
            try:
                answer = await self._ask_with_retries(job)
                if not job.answer.done():
                    job.answer.set_result(answer)
            except (SupersededError, InputError, RuntimeError) as error:
                _fail(job, error)
            finally:
                self._running = None

    async def _ask_with_retries(self, job: _Job) -> Answer:
        """Send a request to the worker; repeat the request with a new worker if the worker was killed."""
        for left in reversed(range(_MAX_TRIES)):
            try:
                return await asyncio.to_thread(self.worker.ask, job.kind, job.resolved_request)
            except WorkersLostError:
                if not left:
                    raise WorkersLostError(
                        f"the worker process was killed {_MAX_TRIES} times during the request"
                    ) from None
        raise AssertionError


def _fail(job: _Job, error: Exception) -> None:
    """Set the error of a request unless the request already has an answer."""
    if not job.answer.done():
        job.answer.set_exception(error)
