"""What only a simulator can ask of a cohort: tables, and sections of the report."""

from dataclasses import dataclass

import pandas as pd

from ..core.execution import Execution
from .learn.ladder import climb, known_of, rungs_of
from .learn.separability import separability
from .predictions import joined
from .report.sections import Section, ladder_section, learning_section
from .settings import StudySettings
from .statistics import ladder, learning
from .statistics.parameters import parameters_of, table_of

_CEILING_KNEES = 1000  # drawn for the best possible, the grades alike
_SHARES = (0.2, 0.4, 0.6, 0.8)  # of the subjects to learn from, beside all
_LEARNING = ("measured", "radiomics", "both")


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
    fewer = climb(known, names, settings, execution, shares=_SHARES, rungs=_LEARNING, stage="learning curves")
    curves = learning.curves(joined([fewer, splits[splits["rung"].isin(_LEARNING)]]))
    power = learning.power(splits, _counts(known), settings.difference)
    tables = {"ladder": rungs, "ladder_differences": differences, "learning": curves, "power": power}
    sections = [ladder_section(rungs, differences, int(known["subject"].nunique())), learning_section(curves, power)]
    return Answers(tables, sections)


def _counts(known: pd.DataFrame) -> pd.Series:
    """grades, as the ladder calls a pair of them -> subjects that have them"""
    of_grade = known.groupby("grade")["subject"].nunique()
    first, *others = sorted(of_grade.index)
    return pd.Series({f"{first} vs {grade}": int(of_grade[first] + of_grade[grade]) for grade in others})
