"""Settings of a run that no result depends on: processes or cluster, progress display, timer."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from ..stage_timer import Stage, Timer

# Function of name and stage; returns a context that displays the progress of the stage while it is open.
ProgressBar = Callable[[str, Stage], AbstractContextManager[None]]


@dataclass(frozen=True, kw_only=True)
class Execution:
    """Say who does the work of a run, and how its progress is shown.

    Parameters
    ----------
    workers : int, default 1
        Number of processes of this machine.
    scheduler : str or None, default None
        Address of a Dask scheduler, whose workers then do the work; None uses processes of this machine.
    progress_bar : callable
        Function that displays the progress of a stage, such as `progress_display.show_progress_bar`. By default nothing
        is displayed.
    timer : Timer
        Timer that measures every stage.
    """

    workers: int = 1
    scheduler: str | None = None
    progress_bar: ProgressBar = lambda what, stage: nullcontext()
    timer: Timer = field(default_factory=Timer)

    @contextmanager
    def stage(self, name: str, unit: str, total: int) -> Iterator[Stage]:
        """Time a stage and show its progress while the context is open.

        Parameters
        ----------
        name : str
            Name of the stage.
        unit : str
            Unit of the counted items.
        total : int
            Number of items to do.

        Yields
        ------
        Stage
            The stage, which counts the items.
        """
        with self.timer.stage(name, unit, total) as stage, self.progress_bar(name, stage):
            yield stage
