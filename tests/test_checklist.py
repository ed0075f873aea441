"""Items of reporting guidelines."""

import json

from pssf.study.report.checklist import STATUSES, checklist


def test_an_item_is_answered_only_where_its_evidence_is(tmp_path):
    (tmp_path / "scores.csv").write_text("model,auc\n")
    (tmp_path / "study.json").write_text(json.dumps({"settings": {}}))
    answered = checklist(tmp_path)
    answers = {(item["guideline"], item["id"]): item for item in answered["items"]}
    assert answers["CLEAR", "39"]["status"] == "yes"
    assert answers["CLEAR", "40"] == {
        "guideline": "CLEAR", "id": "40", "item": "Uncertainty", "status": "no",
        "evidence": "scores.csv auc_low: not made in this run",
    }  # fmt: skip
    assert answers["CLEAR", "1-6"]["status"] == "human"
    assert {item["status"] for item in answered["items"]} <= set(STATUSES)
    assert 0 < answered["metrics_score_percent"] < 60
    assert sum(answered["summary"]["METRICS"].values()) == 30
