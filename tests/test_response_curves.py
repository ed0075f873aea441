"""Check response curves of synthetic cohorts with known results at every step."""

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


def find_step_value(axis: str, turn: int) -> float:
    return PROTOCOL_AXES[axis].steps[turn - 1]


def make_cohort(
    seed: int = 0, subjects: int = 80, curved: int = 32, noise: float = 0.25
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Make a cohort with grades 0 and 2, and repeat some knees at every dose with noise of variance 1/dose."""
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
        parts.append(part.assign(kind="dose", repeat_index=turn))
    return base, pd.concat(parts, ignore_index=True)


def test_grades_3_and_4_form_one_class():
    base, steps = make_cohort()
    for table in (base, steps):
        table["grade"] = np.where(table["grade"] == 0, 0, np.where(table["knee"] % 4 == 1, 3, 4))
    doubtful = base.assign(knee=base["knee"] + 1000, subject=base["subject"] + 1000, grade=1)
    splits = evaluate_response_curves(pd.concat([base, doubtful]), steps, NAMES, SETTINGS, Execution())
    own = splits[splits["step_index"] == 7]
    # Each class has 8 of the 16 test subjects; grade 0 against grade 3 alone would have 12.
    assert set(own["test_subjects"]) == {16}
    assert set(own["test_rarest"]) == {8}
    assert set(own["training_subjects"] + own["test_subjects"]) <= set(range(64, 80))
    # The AUC of classes with means 2.4 SD apart is 0.955.
    assert own["auc"].mean() == pytest.approx(norm.cdf(2.4 / np.sqrt(2 * (1 + 0.25**2))), abs=0.05)


@pytest.fixture(scope="module")
def curves():
    base, steps = make_cohort()
    feature_curves = response_curve_statistics.compute_feature_curves(
        base, steps, NAMES, find_step_value, replicates=200, seed=0
    )
    model_curves = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), find_step_value
    )
    return feature_curves, model_curves


def select_curve(table: pd.DataFrame, measure: str, feature: str = "") -> pd.DataFrame:
    return table[(table["measure"] == measure) & (table["feature"] == feature)].set_index("step_index")


def test_feature_curves_contain_the_shift_and_the_icc(curves):
    table = curves[0].table
    shift = select_curve(table, response_curve_statistics.SHIFT, "glcm_signal")
    spread = make_cohort()[0]["glcm_signal"].std(ddof=1)
    assert_allclose(shift["value"], 0.3 * np.log2(PROTOCOL_AXES["dose"].steps) / spread, atol=0.4)
    assert (shift["low"] < shift["value"]).all()
    agreement = select_curve(table, response_curve_statistics.ICC, "glcm_signal")["value"]
    assert agreement[7] > 0.95
    assert agreement[1] < 0.6
    steady = select_curve(table, response_curve_statistics.ICC, "glcm_steady")
    assert_allclose(steady["value"], 1.0)
    assert_allclose(select_curve(table, response_curve_statistics.SHIFT, "glcm_steady")["value"], 0.0, atol=1e-12)


def test_bootstrap_subjects_are_the_same_at_every_step():
    base, steps = make_cohort(noise=1e-6)
    steps = steps.assign(glcm_other=steps["glcm_other"] + np.random.default_rng(7).normal(size=len(steps)))
    known = ["glcm_other"]

    def compute_medians(table):
        return response_curve_statistics.compute_feature_curves(
            base, table, known, find_step_value, replicates=400, seed=0
        ).median_icc_samples

    one, other = (
        compute_medians(steps[~((steps["repeat_index"] == turn) & (steps["knee"] == 3 * turn))]) for turn in (1, 2)
    )
    every = compute_medians(steps)
    assert every.keys() == one.keys() == other.keys()
    for turn in range(1, 8):
        unchanged = [np.array_equal(table["dose", turn], every["dose", turn]) for table in (one, other)]
        assert unchanged == [turn != 1, turn != 2]
    # Omitting one of 32 knees hardly changes the ICC of a bootstrap sample; other subjects would change it strongly.
    for table, turn in ((one, 1), (other, 2)):
        assert np.corrcoef(table["dose", turn][1:], every["dose", turn][1:])[0, 1] > 0.9


def test_noise_reduces_the_auc_and_a_shift_changes_the_threshold(curves):
    table = curves[1]
    auc, odds = (
        select_curve(table, response_curve_statistics.AUC)["value"],
        select_curve(table, response_curve_statistics.ODDS),
    )
    assert auc[7] > 0.9
    assert auc[1] < auc[7] - 0.1
    assert np.corrcoef(odds["value"], np.log2(PROTOCOL_AXES["dose"].steps))[0, 1] > 0.95
    assert odds.loc[1, "high"] < 0
    assert abs(odds.loc[7, "value"]) < 0.5


def test_the_breakpoint_of_a_conclusion_has_an_interval(curves):
    breaks = breakpoints.find_breakpoints(*curves, DOSE, 0.05).set_index("conclusion")
    assert set(breaks["side"]) == {"below"}
    stable = breaks.loc[breakpoints.STABILITY_CONCLUSION]
    # The median of three features is the noisy feature without trend; its ICC is 0.9 at the true breakpoint.
    assert stable["low"] <= stable["value"] <= stable["high"]
    assert stable["low"] < 0.25**2 / (2 * (1 / 0.9 - 1)) < stable["high"]
    auc = breaks.loc["AUC falls by at most 0.05"]
    assert 1 / 64 < auc["value"] < 1
    assert auc["low"] <= auc["value"] <= auc["high"]
    assert auc["result"].startswith("below 0.")


def test_a_conclusion_that_holds_at_every_step_has_no_breakpoint():
    base, steps = make_cohort(noise=1e-6)
    steps["glcm_signal"] = np.tile(base["glcm_signal"].iloc[:32], 7)
    feature_curves = response_curve_statistics.compute_feature_curves(
        base, steps, NAMES, find_step_value, replicates=100, seed=0
    )
    model_curves = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), find_step_value
    )
    breaks = breakpoints.find_breakpoints(feature_curves, model_curves, DOSE, 0.05)
    assert (breaks["value"] == 0).all()
    assert breaks["result"].str.startswith("holds to 0.0156").all()


def test_the_loss_of_an_auc_at_chance_level_is_not_decidable():
    base, steps = make_cohort()
    rng = np.random.default_rng(4)
    base, steps = (table.assign(glcm_signal=rng.normal(size=len(table))) for table in (base, steps))
    model_curves = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), find_step_value
    )
    feature_curves = response_curve_statistics.compute_feature_curves(
        base, steps, NAMES, find_step_value, replicates=100, seed=0
    )
    breaks = breakpoints.find_breakpoints(feature_curves, model_curves, DOSE, 0.05).set_index("conclusion")
    assert breaks.loc["AUC falls by at most 0.05", "result"] == "not decidable"
    assert breaks.loc[breakpoints.STABILITY_CONCLUSION, "result"] != "not decidable"


def test_response_curves_do_not_depend_on_the_type_of_identifiers(curves):
    tables = [
        table.assign(**{name: table[name].map("P{:02d}".format) for name in ("subject", "knee")})
        for table in make_cohort()
    ]
    found = response_curve_statistics.compute_feature_curves(*tables, NAMES, find_step_value, replicates=200, seed=0)
    pd.testing.assert_frame_equal(found.table, curves[0].table)


def test_few_test_knees_leave_every_conclusion_undecided():
    base, steps = make_cohort(curved=4)
    model_curves = response_curve_statistics.compute_model_curves(
        evaluate_response_curves(base, steps, NAMES, SETTINGS, Execution()), find_step_value
    )
    feature_curves = response_curve_statistics.compute_feature_curves(
        base, steps, NAMES, find_step_value, replicates=100, seed=0
    )
    assert set(breakpoints.find_breakpoints(feature_curves, model_curves, DOSE, 0.05)["result"]) == {"not decidable"}


def test_a_loss_is_undecided_with_too_few_test_subjects_of_a_class(curves):
    feature_curves, model_curves = curves
    few = model_curves.assign(rarest=model_curves["rarest"].where(model_curves["step_index"] > 2, 2))
    breaks = breakpoints.find_breakpoints(feature_curves, few, DOSE, 0.05).set_index("conclusion")
    assert breaks.loc["AUC falls by at most 0.05", "result"] == "not decidable"
    assert breaks.loc[breakpoints.STABILITY_CONCLUSION, "result"] != "not decidable"


def test_all_test_subjects_have_response_curves_and_none_is_in_training():
    base, steps = make_cohort()
    curved = sorted(set(steps["subject"]))
    halves = split_curve_subjects(base, curved, 0, 3)
    assert not set(halves.test) & {*halves.training, *halves.validation}
    assert set(halves.test) < set(curved)
    assert len(halves.test) == 16
    assert {*halves.test, *halves.training, *halves.validation} == set(base["subject"])
    assert halves != split_curve_subjects(base, curved, 0, 4)


@pytest.mark.slow
def test_auc_intervals_have_nominal_coverage_for_repeated_halves():
    """Use a marker without training and with known AUC; curve knees and test subjects are selected at random."""
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
                "axis": "dose", "step_index": 1, "training_subjects": len(halves.training), "curved": 24,
                "test_subjects": len(halves.test), "test_rarest": 6, "auc": score, "auc_own": score, "shift": 0.0,
            })  # fmt: skip
        splits = pd.DataFrame(rows)
        found = select_curve(
            response_curve_statistics.compute_model_curves(splits, find_step_value), response_curve_statistics.AUC
        ).loc[1]
        held += found["low"] <= truth <= found["high"]
        narrow = estimate_proportion(splits["auc"].to_numpy(), average_test_train_ratio(splits))
        held_by_trained += narrow.low <= truth <= narrow.high
    assert held >= binom.ppf(0.001, cohorts, 0.95)
    assert held_by_trained < binom.ppf(0.001, cohorts, 0.85)


def simulate_breakpoint(cohort: int, curved: int, distance: float, noise: float, difference: float) -> pd.Series:
    """Estimate the breakpoint of an AUC along the dose axis in a cohort of 100, for a marker without training."""
    rng, positive = np.random.default_rng([1, cohort]), np.arange(100) % 2 == 1
    base = pd.DataFrame({"subject": range(100), "grade": 2 * positive})
    marker = rng.normal(size=100) + distance * positive
    at_dose = [marker + noise / np.sqrt(dose) * rng.normal(size=100) for dose in PROTOCOL_AXES["dose"].steps]
    rows = []
    for repeat in range(20):
        halves = split_curve_subjects(base, list(range(curved)), cohort, repeat)
        tested = np.array(halves.test)
        counts = {
            "training_subjects": len(halves.training),
            "curved": curved,
            "test_subjects": len(tested),
            "shift": 0.0,
        }
        counts["test_rarest"] = min(int(positive[tested].sum()), int((~positive[tested]).sum()))
        counts["auc_own"] = auc(positive[tested], marker[tested])
        for turn, values in enumerate(at_dose, start=1):
            rows.append(counts | {"axis": "dose", "step_index": turn, "auc": auc(positive[tested], values[tested])})
    model_curves = response_curve_statistics.compute_model_curves(pd.DataFrame(rows), find_step_value)
    no_features = response_curve_statistics.FeatureCurves(pd.DataFrame(columns=response_curve_statistics.COLUMNS), {})
    return breakpoints.find_breakpoints(no_features, model_curves, DOSE, difference).iloc[0]


def count_covering_intervals(
    cohorts: int, curved: int, distance: float, noise: float, difference: float
) -> tuple[int, int]:
    """Count cohorts whose interval contains the true breakpoint of the AUC, and cohorts whose interval misses it."""

    def compute_margin(log_dose: float) -> float:
        lost = norm.cdf(distance / np.sqrt(2)) - norm.cdf(distance / np.sqrt(2 * (1 + noise**2 / np.exp(log_dose))))
        return difference - lost

    truth = np.exp(brentq(compute_margin, np.log(1 / 64), 0.0))
    rows = [simulate_breakpoint(cohort, curved, distance, noise, difference) for cohort in range(cohorts)]
    held = [row["low"] <= truth <= row["high"] for row in rows if row["result"] != "not decidable"]
    return sum(held), len(held) - sum(held)


def test_breakpoint_intervals_of_an_auc_have_nominal_coverage():
    held, missed = count_covering_intervals(60, 24, 2.4, 0.5, 0.05)
    assert held + missed > 40
    assert held >= binom.ppf(0.01, held + missed, 0.95)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("curved", "distance", "noise", "difference"),
    [(24, 1.5, 0.5, 0.05), (24, 2.4, 0.5, 0.05), (24, 1.5, 0.2236, 0.05), (48, 1.5, 0.5, 0.05), (24, 1.5, 0.5, 0.1)],
)
def test_breakpoint_intervals_have_coverage_for_few_and_many_knees(curved, distance, noise, difference):
    held, missed = count_covering_intervals(300, curved, distance, noise, difference)
    assert held + missed > 200
    assert held >= binom.ppf(0.001, held + missed, 0.95)


@pytest.mark.parametrize(
    ("margin", "crossing"),
    [([1, 1, 1], -np.inf), ([1, -1, -1], 1.5), ([1, 1, -3], 0.75), ([-1, 1, 1], 2.0), ([1, np.nan, -1], 2.0)],
)
def test_the_first_crossing_along_the_steps_is_detected(margin, crossing):
    assert response_curve_statistics.find_first_crossing(np.array([2.0, 1.0, 0.0]), np.array(margin, float)) == crossing


def test_steps_are_ordered_outwards_from_the_protocol_value():
    assert breakpoints._order_steps(PROTOCOL_AXES["tilt"]) == {"below": [4, 3, 2, 1], "above": [4, 5, 6, 7]}
    assert list(breakpoints._order_steps(PROTOCOL_AXES["dose"])) == ["below"]
    assert list(breakpoints._order_steps(PROTOCOL_AXES["scatter"])) == ["above"]


def test_the_report_has_a_figure_per_axis_and_a_row_per_conclusion(curves):
    feature_curves, model_curves = curves
    breaks = breakpoints.find_breakpoints(*curves, DOSE, 0.05)
    table = pd.concat([feature_curves.table, model_curves], ignore_index=True)
    section = make_response_curves_section({"curve_dose": table}, breaks, DOSE, NAMES[:2], 32, "0 vs 2")
    assert [picture.name for picture in section.pictures] == ["curve_dose"]
    assert section.pictures[0].png.startswith(b"\x89PNG")
    assert len(section.table) == 2
