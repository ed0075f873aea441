"""All splits of a cohort, trained and tested in parallel."""

from collections.abc import Mapping

import pandas as pd

from ...core.execution import Execution
from ...data.code import require_code
from ..predictions import Outcome
from ..settings import StudySettings
from .baselines import measures_of
from .each_split import each_split
from .scenarios import one_split


def train(usable: pd.DataFrame, names: list[str], settings: StudySettings, execution: Execution) -> list[Outcome]:
    """`scenarios.one_split` of every repeat, in their order.

    usable   radiographs with a region found: radiograph, knee, subject, grade, protocol, features, measures
    names    of the features
    raises   InputError for too few subjects of a grade, or a worker with other code; WorkersLostError when workers keep
             being killed
    """
    table = usable[["radiograph", "knee", "subject", "grade", "protocol", *measures_of(usable), *names]]
    shared = {"table": table, "names": names, "settings": settings}
    return each_split(one_job, range(settings.repeats), shared, execution, "training and testing")


def one_job(
    repeat: int, *, table: pd.DataFrame, names: list[str], settings: StudySettings, code: Mapping[str, str]
) -> Outcome:
    """The outcome of a split.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    return one_split(repeat, table=table, names=names, settings=settings)
