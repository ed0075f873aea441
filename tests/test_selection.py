"""From all features to a few."""

import pandas as pd
import pytest
from made_up import NAMES, features
from numpy.testing import assert_allclose
from test_radiomics import texture

from pssf.radiomics.features import extract
from pssf.study.learn.selection import DropRedundant, preparation
from pssf.study.settings import SELECTIONS


def test_pruning_drops_constants_and_repeats_and_keeps_the_first_of_a_group():
    table = features(10)[NAMES].assign(constant=5.0, inverse=-(features(10)["n3"] ** 3))
    kept = DropRedundant(0.9).fit(table).kept_
    assert "signal" in kept
    assert not {"copy", "constant", "inverse"} & set(kept)


def test_features_that_are_others_in_disguise_are_left_out_before_a_model_sees_them():
    table = pd.DataFrame([extract(texture(32, seed, 0.5 + 0.1 * seed), 0.15) for seed in range(14)])
    twice = (
        ("glcm_SumAverage", 2 * table["glcm_JointAverage"]),
        ("gldm_GrayLevelNonUniformity", 32 * 32 * table["firstorder_linear_Uniformity"]),
        ("firstorder_linear_TotalEnergy", 0.15**2 * table["firstorder_linear_Energy"]),  # a slice is 1 mm high
    )
    for name, other in twice:
        assert_allclose(table[name], other, rtol=1e-9, err_msg=name)
    kept = DropRedundant(0.9).fit(table).kept_
    for pair in (
        {"glcm_SumAverage", "glcm_JointAverage"},
        {"gldm_GrayLevelNonUniformity", "firstorder_linear_Uniformity"},
        {"firstorder_linear_TotalEnergy", "firstorder_linear_Energy"},
    ):
        assert len(pair & set(kept)) < 2


@pytest.mark.parametrize("selection", list(SELECTIONS))
def test_a_selection_keeps_what_follows_the_grade(selection):
    table = features(20, noise=0.3)
    fitted = preparation(selection, rho=0.9, most=4, seed=0).fit(table[NAMES], table["grade"].to_numpy())
    kept = fitted.named_steps["select"].kept_
    assert "signal" in kept
    assert 1 <= len(kept) <= 4
