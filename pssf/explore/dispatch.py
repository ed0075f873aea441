"""Dispatch: many tabs, one worker; of one tab's requests of a kind the latest wins."""

import asyncio
from dataclasses import dataclass
from typing import Any

from ..core.checks import InputError
from ..core.workers import WorkersLostError
from .asked import Wanted
from .worker import SupersededError, Worker

# What is quick goes before what is slow.
ORDER = ("probe", "radiograph", "masks", "file", "solids")
# A new radiograph makes these of its tab needless.
_FOLLOW = ("masks", "solids")
# No more requests wait at a time.
_MOST = 64
# How often a request is given to a new worker where the worker was killed.
_TRIES = 2
Answer = tuple[dict[str, Any], bytes]


@dataclass(eq=False)
class _Job:
    tab: str
    kind: str
    wanted: Wanted
    answer: "asyncio.Future[Answer]"

    def give_way(self, newer: "_Job") -> bool:
        """Whether it is needless where the newer one is there; a file that was asked for is always made."""
        kinds = (newer.kind, *(_FOLLOW if newer.kind == "radiograph" else ()))
        return self.tab == newer.tab and self.kind in kinds and self.kind != "file"


class Dispatch:
    """What waits, and the one that runs."""

    def __init__(self, worker: Worker) -> None:
        self.worker = worker
        self._waiting: list[_Job] = []
        self._running: _Job | None = None
        self._task: asyncio.Task[None] | None = None

    async def ask(self, kind: str, tab: str, wanted: Wanted) -> Answer:
        """The answer of the worker.

        raises  SupersededError where a newer request of the tab came; InputError, RuntimeError and WorkersLostError as
                the worker; InputError where too many wait
        """
        job = _Job(tab, kind, wanted, asyncio.get_running_loop().create_future())
        for old in [old for old in self._waiting if old.give_way(job)]:
            self._waiting.remove(old)
            _fail(old, SupersededError())
        if self._running is not None and self._running.give_way(job):
            self.worker.give_up()
        if len(self._waiting) >= _MOST:
            raise InputError(f"requests waiting = {len(self._waiting)}; allowed: fewer than {_MOST}")
        self._waiting.append(job)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._work())
        return await job.answer

    async def _work(self) -> None:
        while self._waiting:
            job = min(self._waiting, key=lambda job: ORDER.index(job.kind))
            self._waiting.remove(job)
            self._running = job
            try:
                answer = await self._tried(job)
                if not job.answer.done():
                    job.answer.set_result(answer)
            except (SupersededError, InputError, RuntimeError) as error:
                _fail(job, error)
            finally:
                self._running = None

    async def _tried(self, job: _Job) -> Answer:
        for left in reversed(range(_TRIES)):
            try:
                return await asyncio.to_thread(self.worker.ask, job.kind, job.wanted)
            except WorkersLostError:
                if not left:
                    raise WorkersLostError(f"the worker was killed {_TRIES} times by this request") from None
        raise AssertionError


def _fail(job: _Job, error: Exception) -> None:
    if not job.answer.done():
        job.answer.set_exception(error)
