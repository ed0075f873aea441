"""The study: splits, selection, scenarios, reliability, report."""

import hashlib
import importlib.util
import re
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pingouin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter
from sklearn.metrics import balanced_accuracy_score, f1_score, roc_auc_score

from pssf import study
from pssf.core.checks import InputError
from pssf.io.results import load_table
from pssf.radiomics.region import Template
from pssf.radiomics.table import TEXT
from pssf.study import StudySettings
from pssf.study.learn.models import tune
from pssf.study.learn.saving import loads
from pssf.study.learn.scenarios import one_split, score_splits
from pssf.study.learn.selection import SELECTIONS, Prune, is_degenerate, preparation
from pssf.study.learn.split import split_subjects
from pssf.study.report.cost import Meter
from pssf.study.statistics import metrics
from pssf.study.statistics.localisation import errors, summarise
from pssf.study.statistics.reliability import count_stable, icc, reliability

PROTOCOLS = ("reference", "low_dose", "geometry_shift")


# --- split ---------------------------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(
    counts=st.tuples(*[st.integers(3, 30)] * 3),
    knees=st.integers(1, 2),
    seed=st.integers(0, 2**63 - 1),
    repeat=st.integers(0, 20),
)
def test_no_subject_is_in_two_parts_and_every_grade_is_in_every_part(counts, knees, seed, repeat):
    grades = np.repeat([0, 1, 2], counts)
    subjects = np.arange(len(grades))
    split = split_subjects(np.repeat(subjects, knees), np.repeat(grades, knees), seed=seed, repeat=repeat)
    parts = [split.training, split.validation, split.test]
    assert_array_equal(np.sort(np.concatenate(parts)), subjects)
    for part in parts:
        assert set(grades[part]) == {0, 1, 2}
    assert len(split.training) >= 0.5 * len(subjects) - 3


def test_a_split_depends_on_seed_and_repeat_and_not_on_the_order_of_rows():
    subjects, grades = np.arange(40), np.arange(40) % 3
    order = np.random.default_rng(0).permutation(40)
    first = split_subjects(subjects, grades, seed=5, repeat=1)
    assert_array_equal(first.test, split_subjects(subjects[order], grades[order], seed=5, repeat=1).test)
    assert set(first.test) != set(split_subjects(subjects, grades, seed=5, repeat=2).test)
    assert set(first.test) != set(split_subjects(subjects, grades, seed=6, repeat=1).test)


def test_a_split_of_two_hundred_subjects_is_seventy_fifteen_fifteen():
    split = split_subjects(np.arange(200), np.zeros(200, int), seed=0)
    assert [len(split.training), len(split.validation), len(split.test)] == [140, 30, 30]


def test_too_few_subjects_of_a_grade_are_refused():
    with pytest.raises(InputError, match="grade 1 has 2 subjects"):
        split_subjects([0, 1, 2, 3, 4], [0, 0, 0, 1, 1], seed=0)


# --- metrics -------------------------------------------------------------------------------------------------------


def test_metrics_of_four_knees_are_those_worked_out_by_hand():
    # Positives at 0.9 and 0.3, negatives at 0.2 and 0.6: three of four pairs are in order. One of each class is called.
    truth, p = np.array([1, 1, 0, 0]), np.array([0.9, 0.3, 0.2, 0.6])
    found = metrics.score(truth, np.column_stack([1 - p, p]))
    assert found == {"auc": 0.75, "balanced_accuracy": 0.5, "macro_f1": 0.5}
    assert_array_equal(metrics.confusion(truth, np.column_stack([1 - p, p])), [[1, 1], [1, 1]])


@settings(max_examples=30)
@given(classes=st.integers(2, 3), rows=st.integers(6, 40), seed=st.integers(0, 1000))
def test_metrics_equal_those_of_scikit_learn(classes, rows, seed):
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.arange(rows) % classes)
    probability = rng.dirichlet(np.ones(classes), rows).round(1) + 1e-3
    probability /= probability.sum(axis=1, keepdims=True)
    called = probability.argmax(axis=1)
    theirs = {
        "auc": roc_auc_score(truth, probability[:, 1] if classes == 2 else probability, multi_class="ovr"),
        "balanced_accuracy": balanced_accuracy_score(truth, called),
        "macro_f1": f1_score(truth, called, average="macro"),
    }
    assert metrics.score(truth, probability) == pytest.approx(theirs, abs=1e-12)


@given(seed=st.integers(0, 10**6), splits=st.integers(1, 5), levels=st.sampled_from([3, 1000]))
@settings(max_examples=30)
def test_the_area_under_the_mean_roc_curve_is_the_mean_auc_of_the_splits(seed, splits, levels):
    rng = np.random.default_rng(seed)
    split = np.repeat(np.arange(splits), 20)
    truth = np.tile(np.arange(20) % 2, splits)
    # A split's own offset, which a curve of all splits pooled would mix.
    value = np.round(rng.random(len(truth)) + 0.5 * truth, int(np.log10(levels))) + 3.0 * split
    false, true = metrics.mean_roc(truth, value, split)
    aucs = [metrics.auc(truth[split == one] == 1, value[split == one]) for one in range(splits)]
    # Each jump of a curve is spread over a step of its 400.
    assert abs(np.trapezoid(true, false) - np.mean(aucs)) < 1 / 400
    assert np.all(np.diff(true) >= 0)
    assert (false[0], true[0], false[-1], true[-1]) == (0, 0, 1, 1)


def test_splits_without_both_classes_have_no_roc_curve():
    false, true = metrics.mean_roc(np.ones(4, np.int64), np.arange(4.0), np.arange(4) % 2)
    assert len(false) == len(true) == 0


def test_a_class_that_is_not_tested_gives_no_measure():
    assert all(np.isnan(value) for value in metrics.score(np.zeros(3, int), np.full((3, 2), 0.5)).values())


# --- reliability ---------------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(
    knees=st.integers(4, 20),
    protocols=st.integers(2, 4),
    noise=st.floats(0.05, 3),
    size=st.sampled_from([1e-6, 1.0, 1e9]),
    seed=st.integers(0, 1000),
)
def test_icc_equals_that_of_pingouin(knees, protocols, noise, size, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(knees, 1)) + noise * rng.normal(size=(knees, protocols)) + rng.normal(size=protocols)
    table = pd.DataFrame(values).rename_axis(index="knee", columns="protocol").stack().rename("value").reset_index()
    theirs = pingouin.intraclass_corr(table, "knee", "protocol", "value").set_index("Type")["ICC"]
    assert_allclose(icc(size * values), [theirs["ICC(A,1)"], theirs["ICC(C,1)"]], rtol=1e-9, atol=1e-12)


def test_an_offset_between_protocols_lowers_agreement_and_not_consistency():
    values = np.arange(10.0)[:, None] + np.array([0.0, 5.0])
    agreement, consistency = icc(values)
    assert consistency == pytest.approx(1)
    assert 0 < agreement < 0.5


def test_a_feature_that_is_the_same_everywhere_has_no_icc_and_is_counted_apart():
    assert np.isnan(icc(np.full((5, 3), 7.0))).all()
    assert np.isnan(icc(1 + 1e-15 * np.arange(15.0).reshape(5, 3))).all()
    table = features(8).assign(constant=1.0)
    stable = count_stable(reliability(table, ["signal", "constant"], "reference"))
    assert list(stable["across"]) == [
        "all protocols",
        "reference and low_dose",
        "reference and geometry_shift",
    ]
    assert (stable["degenerate"] == 1).all()
    assert (stable["ICC(2,1) of"] == 1).all()


# --- selection and models ------------------------------------------------------------------------------------------


def features(per_grade: int, *, noise: float = 1.0, seed: int = 0, extra: int = 12) -> pd.DataFrame:
    """One row a radiograph: `signal` follows the grade, `copy` follows signal, n0, n1, ... are noise of the knee."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(3 * per_grade):
        grade = subject % 3
        own = rng.normal(size=extra)
        signal = grade + noise * rng.normal()
        for protocol in PROTOCOLS:
            jitter = 0.1 * rng.normal(size=extra)
            row = {"radiograph": f"{subject}_{protocol}", "knee": subject, "subject": subject, "grade": grade}
            row |= {"protocol": protocol, "signal": signal + 0.1 * rng.normal()}
            rows.append(row | {f"n{i}": own[i] + jitter[i] for i in range(extra)})
    table = pd.DataFrame(rows)
    return table.assign(copy=2 * table["signal"] + 3)


NAMES = ["signal", "copy", *[f"n{i}" for i in range(12)]]


def test_pruning_drops_constants_and_repeats_and_keeps_the_first_of_a_group():
    table = features(10)[NAMES].assign(constant=5.0, inverse=-(features(10)["n3"] ** 3))
    kept = Prune(0.9).fit(table).kept_
    assert "signal" in kept
    assert not {"copy", "constant", "inverse"} & set(kept)


def test_a_feature_that_varies_by_rounding_alone_is_degenerate():
    assert is_degenerate(np.array([1.0, 1.0 + 1e-15, 1.0 - 1e-15]))
    assert is_degenerate(np.array([1e-17, -1e-17]))
    assert is_degenerate(np.array([1.0, np.nan]))
    assert not is_degenerate(np.array([1e-6, 2e-6]))


@pytest.mark.parametrize("selection", list(SELECTIONS))
def test_a_selection_keeps_what_follows_the_grade(selection):
    table = features(20, noise=0.3)
    fitted = preparation(selection, rho=0.9, most=4, seed=0).fit(table[NAMES], table["grade"].to_numpy())
    kept = fitted.named_steps["select"].kept_
    assert "signal" in kept
    assert 1 <= len(kept) <= 4


@pytest.mark.parametrize("selection", list(SELECTIONS))
def test_features_without_anything_in_them_give_a_model_of_chance(selection):
    table = pd.DataFrame({"a": np.ones(12), "b": np.zeros(12)})
    y = np.arange(12) % 2
    prepared = preparation(selection, rho=0.9, most=4, seed=0).fit(table, y)
    fitted = tune(prepared, "lr", (table, y), (table, y), seed=0)
    assert_allclose(fitted.pipeline.predict_proba(table), 0.5, atol=1e-6)


@pytest.mark.parametrize("model", ["lr", "rf", "xgb"])
def test_importances_are_shares_and_the_signal_leads(model):
    table = features(20, noise=0.2)
    X, y = table[NAMES], table["grade"].to_numpy()
    fitted = tune(preparation("l1", rho=0.9, most=5, seed=0).fit(X, y), model, (X, y), (X, y), seed=0)
    assert sum(fitted.importance.values()) == pytest.approx(1)
    assert max(fitted.importance, key=fitted.importance.get) == "signal"


def test_without_validation_rows_the_most_cautious_parameters_are_taken():
    table = features(10)
    X, y = table[NAMES], table["grade"].to_numpy()
    fitted = tune(preparation("l1", rho=0.9, most=5, seed=0).fit(X, y), "lr", (X, y), (X[:0], y[:0]), seed=0)
    assert fitted.parameters == {"C": 0.01}


FAST = StudySettings(selections=("l1",), models=("lr", "rf"), repeats=4)


def test_test_rows_change_nothing_that_is_learnt():
    table = features(8)
    split = split_subjects(table["subject"], table["grade"], seed=0)
    changed = table.copy()
    held_out = changed["subject"].isin(split.test)
    changed.loc[held_out, NAMES] = 1e3 * np.random.default_rng(1).normal(size=(held_out.sum(), len(NAMES)))
    both = StudySettings(selections=("l1", "mrmr"), models=("lr", "rf", "xgb"))
    one, other = (one_split(0, table=t, names=NAMES, settings=both) for t in (table, changed))
    pd.testing.assert_frame_equal(one.importances, other.importances)
    assert not np.allclose(one.predictions["p0"], other.predictions["p0"])
    assert set(one.predictions["subject"]) <= set(split.test)


def test_signal_is_found_in_every_scenario_and_the_same_twice():
    table = features(10, noise=0.2)
    outcome = one_split(0, table=table, names=NAMES, settings=FAST)
    scores = score_splits(outcome.predictions)
    assert set(scores["scenario"]) == {"within", "cross", "cross_stable", "cross_harmonised", "multi"}
    models = scores[scores["selection"] != "none"]
    assert (models.loc[models["task"] == "0 vs 2", "auc"] > 0.9).all()
    pd.testing.assert_frame_equal(
        outcome.predictions, one_split(0, table=table, names=NAMES, settings=FAST).predictions
    )


def mean_auc(table: pd.DataFrame, names: list[str], model: str, repeats: int = 6) -> float:
    quick = StudySettings(selections=("l1",), models=(model,))
    outcomes = [one_split(r, table=table, names=names, settings=quick).predictions for r in range(repeats)]
    scores = score_splits(pd.concat(outcomes, ignore_index=True))
    of_model = (scores["task"] == "0 vs 2") & (scores["scenario"] == "multi") & (scores["model"] == model)
    return float(scores[of_model]["auc"].mean())


def test_permuted_labels_give_an_auc_of_a_half():
    table = features(24, noise=0.2)
    grades = np.random.default_rng(3).permutation(np.repeat([0, 1, 2], 24))
    table["grade"] = grades[table["subject"]]
    # Standard deviation of the AUC of 24 against 24 knees of chance (Hanley & McNeil 1982): sqrt((n + m + 1) / 12 n m).
    # The splits share knees, so their mean is taken to be no better than one look at all of them; four of these.
    bound = 4 * np.sqrt(49 / (12 * 24 * 24))
    assert abs(mean_auc(table, NAMES, "lr") - 0.5) < bound


def test_a_fingerprint_of_the_subject_does_not_leak_across_the_split():
    rng = np.random.default_rng(5)
    table = features(24, noise=1e9)
    table["grade"] = rng.permutation(np.repeat([0, 1, 2], 24))[table["subject"]]
    mark = rng.normal(size=(72, 3))
    for i in range(3):  # the same in all radiographs of a subject: split by radiograph, it would tell every grade
        table[f"mark{i}"] = mark[table["subject"], i]
    names = [f"mark{i}" for i in range(3)]
    assert abs(mean_auc(table, names, "rf") - 0.5) < 4 * np.sqrt(49 / (12 * 24 * 24))
    # The same study with the leak planted, each radiograph passing for a subject of its own: the mark tells nearly all.
    leaking = table.assign(subject=np.arange(len(table)))
    assert mean_auc(leaking, names, "rf", repeats=2) > 0.9


# --- localisation --------------------------------------------------------------------------------------------------


def test_errors_are_at_the_joint_plane_and_failures_are_counted():
    table = pd.DataFrame(
        {
            "protocol": ["reference"] * 3,
            "grade": [0, 0, 1],
            "status": ["found", "low score", "found"],
            "score": [0.9, 0.1, 0.8],
            "row_px": [103.0, 0.0, 100.0],
            "col_px": [204.0, 0.0, 200.0],
            "truth_medial_row_px": [100.0] * 3,
            "truth_medial_col_px": [200.0] * 3,
            "pixel_mm": [0.15] * 3,
            "sdd_mm": [1200.0] * 3,
            "sod_mm": [1000.0] * 3,
        }
    )
    found = summarise(errors(table))
    assert list(found["low_score"]) == [1, 0, 1]
    assert found["mean_px"].tolist() == [5.0, 0.0, 2.5]
    assert_allclose(found["mean_mm"], np.array([5.0, 0.0, 2.5]) * 0.15 / 1.2)


# --- the whole study -----------------------------------------------------------------------------------------------

SIZE, PIXEL_MM = 256, 0.6


def draw(grade: int, row: float, col: float, side: str, coarse: float, gain: float, seed: int) -> np.ndarray:
    """(256, 256) uint16: a limb with two blocks of bone; with the grade the gap narrows and the texture coarsens."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:SIZE, :SIZE].astype(float)
    medial = (cols - col) * (1 if side == "right" else -1) * PIXEL_MM
    up = (row - rows) * PIXEL_MM
    limb = np.clip(1 - ((medial + 20) / 62) ** 2, 0, None)
    bone = (np.abs(medial + 20) < 37 - 0.12 * np.abs(up)) & (np.abs(up) > 3.0 - 0.5 * grade + 0.08 * np.abs(medial))
    notch = (np.abs(medial + 20) < 7) & (up > 0) & (up < 16)
    field = gaussian_filter(rng.standard_normal((SIZE, SIZE)), coarse + 0.6 * grade)
    inside = gaussian_filter((bone & ~notch).astype(float), 0.8)
    signal = gain * np.exp(-2.2 * limb - inside * (0.7 + 0.05 * field / field.std()))
    signal += np.sqrt(signal) * rng.standard_normal(signal.shape)
    return np.clip(np.rint(signal), 1, 65535).astype(np.uint16)


class Cohort:
    """A manifest of 3 x `per_grade` subjects under three protocols, and pixels that are drawn when asked for."""

    def __init__(self, per_grade: int) -> None:
        rng = np.random.default_rng(11)
        self.rows = []
        for subject in range(3 * per_grade):
            place = {"side": ["right", "left"][subject % 2], "subject": subject, "knee": subject, "grade": subject % 3}
            row, col = rng.uniform(115, 140), rng.uniform(115, 140)
            for protocol in PROTOCOLS:
                name = f"s{subject:03d}_{protocol}"
                truth = {"truth_medial_row_px": row, "truth_medial_col_px": col, "pixel_mm": PIXEL_MM}
                file = {"radiograph": name, "file": name, "sha256": hashlib.sha256(name.encode()).hexdigest()}
                self.rows.append(place | truth | file | {"protocol": protocol, "sdd_mm": 1150.0, "sod_mm": 950.0})
        self.manifest = pd.DataFrame(self.rows)

    def again(self, knees: int) -> pd.DataFrame:
        """The first knees taken twice more with other noise, and twice with other noise and a little further left."""
        rows = []
        for row in [row for row in self.rows if row["protocol"] == "reference"][:knees]:
            for place, (kind, turn) in enumerate((k, t) for k in ("noise", "perturbation") for t in ("1", "2")):
                name = f"{row['radiograph']}_{kind}{turn}"
                file = {"radiograph": name, "file": name, "sha256": hashlib.sha256(name.encode()).hexdigest()}
                moved = {"truth_medial_col_px": row["truth_medial_col_px"] - 0.4 * (kind == "perturbation")}
                rows.append(
                    row | file | moved | {"kind": kind, "turn": turn, "draw": 10_000 + 10 * row["knee"] + place}
                )
        self.rows += [row for row in rows if row["radiograph"] not in {known["radiograph"] for known in self.rows}]
        return pd.DataFrame(rows)

    def load(self, file: str) -> np.ndarray:
        row = next(row for row in self.rows if row["file"] == file)
        gain = {"reference": 30000, "low_dose": 6000, "geometry_shift": 25000}[row["protocol"]]
        at = row["truth_medial_row_px"], row["truth_medial_col_px"]
        seed = row.get("draw", 100 * row["subject"] + PROTOCOLS.index(row["protocol"]))
        return draw(row["grade"], *at, row["side"], 1.0, gain, seed)


TEMPLATE = Template(pixels=draw(0, 128, 140, "right", 3.0, 60000, 0), row=128, col=140, pixel_mm=PIXEL_MM)
SMALL = StudySettings(region_px=80, bins=32, repeats=2, replicates=200, selections=("l1",), models=("lr", "rf"))


@cache
def cohort() -> Cohort:
    return Cohort(5)


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> study.StudyResult:
    out = tmp_path_factory.mktemp("study")
    again = cohort().again(3)
    meter = Meter()
    with meter.stage("cohort", "radiographs") as made:
        made(45)
    return study.run(cohort().manifest, cohort().load, [TEMPLATE], SMALL, out, again=again, meter=meter)


def test_a_study_finds_the_regions_and_tells_the_grades_apart(result):
    everything = result.localisation.iloc[-1]
    assert everything["radiographs"] == 45
    assert everything["low_score"] == everything["leaves_image"] == everything["gross"] == 0
    assert everything["mean_px"] < 2
    scores = result.scores
    within = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")]
    assert within["auc"].max() > 0.8
    assert list(result.seconds) == [
        "cohort",
        "regions and features",
        "training and testing",
        "intervals and differences",
        "reliability and figures",
        "claims",
    ]


def test_the_report_is_one_page_with_everything_in_it(result):
    page = result.report.read_text(encoding="utf-8")
    for target in re.findall(r"(?:src|href)=(\S{30}|\S+)", page):
        assert target.startswith(('"data:image/png;base64,', '"#')), target
    assert not re.search(r"<script|<link|@import|url\(|https?://", page)
    pictures = re.findall(r"<img[^>]*>", page)
    assert len(pictures) == len(result.pictures) == 7
    assert all(re.search(r'alt="[^"]{20,}"', picture) for picture in pictures)
    assert "43 of 107" in page
    for path in [*result.pictures.values(), *result.tables.values()]:
        assert path.stat().st_size > 0
    assert not [path for path in result.report.parent.rglob("*") if path.name.startswith(".")]


def test_a_second_run_measures_nothing_again_and_writes_the_same_bytes(result, tmp_path):
    (tmp_path / "features.csv").write_bytes(result.tables["features"].read_bytes())
    asked: list[str] = []

    def load(file: str) -> np.ndarray:
        asked.append(file)
        return cohort().load(file)

    again = study.run(cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, again=cohort().again(3))
    assert len(asked) == 9  # the panel's
    for name, path in result.tables.items():
        assert again.tables[name].read_bytes() == path.read_bytes(), name
    for name, path in result.pictures.items():
        assert again.pictures[name].read_bytes() == path.read_bytes(), name
    for name, path in result.models.items():
        assert again.models[name].read_bytes() == path.read_bytes(), name


def test_a_row_of_features_that_was_changed_by_hand_is_measured_again(result, tmp_path):
    lines = result.tables["features"].read_text(encoding="utf-8").splitlines(keepends=True)
    head, row = lines[0].split(","), lines[2].split(",")
    row[head.index("glcm_Contrast")] = "1.5"
    (tmp_path / "features.csv").write_text("".join([*lines[:2], ",".join(row), *lines[3:]]), encoding="utf-8")
    asked: list[str] = []

    def load(file: str) -> np.ndarray:
        asked.append(file)
        return cohort().load(file)

    path = study.measure(cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, again=cohort().again(3))
    assert len(asked) == 1
    assert path.read_text(encoding="utf-8") == "".join(lines)


def test_repeats_have_their_own_reliability_and_no_part_in_training_or_localisation(result):
    across = result.reliability.groupby("across")["knees"].max()
    assert across["repeated noise"] == across["small perturbations"] == 3
    assert across["all protocols"] == 15
    assert result.localisation.iloc[-1]["radiographs"] == 45
    tested = set(pd.read_csv(result.tables["predictions"])["radiograph"])
    assert not [name for name in tested if "noise" in name or "perturbation" in name]
    page = result.report.read_text(encoding="utf-8")
    assert "repeated noise" in page
    assert "are not in it" not in page


def test_a_model_on_disk_gives_the_probabilities_of_the_first_split(result):
    told = pd.read_csv(result.tables["predictions"]).query("task == '0 vs 2' and scenario == 'within' and repeat == 0")
    features = load_table(result.tables["features"], TEXT)
    features = features.set_index("radiograph")
    assert set(result.models) == {"lr_l1", "rf_l1"}
    for name, path in result.models.items():
        rows = told[told["model"] == name.split("_")[0]]
        model = loads(path.read_bytes())
        found = model.predict_proba(features.loc[rows["radiograph"], list(model[0].feature_names_in_)])
        assert_allclose(found[:, 1], rows["p1"], rtol=1e-12)


def test_repeats_that_cannot_serve_are_refused_by_name(tmp_path):
    manifest, again = cohort().manifest, cohort().again(2)
    for broken, told in (
        (again.drop(columns="turn"), "turn"),
        (again.assign(kind="shake"), "kind of repeat = 'shake'"),
        (again.assign(radiograph=manifest["radiograph"].iloc[0]), "listed twice"),
    ):
        with pytest.raises(InputError, match=told):
            study.run(manifest, cohort().load, [TEMPLATE], SMALL, tmp_path, again=broken)


def test_refused_regions_are_counted_and_left_out(tmp_path):
    manifest = cohort().manifest
    blank = set(manifest[manifest["subject"] == 14]["file"])

    def load(file: str) -> np.ndarray:
        if file in blank:
            return np.random.default_rng(0).integers(900, 1100, (SIZE, SIZE)).astype(np.uint16)
        return cohort().load(file)

    found = study.run(manifest, load, [TEMPLATE], SMALL, tmp_path)
    assert found.localisation.iloc[-1]["low_score"] == 3
    assert "14" not in set(pd.read_csv(found.tables["predictions"])["subject"].astype(str))


def test_a_cohort_of_one_protocol_and_two_grades_has_a_report_too(tmp_path):
    manifest = cohort().manifest
    part = manifest[(manifest["protocol"] == "reference") & (manifest["grade"] != 1)]
    found = study.run(part, cohort().load, [TEMPLATE], SMALL, tmp_path)
    assert set(found.scores["scenario"]) == {"within"}
    assert found.reliability.empty
    page = found.report.read_text(encoding="utf-8")
    assert "nothing to compare" in page
    assert "no knees of all three grades" in page


def test_a_manifest_that_cannot_serve_is_refused_by_name(tmp_path):
    manifest = cohort().manifest
    for broken, told in (
        (manifest.drop(columns="sha256"), "sha256"),
        (manifest[manifest["protocol"] != "reference"], "reference"),
        (pd.concat([manifest, manifest.head(1)]), "listed twice"),
    ):
        with pytest.raises(InputError, match=told):
            study.run(broken, cohort().load, [TEMPLATE], SMALL, tmp_path)


@pytest.mark.parametrize("wrong", [{"rho": 2}, {"models": ("svm",)}, {"selections": ()}, {"repeats": 0}, {"bins": 7.5}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        StudySettings(**wrong)


def test_without_the_extra_the_refusal_names_the_command(monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr(study, "find_spec", lambda name: None if name == "radiomics" else there(name))
    with pytest.raises(InputError, match=r"needs pyradiomics; bring them, .*uv sync --extra study"):
        study.require_extra()


def test_importing_the_study_does_not_import_its_libraries():
    import subprocess
    import sys

    check = (
        "import sys, pssf.study; print([m for m in ('radiomics', 'sklearn', 'xgboost', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, cwd=Path(__file__).parents[1])
    assert done.stdout.strip() == "[]", done.stderr
