"""Check the parallel training of all splits."""

import dataclasses

import pandas as pd
import pytest
from test_extreme_cohorts import LIGHT, NAMES, make_feature_table

from pssf.core.checks import InputError
from pssf.core.processes.execution import Execution
from pssf.study.learn.protocol_scenarios import evaluate_split
from pssf.study.learn.subject_split import PARTS
from pssf.study.learn.training import train_all_splits, train_split


def test_parallel_splits_equal_splits_evaluated_one_by_one():
    cohort, alone, together = make_feature_table(13), Execution(), Execution(workers=2)
    one, two = (train_all_splits(cohort, NAMES, LIGHT, execution) for execution in (alone, together))
    for execution in (alone, together):
        assert execution.timer.stages["training and testing"].newly_done == LIGHT.repeats
    for repeat, (first, second) in enumerate(zip(one, two, strict=True)):
        expected = evaluate_split(repeat, table=cohort, names=NAMES, settings=LIGHT).predictions
        for outcome in (first, second):
            pd.testing.assert_frame_equal(outcome.predictions[list(expected)], expected, check_exact=True)


def test_training_on_a_worker_with_other_code_raises_an_error():
    with pytest.raises(InputError, match=r"code of pssf on .* must be .*, got other code \(study\)"):
        train_split(0, table=make_feature_table(6), names=NAMES, settings=LIGHT, code={"study": "0"})


def test_every_subject_is_in_one_part_of_each_split():
    outcomes = train_all_splits(make_feature_table(6), NAMES, dataclasses.replace(LIGHT, repeats=3), Execution())
    parts = pd.concat([outcome.subjects for outcome in outcomes])
    assert (parts.groupby(["repeat", "subject"]).size() == 1).all()
    assert set(parts["part"]) == set(PARTS)
    assert len(parts) == 3 * 18
    tested = parts[parts["part"] == "test"]
    for outcome, (_, of) in zip(outcomes, tested.groupby("repeat"), strict=True):
        assert set(outcome.predictions["subject"]) == set(of["subject"])
