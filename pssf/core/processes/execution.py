"""Define the settings of a run that do not affect its results: processes or cluster, progress display, timer."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from ..stage_timer import Stage, Timer

# Function that takes a name and a stage, and returns a context that displays the progress of the stage.
ProgressBar = Callable[[str, Stage], AbstractContextManager[None]]


@dataclass(frozen=True, kw_only=True)
class Execution:
    """Specify the processes or cluster of a run, its progress display and its timer.

    Parameters
    ----------
    workers : int, default 1
        Number of local processes.
    scheduler : str or None, default None
        Address of a Dask scheduler whose workers process the items; None uses local processes.
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
            Stage that counts the items.
        """
        with self.timer.stage(name, unit, total) as stage, self.progress_bar(name, stage):
            yield stage
