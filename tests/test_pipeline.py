"""The whole study, from a manifest to a report."""

import re

import numpy as np
import pandas as pd
import pytest
from drawn import SIZE, SMALL, TEMPLATE, cohort

from pssf import study
from pssf.core.checks import InputError
from pssf.core.processes.execution import Execution
from pssf.data.analysis.readme_table import load_readme_tables
from pssf.experiment import README_TABLES, collect_readme_rows
from pssf.io.readme_tables import open_checkout
from pssf.io.study_results import load_table
from pssf.radiomics.features.feature_table import TEXT_COLUMNS
from pssf.study.learn.models.model_bytes import loads
from pssf.study.learn.models.model_file import unpack_model


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> study.StudyResult:
    out = tmp_path_factory.mktemp("study")
    execution = Execution()
    with execution.stage("cohort", "radiographs", 45) as stage:
        stage.advance(45)
    retest = cohort().retest(3)
    return study.run(cohort().manifest, cohort().load, [TEMPLATE], SMALL, out, retest=retest, execution=execution)


def test_a_study_finds_the_regions_and_tells_the_grades_apart(result):
    everything = result.localisation.iloc[-1]
    assert everything["radiographs"] == 45
    assert everything["refused"] == everything["leaves_image"] == everything["gross"] == 0
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
        "models refitted",
    ]


def test_the_readme_of_a_checkout_takes_what_a_study_found(result, tmp_path):
    names = [name for source in README_TABLES for name in load_readme_tables().tables_showing(source)]
    (tmp_path / "README.md").write_text("".join(f"<!-- table: {name} -->\n<!-- /table -->\n" for name in names))
    checkout = open_checkout(tmp_path, README_TABLES, preset="mine")
    written = checkout.update_tables(collect_readme_rows(result), result.pictures.values(), measured_with=result.report)
    assert [path.name for path in written] == ["README.md", "robustness.png", "stability.png"]
    text = written[0].read_text()
    assert text.count("`uv run pssf study --preset mine`") == len(names)
    within = result.scores.query("task == '0 vs 2' and scenario == 'within' and model == 'lr'").iloc[0]
    line = next(line for line in text.splitlines() if line.startswith("| 0 vs 2 | reference, reference | "))
    assert line.split(" | ")[2].startswith(f"{within['auc']:.2f} (")
    assert "| cohort | " in text
    assert "| A subset of features is stable | " in text


def test_the_report_is_one_page_with_everything_in_it(result):
    page = result.report.read_text(encoding="utf-8")
    for target in re.findall(r"(?:src|href)=(\S{30}|\S+)", page):
        assert target.startswith(('"data:image/png;base64,', '"#')), target
    assert not re.search(r"<script|<link|@import|url\(|https?://", page)
    pictures = re.findall(r"<img[^>]*>", page)
    assert len(pictures) == len(result.pictures) == 7
    assert all(re.search(r'alt="[^"]{20,}"', picture) for picture in pictures)
    assert "43 of 107" in page
    # The result, and how far it is one, before anything else.
    first = page[page.index("<h1>") : page.index("<nav")]
    assert "mean over the splits" in first
    assert "Too few test subjects." in first
    for path in [*result.pictures.values(), *result.tables.values()]:
        assert path.stat().st_size > 0
    assert not [path for path in result.report.parent.rglob("*") if path.name.startswith(".")]


def test_a_second_run_measures_nothing_again_and_writes_the_same_bytes(result, tmp_path):
    (tmp_path / "features.csv").write_bytes(result.tables["features"].read_bytes())
    asked: list[str] = []

    def load(file: str) -> np.ndarray:
        asked.append(file)
        return cohort().load(file)

    again = study.run(cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, retest=cohort().retest(3))
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

    path = study.measure(cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, retest=cohort().retest(3))
    assert len(asked) == 1
    assert path.read_text(encoding="utf-8") == "".join(lines)


def test_repeats_have_their_own_reliability_and_no_part_in_training_or_localisation(result):
    across = result.reliability.groupby("conditions")["knees"].max()
    assert across["repeated noise"] == across["small perturbations"] == 3
    assert across["all protocols"] == 15
    assert result.localisation.iloc[-1]["radiographs"] == 45
    tested = set(pd.read_csv(result.tables["predictions"])["radiograph"])
    assert not [name for name in tested if "noise" in name or "perturbation" in name]
    page = result.report.read_text(encoding="utf-8")
    assert "repeated noise" in page
    assert "are not in it" not in page


def test_models_on_disk_have_learnt_from_all_subjects_within_and_over_protocols(result):
    sets = {"0v2_reference": (10, 10), "0v2_all": (10, 30), "012_reference": (15, 15), "012_all": (15, 45)}
    assert set(result.models) == {f"{model}_l1_{name}" for model in ("lr", "rf") for name in sets}
    features = load_table(result.tables["features"], TEXT_COLUMNS)
    for name, path in result.models.items():
        model = unpack_model(path.read_bytes(), name)
        assert (model.card.subjects, model.card.radiographs) == sets["_".join(name.split("_")[2:])]
        assert model.card.grade_names[0] == "normal"
        anybody = loads(path.read_bytes()).predict_proba(features[list(model.card.features)])
        np.testing.assert_array_equal(model.predict_probabilities(features), anybody)
        assert anybody.shape == (len(features), len(model.card.grades))


def test_repeats_that_cannot_serve_are_refused_by_name(tmp_path):
    manifest, retest = cohort().manifest, cohort().retest(2)
    first = manifest[manifest["protocol"] == "reference"].set_index("knee")
    for broken, told in (
        (retest.drop(columns="turn"), "turn"),
        (retest.assign(kind="shake"), "kind of repeat must be one of .*, got 'shake'"),
        (retest.assign(radiograph=manifest["radiograph"].iloc[0]), "listed twice"),
        (
            retest.assign(sha256=retest["knee"].map(first["sha256"])),
            f"a file of its own, got sha256 = {first['sha256'][0][:12]}",
        ),
        (
            retest.assign(sha256=retest["sha256"].iloc[0]),
            r"must have a file of its own, got sha256 = .*\(7 such rows\)",
        ),
        (retest.assign(knee=99), r"must have a knee of the manifest, got knee = 99 \(8 such rows\)"),
        (retest.assign(subject=14), "manifest of repeats: knee 0 must have one subject, got 0 and 14"),
        (retest.assign(grade=2), "manifest of repeats: knee 0 must have one grade, got 0 and 2"),
        (retest.assign(knee=1 - retest["knee"]), "manifest of repeats: knee 0 must have one subject, got 0 and 1"),
        (retest.assign(side="left"), "manifest of repeats: knee 0 must have one side, got right and left"),
    ):
        with pytest.raises(InputError, match=told):
            study.run(manifest, cohort().load, [TEMPLATE], SMALL, tmp_path, retest=broken)


def test_refused_regions_are_counted_and_left_out_and_subjects_numbered_by_grade_are_told(tmp_path):
    manifest = cohort().manifest
    number = 5 * manifest["grade"] + manifest["subject"] // 3
    # Called by texts, in whose own order P10 comes before P2.
    manifest = manifest.assign(subject=[f"P{one}" for one in number])
    blank = set(manifest[manifest["subject"] == "P14"]["file"])

    def load(file: str) -> np.ndarray:
        if file in blank:
            return np.random.default_rng(0).integers(900, 1100, (SIZE, SIZE)).astype(np.uint16)
        return cohort().load(file)

    found = study.run(manifest, load, [TEMPLATE], SMALL, tmp_path)
    assert found.localisation.iloc[-1]["refused"] == 3
    assert "P14" not in set(pd.read_csv(found.tables["predictions"])["subject"])
    assert set(found.reliability["subjects"]) == {14}
    assert "<strong>Warning:</strong> Subjects are numbered by their grade" in found.report.read_text(encoding="utf-8")


def test_a_cohort_of_one_protocol_and_two_grades_has_a_report_too(tmp_path):
    manifest = cohort().manifest
    part = manifest[(manifest["protocol"] == "reference") & (manifest["grade"] != 1)]
    found = study.run(part, cohort().load, [TEMPLATE], SMALL, tmp_path)
    assert set(found.scores["scenario"]) == {"within"}
    assert found.reliability.empty
    page = found.report.read_text(encoding="utf-8")
    assert "nothing to compare" in page
    assert "There is no external data" in page
    assert "no knees of grades 0, 1 and 2" in page


def test_a_manifest_that_cannot_serve_is_refused_by_name(tmp_path):
    manifest = cohort().manifest
    for broken, told in (
        (manifest.drop(columns="sha256"), "sha256"),
        (manifest[manifest["protocol"] != "reference"], "reference"),
        (pd.concat([manifest, manifest.head(1)]), "listed twice"),
        (manifest.assign(sha256=manifest["sha256"].iloc[0]), "must have one subject, got 0 and 1"),
    ):
        with pytest.raises(InputError, match=told):
            study.run(broken, cohort().load, [TEMPLATE], SMALL, tmp_path)
