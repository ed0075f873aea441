"""Items of reporting guidelines that a program can fill, each with its evidence; the rest is left for a human."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...data.reporting import Guideline, Item
from ...io.evidence import lacking

STATUSES = ("yes", "no", "human", "none")


def checklist(out: Path, known: Mapping[str, Guideline]) -> dict[str, Any]:
    """What the study in a folder answers of IBSI, METRICS, CLEAR, TRIPOD+AI and CLAIM (`data/reporting.toml`).

    known  name -> guideline, as `data.reporting.guidelines` has them
    An item is answered only if the run's own figures do: all conditions of its evidence hold, see `io.evidence`.
    returns  versions of the guidelines; summary: guideline -> how many of each status; METRICS score, strict: earned
             over applicable weight, items for a human not counted; items: guideline, id, item, status, evidence
    """
    items = [
        {"guideline": name, "id": item.id, "item": item.item, **_answer(out, item)}
        for name, guideline in known.items()
        for item in guideline.items
    ]
    summary = {
        name: {status: sum(i["guideline"] == name and i["status"] == status for i in items) for status in STATUSES}
        for name in known
    }
    versions = {name: guideline.version for name, guideline in known.items()}
    return {
        "versions": versions,
        "summary": summary,
        "metrics_score_percent": _score(items, known["METRICS"]),
        "items": items,
    }


def _answer(out: Path, item: Item) -> dict[str, str]:
    if item.status != "yes":
        return {"status": item.status, "evidence": item.evidence}
    lacks = lacking(out, item.evidence)
    if not lacks:
        return {"status": "yes", "evidence": item.evidence}
    return {"status": "no", "evidence": f"{lacks}: not so in this run"}


def _score(items: list[dict[str, Any]], metrics: Guideline) -> float:
    weights = {item.id: item.weight for item in metrics.items}
    ours = [item for item in items if item["guideline"] == "METRICS" and item["status"] != "none"]
    earned = sum(weights[item["id"]] for item in ours if item["status"] == "yes")
    return round(100 * earned / sum(weights[item["id"]] for item in ours), 1)
