"""All splits in parallel, and how the cost of one grows."""

import dataclasses

import numpy as np
import pandas as pd
from test_extremes import LIGHT, NAMES, table

from pssf.study.learn.scenarios import one_split
from pssf.study.learn.split import PARTS
from pssf.study.learn.training import fewest, share_of, train


def test_splits_are_those_of_one_split_in_order_on_any_number_of_workers():
    cohort, told = table(13), []
    how = {"scheduler": None, "made": told.append}
    one, growth = train(cohort, NAMES, LIGHT, workers=1, **how)
    two, _ = train(cohort, NAMES, LIGHT, workers=2, **how)
    assert told == [1] * (2 * LIGHT.repeats)
    assert np.isfinite(growth)
    for repeat, (first, second) in enumerate(zip(one, two, strict=True)):
        alone = one_split(repeat, table=cohort, names=NAMES, settings=LIGHT)
        columns = list(alone.predictions.columns)
        for found in (first, second):
            pd.testing.assert_frame_equal(found.predictions[columns], alone.predictions, check_exact=True)


def test_every_subject_is_in_one_part_of_each_split():
    outcomes, _ = train(
        table(6), NAMES, dataclasses.replace(LIGHT, repeats=3), workers=1, scheduler=None, made=lambda more: None
    )
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
    assert train(table(4), NAMES, LIGHT, workers=1, scheduler=None, made=lambda more: None)[1] is None
