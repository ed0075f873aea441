"""What the report says first."""

import pandas as pd
import pytest

from pssf.study.report.summary_lines import format_sample_size_warning, summarise_results


def scores(*rows) -> pd.DataFrame:
    names = ("task", "scenario", "tested_on", "model", "selection", "auc")
    return pd.DataFrame([dict(zip(names, row, strict=True)) for row in rows])


CLAIMS = pd.DataFrame({"verdict": ["holds", "does not hold", "holds", "not decidable"]})
SCORES = scores(
    ("0/1/2", "within", "a", "lr", "l1", 0.61),
    ("0 vs 2", "within", "a", "lr", "l1", 0.81),
    ("0 vs 2", "within", "a", "rf", "l1", 0.92),
    ("0 vs 2", "within", "a", "jsw", "none", 1.00),
    ("0 vs 2", "cross", "b", "lr", "l1", 0.70),
    ("0 vs 2", "cross", "b", "rf", "l1", float("nan")),
    ("0 vs 2", "multi", "b", "rf", "l1", 0.99),
    ("0 vs 2", "multi", "all", "rf", "l1", 0.88),
)


def test_the_result_is_the_range_of_all_models_and_of_no_baseline():
    auc, claims = summarise_results(SCORES, CLAIMS)
    assert auc == (
        "AUC for grade 0 vs 2, mean over the splits, range over 2 models: within one protocol "
        "0.81 to 0.92; on another protocol 0.70; trained and tested on all protocols 0.88."
    )
    assert claims == ("Of 4 measurements of the claims of the paper, 2 hold, 1 do not hold, 1 are not decidable here.")


def test_of_one_protocol_and_one_model_the_rest_is_left_out():
    (auc, _) = summarise_results(SCORES[1:2], CLAIMS)
    assert auc == "AUC for grade 0 vs 2, mean over the splits, one model: within one protocol 0.81."


@pytest.mark.parametrize(
    ("tested", "rarest", "said"),
    [
        ((2, 3), 1, "tests 2 to 3 subjects"),
        ((5, 9), 3, "5 to 9"),
        ((7, 7), 1, "tests 7 subjects, 1 of the rarest grade"),
        ((6, 9), 3, ""),
    ],
)
def test_a_warning_stands_where_splits_test_too_few(tested, rarest, said):
    warning = format_sample_size_warning(tested, rarest)
    assert (said in warning) if said else warning == ""
