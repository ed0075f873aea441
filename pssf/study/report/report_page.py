"""HTML page of the report; it contains all styles and figures and loads no other file."""

from dataclasses import dataclass, field
from typing import Any

import jinja2
import pandas as pd

from ..design.classification_tasks import GRADE_NAMES
from ..design.study_settings import MODELS, SELECTIONS
from ..prediction.patient_test import FilmTestResult
from ..predictions import BASELINES, NO_SELECTION
from ..statistics.features.localisation_error import GROSS_ERROR_MM
from ..statistics.features.reliability import ICC_FORMS
from ..statistics.scores.metrics import METRICS
from ..statistics.scores.tested_subjects import MIN_TEST_SUBJECTS, MIN_TEST_SUBJECTS_PER_CLASS
from .cell_formats import MISSING, format_fixed, format_interval, format_short, format_signed
from .figures.feature_figures import FAMILY_NAMES
from .figures.result_figures import SCENARIO_LABELS
from .published_results import PAPER_RESULTS
from .report_elements import Picture, Section
from .score_tables import arrange_differences, arrange_scores
from .summary_lines import explain_undecided_run, summarise_results
from .undecided_tables import (
    explain_undecided_calibration,
    explain_undecided_claims,
    explain_undecided_intervals,
    explain_undecided_reliability,
)

# Classifier or baseline -> short label.
_SHORT_MODEL_NAMES = {"lr": "Logistic", "rf": "Forest", "xgb": "XGBoost"} | BASELINES
# Sections before the sections of the analyses: template -> heading.
_FIRST_SECTIONS = {
    "summary": "Summary",
    "claims": "Claims of the published study",
    "panel": "Radiographs",
    "localisation": "Joint line localisation",
    "scores": "Classification",
    "films": "Patient radiographs",
    "subgroups": "Subgroups",
    "robustness": "Robustness across protocols",
    "differences": "Differences between models and protocols",
    "confusion": "Confusion matrices",
    "calibration": "Calibration",
    "icc": "Feature reliability",
    "importance": "Feature importance",
}
# Sections after the sections of the analyses: template -> heading.
_LAST_SECTIONS = {"limits": "Limitations", "times": "Run time, versions and settings", "glossary": "Glossary"}


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All data that the report page shows.

    Parameters
    ----------
    counts : dict of str to int
        Number of subjects, knees, protocols, radiographs and rejected regions, by label.
    composition : DataFrame
        Table from `summarise_composition`.
    warnings : list of str
        Warnings from `find_leakage_warnings`.
    notes : list of str
        Notes from `find_leakage_notes`.
    localisation : DataFrame
        Table from `summarise_localisation`.
    morphology : DataFrame
        Table from `summarise_morphology`.
    subgroups : DataFrame
        Table from `score_subgroups`.
    scores : DataFrame
        Table from `summarise_scores`.
    differences : DataFrame
        Table from `compare_arms`.
    claims : DataFrame
        Table from `evaluate_claims`.
    calibration : DataFrame
        Table from `compute_calibration`.
    families : DataFrame
        Importance of each feature family per model, and the drop in AUC after permutation in the columns "<model>
        drop".
    stable_counts_by_split : list of int
        Number of features that are stable in the training subjects of each split.
    stable_counts : DataFrame
        Table from `count_stable_features`.
    leading : DataFrame
        Most important features: model, feature, importance, selection_frequency, drop.
    degenerate : list of str
        Names of features with the same value in every radiograph.
    pictures : dict of str to Picture
        Figures by name.
    settings : dict of str to Any
        Settings of the study.
    processing : dict of str to Any
        Image processing, from `describe_processing`.
    versions : dict of str to str
        Versions of Python and libraries.
    cost : list of dict
        Run time of each stage, from `summarise_cost`.
    work_seconds : dict of str to float
        Time of each step of the feature measurement, summed over the processes, in s.
    workers : int
        Number of processes.
    features : int
        Number of features per radiograph.
    test_subjects : tuple of int
        Smallest and largest number of test subjects per split in the within-protocol scenario.
    test_rarest : int
        Smallest number of test subjects of a class in the within-protocol scenario.
    models : list of str
        Names of the saved models.
    external : FilmTestResult or None
        Results on patient radiographs; None without patient radiographs.
    sections : list of Section
        Sections of the analyses, in order.
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
    sections: list[Section] = field(default_factory=list)


def render_page(findings: Findings) -> str:
    """Render the HTML page of the report.

    Parameters
    ----------
    findings : Findings
        All data that the report page shows.

    Returns
    -------
    str
        HTML text of the page.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pssf.study.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["fixed"] = format_fixed
    environment.filters["short"] = format_short
    environment.filters["signed"] = format_signed
    environment.filters["plain"] = lambda name: str(name).replace("_", " ")
    environment.globals["interval"] = format_interval
    return environment.get_template("report.html.j2").render(
        f=findings,
        contents=_list_sections(findings),
        tasks=arrange_scores(findings.scores),
        compared=arrange_differences(findings.differences),
        undecided=_explain_undecided_tables(findings),
        result=summarise_results(findings.scores, findings.claims),
        undecided_run=explain_undecided_run(
            findings.claims, findings.counts["subjects"], findings.test_subjects, findings.test_rarest
        ),
        **_list_labels(),
    )


def _list_sections(findings: Findings) -> list[dict[str, Any]]:
    """List the sections of the page in order: identifier, heading, template, and analysis section (None for others)."""
    left_out = {"films": findings.external is None, "subgroups": findings.subgroups.empty}
    first, last = (
        [
            {"name": name, "title": title, "template": f"{name}.html.j2", "section": None}
            for name, title in sections.items()
            if not left_out.get(name, False)
        ]
        for sections in (_FIRST_SECTIONS, _LAST_SECTIONS)
    )
    analyses = [
        {"name": one.name, "title": one.title, "template": "analysis.html.j2", "section": one}
        for one in findings.sections
    ]
    return [*first, *analyses, *last]


def _explain_undecided_tables(findings: Findings) -> dict[str, str]:
    """Explain for each table why no conclusion can be drawn from it; "" if a conclusion is possible."""
    patients = {} if findings.external is None else findings.external.tables
    reasons = {
        name: explain_undecided_intervals(patients[name], f"{metric}_low", f"{metric}_high") if name in patients else ""
        for name, metric in (("films_scores", "auc"), ("films_grades", "kappa"), ("films_measures", "auc"))
    }
    subgroups = findings.subgroups
    return reasons | {
        "claims": explain_undecided_claims(findings.claims),
        "subgroups": "" if subgroups.empty else explain_undecided_intervals(subgroups, "auc_low", "auc_high"),
        "calibration": explain_undecided_calibration(findings.calibration),
        "reliability": explain_undecided_reliability(findings.stable_counts),
    }


def _list_labels() -> dict[str, Any]:
    """List the labels and constants used by the templates."""
    return {
        "metrics": METRICS,
        "least_tested": MIN_TEST_SUBJECTS,
        "least_of_a_class": MIN_TEST_SUBJECTS_PER_CLASS,
        "missing": MISSING,
        "models": MODELS | BASELINES,
        "selections": SELECTIONS | {NO_SELECTION: "baseline"},
        "short": _SHORT_MODEL_NAMES,
        "scenarios": SCENARIO_LABELS,
        "forms": ICC_FORMS,
        "families": FAMILY_NAMES,
        "paper": PAPER_RESULTS,
        "grades": GRADE_NAMES,
        "gross_mm": GROSS_ERROR_MM,
    }
