"""Options across protocols, baselines, and the tables about probabilities and importances."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.special import expit

from pssf.study import StudySettings
from pssf.study.learn.baselines import baselines_of, measures_of, with_measures
from pssf.study.learn.importance import permuted
from pssf.study.learn.models import tune
from pssf.study.learn.saving import dumps, loads
from pssf.study.learn.scenarios import one_split, score_splits
from pssf.study.learn.selection import preparation
from pssf.study.learn.split import split_subjects
from pssf.study.learn.transfer import harmonise, stable_features
from pssf.study.statistics.calibration import calibration, confusions, reliability_curve

NAMES = ["signal", "shaky", *[f"n{i}" for i in range(4)]]


def cohort(per_grade: int = 12, *, shift: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """One row a radiograph: `signal` follows the grade, `shaky` of the radiograph; protocol `b` shifts the others."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(3 * per_grade):
        own, signal = rng.normal(size=4), subject % 3 + 0.3 * rng.normal()
        for protocol in ("a", "b"):
            off = shift if protocol == "b" else 0.0
            row = {"radiograph": f"{subject}_{protocol}", "knee": subject, "subject": subject, "grade": subject % 3}
            row |= {"protocol": protocol, "signal": signal + off + 0.02 * rng.normal(), "shaky": 2.0 * rng.normal()}
            rows.append(row | {f"n{i}": own[i] + off + 0.02 * rng.normal() for i in range(4)})
    table = pd.DataFrame(rows)
    return table.assign(
        sex=np.where(table["subject"] % 2, "female", "male"),
        age_years=50.0 + table["subject"] % 7,
        stature_mm=1700.0 + table["subject"] % 11,
        jsw_medial_mm=5.0 - table["grade"],
    )


def settings_of(**more) -> StudySettings:
    return StudySettings(**({"selections": ("l1",), "models": ("lr",), "reference": "a"} | more))


# --- options across protocols --------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(scale=st.floats(0.1, 10), shift=st.floats(-100, 100), seed=st.integers(0, 100))
def test_harmonising_undoes_a_shift_and_scale_of_the_protocol(scale, shift, seed):
    onto = pd.DataFrame(np.random.default_rng(seed).normal(size=(15, 3)), columns=list("abc"))
    of = onto * scale + shift
    assert_allclose(harmonise(of, of, onto), onto, atol=1e-9)
    assert_allclose(harmonise(of.head(2), of, onto), onto.head(2), atol=1e-9)


def test_a_feature_that_never_varies_is_shifted_and_not_scaled():
    of, onto = pd.DataFrame({"a": [2.0, 2.0]}), pd.DataFrame({"a": [1.0, 3.0]})
    assert_allclose(harmonise(of, of, onto)["a"], 2.0)


def test_stable_features_are_those_that_agree_across_protocols():
    table = cohort()
    assert stable_features(table, NAMES, ["a", "b"]) == ["signal", *[f"n{i}" for i in range(4)]]
    assert stable_features(cohort(shift=30.0), NAMES, ["a", "b"]) == []


def auc_of(table: pd.DataFrame, scenario: str) -> float:
    scores = score_splits(one_split(0, table=table, names=NAMES, settings=settings_of()).predictions)
    found = scores[(scores["task"] == "0/1/2") & (scores["scenario"] == scenario) & (scores["model"] == "lr")]
    return float(found["balanced_accuracy"].mean())


def test_harmonising_gives_back_what_a_shift_of_the_protocol_costs():
    table = cohort(per_grade=20, shift=30.0)
    assert auc_of(table, "within") > 0.8
    assert auc_of(table, "cross") == pytest.approx(1 / 3, abs=0.05)  # all are called one grade
    assert auc_of(table, "cross_harmonised") > 0.8


def test_options_learn_nothing_from_test_subjects_and_from_no_label_of_the_other_protocol():
    table = cohort()
    split = split_subjects(table["subject"], table["grade"], seed=0)
    changed = table.copy()
    held = changed["subject"].isin([*split.test, *split.validation])
    changed.loc[held, "n0"] = 1e3 * np.random.default_rng(1).normal(size=held.sum())
    one, other = (one_split(0, table=t, names=NAMES, settings=settings_of()) for t in (table, changed))
    assert one.stable == other.stable == 5


def test_a_test_subject_changes_no_prediction_but_its_own_in_any_scenario():
    table = cohort(shift=3.0)
    one_of_them = split_subjects(table["subject"], table["grade"], seed=0).test[0]
    changed = table.copy()
    changed.loc[changed["subject"] == one_of_them, NAMES] += 100.0
    before, after = (one_split(0, table=t, names=NAMES, settings=settings_of()).predictions for t in (table, changed))
    others = before["subject"] != one_of_them
    pd.testing.assert_frame_equal(before[others], after[others])
    assert not before[~others].equals(after[~others])


# --- baselines -----------------------------------------------------------------------------------------------------


def test_baselines_pass_through_the_same_splits_and_are_what_they_say():
    table = with_measures(cohort(per_grade=20))
    found = one_split(0, table=table, names=NAMES, settings=settings_of()).predictions
    scores = score_splits(found)
    within = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")].set_index("model")
    assert set(within.index) == {"lr", "chance", "body", "jsw"}
    assert within.loc["chance", "auc"] == within.loc["chance", "balanced_accuracy"] == 0.5
    assert within.loc["jsw", "auc"] == 1.0
    tested = found.groupby("model")["radiograph"].agg(lambda names: tuple(sorted(set(names))))
    assert len(set(tested)) == 1


def test_chance_gives_the_shares_of_the_grades_in_training():
    table = cohort(per_grade=20)
    table = table[(table["grade"] != 2) | (table["subject"] < 30)]
    found = one_split(0, table=table, names=NAMES, settings=settings_of()).predictions
    rows = found[(found["model"] == "chance") & (found["task"] == "0 vs 2")]
    split = split_subjects(table["subject"], table["grade"], seed=0)
    training = table[table["subject"].isin(split.training) & (table["grade"] != 1)]
    assert_allclose(rows["p1"], (training["grade"] == 2).mean())


def test_a_cohort_without_measures_has_chance_alone():
    table = cohort().drop(columns=["sex", "age_years", "jsw_medial_mm"])
    assert list(baselines_of(with_measures(table), NAMES)) == ["chance"]
    assert measures_of(with_measures(table)) == ["stature_mm"]


# --- probabilities -------------------------------------------------------------------------------------------------


def told(truth: np.ndarray, p1: np.ndarray) -> pd.DataFrame:
    labels = {"task": "0 vs 2", "scenario": "within", "trained_on": "a", "tested_on": "a", "model": "lr"}
    table = pd.DataFrame({"truth": truth, "p0": 1 - p1, "p1": p1, "subject": np.arange(len(truth)), "repeat": 0})
    return table.assign(**labels, selection="l1")


@pytest.mark.parametrize(("stretch", "shift"), [(1.0, 0.0), (2.0, 0.0), (1.0, 1.0)])
def test_calibration_finds_the_slope_and_intercept_that_were_put_in(stretch, shift):
    rng = np.random.default_rng(0)
    logit = 1.5 * rng.normal(size=20_000)
    truth = (rng.random(20_000) < expit(logit)).astype(int)
    row = calibration(told(truth, expit(stretch * logit + shift))).iloc[0]
    # Standard errors of logistic regression on 20000 rows are below 0.025; bound at 4.
    assert row["slope"] == pytest.approx(1 / stretch, abs=0.1)
    assert row["intercept"] == pytest.approx(-shift / stretch, abs=0.1)
    if stretch == 1 and shift == 0:
        p1 = expit(logit)
        assert row["brier"] == pytest.approx((p1 * (1 - p1)).mean(), abs=4 * 0.25 / np.sqrt(20_000))
        curve = reliability_curve(told(truth, p1))
        spread = 0.5 / np.sqrt(curve["predictions"])
        assert ((curve["mean_probability"] - curve["observed_share"]).abs() < 4 * spread).all()
        assert curve["predictions"].sum() == 20_000


@pytest.mark.parametrize("p1", [np.array([0.1, 0.2, 0.8, 0.9]), np.full(4, 0.5), np.array([0.0, 0.0, 1.0, 1.0])])
def test_a_slope_that_is_not_finite_is_undefined(p1):
    row = calibration(told(np.array([0, 0, 1, 1]), p1)).iloc[0]
    assert np.isnan(row["slope"])
    assert row["brier"] == pytest.approx(((p1 - [0, 0, 1, 1]) ** 2).mean())


def test_confusion_counts_every_prediction_of_every_split():
    both = [told(np.array([0, 0, 1]), np.array([0.2, 0.7, 0.9])).assign(repeat=repeat) for repeat in (0, 1)]
    table = confusions(pd.concat(both, ignore_index=True)).set_index(["true_grade", "predicted_grade"])["count"]
    assert table.to_dict() == {(0, 0): 2, (0, 2): 2, (2, 0): 0, (2, 2): 2}


# --- importance and models -----------------------------------------------------------------------------------------


def fitted(model: str, table: pd.DataFrame):
    X, y = table[NAMES], (table["grade"] == 2).astype(int).to_numpy()
    return tune(preparation("l1", rho=0.9, most=5, seed=0).fit(X, y), model, (X, y), (X, y), seed=0), X, y


def test_shuffling_what_a_model_leans_on_costs_auc_and_shuffling_noise_does_not():
    table = cohort(per_grade=20)
    found, X, y = fitted("lr", table)
    drops = permuted(found.pipeline, X, y, seed=2**40)
    assert max(drops, key=drops.get) == "signal"
    assert drops["signal"] > 0.2
    assert all(abs(drop) < 0.1 for name, drop in drops.items() if name != "signal")
    assert permuted(found.pipeline, X, np.zeros(len(X), int), seed=0) == {}


@pytest.mark.parametrize("model", ["lr", "rf", "xgb"])
def test_a_saved_model_gives_the_same_probabilities_to_the_last_bit_and_the_same_bytes(model):
    table = cohort()
    found, X, _ = fitted(model, table)
    content = dumps(found.pipeline)
    assert content == dumps(fitted(model, table)[0].pipeline)
    again = loads(content)
    holes = X.copy()
    holes.iloc[:3] = np.nan
    for features in (X, holes):
        probability = again.predict_proba(features[list(again[0].feature_names_in_)])
        np.testing.assert_array_equal(probability, found.pipeline.predict_proba(features))
    assert b"pickle" not in content


def test_a_file_with_another_type_in_it_is_not_loaded():
    import skops.io

    class Other:
        pass

    with pytest.raises(TypeError, match="Other"):
        loads(skops.io.dumps(Other()))
