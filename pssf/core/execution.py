"""Who does the work of a long run, and what shows it; no result depends on either."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from .timer import Stage, Timer

# Shows a stage by its name for as long as the context is open.
Bar = Callable[[str, Stage], AbstractContextManager[None]]


@dataclass(frozen=True, kw_only=True)
class Execution:
    """Who does the work, and what shows it.

    workers    processes of this machine
    scheduler  address of a Dask scheduler whose workers do it instead; None: processes of this machine
    bar        shows the progress of a stage, such as `progress.bar`; by default nothing does
    timer      times every stage
    """

    workers: int = 1
    scheduler: str | None = None
    bar: Bar = lambda what, stage: nullcontext()
    timer: Timer = field(default_factory=Timer)

    @contextmanager
    def stage(self, name: str, unit: str, total: int) -> Iterator[Stage]:
        """Time and show a stage that makes `total` of a unit; gives what counts them."""
        with self.timer.stage(name, unit, total) as stage, self.bar(name, stage):
            yield stage
