"""Checklist of reporting guidelines: items answered from the files of a study, with evidence.

All other items must be answered by the authors.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...data.analysis.reporting_table import ChecklistItem, Guideline
from ...io.file_conditions import find_unmet_condition

STATUSES = ("yes", "no", "human", "none")


def fill_checklist(out: Path, guidelines: Mapping[str, Guideline]) -> dict[str, Any]:
    """Answer the items of IBSI, METRICS, CLEAR, TRIPOD+AI and CLAIM for the study in a folder.

    The items are in ``data/reporting.toml``. An item is answered "yes" only if the files of the run meet all conditions
    in its evidence; see `io.file_conditions.find_unmet_condition`.

    Parameters
    ----------
    out : Path
        Folder of the study.
    guidelines : mapping of str to Guideline
        Guidelines by name.

    Returns
    -------
    dict of str to Any
        Entries by name. versions: version of each guideline. summary: number of items by guideline and status.
        metrics_score_percent: strict METRICS score, which is the weight of the items answered "yes" divided by the
        weight of all applicable items. items: guideline, id, item, status and evidence of each item.
    """
    items = [
        {"guideline": name, "id": item.id, "item": item.item, **_answer_item(out, item)}
        for name, guideline in guidelines.items()
        for item in guideline.items
    ]
    summary = {
        name: {status: sum(i["guideline"] == name and i["status"] == status for i in items) for status in STATUSES}
        for name in guidelines
    }
    versions = {name: guideline.version for name, guideline in guidelines.items()}
    return {
        "versions": versions,
        "summary": summary,
        "metrics_score_percent": _score_metrics(items, guidelines["METRICS"]),
        "items": items,
    }


def _answer_item(out: Path, item: ChecklistItem) -> dict[str, str]:
    """Return status and evidence of one item."""
    if item.status != "yes":
        return {"status": item.status, "evidence": item.evidence}
    lacks = find_unmet_condition(out, item.evidence)
    if not lacks:
        return {"status": "yes", "evidence": item.evidence}
    return {"status": "no", "evidence": f"{lacks}: not met in this run"}


def _score_metrics(items: list[dict[str, Any]], metrics: Guideline) -> float:
    """Compute the METRICS score in percent."""
    weights = {item.id: item.weight for item in metrics.items}
    ours = [item for item in items if item["guideline"] == "METRICS" and item["status"] != "none"]
    earned = sum(weights[item["id"]] for item in ours if item["status"] == "yes")
    return round(100 * earned / sum(weights[item["id"]] for item in ours), 1)
