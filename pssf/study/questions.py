"""What only a simulator can ask of a cohort: tables, and sections of the report."""

from dataclasses import dataclass

import pandas as pd

from ..core.execution import Execution
from .learn.ladder import climb, known_of, rungs_of
from .learn.separability import separability
from .predictions import joined
from .report.sections import Section, ladder_section
from .settings import StudySettings
from .statistics import ladder
from .statistics.parameters import parameters_of, table_of

_CEILING_KNEES = 1000  # drawn for the best possible, the grades alike


@dataclass(frozen=True)
class Answers:
    """Tables by name, and the sections that show them."""

    tables: dict[str, pd.DataFrame]
    sections: list[Section]


def ask(
    manifest: pd.DataFrame, usable: pd.DataFrame, names: list[str], settings: StudySettings, execution: Execution
) -> Answers:
    """All that the manifest tells enough for: nothing where it has no joint spaces to hold features against.

    usable  radiographs with a region found: knee, subject, grade, protocol, features
    names   of the features
    """
    known = known_of(usable, names, parameters_of(manifest), settings)
    if len(rungs_of(known, names)) < 2:
        return Answers({}, [])
    splits = climb(known, names, settings, execution)
    rungs, differences = ladder.rungs(splits), ladder.differences(splits)
    if table_of(manifest) is not None:
        with execution.timer.stage("best possible"):
            drawn = separability(str(manifest["grade_table"].iloc[0]), knees=_CEILING_KNEES, seed=settings.seed)
        best = ladder.ceiling(drawn)
        rungs = joined([rungs, best[best["grades"].isin(rungs["grades"])]])
    tables = {"ladder": rungs, "ladder_differences": differences}
    return Answers(tables, [ladder_section(rungs, differences, int(known["subject"].nunique()))])
