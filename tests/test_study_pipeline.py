"""Check a complete study, from the manifest to the report."""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from block_knee_cohort import LIGHT, SIZE, SMALL, TEMPLATE, make_cohort

from pssf import study
from pssf.core.checks import InputError
from pssf.core.processes.execution import Execution
from pssf.io.study_results import load_table
from pssf.radiomics.features.feature_table import TEXT_COLUMNS
from pssf.study.learn.models.model_bytes import loads
from pssf.study.learn.models.model_file import unpack_model

sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "_ext"))

from table_layout import read_rows
from table_store import TableStore


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> study.StudyResult:
    out = tmp_path_factory.mktemp("study")
    execution = Execution()
    with execution.stage("cohort", "radiographs", 45) as stage:
        stage.advance(45)
    retest = make_cohort().retest(3)
    return study.run(
        make_cohort().manifest, make_cohort().load, [TEMPLATE], SMALL, out, retest=retest, execution=execution
    )


def test_a_study_finds_the_regions_and_separates_the_grades(result):
    everything = result.localisation.iloc[-1]
    assert everything["radiographs"] == 45
    assert everything["rejected"] == everything["leaves_image"] == everything["gross_errors"] == 0
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


@pytest.mark.parametrize("name", ["auc", "balanced_accuracy", "reliability", "claims", "cost"])
def test_the_tables_of_a_study_are_shown_in_the_documentation(name, result):
    layout = TableStore().load_layouts()[name]
    rows = layout.format_cells(read_rows(layout, result.report.parent, {}))
    assert rows
    if name == "auc":
        score = result.scores.query("task == '0 vs 2' and scenario == 'within' and model == 'lr'").iloc[0]
        (row,) = [row for row in rows if row[:2] == ["0 vs 2", "reference, reference"]]
        assert row[2].startswith(f"{score['auc']:.2f} (")


def test_the_report_is_one_self_contained_page(result):
    page = result.report.read_text(encoding="utf-8")
    for target in re.findall(r'(?:src|href)="([^"]*)"', page):
        inside = target.startswith(("data:image/png;base64,", "#"))
        assert inside or (result.report.parent / target).is_file(), target[:60]
    assert not re.search(r"<script|<link|@import|url\(|https?://", page)
    pictures = re.findall(r"<img[^>]*>", page)
    assert len(pictures) == len(result.pictures) == 7
    assert all(re.search(r'alt="[^"]{20,}"', picture) for picture in pictures)
    assert "43 of 107" in page
    # The report begins with the results and their limitations.
    first = page[page.index("<h1>") : page.index("<section")]
    assert "mean over the splits" in first
    assert "With 15 subjects no claim about a model is decided; a split has 2 to 3 test subjects" in first
    for path in [*result.pictures.values(), *result.tables.values()]:
        assert path.stat().st_size > 0
    assert not [path for path in result.report.parent.rglob("*") if path.name.startswith(".")]


def test_the_table_of_contents_of_the_report_lists_its_headings(result):
    page = result.report.read_text(encoding="utf-8")
    headings = re.findall(r'<section id="(\w+)">\s*<h2>([^<]+)</h2>', page)
    navigations = re.findall(r"<nav .*?</nav>", page, re.DOTALL)
    assert len(headings) == page.count("<h2>") > 10
    assert headings[-1] == ("glossary", "Glossary")
    assert len(navigations) == 2  # beside the text, and folded above it on a narrow screen
    for navigation in navigations:
        assert re.findall(r'<a href="#(\w+)">([^<]+)</a>', navigation) == headings


def test_every_table_of_the_report_links_to_an_existing_file(result, film_study):
    for study_result in (result, film_study):
        page = study_result.report.read_text(encoding="utf-8")
        after_tables = page.split("</table>")[1:]
        assert len(after_tables) > 10
        for text in after_tables:
            linked = re.match(r'\s*</div>\s*<p class="files">(.*?)</p>', text)
            assert linked, text[:200]
            files = re.findall(r'href="([^"]+)"', linked[1])
            assert files
            assert all((study_result.report.parent / file).is_file() for file in files), files


def test_no_cell_of_the_report_has_missing_interval_limits(result, film_study):
    for study_result in (result, film_study):
        page = re.sub('src="data:[^"]*"', "", study_result.report.read_text(encoding="utf-8"))
        assert not re.search(r"n/a|\bnan\b|\binf\b|– to|to –|None", page)


def test_undecided_report_tables_are_collapsed_with_a_reason(result):
    page = result.report.read_text(encoding="utf-8")
    scores = page[page.index('<section id="scores">') : page.index('<section id="robustness">')]
    tables = scores.count("<table")
    folded = scores.count("no conclusion can be drawn from this table.</p>\n<details>")
    assert folded == scores.count("</details>") == tables == 2
    assert "<details open" not in page


def test_a_second_run_reuses_the_features_and_writes_identical_files(result, tmp_path):
    (tmp_path / "features.csv").write_bytes(result.tables["features"].read_bytes())
    loaded: list[str] = []

    def load(file: str) -> np.ndarray:
        loaded.append(file)
        return make_cohort().load(file)

    again = study.run(make_cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, retest=make_cohort().retest(3))
    # Only the nine radiographs of the figure are loaded.
    assert len(loaded) == 9
    for name, path in result.tables.items():
        assert again.tables[name].read_bytes() == path.read_bytes(), name
    for name, path in result.pictures.items():
        assert again.pictures[name].read_bytes() == path.read_bytes(), name
    for name, path in result.models.items():
        assert again.models[name].read_bytes() == path.read_bytes(), name


def test_a_manually_changed_row_of_features_is_measured_again(result, tmp_path):
    lines = result.tables["features"].read_text(encoding="utf-8").splitlines(keepends=True)
    head, row = lines[0].split(","), lines[2].split(",")
    row[head.index("glcm_Contrast")] = "1.5"
    (tmp_path / "features.csv").write_text("".join([*lines[:2], ",".join(row), *lines[3:]]), encoding="utf-8")
    loaded: list[str] = []

    def load(file: str) -> np.ndarray:
        loaded.append(file)
        return make_cohort().load(file)

    path = study.measure(make_cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, retest=make_cohort().retest(3))
    assert len(loaded) == 1
    assert path.read_text(encoding="utf-8") == "".join(lines)


def test_repeated_radiographs_are_used_only_for_reliability(result):
    across = result.reliability.groupby("conditions")["knees"].max()
    assert across["repeated noise"] == across["small perturbations"] == 3
    assert across["all protocols"] == 15
    assert result.localisation.iloc[-1]["radiographs"] == 45
    tested = set(pd.read_csv(result.tables["predictions"])["radiograph"])
    assert not [name for name in tested if "noise" in name or "perturbation" in name]
    page = result.report.read_text(encoding="utf-8")
    assert "repeated noise" in page
    assert "there are no repeat radiographs" not in page


def test_saved_models_are_trained_on_all_subjects(result):
    sets = {"0v2_reference": (10, 10), "0v2_all": (10, 30), "012_reference": (15, 15), "012_all": (15, 45)}
    assert set(result.models) == {f"lr_l1_{name}" for name in sets}
    features = load_table(result.tables["features"], TEXT_COLUMNS)
    for name, path in result.models.items():
        model = unpack_model(path.read_bytes(), name)
        assert (model.card.subjects, model.card.radiographs) == sets["_".join(name.split("_")[2:])]
        assert model.card.grade_names[0] == "normal"
        probabilities = loads(path.read_bytes()).predict_proba(features[list(model.card.features)])
        np.testing.assert_array_equal(model.predict_probabilities(features), probabilities)
        assert probabilities.shape == (len(features), len(model.card.grades))


def test_the_error_for_invalid_repeats_names_the_fault(tmp_path):
    manifest, retest = make_cohort().manifest, make_cohort().retest(2)
    first = manifest[manifest["protocol"] == "reference"].set_index("knee")
    for broken, message in (
        (retest.drop(columns="repeat_index"), "repeat_index"),
        (retest.assign(kind="shake"), "kind of repeat must be one of .*, got 'shake'"),
        (retest.assign(radiograph=manifest["radiograph"].iloc[0]), "listed twice"),
        (
            retest.assign(sha256=retest["knee"].map(first["sha256"])),
            f"its own file, got sha256 = {first['sha256'][0][:12]}",
        ),
        (
            retest.assign(sha256=retest["sha256"].iloc[0]),
            r"must have its own file, got sha256 = .*\(7 rows affected\)",
        ),
        (retest.assign(knee=99), r"must show a knee in the manifest, got knee = 99 \(8 rows affected\)"),
        (retest.assign(subject=14), "retest manifest: knee 0 must have one subject, got 0 and 14"),
        (retest.assign(grade=2), "retest manifest: knee 0 must have one grade, got 0 and 2"),
        (retest.assign(knee=1 - retest["knee"]), "retest manifest: knee 0 must have one subject, got 0 and 1"),
        (retest.assign(side="left"), "retest manifest: knee 0 must have one side, got right and left"),
    ):
        with pytest.raises(InputError, match=message):
            study.run(manifest, make_cohort().load, [TEMPLATE], SMALL, tmp_path, retest=broken)


def test_rejected_regions_and_subjects_ordered_by_grade_are_reported(tmp_path):
    manifest = make_cohort().manifest
    number = 5 * manifest["grade"] + manifest["subject"] // 3
    # Identifiers are strings; P10 sorts before P2.
    manifest = manifest.assign(subject=[f"P{one}" for one in number])
    blank = set(manifest[manifest["subject"] == "P14"]["file"])

    def load(file: str) -> np.ndarray:
        if file in blank:
            return np.random.default_rng(0).integers(900, 1100, (SIZE, SIZE)).astype(np.uint16)
        return make_cohort().load(file)

    found = study.run(manifest, load, [TEMPLATE], LIGHT, tmp_path)
    assert found.localisation.iloc[-1]["rejected"] == 3
    assert "P14" not in set(pd.read_csv(found.tables["predictions"])["subject"])
    assert set(found.reliability["subjects"]) == {14}
    assert "<strong>Warning:</strong> Subjects are numbered by their grade" in found.report.read_text(encoding="utf-8")


def test_a_cohort_of_one_protocol_and_two_grades_has_a_report(tmp_path):
    manifest = make_cohort().manifest
    part = manifest[(manifest["protocol"] == "reference") & (manifest["grade"] != 1)]
    found = study.run(part, make_cohort().load, [TEMPLATE], LIGHT, tmp_path)
    assert set(found.scores["scenario"]) == {"within"}
    assert found.reliability.empty
    page = found.report.read_text(encoding="utf-8")
    assert "reliability cannot be computed" in page
    assert "There are no external data" in page
    assert "no knees with grades 0, 1 and 2" in page


def test_the_error_for_an_invalid_manifest_names_the_fault(tmp_path):
    manifest = make_cohort().manifest
    for broken, message in (
        (manifest.drop(columns="sha256"), "sha256"),
        (manifest[manifest["protocol"] != "reference"], "reference"),
        (pd.concat([manifest, manifest.head(1)]), "listed twice"),
        (manifest.assign(sha256=manifest["sha256"].iloc[0]), "must have one subject, got 0 and 1"),
    ):
        with pytest.raises(InputError, match=message):
            study.run(broken, make_cohort().load, [TEMPLATE], SMALL, tmp_path)
