"""All splits in parallel, and how the cost of one grows."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from test_evidence import LIGHT, NAMES, table

from pssf.core.checks import InputError
from pssf.core.execution import Execution
from pssf.study.learn.scenarios import one_split
from pssf.study.learn.split import PARTS
from pssf.study.learn.training import Job, fewest, one_job, share_of, train


def test_splits_are_those_of_one_split_in_order_on_any_number_of_workers():
    cohort, alone, together = table(13), Execution(), Execution(workers=2)
    one, two = (train(cohort, NAMES, LIGHT, execution) for execution in (alone, together))
    for execution in (alone, together):
        assert execution.timer.stages["training and testing"].made == LIGHT.repeats
        assert np.isfinite(execution.timer.stages["training and testing"].growth)
    for repeat, (first, second) in enumerate(zip(one, two, strict=True)):
        expected = one_split(repeat, table=cohort, names=NAMES, settings=LIGHT).predictions
        for outcome in (first, second):
            pd.testing.assert_frame_equal(outcome.predictions[list(expected)], expected, check_exact=True)


def test_a_worker_with_other_code_trains_nothing():
    with pytest.raises(
        InputError, match=r"on .*: other code of pssf \(study\); allowed: the code where the run started"
    ):
        one_job(Job(0), table=table(6), names=NAMES, settings=LIGHT, code={"study": "0"})


def test_every_subject_is_in_one_part_of_each_split():
    outcomes = train(table(6), NAMES, dataclasses.replace(LIGHT, repeats=3), Execution())
    parts = pd.concat([outcome.subjects for outcome in outcomes])
    assert (parts.groupby(["repeat", "subject"]).size() == 1).all()
    assert set(parts["part"]) == set(PARTS)
    assert len(parts) == 3 * 18
    tested = parts[parts["part"] == "test"]
    for outcome, (_, of) in zip(outcomes, tested.groupby("repeat"), strict=True):
        assert set(outcome.predictions["subject"]) == set(of["subject"])


def test_a_share_holds_every_grade_and_too_few_subjects_have_no_growth():
    cohort = table(8)
    half = cohort[cohort["subject"].isin(share_of(cohort, 0.5))]
    assert half.groupby("grade")["subject"].nunique().tolist() == [4, 4, 4]
    assert (fewest(cohort, 0.5), fewest(cohort, 0.25)) == (4, 2)
    execution = Execution()
    train(table(4), NAMES, LIGHT, execution)
    assert execution.timer.stages["training and testing"].growth is None
