"""One function on every split of a cohort, in parallel."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from ...core.execution import Execution
from ...core.parallel import ordered_map
from ...data.code import code_digest

Job = TypeVar("Job")
Given = TypeVar("Given")

CODE = ("core", "radiomics", "study")  # what the outcome of a split depends on


def each_split(
    function: Callable[..., Given], jobs: Sequence[Job], shared: Mapping[str, Any], execution: Execution, stage: str
) -> list[Given]:
    """What a function gives for each job, in their order; whoever runs it, by the code that is here.

    function  of a job, of what is shared and of `code`, of `code_digest`, by name; one that processes can import
    stage     of the execution's timer
    raises    WorkersLostError when workers keep being killed
    """
    with execution.stage(stage, "splits", len(jobs)) as shown:
        return ordered_map(
            function,
            jobs,
            shared={**shared, "code": code_digest(CODE)},
            workers=execution.workers,
            scheduler=execution.scheduler,
            arrived=lambda *_: shown.advance(),
        )
