"""Response curves of made-up cohorts, whose answer is known at every step."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.stats import binom, norm

from pssf.core.processes.execution import Execution
from pssf.study import StudySettings
from pssf.study.design.response_curve_design import PROTOCOL_AXES
from pssf.study.learn.response_curves import evaluate_response_curves, split_curve_subjects
from pssf.study.report.report_sections import make_response_curves_section
from pssf.study.statistics.analyses import breakpoints, response_curve_statistics
from pssf.study.statistics.analyses.incremental_value_scores import average_test_train_ratio
from pssf.study.statistics.scores.confidence_intervals import estimate_proportion
from pssf.study.statistics.scores.metrics import auc

NAMES = ["glcm_signal", "glcm_steady", "glcm_other"]
SETTINGS = StudySettings(repeats=8, selections=("l1",), models=("lr",))
DOSE = {"dose": PROTOCOL_AXES["dose"]}


def step(axis: str, turn: int) -> float:
    return PROTOCOL_AXES[axis].steps[turn - 1]


def made(seed: int = 0, subjects: int = 80, curved: int = 32, noise: float = 0.25) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A cohort of grades 0 and 2, and knees of it along the dose: noise of variance 1/dose on what tells."""
    rng = np.random.default_rng(seed)
    grade = 2 * (np.arange(subjects) % 2)
    base = pd.DataFrame({"knee": range(subjects), "subject": range(subjects), "grade": grade})
    base["glcm_signal"] = 1.2 * grade + rng.normal(size=subjects)
    base["glcm_steady"], base["glcm_other"] = rng.normal(size=(2, subjects))
    parts = []
    for turn, dose in enumerate(PROTOCOL_AXES["dose"].steps, start=1):
        part = base.iloc[:curved].copy()
        part["glcm_signal"] += noise / np.sqrt(dose) * rng.normal(size=curved) + 0.3 * np.log2(dose)
        part["glcm_other"] += noise / np.sqrt(dose) * rng.normal(size=curved)
        parts.append(part.assign(kind="dose", turn=turn))
    return base, pd.concat(parts, ignore_index=True)


def test_grades_3_and_4_are_one_class():
    base, steps = made()
    for table in (base, steps):
        table["grade"] = np.where(table["grade"] == 0, 0, np.where(table["knee"] % 4 == 1, 3, 4))
    doubtful = base.assign(knee=base["knee"] + 1000, subject=base["subject"] + 1000, grade=1)
    splits = evaluate_response_curves(pd.concat([base, doubtful]), steps, NAMES, SETTINGS, Execution())
    own = splits[splits["turn"] == 7]
    # Of 16 tested, 8 are of either class, whichever the grade; 0 against 3 alone would be of 12 of them.
    assert set(own["test_subjects"]) == {16}
    assert set(own["test_rarest"]) == {8}
    assert set(own["trained"] + own["test_subjects"]) <= set(range(64, 80))
    # Of knees 2.4 deviations apart, learnt: 0.955.
    assert own["auc"].mean() == pytest.approx(norm.cdf(2.4 / np.sqrt(2 * (1 + 0.25**2))), abs=0.05)


@pytest.fixture(scope="module")
def answered():
    base, steps = made()
    of_features = response_curve_statistics.compute_feature_curves(base, steps, NAMES, step, replicates=200, seed=0)
    of_models = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), step
    )
    return of_features, of_models


def at(table: pd.DataFrame, measure: str, feature: str = "") -> pd.DataFrame:
    return table[(table["measure"] == measure) & (table["feature"] == feature)].set_index("turn")


def test_a_feature_is_followed_in_value_and_in_icc(answered):
    table = answered[0].table
    shift = at(table, response_curve_statistics.SHIFT, "glcm_signal")
    spread = made()[0]["glcm_signal"].std(ddof=1)
    assert_allclose(shift["value"], 0.3 * np.log2(PROTOCOL_AXES["dose"].steps) / spread, atol=0.4)
    assert (shift["low"] < shift["value"]).all()
    agreement = at(table, response_curve_statistics.ICC, "glcm_signal")["value"]
    assert agreement[7] > 0.95
    assert agreement[1] < 0.6
    steady = at(table, response_curve_statistics.ICC, "glcm_steady")
    assert_allclose(steady["value"], 1.0)
    assert_allclose(at(table, response_curve_statistics.SHIFT, "glcm_steady")["value"], 0.0, atol=1e-12)


def test_a_sample_is_of_the_same_subjects_at_every_step_whoever_lacks_a_region_at_one():
    base, steps = made(noise=1e-6)
    steps = steps.assign(glcm_other=steps["glcm_other"] + np.random.default_rng(7).normal(size=len(steps)))
    known = ["glcm_other"]

    def medians(table):
        return response_curve_statistics.compute_feature_curves(
            base, table, known, step, replicates=400, seed=0
        ).median_icc_samples

    one, other = (medians(steps[~((steps["turn"] == turn) & (steps["knee"] == 3 * turn))]) for turn in (1, 2))
    every = medians(steps)
    assert every.keys() == one.keys() == other.keys()
    for turn in range(1, 8):
        at_one = [np.array_equal(table["dose", turn], every["dose", turn]) for table in (one, other)]
        assert at_one == [turn != 1, turn != 2]
    # With one of 32 knees away a sample's ICC is nearly what it was; of other subjects it would be another sample's.
    for table, turn in ((one, 1), (other, 2)):
        assert np.corrcoef(table["dose", turn][1:], every["dose", turn][1:])[0, 1] > 0.9


def test_a_model_loses_by_noise_and_its_threshold_moves_by_the_shift(answered):
    table = answered[1]
    auc, odds = at(table, response_curve_statistics.AUC)["value"], at(table, response_curve_statistics.ODDS)
    assert auc[7] > 0.9
    assert auc[1] < auc[7] - 0.1
    assert np.corrcoef(odds["value"], np.log2(PROTOCOL_AXES["dose"].steps))[0, 1] > 0.95
    assert odds.loc[1, "high"] < 0
    assert abs(odds.loc[7, "value"]) < 0.5


def test_the_dose_below_which_a_conclusion_breaks_is_read_off_with_an_interval(answered):
    places = breakpoints.find_breakpoints(*answered, DOSE, 0.05).set_index("conclusion")
    assert set(places["side"]) == {"below"}
    stable = places.loc[breakpoints.STABILITY_CONCLUSION]
    # The median of three features is the noisy one that has no trend: ICC = 1/(1 + noise variance/2) = 0.9.
    assert stable["low"] <= stable["value"] <= stable["high"]
    assert stable["low"] < 0.25**2 / (2 * (1 / 0.9 - 1)) < stable["high"]
    auc = places.loc["AUC falls by at most 0.05"]
    assert 1 / 64 < auc["value"] < 1
    assert auc["low"] <= auc["value"] <= auc["high"]
    assert auc["reading"].startswith("below 0.")


def test_a_conclusion_that_never_breaks_is_not_given_a_place():
    base, steps = made(noise=1e-6)
    steps["glcm_signal"] = np.tile(base["glcm_signal"].iloc[:32], 7)
    of_features = response_curve_statistics.compute_feature_curves(base, steps, NAMES, step, replicates=100, seed=0)
    of_models = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), step
    )
    places = breakpoints.find_breakpoints(of_features, of_models, DOSE, 0.05)
    assert (places["value"] == 0).all()
    assert places["reading"].str.startswith("holds to 0.0156").all()


def test_an_auc_that_is_not_above_chance_has_nothing_to_lose():
    base, steps = made()
    rng = np.random.default_rng(4)
    base, steps = (table.assign(glcm_signal=rng.normal(size=len(table))) for table in (base, steps))
    of_models = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), step
    )
    of_features = response_curve_statistics.compute_feature_curves(base, steps, NAMES, step, replicates=100, seed=0)
    places = breakpoints.find_breakpoints(of_features, of_models, DOSE, 0.05).set_index("conclusion")
    assert places.loc["AUC falls by at most 0.05", "reading"] == "not decidable"
    assert places.loc[breakpoints.STABILITY_CONCLUSION, "reading"] != "not decidable"


def test_curves_of_subjects_and_knees_called_by_texts_are_those_of_numbers(answered):
    tables = [
        table.assign(**{name: table[name].map("P{:02d}".format) for name in ("subject", "knee")}) for table in made()
    ]
    found = response_curve_statistics.compute_feature_curves(*tables, NAMES, step, replicates=200, seed=0)
    pd.testing.assert_frame_equal(found.table, answered[0].table)


def test_few_tested_knees_decide_nothing():
    base, steps = made(curved=4)
    of_models = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), step
    )
    of_features = response_curve_statistics.compute_feature_curves(base, steps, NAMES, step, replicates=100, seed=0)
    assert set(breakpoints.find_breakpoints(of_features, of_models, DOSE, 0.05)["reading"]) == {"not decidable"}


def test_a_loss_is_not_decided_where_too_few_of_a_class_are_tested(answered):
    of_features, of_models = answered
    few = of_models.assign(rarest=of_models["rarest"].where(of_models["turn"] > 2, 2))
    places = breakpoints.find_breakpoints(of_features, few, DOSE, 0.05).set_index("conclusion")
    assert places.loc["AUC falls by at most 0.05", "reading"] == "not decidable"
    assert places.loc[breakpoints.STABILITY_CONCLUSION, "reading"] != "not decidable"


def test_no_subject_is_tested_and_learnt_from_and_only_those_with_curves_are_tested():
    base, steps = made()
    curved = sorted(set(steps["subject"]))
    halves = split_curve_subjects(base, curved, 0, 3)
    assert not set(halves.test) & {*halves.training, *halves.validation}
    assert set(halves.test) < set(curved)
    assert len(halves.test) == 16
    assert {*halves.test, *halves.training, *halves.validation} == set(base["subject"])
    assert halves != split_curve_subjects(base, curved, 0, 4)


def test_intervals_hold_a_models_auc_though_halves_of_few_knees_are_tested_again_and_again():
    """A marker that needs no training: its AUC is known, and chance is whose knees have curves and who is tested."""
    distance, cohorts, rng = 1.5, 200, np.random.default_rng(0)
    truth, held, held_by_trained = norm.cdf(distance / np.sqrt(2)), 0, 0
    base = pd.DataFrame({"subject": range(100), "grade": 2 * (np.arange(100) % 2)})
    for cohort in range(cohorts):
        marker = rng.normal(size=100) + distance * (base["grade"] == 2)
        rows = []
        for repeat in range(20):
            halves = split_curve_subjects(base, list(range(24)), cohort, repeat)
            tested = base["subject"].isin(halves.test)
            score = auc((base["grade"] == 2)[tested].to_numpy(), marker[tested].to_numpy())
            rows.append({
                "axis": "dose", "turn": 1, "trained": len(halves.training), "curved": 24,
                "test_subjects": len(halves.test), "test_rarest": 6, "auc": score, "auc_own": score, "shift": 0.0,
            })  # fmt: skip
        splits = pd.DataFrame(rows)
        found = at(response_curve_statistics.compute_model_curves(splits, step), response_curve_statistics.AUC).loc[1]
        held += found["low"] <= truth <= found["high"]
        narrow = estimate_proportion(splits["auc"].to_numpy(), average_test_train_ratio(splits))
        held_by_trained += narrow.low <= truth <= narrow.high
    assert held >= binom.ppf(0.001, cohorts, 0.95)
    assert held_by_trained < binom.ppf(0.001, cohorts, 0.85)


def broken(cohort: int, curved: int, distance: float, noise: float, difference: float) -> pd.Series:
    """Where an AUC breaks along the dose, as read off one cohort of 100 by a marker that needs no training."""
    rng, positive = np.random.default_rng([1, cohort]), np.arange(100) % 2 == 1
    base = pd.DataFrame({"subject": range(100), "grade": 2 * positive})
    marker = rng.normal(size=100) + distance * positive
    at_dose = [marker + noise / np.sqrt(dose) * rng.normal(size=100) for dose in PROTOCOL_AXES["dose"].steps]
    rows = []
    for repeat in range(20):
        halves = split_curve_subjects(base, list(range(curved)), cohort, repeat)
        tested = np.array(halves.test)
        counts = {"trained": len(halves.training), "curved": curved, "test_subjects": len(tested), "shift": 0.0}
        counts["test_rarest"] = min(int(positive[tested].sum()), int((~positive[tested]).sum()))
        counts["auc_own"] = auc(positive[tested], marker[tested])
        for turn, values in enumerate(at_dose, start=1):
            rows.append(counts | {"axis": "dose", "turn": turn, "auc": auc(positive[tested], values[tested])})
    of_models = response_curve_statistics.compute_model_curves(pd.DataFrame(rows), step)
    nothing = response_curve_statistics.FeatureCurves(pd.DataFrame(columns=response_curve_statistics.COLUMNS), {})
    return breakpoints.find_breakpoints(nothing, of_models, DOSE, difference).iloc[0]


def share_held(cohorts: int, curved: int, distance: float, noise: float, difference: float) -> tuple[int, int]:
    """In how many cohorts an interval holds the dose where the AUC has lost a difference, and in how many not."""

    def margin(log_dose: float) -> float:
        lost = norm.cdf(distance / np.sqrt(2)) - norm.cdf(distance / np.sqrt(2 * (1 + noise**2 / np.exp(log_dose))))
        return difference - lost

    truth = np.exp(brentq(margin, np.log(1 / 64), 0.0))
    rows = [broken(cohort, curved, distance, noise, difference) for cohort in range(cohorts)]
    held = [row["low"] <= truth <= row["high"] for row in rows if row["reading"] != "not decidable"]
    return sum(held), len(held) - sum(held)


def test_an_interval_of_where_an_auc_breaks_holds_the_place():
    held, missed = share_held(60, 24, 2.4, 0.5, 0.05)
    assert held + missed > 40
    assert held >= binom.ppf(0.01, held + missed, 0.95)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("curved", "distance", "noise", "difference"),
    [(24, 1.5, 0.5, 0.05), (24, 2.4, 0.5, 0.05), (24, 1.5, 0.2236, 0.05), (48, 1.5, 0.5, 0.05), (24, 1.5, 0.5, 0.1)],
)
def test_intervals_of_where_an_auc_breaks_hold_the_place_for_few_and_many_knees(curved, distance, noise, difference):
    held, missed = share_held(300, curved, distance, noise, difference)
    assert held + missed > 200
    assert held >= binom.ppf(0.001, held + missed, 0.95)


@pytest.mark.parametrize(
    ("margin", "place"),
    [([1, 1, 1], -np.inf), ([1, -1, -1], 1.5), ([1, 1, -3], 0.75), ([-1, 1, 1], 2.0), ([1, np.nan, -1], 2.0)],
)
def test_a_crossing_is_the_first_on_the_way(margin, place):
    assert response_curve_statistics.find_first_crossing(np.array([2.0, 1.0, 0.0]), np.array(margin, float)) == place


def test_both_sides_of_the_protocols_own_step_are_followed():
    assert breakpoints._order_steps(PROTOCOL_AXES["tilt"]) == {"below": [4, 3, 2, 1], "above": [4, 5, 6, 7]}
    assert list(breakpoints._order_steps(PROTOCOL_AXES["dose"])) == ["below"]
    assert list(breakpoints._order_steps(PROTOCOL_AXES["scatter"])) == ["above"]


def test_the_report_has_a_picture_an_axis_and_a_row_a_conclusion(answered):
    of_features, of_models = answered
    places = breakpoints.find_breakpoints(*answered, DOSE, 0.05)
    table = pd.concat([of_features.table, of_models], ignore_index=True)
    section = make_response_curves_section({"curve_dose": table}, places, DOSE, NAMES[:2], 32, "0 vs 2")
    assert [picture.name for picture in section.pictures] == ["curve_dose"]
    assert section.pictures[0].png.startswith(b"\x89PNG")
    assert len(section.table) == 2
