"""Check feature selection: redundancy filter and selection methods."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from synthetic_features import NAMES, make_features
from test_radiomics import make_texture

from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.study.design.study_settings import SELECTIONS
from pssf.study.learn.models.feature_selection import DropRedundant, build_feature_pipeline


def test_pruning_drops_constants_and_keeps_one_of_each_correlated_group():
    table = make_features(10)[NAMES].assign(constant=5.0, inverse=-(make_features(10)["n3"] ** 3))
    kept = set(DropRedundant(0.9).fit(table).kept_)
    assert len({"signal", "copy"} & kept) == len({"n3", "inverse"} & kept) == 1
    assert "constant" not in kept


def test_pruning_keeps_the_feature_with_the_most_correlations():
    rng = np.random.default_rng(0)
    middle = rng.normal(size=400)
    # Features a, b and c correlate with m by 0.93 and with each other by 0.86.
    ends = {name: middle + 0.4 * rng.normal(size=400) for name in ("a", "b", "c")}
    assert DropRedundant(0.9).fit(pd.DataFrame({**ends, "m": middle})).kept_ == ["m"]


@given(order=st.permutations(range(9)), seed=st.integers(0, 50))
def test_pruning_does_not_depend_on_the_order_of_columns(order, seed):
    rng = np.random.default_rng(seed)
    sources, noise = rng.normal(size=(40, 3)), rng.uniform(0.1, 0.6)
    table = pd.DataFrame({f"f{k}": sources[:, k % 3] + noise * rng.normal(size=40) for k in range(8)})
    table = table.assign(f8=2 * table["f0"])
    reordered = table[[f"f{k}" for k in order]]
    fitted, other = (DropRedundant(0.9).fit(one) for one in (table, reordered))
    assert fitted.kept_ == other.kept_
    assert fitted.transform(table).equals(other.transform(reordered))


def test_pruning_drops_features_that_are_multiples_of_others():
    table = pd.DataFrame(
        [extract_features(make_texture(32, seed, 0.5 + 0.1 * seed), 0.15, load_ibsi_tags()) for seed in range(14)]
    )
    twice = (
        ("glcm_SumAverage", 2 * table["glcm_JointAverage"]),
        ("gldm_GrayLevelNonUniformity", 32 * 32 * table["firstorder_linear_Uniformity"]),
        # The voxel volume is 0.15 x 0.15 x 1 mm.
        ("firstorder_linear_TotalEnergy", 0.15**2 * table["firstorder_linear_Energy"]),
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
def test_every_selection_keeps_a_feature_that_depends_on_the_grade(selection):
    table = make_features(20, noise=0.3)
    fitted = build_feature_pipeline(selection, rho=0.9, max_features=4, seed=0).fit(
        table[NAMES], table["grade"].to_numpy()
    )
    kept = fitted.named_steps["select"].kept_
    assert {"signal", "copy"} & set(kept)
    assert 1 <= len(kept) <= 4
