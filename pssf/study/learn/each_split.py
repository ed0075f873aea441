"""Run one function on every split of a cohort in parallel."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from ...core.processes.execution import Execution
from ...core.processes.parallel_map import map_in_parallel
from ...data.code_hash import compute_code_hashes

Job = TypeVar("Job")
Result = TypeVar("Result")

# Subpackages whose code affects the results of a split.
CODE_PACKAGES = ("core", "radiomics", "study")


def map_splits(
    function: Callable[..., Result], jobs: Sequence[Job], shared: Mapping[str, Any], execution: Execution, stage: str
) -> list[Result]:
    """Call a function for each job in parallel, and return the results in order.

    The called function checks that the worker has the same code version as this process.

    Parameters
    ----------
    function : callable
        Function of a job, with the entries of `shared` and ``code`` as keyword arguments. Workers must be able to
        import the function.
    jobs : sequence
        First argument of each call, such as the index of a split.
    shared : mapping of str to Any
        Keyword arguments of all calls.
    execution : Execution
        Workers, scheduler, timer and progress bar.
    stage : str
        Name of the stage in the timer.

    Returns
    -------
    list
        Results in the order of the jobs.

    Raises
    ------
    InputError
        A worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    with execution.stage(stage, "splits", len(jobs)) as shown:
        return map_in_parallel(
            function,
            jobs,
            shared={**shared, "code": compute_code_hashes(CODE_PACKAGES)},
            workers=execution.workers,
            scheduler=execution.scheduler,
            on_result=lambda *_: shown.advance(),
        )
