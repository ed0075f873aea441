"""Tables of scores and differences for the page, with one column per model, grouped by feature selection."""

from itertools import product
from typing import Any

import pandas as pd

from ..design.classification_tasks import TASKS
from ..statistics.scores.confidence_intervals import MODEL_MINUS_JSW
from ..statistics.scores.metrics import METRICS
from .cell_formats import MISSING, format_fixed, format_interval
from .figures.result_figures import SCENARIO_LABELS
from .undecided_tables import explain_undecided_differences, explain_undecided_scores

# Metrics whose differences are shown; the CSV file contains all metrics.
_DIFFERENCE_METRICS = ("auc", "balanced_accuracy")


def arrange_scores(scores: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Arrange the scores of each task as a table with one column per model.

    Parameters
    ----------
    scores : DataFrame
        Table from `split_scores.summarise_scores`, with intervals.

    Returns
    -------
    dict of str to dict
        Table of each task: ``groups`` (models of each feature selection, which form the columns), ``rows`` (one per
        scenario, with one line per metric) and ``undecided`` (why no conclusion can be drawn from the table, or "").
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
        tables[task] = {"groups": groups, "rows": rows, "undecided": explain_undecided_scores(part)}
    return tables


def arrange_differences(differences: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Arrange the differences of each task and metric as a table with one column per model.

    Parameters
    ----------
    differences : DataFrame
        Table from `confidence_intervals.compare_arms`.

    Returns
    -------
    dict of str to dict
        Table of each task and metric: ``groups``, ``rows`` and ``undecided``, as in `arrange_scores`.
    """
    tables = {}
    for task, metric in product(TASKS, _DIFFERENCE_METRICS):
        part = differences[(differences["task"] == task) & (differences["metric"] == metric)]
        if part.empty:
            continue
        groups, rows = _group_models(part), []
        for (comparison, scenario, tested_on), block in part.groupby(
            ["comparison", "scenario", "tested_on"], sort=False
        ):
            if comparison == MODEL_MINUS_JSW and scenario == "multi" and tested_on != "all":
                continue  # The row hardly differs from the row of all protocols, so only the CSV file contains the row.
            cells = {(line["model"], line["selection"]): line for line in block.to_dict("records")}
            line = [cells.get((model, selection), {}) for selection, models in groups.items() for model in models]
            rows.append({"comparison": comparison, "scenario": scenario, "tested_on": tested_on, "cells": line})
        undecided = explain_undecided_differences(part)
        tables[f"{task}: {METRICS[metric]}"] = {"groups": groups, "rows": rows, "undecided": undecided}
    return tables


def _group_models(table: pd.DataFrame) -> dict[str, list[str]]:
    """Group the models by selection, in the order of the table."""
    pairs = dict.fromkeys(zip(table["selection"], table["model"], strict=True))
    groups: dict[str, list[str]] = {}
    for selection, model in pairs:
        groups.setdefault(selection, []).append(model)
    return groups


def _format_cell(line: dict[str, Any], metric: str) -> tuple[str, str]:
    """Format the mean and the interval of a metric; a missing interval becomes ""."""
    interval = format_interval(line.get(f"{metric}_low"), line.get(f"{metric}_high"))
    return format_fixed(line.get(metric)), "" if interval == MISSING else interval
