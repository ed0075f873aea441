"""Check the summary lines of the report."""

import pandas as pd
import pytest

from pssf.study.report.summary_lines import explain_undecided_run, summarise_results


def make_scores(*rows) -> pd.DataFrame:
    """Return a table of scores."""
    names = ("task", "scenario", "tested_on", "model", "selection", "auc")
    return pd.DataFrame([dict(zip(names, row, strict=True)) for row in rows])


CLAIMS = pd.DataFrame({"verdict": ["holds", "does not hold", "holds", "not decidable"]})
SCORES = make_scores(
    ("0/1/2", "within", "a", "lr", "l1", 0.61),
    ("0 vs 2", "within", "a", "lr", "l1", 0.81),
    ("0 vs 2", "within", "a", "rf", "l1", 0.92),
    ("0 vs 2", "within", "a", "jsw", "none", 1.00),
    ("0 vs 2", "cross", "b", "lr", "l1", 0.70),
    ("0 vs 2", "cross", "b", "rf", "l1", float("nan")),
    ("0 vs 2", "multi", "b", "rf", "l1", 0.99),
    ("0 vs 2", "multi", "all", "rf", "l1", 0.88),
)


def test_the_summary_states_the_range_of_models_without_baselines():
    auc, claims = summarise_results(SCORES, CLAIMS)
    assert auc == (
        "AUC for grade 0 vs 2, mean over the splits, range over 2 models: within one protocol "
        "0.81 to 0.92; on another protocol 0.70; trained and tested on all protocols 0.88."
    )
    assert claims == (
        "Of 4 measures of the published claims, 2 hold, 1 do not hold, 1 are not decidable with this cohort."
    )


def test_the_summary_of_one_protocol_and_model_omits_other_statements():
    (auc, _) = summarise_results(SCORES[1:2], CLAIMS)
    assert auc == "AUC for grade 0 vs 2, mean over the splits, one model: within one protocol 0.81."


@pytest.mark.parametrize(
    ("verdicts", "tested", "rarest", "message"),
    [
        (
            ["not decidable"],
            (2, 3),
            1,
            "With 20 subjects no claim is decided; a split has 2 to 3 test subjects (1 of the rarest grade), and a "
            "decision needs 6 (3 of each grade).",
        ),
        (
            ["not decidable", "holds"],
            (7, 7),
            1,
            "With 20 subjects no claim about a model is decided; a split has 7 test ",
        ),
        (["not decidable"], (6, 9), 3, "With 20 subjects no claim is decided; the intervals are too wide."),
        (["not decidable", "holds"], (6, 9), 3, ""),
    ],
)
def test_the_summary_explains_an_undecided_study_in_one_sentence(verdicts, tested, rarest, message):
    sentence = explain_undecided_run(pd.DataFrame({"verdict": verdicts}), 20, tested, rarest)
    assert sentence.startswith(message) if message else sentence == ""
    assert sentence.count(".") <= 1
