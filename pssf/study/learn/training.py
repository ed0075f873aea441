"""All splits of a cohort, trained and tested in parallel, and how the cost of one grows with the subjects."""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

import numpy as np
import pandas as pd

from ...core.parallel import ordered_map
from .. import StudySettings
from .baselines import measures_of
from .scenarios import Outcome, one_split
from .split import PARTS, worst_grades

_SHARES = (0.5, 0.25)  # of the subjects, on which the first split is taken once more


@dataclass(frozen=True)
class Job:
    """A split of a share of the subjects."""

    repeat: int
    share: float = 1.0


def train(
    usable: pd.DataFrame,
    names: list[str],
    settings: StudySettings,
    *,
    workers: int,
    scheduler: str | None,
    made: Callable[[int], None],
) -> tuple[list[Outcome], float | None]:
    """`scenarios.one_split` of every repeat.

    usable   radiographs with a region found: radiograph, knee, subject, grade, protocol, features, measures
    made     is told how many more splits have been made
    returns  outcomes in the order of the repeats; exponent of the seconds of a split in the number of subjects, from
             the first split of all, half and a quarter of them; None where a grade has too few for a half
    """
    table = usable[["radiograph", "knee", "subject", "grade", "protocol", *measures_of(usable), *names]]
    smaller = [share for share in _SHARES if fewest(table, share) >= len(PARTS)]
    jobs = [*(Job(repeat) for repeat in range(settings.repeats)), *(Job(0, share) for share in smaller)]
    shared = {"table": table, "names": names, "settings": settings}
    found = ordered_map(
        one_job,
        jobs,
        shared=shared,
        workers=workers,
        scheduler=scheduler,
        arrived=lambda index, _: made(1) if index < settings.repeats else None,
    )
    outcomes = [outcome for outcome, _, _ in found[: settings.repeats]]
    timed = [found[0], *found[settings.repeats :]]
    if len(timed) == 1:
        return outcomes, None
    subjects, seconds = [one[1] for one in timed], [one[2] for one in timed]
    return outcomes, float(np.polyfit(np.log(subjects), np.log(seconds), 1)[0])


def one_job(job: Job, *, table: pd.DataFrame, names: list[str], settings: StudySettings) -> tuple[Outcome, int, float]:
    """The outcome of a split, of how many subjects, and the seconds of work that it took."""
    began = process_time()
    part = table[table["subject"].isin(share_of(table, job.share))]
    outcome = one_split(job.repeat, table=part, names=names, settings=settings)
    return outcome, part["subject"].nunique(), process_time() - began


def share_of(table: pd.DataFrame, share: float) -> list[int]:
    """The first subjects of each grade, the highest of their knees; a share of them, rounded down."""
    worst = worst_grades(table["subject"], table["grade"])
    return [s for _, members in worst.groupby(worst) for s in members.index[: int(share * len(members))]]


def fewest(table: pd.DataFrame, share: float) -> int:
    """Subjects of the rarest grade in a share of them."""
    return int(share * worst_grades(table["subject"], table["grade"]).value_counts().min())
