"""One HTML page with everything in it: no style, script or picture is fetched from anywhere."""

from base64 import b64encode
from dataclasses import dataclass
from typing import Any

import jinja2
import pandas as pd

from .figures import FAMILY_NAMES
from .localisation import GROSS_MM
from .metrics import METRICS
from .models import MODELS
from .reliability import ICC_FORMS
from .scenarios import TASKS
from .selection import SELECTIONS

SCENARIOS = {"within": "Within protocol", "cross": "Cross-protocol", "multi": "Multi-protocol"}
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
    composition   grade, subjects, knees, radiographs
    localisation  of `localisation.summarise`
    scores        of `scenarios.summarise`
    stable        of `reliability.count_stable`
    leading       model, feature, share, chosen: the features that count most
    degenerate    names of features that are the same in every radiograph
    seconds       stage -> wall time; work_seconds: step -> sum over the processes
    test_subjects least and most of a split
    """

    counts: dict[str, int]
    composition: pd.DataFrame
    localisation: pd.DataFrame
    scores: pd.DataFrame
    stable: pd.DataFrame
    leading: pd.DataFrame
    degenerate: list[str]
    pictures: dict[str, Picture]
    settings: dict[str, Any]
    versions: dict[str, str]
    seconds: dict[str, float]
    work_seconds: dict[str, float]
    workers: int
    features: int
    test_subjects: tuple[int, int]


def render(findings: Findings) -> str:
    """The page."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pssf.study", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["fixed"] = _fixed
    environment.filters["plain"] = lambda name: str(name).replace("_", " ")
    return environment.get_template("report.html.j2").render(
        f=findings,
        tasks=_score_tables(findings.scores),
        metrics=METRICS,
        models=MODELS,
        selections=SELECTIONS,
        scenarios=SCENARIOS,
        forms=ICC_FORMS,
        families=FAMILY_NAMES,
        paper=PAPER,
        gross_mm=GROSS_MM,
    )


def _score_tables(scores: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Task -> {selections, models: of the columns, models within selections; rows: scenario, and a line a metric}."""
    tables = {}
    for task in TASKS:
        part = scores[scores["task"] == task]
        if part.empty:
            continue
        selections, models = list(dict.fromkeys(part["selection"])), list(dict.fromkeys(part["model"]))
        arms = [(model, selection) for selection in selections for model in models]
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
                    "lines": {metric: [_spread(cells.get(arm, {}), metric) for arm in arms] for metric in METRICS},
                }
            )
        tables[task] = {"selections": selections, "models": models, "rows": rows}
    return tables


def _spread(line: dict[str, Any], metric: str) -> str:
    if pd.isna(line.get(metric)):
        return "n/a"
    spread = line[f"{metric}_sd"]
    return _fixed(line[metric], 2) + ("" if pd.isna(spread) else f" ± {_fixed(spread, 2)}")


def _fixed(value: Any, digits: int = 2) -> str:
    # Adding 0 to what was rounded turns a negative zero into a plain one.
    return "n/a" if pd.isna(value) else f"{round(float(value), digits) + 0.0:.{digits}f}".replace("-", "−")
