"""All splits of a cohort, trained and tested in parallel, and how the cost of one grows with the subjects."""

from collections.abc import Mapping
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
import pandas as pd

from ...core.execution import Execution
from ...core.parallel import ordered_map
from ...data.code import code_digest, require_code
from ..predictions import Outcome
from ..settings import StudySettings
from ..statistics.subjects import worst_grades
from .baselines import measures_of
from .each_split import CODE
from .scenarios import one_split
from .split import PARTS

_SHARES = (0.5, 0.25)  # of the subjects, on which the first split is taken once more


@dataclass(frozen=True)
class Job:
    """A split of a share of the subjects."""

    repeat: int
    share: float = 1.0


def train(usable: pd.DataFrame, names: list[str], settings: StudySettings, execution: Execution) -> list[Outcome]:
    """`scenarios.one_split` of every repeat, in their order.

    The stage of the execution's timer gets as its growth the exponent of the seconds of a split in the number of
    subjects, from the first split of all, half and a quarter of them; none where a grade has too few for a half.

    usable   radiographs with a region found: radiograph, knee, subject, grade, protocol, features, measures
    names    of the features
    raises   InputError for too few subjects of a grade, or a worker with other code; WorkersLostError when workers keep
             being killed
    """
    table = usable[["radiograph", "knee", "subject", "grade", "protocol", *measures_of(usable), *names]]
    smaller = [share for share in _SHARES if fewest(table, share) >= len(PARTS)]
    jobs = [*(Job(repeat) for repeat in range(settings.repeats)), *(Job(0, share) for share in smaller)]
    with execution.stage("training and testing", "splits", settings.repeats) as stage:
        splits = ordered_map(
            one_job,
            jobs,
            shared={"table": table, "names": names, "settings": settings, "code": code_digest(CODE)},
            workers=execution.workers,
            scheduler=execution.scheduler,
            arrived=lambda index, _: stage.advance() if index < settings.repeats else None,
        )
    timed = [splits[0], *splits[settings.repeats :]]
    if len(timed) > 1:
        subjects, seconds = [one[1] for one in timed], [one[2] for one in timed]
        stage.growth = float(np.polyfit(np.log(subjects), np.log(seconds), 1)[0])
    return [outcome for outcome, _, _ in splits[: settings.repeats]]


def one_job(
    job: Job, *, table: pd.DataFrame, names: list[str], settings: StudySettings, code: Mapping[str, str]
) -> tuple[Outcome, int, float]:
    """The outcome of a split, of how many subjects, and the seconds of work that it took.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    began = process_time()
    part = table[table["subject"].isin(share_of(table, job.share))]
    outcome = one_split(job.repeat, table=part, names=names, settings=settings)
    return outcome, part["subject"].nunique(), process_time() - began


def share_of(table: pd.DataFrame, share: float) -> list[Any]:
    """The first subjects of each grade, the highest of their knees; a share of them, rounded down."""
    worst = worst_grades(table["subject"], table["grade"])
    return [s for _, members in worst.groupby(worst) for s in members.index[: int(share * len(members))]]


def fewest(table: pd.DataFrame, share: float) -> int:
    """Subjects of the rarest grade in a share of them."""
    return int(share * worst_grades(table["subject"], table["grade"]).value_counts().min())
