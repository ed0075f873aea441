"""One HTML page with everything in it: no style, script or picture is fetched from anywhere."""

from base64 import b64encode
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any

import jinja2
import pandas as pd

from ..external import External
from ..predictions import BASELINES, NONE
from ..settings import MODELS, SELECTIONS
from ..statistics.intervals import MINUS_JSW
from ..statistics.localisation import GROSS_MM
from ..statistics.metrics import METRICS
from ..statistics.reliability import ICC_FORMS
from ..statistics.tested import LEAST_OF_A_CLASS, LEAST_TESTED
from ..tasks import GRADES, TASKS
from .feature_figures import FAMILY_NAMES
from .figures import SCENARIOS
from .first_lines import few_tested, result_lines

if TYPE_CHECKING:
    from .sections import Section

_SHORT = {"lr": "Logistic", "rf": "Forest", "xgb": "XGBoost"} | BASELINES
# Alzubaidi & Al-Bayaty, arXiv 2601.11642: what is printed beside, never aimed at.
PAPER = {"stable": 43, "features": 107, "within": 0.92, "cross": 0.78, "multi": "0.88–0.90"}


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A PNG of the report: `name` of its file, what it shows (for who cannot see it), and its caption."""

    name: str
    png: bytes
    alt: str
    caption: str

    @property
    def uri(self) -> str:
        """The picture as part of the page."""
        return "data:image/png;base64," + b64encode(self.png).decode("ascii")


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that the page tells.

    counts        label -> number, of the cohort
    composition   grade, subjects, knees, protocols, radiographs; the last row is of all
    warnings      of `provenance.warnings_of`
    notes         of `provenance.notes_of`
    morphology    of `parameters.morphology`
    subgroups     of `subgroups.subgroups`
    localisation  of `localisation.summarise`
    scores        of `scores.summarise`
    differences   of `intervals.differences`
    claims        of `claims.claims`
    calibration   of `calibration.calibration`
    families      share of importance of each family, a column a model; and the drop of AUC, "<model> drop"
    screened      how many features were stable in the training subjects of each split
    models        names of the saved models
    external      of `external.tested_on_films`, or None without films
    sections      further parts, in order
    stable        of `reliability.count_stable`
    leading       model, feature, share, chosen, drop: the features that count most
    processing    of `radiomics.processing`
    degenerate    names of features that are the same in every radiograph
    cost          of `cost.cost_rows`; work_seconds: step -> sum over the processes
    test_subjects least and most of a split within the protocol
    test_rarest   least of a split's class that has the fewest, within the protocol
    """

    counts: dict[str, int]
    composition: pd.DataFrame
    warnings: list[str]
    notes: list[str]
    localisation: pd.DataFrame
    morphology: pd.DataFrame
    subgroups: pd.DataFrame
    scores: pd.DataFrame
    differences: pd.DataFrame
    claims: pd.DataFrame
    calibration: pd.DataFrame
    families: pd.DataFrame
    screened: list[int]
    stable: pd.DataFrame
    leading: pd.DataFrame
    degenerate: list[str]
    pictures: dict[str, Picture]
    settings: dict[str, Any]
    processing: dict[str, Any]
    versions: dict[str, str]
    cost: list[dict[str, Any]]
    work_seconds: dict[str, float]
    workers: int
    features: int
    test_subjects: tuple[int, int]
    test_rarest: int
    models: list[str] = field(default_factory=list)
    external: External | None = None
    sections: list["Section"] = field(default_factory=list)


def render(findings: Findings) -> str:
    """The page."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pssf.study.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["fixed"] = fixed
    environment.filters["short"] = _short
    environment.filters["signed"] = signed
    environment.filters["plain"] = lambda name: str(name).replace("_", " ")
    return environment.get_template("report.html.j2").render(
        f=findings,
        tasks=_score_tables(findings.scores),
        metrics=METRICS,
        least_tested=LEAST_TESTED,
        least_of_a_class=LEAST_OF_A_CLASS,
        result=result_lines(findings.scores, findings.claims),
        few=few_tested(findings.test_subjects, findings.test_rarest),
        compared=_compared(findings.differences),
        models=MODELS | BASELINES,
        selections=SELECTIONS | {NONE: "baseline"},
        short=_SHORT,
        scenarios=SCENARIOS,
        forms=ICC_FORMS,
        families=FAMILY_NAMES,
        paper=PAPER,
        grades=GRADES,
        gross_mm=GROSS_MM,
    )


def _score_tables(scores: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Task -> {groups: selection -> models, the columns; rows: scenario, and a line a metric}."""
    tables = {}
    for task in TASKS:
        part = scores[(scores["task"] == task) & scores["scenario"].isin(list(SCENARIOS))]
        if part.empty:
            continue
        groups = _groups(part)
        arms = [(model, selection) for selection, models in groups.items() for model in models]
        rows = []
        for (scenario, trained_on, tested_on), block in part.groupby(
            ["scenario", "trained_on", "tested_on"], sort=False
        ):
            cells = {(line["model"], line["selection"]): line for line in block.to_dict("records")}
            first = block.iloc[0]
            rows.append(
                {
                    "scenario": scenario,
                    "trained_on": trained_on,
                    "tested_on": tested_on,
                    "subjects": int(first["test_subjects"]),
                    "radiographs": int(first["test_radiographs"]),
                    "splits": int(block["splits"].min()),
                    "lines": {metric: [_cell(cells.get(arm, {}), metric) for arm in arms] for metric in METRICS},
                }
            )
        tables[task] = {"groups": groups, "rows": rows}
    return tables


def _compared(differences: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Task and metric -> {groups: as above; rows: comparison, scenario, tested_on, cells: differences}."""
    tables = {}
    for task, metric in product(TASKS, ("auc", "balanced_accuracy")):
        part = differences[(differences["task"] == task) & (differences["metric"] == metric)]
        if part.empty:
            continue
        groups, rows = _groups(part), []
        for (comparison, scenario, tested_on), block in part.groupby(
            ["comparison", "scenario", "tested_on"], sort=False
        ):
            if comparison == MINUS_JSW and scenario == "multi" and tested_on != "all":
                continue  # nearly the row of all protocols; it is in the CSV
            cells = {(line["model"], line["selection"]): line for line in block.to_dict("records")}
            line = [cells.get((model, selection), {}) for selection, models in groups.items() for model in models]
            rows.append({"comparison": comparison, "scenario": scenario, "tested_on": tested_on, "cells": line})
        tables[f"{task}: {METRICS[metric]}"] = {"groups": groups, "rows": rows}
    return tables


def _groups(table: pd.DataFrame) -> dict[str, list[str]]:
    """Selection -> models, in the order of the table."""
    pairs = dict.fromkeys(zip(table["selection"], table["model"], strict=True))
    groups: dict[str, list[str]] = {}
    for selection, model in pairs:
        groups.setdefault(selection, []).append(model)
    return groups


def _cell(line: dict[str, Any], metric: str) -> tuple[str, str]:
    """The mean, and its interval or nothing."""
    if pd.isna(line.get(metric)):
        return "n/a", ""
    low, high = line[f"{metric}_low"], line[f"{metric}_high"]
    return fixed(line[metric]), "" if pd.isna(low) else f"{fixed(low)}–{fixed(high)}"


def _short(value: float) -> str:
    """Three digits, without a fraction that says nothing."""
    digits = ".0f" if abs(value) >= 100 or value == int(value) else ".3g"
    return f"{value + 0.0:{digits}}".replace("-", "−")


def signed(value: float) -> str:
    """Two digits, with a plus."""
    return ("+" if value > 0 else "") + fixed(value)


def fixed(value: Any, digits: int = 2) -> str:
    """So many digits, or n/a."""
    # Adding 0 to what was rounded turns a negative zero into a plain one.
    return "n/a" if pd.isna(value) else f"{round(float(value), digits) + 0.0:.{digits}f}".replace("-", "−")
