"""HTML page of the report; all styles and figures are inside, and nothing is loaded from elsewhere."""

from base64 import b64encode
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any

import jinja2
import pandas as pd

from ..design.classification_tasks import GRADE_NAMES, TASKS
from ..design.study_settings import MODELS, SELECTIONS
from ..prediction.patient_test import FilmTestResult
from ..predictions import BASELINES, NO_SELECTION
from ..statistics.features.localisation_error import GROSS_ERROR_MM
from ..statistics.features.reliability import ICC_FORMS
from ..statistics.scores.confidence_intervals import MODEL_MINUS_JSW
from ..statistics.scores.metrics import METRICS
from ..statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS
from .feature_figures import FAMILY_NAMES
from .result_figures import SCENARIO_LABELS
from .summary_lines import format_sample_size_warning, summarise_results

if TYPE_CHECKING:
    from .report_sections import Section

# Classifiers and baselines with short labels.
_SHORT_MODEL_NAMES = {"lr": "Logistic", "rf": "Forest", "xgb": "XGBoost"} | BASELINES
# Published results of Alzubaidi and Al-Bayaty, arXiv 2601.11642; they are printed for comparison only.
PAPER_RESULTS = {"stable": 43, "features": 107, "within": 0.92, "cross": 0.78, "multi": "0.88–0.90"}


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure of the report.

    Parameters
    ----------
    name : str
        Stem of the file name.
    png : bytes
        Content of the file.
    alt : str
        Description for readers who cannot see the figure.
    caption : str
        Caption.
    """

    name: str
    png: bytes
    alt: str
    caption: str

    @property
    def uri(self) -> str:
        """Figure as a data URI."""
        return "data:image/png;base64," + b64encode(self.png).decode("ascii")


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Everything that the page shows.

    Parameters
    ----------
    counts : dict of str to int
        Numbers of the cohort, by label.
    composition : DataFrame
        Table of `summarise_composition`.
    warnings : list of str
        Texts of `find_leakage_warnings`.
    notes : list of str
        Texts of `find_leakage_notes`.
    localisation : DataFrame
        Table of `summarise_localisation`.
    morphology : DataFrame
        Table of `summarise_morphology`.
    subgroups : DataFrame
        Table of `score_subgroups`.
    scores : DataFrame
        Table of `summarise_scores`.
    differences : DataFrame
        Table of `compare_arms`.
    claims : DataFrame
        Table of `evaluate_claims`.
    calibration : DataFrame
        Table of `compute_calibration`.
    families : DataFrame
        Share of importance of each family, one column per model; and the drop of AUC in the columns "<model> drop".
    stable_counts_by_split : list of int
        Number of features that are stable in the training subjects of each split.
    stable_counts : DataFrame
        Table of `count_stable_features`.
    leading : DataFrame
        Most important features: model, feature, share, chosen, drop.
    degenerate : list of str
        Names of features that are the same in every radiograph.
    pictures : dict of str to Picture
        Figures by name.
    settings : dict of str to Any
        Settings of the study.
    processing : dict of str to Any
        Image processing, of `describe_processing`.
    versions : dict of str to str
        Versions of Python and libraries.
    cost : list of dict
        Run time of each stage, of `summarise_cost`.
    work_seconds : dict of str to float
        Time of each step, summed over the processes, in s.
    workers : int
        Number of processes.
    features : int
        Number of features per radiograph.
    test_subjects : tuple of int
        Smallest and largest number of test subjects of a split within protocol.
    test_rarest : int
        Smallest number of test subjects of a class within protocol.
    models : list of str
        Names of the saved models.
    external : FilmTestResult or None
        Results on patient radiographs; None without any.
    sections : list of Section
        Further sections, in order.
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
    stable_counts_by_split: list[int]
    stable_counts: pd.DataFrame
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
    external: FilmTestResult | None = None
    sections: list["Section"] = field(default_factory=list)


def render_page(findings: Findings) -> str:
    """Render the HTML page.

    Parameters
    ----------
    findings : Findings
        Everything that the page shows.

    Returns
    -------
    str
        HTML.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pssf.study.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["fixed"] = format_fixed
    environment.filters["short"] = _format_short
    environment.filters["signed"] = format_signed
    environment.filters["plain"] = lambda name: str(name).replace("_", " ")
    return environment.get_template("report.html.j2").render(
        f=findings,
        tasks=_build_score_tables(findings.scores),
        metrics=METRICS,
        least_tested=MIN_TEST_SUBJECTS,
        least_of_a_class=MIN_TEST_SUBJECTS_PER_CLASS,
        result=summarise_results(findings.scores, findings.claims),
        few=format_sample_size_warning(findings.test_subjects, findings.test_rarest),
        compared=_build_difference_tables(findings.differences),
        models=MODELS | BASELINES,
        selections=SELECTIONS | {NO_SELECTION: "baseline"},
        short=_SHORT_MODEL_NAMES,
        scenarios=SCENARIO_LABELS,
        forms=ICC_FORMS,
        families=FAMILY_NAMES,
        paper=PAPER_RESULTS,
        grades=GRADE_NAMES,
        gross_mm=GROSS_ERROR_MM,
    )


def _build_score_tables(scores: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Build the score table of each task.

    Each table has ``groups`` (models of each selection, the columns) and ``rows`` (a scenario with a line per metric).
    """
    tables = {}
    for task in TASKS:
        part = scores[(scores["task"] == task) & scores["scenario"].isin(list(SCENARIO_LABELS))]
        if part.empty:
            continue
        groups = _group_models(part)
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
                    "lines": {metric: [_format_cell(cells.get(arm, {}), metric) for arm in arms] for metric in METRICS},
                }
            )
        tables[task] = {"groups": groups, "rows": rows}
    return tables


def _build_difference_tables(differences: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Build the table of differences of each task and metric; see `_build_score_tables`."""
    tables = {}
    for task, metric in product(TASKS, ("auc", "balanced_accuracy")):
        part = differences[(differences["task"] == task) & (differences["metric"] == metric)]
        if part.empty:
            continue
        groups, rows = _group_models(part), []
        for (comparison, scenario, tested_on), block in part.groupby(
            ["comparison", "scenario", "tested_on"], sort=False
        ):
            if comparison == MODEL_MINUS_JSW and scenario == "multi" and tested_on != "all":
                continue  # The row is nearly that of all protocols; it is in the CSV.
            cells = {(line["model"], line["selection"]): line for line in block.to_dict("records")}
            line = [cells.get((model, selection), {}) for selection, models in groups.items() for model in models]
            rows.append({"comparison": comparison, "scenario": scenario, "tested_on": tested_on, "cells": line})
        tables[f"{task}: {METRICS[metric]}"] = {"groups": groups, "rows": rows}
    return tables


def _group_models(table: pd.DataFrame) -> dict[str, list[str]]:
    """Group the models by selection, in the order of the table."""
    pairs = dict.fromkeys(zip(table["selection"], table["model"], strict=True))
    groups: dict[str, list[str]] = {}
    for selection, model in pairs:
        groups.setdefault(selection, []).append(model)
    return groups


def _format_cell(line: dict[str, Any], metric: str) -> tuple[str, str]:
    """Format the mean and its interval; the interval is "" if there is none."""
    if pd.isna(line.get(metric)):
        return "n/a", ""
    low, high = line[f"{metric}_low"], line[f"{metric}_high"]
    return format_fixed(line[metric]), "" if pd.isna(low) else f"{format_fixed(low)}–{format_fixed(high)}"


def _format_short(value: float) -> str:
    """Format a number with three digits, or as a whole number."""
    digits = ".0f" if abs(value) >= 100 or value == int(value) else ".3g"
    return f"{value + 0.0:{digits}}".replace("-", "−")


def format_signed(value: float) -> str:
    """Format a number with a sign and two decimals.

    Parameters
    ----------
    value : float
        Number.

    Returns
    -------
    str
        Text with a plus or a true minus sign.
    """
    return ("+" if value > 0 else "") + format_fixed(value)


def format_fixed(value: Any, digits: int = 2) -> str:
    """Format a number with fixed decimals.

    Parameters
    ----------
    value : Any
        Number, or a missing value.
    digits : int, default 2
        Number of decimals.

    Returns
    -------
    str
        Text with a true minus sign; "n/a" for a missing value.
    """
    # Adding 0 turns a negative zero into zero.
    return "n/a" if pd.isna(value) else f"{round(float(value), digits) + 0.0:.{digits}f}".replace("-", "−")
