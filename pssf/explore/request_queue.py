"""Queue of requests from many tabs to one worker; a newer request of a tab supersedes older ones."""

import asyncio
from dataclasses import dataclass
from typing import Any

from ..core.checks import InputError
from ..core.processes.worker_processes import WorkersLostError
from .page_worker import SupersededError, Worker
from .request_schema import ResolvedRequest

# Kinds of requests in the order in which they are answered; fast kinds come first.
PRIORITY = ("probe", "radiograph", "masks", "file", "solids")
# Kinds of requests that a new radiograph request of the same tab supersedes.
_SUPERSEDED_BY_RADIOGRAPH = ("masks", "solids")
# Largest number of waiting requests.
_MAX_WAITING = 64
# Largest number of workers that try to answer a request if workers are killed.
_MAX_TRIES = 2
Answer = tuple[dict[str, Any], bytes]


@dataclass(eq=False)
class _Job:
    """Request with a future for its answer."""

    tab: str
    kind: str
    resolved_request: ResolvedRequest
    answer: "asyncio.Future[Answer]"

    def is_superseded_by(self, newer: "_Job") -> bool:
        """Return whether a newer job supersedes the present job; a file request is never superseded."""
        kinds = (newer.kind, *(_SUPERSEDED_BY_RADIOGRAPH if newer.kind == "radiograph" else ()))
        return self.tab == newer.tab and self.kind in kinds and self.kind != "file"


class Dispatcher:
    """Queue of waiting requests, and the running request.

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
        """Queue a request and wait for its answer.

        Parameters
        ----------
        kind : str
            Kind of request, one of `PRIORITY`.
        tab : str
            Name of the browser tab.
        wanted : ResolvedRequest
            Validated request from the page.

        Returns
        -------
        header : dict
            JSON-ready part of the answer.
        content : bytes
            Binary part of the answer.

        Raises
        ------
        InputError
            If the request contains an invalid value, or too many requests are waiting.
        SupersededError
            If a newer request of the tab supersedes the request.
        WorkersLostError
            If the worker process was killed or is closed.
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
            raise InputError(f"waiting requests must be fewer than {_MAX_WAITING}, got {len(self._waiting)}")
        self._waiting.append(job)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._run_jobs())
        return await job.answer

    async def _run_jobs(self) -> None:
        """Answer waiting jobs by priority until none is left."""
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
        """Send a job to the worker; repeat the job with a new worker if the worker was killed."""
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
    """Set the error of a job unless it already has an answer."""
    if not job.answer.done():
        job.answer.set_exception(error)
