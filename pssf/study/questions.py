"""What only a simulator can ask of a cohort: tables, and sections of the report."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from ..model.draw import DrawLaws
from .design import AXES, Designed
from .learn.confounders import CLASSES, CONFOUNDERS, confound
from .learn.ladder import climb, known_of, rungs_of
from .learn.responses import respond
from .learn.separability import KNEES, separability
from .learn.split import of_grades_to_split, split_subjects
from .measuring import Run, measured_by_design
from .predictions import joined
from .report.page import Picture
from .report.sections import (
    Section,
    confounders_section,
    curves_section,
    ladder_section,
    learning_section,
    meaning_section,
)
from .settings import StudySettings
from .statistics import breaks, confounders, ladder, learning, responses, space
from .statistics.evidence import Tables
from .statistics.importance import leading
from .statistics.parameters import parameters_of
from .statistics.tested import TESTED, count_tested, enough
from .tasks import contrast_of

_SHARES = (0.2, 0.4, 0.6, 0.8)  # of the subjects to learn from, beside all
_FEW_KNEES = 1_000
_LEARNING = ("measured", "radiomics", "both")


@dataclass(frozen=True)
class Answers:
    """Tables by name, and the sections that show them."""

    tables: dict[str, pd.DataFrame]
    sections: list[Section]

    def pictures(self) -> dict[str, Picture]:
        """Name -> picture, of all sections."""
        return {picture.name: picture for section in self.sections for picture in section.pictures}


def ask(
    run: Run,
    manifest: pd.DataFrame,
    usable: pd.DataFrame,
    names: list[str],
    tables: Tables,
    designed: Designed,
    laws: DrawLaws | None,
) -> Answers:
    """All that is known enough for.

    usable    radiographs with a region found: knee, subject, grade, protocol, features
    names     of the features
    tables    of `evidence`: importance, follows
    designed  radiographs taken by design
    laws      that the knees were drawn by, where that is known
    """
    parts = [_ladder(manifest, usable, names, run, laws)]
    base, most = usable[usable["protocol"] == run.settings.reference], leading(tables["importance"], run.settings)
    parts.append(_confounders(manifest, usable, names, run))
    if designed.curves is not None:
        parts.append(_curves(designed.curves, base, names, most, run))
    if designed.shares is not None or designed.pairs is not None:
        parts.append(_meaning(designed, manifest, base, names, most, tables["follows"], run))
    answers = {name: table for part in parts for name, table in part.tables.items()}
    return Answers(answers, [section for part in parts for section in part.sections])


def _ladder(manifest: pd.DataFrame, usable: pd.DataFrame, names: list[str], run: Run, laws: DrawLaws | None) -> Answers:
    """Ladder and learning curves: nothing where the manifest has no joint spaces to hold features against.

    Nor of so few tested subjects that nothing could be decided; a grade of too few to split is left out.
    """
    settings, execution = run.settings, run.execution
    known = of_grades_to_split(known_of(usable, names, parameters_of(manifest), settings))
    if len(rungs_of(known, names)) < 2 or not _enough(known, settings):
        return Answers({}, [])
    splits = climb(known, names, settings, execution)
    rungs, differences = ladder.rungs(splits), ladder.differences(splits)
    if laws is not None:
        with execution.timer.stage("best possible"):
            best = _best_possible(laws, run)
        rungs = joined([rungs, best[best["grades"].isin(rungs["grades"])]])
        rungs = rungs.astype(dict.fromkeys(("trained", *TESTED, "splits", "knees"), "Int64"))
    fewer = climb(known, names, settings, execution, shares=_SHARES, rungs=_LEARNING, stage="learning curves")
    curves = learning.curves(joined([fewer, splits[splits["rung"].isin(_LEARNING)]]))
    power = learning.power(splits, _counts(known), settings.difference)
    tables = {"ladder": rungs, "ladder_differences": differences, "learning": curves, "power": power}
    sections = [ladder_section(rungs, differences, int(known["subject"].nunique())), learning_section(curves, power)]
    return Answers(tables, sections)


def _best_possible(laws: DrawLaws, run: Run) -> pd.DataFrame:
    """Rows of `ladder.ceiling`: of few knees where the grades of a table do not overlap, of which more say the same."""
    for knees in (_FEW_KNEES, KNEES):
        drawn = separability(laws, run.tables.gap_alone_auc, knees=knees, seed=run.settings.seed)
        best = ladder.ceiling(drawn)
        if (best["auc"] == 1.0).all():
            break
    return best


def _confounders(manifest: pd.DataFrame, usable: pd.DataFrame, names: list[str], run: Run) -> Answers:
    """What confounders do: age and BMI where the manifest tells them, the site where there are two protocols.

    Nothing of so few tested subjects that nothing could be decided.
    """
    known_of_knees = parameters_of(manifest)
    columns = [name for name in CONFOUNDERS if name in known_of_knees]
    known = usable[["knee", "subject", "grade", "protocol", *names]]
    known = known.merge(known_of_knees[["knee", *columns]], on="knee", how="left")
    wanted = columns + (["site"] if known["protocol"].nunique() > 1 else [])
    if not wanted or not _enough(of_grades_to_split(known[known["grade"].isin(sum(CLASSES, ()))]), run.settings):
        return Answers({}, [])
    table = confounders.confounding(confound(known, names, wanted, run.settings, run.execution))
    if table.empty:
        return Answers({}, [])
    return Answers({"confounders": table}, [confounders_section(table)])


def _enough(known: pd.DataFrame, settings: StudySettings) -> bool:
    """Whether the first split tests enough subjects of the least grade and any other one to decide anything."""
    if known.empty:
        return False
    test = known[known["subject"].isin(split_subjects(known["subject"], known["grade"], seed=settings.seed).test)]
    first, *others = sorted(set(known["grade"]))
    pairs = ((first, grade) for grade in others)
    of_pairs = ((pair, test[test["grade"].isin(pair)]) for pair in pairs)
    return any(enough(count_tested(part["subject"], part["grade"], pair)) for pair, part in of_pairs)


def _with_region(taken: pd.DataFrame, name: str, base: pd.DataFrame, run: Run) -> pd.DataFrame:
    """Of radiographs taken by design, those with a region, and their features."""
    measured = measured_by_design(run, taken, name, float(base["pixel_mm"].iloc[0]))
    return measured[measured["status"] == "found"]


def _meaning(
    designed: Designed,
    manifest: pd.DataFrame,
    base: pd.DataFrame,
    names: list[str],
    most: Sequence[str],
    follows: pd.DataFrame,
    run: Run,
) -> Answers:
    """What features measure: shares of variance, slopes, and both beside the correlations."""
    of_shares, of_slopes = pd.DataFrame(columns=space.SHARES), pd.DataFrame(columns=space.SLOPES)
    if designed.shares is not None:
        table = _with_region(designed.shares, "shares", base, run)
        with run.execution.timer.stage("shares of variance"):
            of_shares = space.shares(table, names, designed.bounds, designed.samples, run.settings.seed)
    if designed.pairs is not None:
        table = _with_region(designed.pairs, "pairs", base, run)
        before = manifest[manifest["protocol"] == run.settings.reference]
        of_slopes = space.slopes(base, table, before, names, designed.bounds)
    both = space.beside(follows, of_slopes, of_shares)
    section = meaning_section(of_shares, both, most, designed.bounds)
    return Answers({"shares": of_shares, "slopes": of_slopes, "follows": both}, [section])


def _curves(curves: pd.DataFrame, base: pd.DataFrame, names: list[str], most: Sequence[str], run: Run) -> Answers:
    """What becomes of features and models along the axes of `design`."""
    settings = run.settings
    steps = _with_region(curves, "curves", base, run)
    axes = {name: axis for name, axis in AXES.items() if name in set(curves["kind"])}

    def step(axis: str, turn: int) -> float:
        return axes[axis].steps[turn - 1]

    with run.execution.timer.stage("curves of features"):
        chance = {"replicates": settings.replicates, "seed": settings.seed}
        of_features = responses.curves_of_features(base, steps, names, step, **chance)
    of_models = responses.curves_of_models(respond(base, steps, names, settings, run.execution), step)
    places = breaks.breaks(of_features, of_models, axes, settings.difference)
    whole = joined([of_features.table, of_models])
    tables = {f"curve_{name}": whole[whole["axis"] == name].reset_index(drop=True) for name in axes}
    knees, task = int(curves["knee"].nunique()), contrast_of(curves["grade"])
    section = curves_section(tables, places, axes, most, knees, task)
    return Answers(tables | {"breaks": places}, [section])


def _counts(known: pd.DataFrame) -> pd.Series:
    """grades, as the ladder calls a pair of them -> subjects that have them"""
    of_grade = known.groupby("grade")["subject"].nunique()
    first, *others = sorted(of_grade.index)
    return pd.Series({f"{first} vs {grade}": int(of_grade[first] + of_grade[grade]) for grade in others})
