"""Check table cells of the report, and the stated reasons why a table allows no conclusion."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pssf.study import report
from pssf.study.report.cell_formats import MISSING, format_fixed, format_interval, format_short, format_signed
from pssf.study.report.undecided_tables import (
    explain_undecided_claims,
    explain_undecided_intervals,
    explain_undecided_scores,
)

NAN, INF = float("nan"), float("inf")


def test_missing_and_infinite_values_are_shown_as_a_dash():
    for form in (format_fixed, format_signed, format_short):
        assert {form(NAN), form(INF), form(-INF)} == {MISSING}
    assert {format_interval(NAN, 1.0), format_interval(0.0, INF), format_interval(None, None)} == {MISSING}


def test_intervals_have_minus_signs_instead_of_hyphens():
    assert format_interval(-0.5, 0.25) == "−0.50 to 0.25"
    assert format_interval(-0.5, 0.25, signs=True) == "−0.50 to +0.25"
    assert format_interval(10.4, 20.6, 0) == "10 to 21"
    assert format_fixed(-0.001) == "0.00"


@pytest.mark.parametrize(
    ("low", "high", "bound", "reason"),
    [
        ([NAN, NAN], [NAN, NAN], None, "No value has a 95 % interval"),
        ([0.5, NAN], [0.5, NAN], None, "No value has a 95 % interval"),
        ([0.1, NAN], [0.2, NAN], None, ""),
        ([-0.1, NAN], [0.2, NAN], 0.0, "No 95 % interval excludes 0:"),
        ([0.1, NAN], [0.2, NAN], 0.0, ""),
    ],
)
def test_a_table_without_a_useful_interval_allows_no_conclusion(low, high, bound, reason):
    explained = explain_undecided_intervals(pd.DataFrame({"low": low, "high": high}), "low", "high", bound)
    assert explained.startswith(reason) if reason else explained == ""


def test_scores_of_too_few_test_subjects_allow_no_conclusion():
    table = pd.DataFrame({"auc_low": [0.6], "auc_high": [0.9], "test_subjects": [12], "test_rarest": [3]})
    assert explain_undecided_scores(table) == ""
    assert "fewer than 6 test subjects, or fewer than 3" in explain_undecided_scores(table.assign(test_rarest=2))
    assert "No value" in explain_undecided_scores(table.assign(auc_low=np.nan))


def test_the_overall_verdict_is_undecided_only_if_all_claims_are():
    assert explain_undecided_claims(pd.DataFrame({"verdict": ["not decidable", "holds"]})) == ""
    assert "No claim is decided" in explain_undecided_claims(pd.DataFrame({"verdict": ["not decidable"] * 2}))


def test_the_modules_of_the_report_have_no_circular_imports():
    folder = Path(report.__file__).parent
    paths = {path.stem: path for path in folder.rglob("*.py") if path.name != "__init__.py"}
    imports = {}
    for name, path in paths.items():
        nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
        words = {
            word for node in nodes for word in [*(node.module or "").split("."), *(one.name for one in node.names)]
        }
        imports[name] = words & paths.keys()
    assert imports["report_page"] >= {"report_elements", "score_tables"}
    # A circular import raises CycleError.
    list(TopologicalSorter(imports).static_order())
