"""Check the frozen benchmark data set: subjects, splits, baselines, metadata and image hashes."""

import dataclasses
import hashlib
import json
import re

import numpy as np
import pandas as pd
import pytest
from conftest import write_protocol

import pssf
from pssf import cohort, simulation
from pssf.benchmark import benchmark_maker, make_benchmark
from pssf.benchmark.croissant import CONFORMS_TO, build_croissant_metadata
from pssf.benchmark.image_hashes import count_matching_hashes, format_hashes_toml, hash_subject_pixels
from pssf.cohort import cohort_plan as plan_module
from pssf.core.processes.execution import Execution
from pssf.data.analysis.benchmark_table import load_benchmark_definition, load_benchmark_hashes
from pssf.data.knees.preset_table import load_presets
from pssf.radiomics.localisation.templates import Template
from pssf.study import StudySettings
from pssf.study.learn.benchmark_baselines import build_benchmark_data, make_splits, predict_baselines
from pssf.study.learn.models import small_network
from pssf.study.statistics.analyses.leakage_checks import find_leakage_warnings

# Seven knees of six subjects, one bilateral: the smallest data set that can be split into three parts.
FEW_KNEES = {"knees": (4, 0, 3), "bilateral": 1, "doses": (1.0, 0.5), "tilts_deg": (0.0,)}
# Headings of a datasheet according to Gebru et al. 2021.
HEADINGS = (
    *("Motivation", "Composition", "Collection process", "Preprocessing, cleaning, labelling"),
    *("Uses", "Distribution", "Maintenance"),
)
LIGHT = StudySettings(models=("lr",), selections=("l1",), repeats=3, reference="one")


def load_small_protocol(name):
    """Return a protocol with 256 x 256 pixels of 1.2 mm."""
    return dataclasses.replace(pssf.load_protocol(name), rows=256, cols=256, pixel_mm=1.2)


def make_template():
    """Return a coarse template of the standard knee."""
    radiograph = simulation.simulate(pssf.Knee(), load_small_protocol("reference"), engine="scanline")
    row, col = radiograph.truth.medial_joint_line_px
    edges = [radiograph.truth.landmarks_px[f"{side}_plateau_edge"][1] for side in ("medial", "lateral")]
    return Template(pixels=radiograph.pixels, row=row, col=col, pixel_mm=1.2, plateau_mm=1.2 * abs(edges[0] - edges[1]))


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Make the small benchmark twice; return the first result, its file hashes and the stages of the second run."""
    folder = tmp_path_factory.mktemp("benchmark")
    path = write_protocol(folder, load_small_protocol("fixed_flexion"))
    templates, overrides = (make_template(),), {**FEW_KNEES, "protocols": (path,)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark_maker, "make_standard_templates", lambda workers: templates)
        # Subjects are numbered by grade, so that a leakage warning is raised.
        patch.setattr(plan_module, "_renumber_subjects", lambda cases, seed: cases)
        result = make_benchmark(folder / "out", Execution(workers=1), overrides=overrides)
        before = compute_digests(result.folder)
        execution = Execution(workers=1)
        make_benchmark(folder / "out", execution, overrides=overrides)
    return (
        result,
        before,
        {name: (stage.already_done, stage.newly_done) for name, stage in execution.timer.stages.items()},
    )


def compute_digests(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def read_csv(folder, name):
    return pd.read_csv(folder / name)


def test_a_second_benchmark_run_creates_no_new_files(tiny):
    result, before, again = tiny
    assert cohort.verify_cohort(result.folder).faults == ()
    assert again["images"] == again["regions and features"] == (14, 0)
    assert compute_digests(result.folder) == before
    assert {path.name for path in result.folder.iterdir()} == {
        "images", "records", "cohort.json", "manifest.csv", "splits.csv", "features.csv", "baselines.csv",
        "predictions.csv", "datasheet.md", "CITATION.cff", "croissant.json", "frozen.toml",
    }  # fmt: skip


def test_both_knees_of_a_subject_are_in_the_same_part_of_each_split(tiny):
    folder = tiny[0].folder
    splits, manifest, tested = (read_csv(folder, f"{name}.csv") for name in ("splits", "manifest", "predictions"))
    assert manifest.groupby("subject")["knee"].nunique().max() == 2
    for repeat, split in splits.groupby("repeat"):
        assert sorted(split["subject"]) == sorted(manifest["subject"].unique())
        test = set(split.loc[split["part"] == "test", "subject"])
        assert set(tested.loc[tested["repeat"] == repeat, "subject"]) == test
        grades = manifest.merge(split, on="subject").groupby("part")["grade"].nunique()
        assert (grades == 2).all()
    assert splits["repeat"].nunique() == load_benchmark_definition().splits


def test_only_image_baselines_are_tested_at_every_dose(tiny):
    result, folder = tiny[0], tiny[0].folder
    rows = read_csv(folder, "baselines.csv")
    where = rows.groupby("model")["tested_on"].agg(set).to_dict()
    assert where["jsw"] == where["measured"] == {"fixed_flexion"}
    assert where["radiomics"] == {"fixed_flexion", "fixed_flexion_dose50"}
    is_installed = small_network.is_pytorch_installed()
    assert ("cnn" in where) == is_installed
    assert any("PyTorch is not installed" in note for note in result.notes) != is_installed
    assert any("fewer than 6 subjects" in note for note in result.notes)
    # Reference hashes exist only for the unmodified data set.
    assert result.hash_agreement == (0, 0)


def test_the_datasheet_fills_every_heading_and_reports_modifications(tiny):
    page = (tiny[0].folder / "datasheet.md").read_text()
    assert re.findall(r"^## (.*)$", page, re.MULTILINE) == list(HEADINGS)
    for part in re.split(r"^## .*$", page, flags=re.MULTILINE)[1:]:
        assert len(part.split()) > 20
    assert "14 radiographs of 7 knees of 6 subjects; both knees are included for 1 of them" in " ".join(page.split())
    assert "**This folder is not benchmark-1**: it was made with other knees and bilateral and doses" in page
    citation = (tiny[0].folder / "CITATION.cff").read_text()
    assert "type: dataset" in citation
    assert f"version: {load_benchmark_definition().version}" in citation
    assert "arXiv:2601.11642" in citation


def test_subjects_numbered_by_grade_give_a_leakage_warning(tiny):
    (warning,) = [note for note in tiny[0].notes if "numbered by their grade" in note]
    assert "file names as predictors" in warning
    page = (tiny[0].folder / "datasheet.md").read_text()
    assert f"**Warning:** {warning}" in page.split("## Collection process")[0].split("## Composition")[1]


def require_valid_croissant(described):
    """Require the properties of Croissant 1.0 and that every reference has a target."""
    required = ("@context", "@type", "conformsTo", "description", "license", "name", "url", "creator", "datePublished")
    assert not set(required) - set(described)
    assert described["@type"] == "sc:Dataset"
    assert described["conformsTo"] == CONFORMS_TO
    for file in described["distribution"]:
        kind = file["@type"]
        needed = {"cr:FileObject": {"contentUrl", "sha256"}, "cr:FileSet": {"includes"}}[kind]
        assert not (needed | {"@id", "name", "encodingFormat"}) - set(file)
    fields = [field for one in described["recordSet"] for field in one["field"]]
    ids = [one["@id"] for one in (*described["distribution"], *described["recordSet"], *fields)]
    assert len(set(ids)) == len(ids)
    referred = re.findall(r'\{"@id": "([^"]*)"\}', json.dumps({**described, "@context": {}}))
    assert referred
    assert not set(referred) - set(ids)
    for one in described["recordSet"]:
        assert all(field["@id"].startswith(f"{one['@id']}/") for field in one["field"])
        assert all({"dataType", "@type", "name"} <= set(field) for field in one["field"])
        assert all("source" in field for field in one["field"]) != ("data" in one)


def test_the_croissant_file_is_valid_and_describes_the_written_files(tiny):
    folder = tiny[0].folder
    described = json.loads((folder / "croissant.json").read_text())
    require_valid_croissant(described)
    for file in described["distribution"]:
        if file["@type"] == "cr:FileObject":
            content = (folder / file["contentUrl"]).read_bytes()
            assert file["sha256"] == hashlib.sha256(content).hexdigest()
            assert file["contentSize"] == f"{len(content)} B"
    for one in described["recordSet"]:
        for field in one["field"]:
            source = field.get("source", {})
            if "fileObject" in source:
                assert source["extract"]["column"] in read_csv(folder, source["fileObject"]["@id"]).columns


def test_an_incomplete_croissant_file_fails_the_check(tiny):
    described = json.loads((tiny[0].folder / "croissant.json").read_text())
    for name in ("url", "datePublished"):
        with pytest.raises(AssertionError):
            require_valid_croissant({key: value for key, value in described.items() if key != name})
    described["recordSet"][0]["field"][0]["source"]["fileObject"]["@id"] = "another.csv"
    with pytest.raises(AssertionError):
        require_valid_croissant(described)


def test_mlcroissant_reads_labels_and_splits(tiny):
    mlcroissant = pytest.importorskip("mlcroissant", reason="mlcroissant is in the dependency group `peers`")
    read = mlcroissant.Dataset(jsonld=str(tiny[0].folder / "croissant.json"))
    assert not read.metadata.ctx.issues.errors
    assert len(list(read.records("radiographs"))) == 14
    assert {row["splits/part"] for row in read.records("splits")} == {b"training", b"validation", b"test"}


def test_croissant_describes_only_columns_of_the_manifest():
    files = {name: ("0" * 64, 1) for name in ("manifest.csv", "splits.csv")}
    described = build_croissant_metadata(load_benchmark_definition(), files, ["radiograph", "grade"])
    require_valid_croissant(described)
    names = [field["@id"] for field in described["recordSet"][0]["field"]]
    assert names == ["radiographs/radiograph", "radiographs/grade", "radiographs/image"]


def test_subject_numbers_do_not_predict_the_grade_or_change_images(monkeypatch):
    whole = cohort.plan_cohort("benchmark-1", seed=0)
    monkeypatch.setattr(plan_module, "_renumber_subjects", lambda cases, seed: cases)
    by_grade = cohort.plan_cohort("benchmark-1", seed=0)

    def list_images(plan):
        return [
            (case.knee, *((exposure.protocol, exposure.seed) for exposure in case.exposures)) for case in plan.cases
        ]

    assert set(list_images(whole)) == set(list_images(by_grade))
    assert list_images(whole) != list_images(by_grade)
    assert [case.index for case in whole.cases] == list(range(1100))
    assert sorted({case.subject for case in whole.cases}) == list(range(1000))
    for case in whole.cases:
        assert all(
            exposure.name.startswith(f"s{case.subject:04d}_k{case.index:04d}_fixed") for exposure in case.exposures
        )
    for plan, warnings in ((by_grade, 1), (whole, 0), (cohort.select_subjects(whole, 50), 0)):
        rows = [(case.subject, case.index, case.knee.grade) for case in plan.cases]
        subjects = pd.DataFrame(rows, columns=["subject", "knee", "grade"])
        assert subjects["subject"].is_monotonic_increasing
        assert subjects.groupby("subject")["grade"].nunique().max() == 1
        assert (
            sum("numbered by their grade" in line for line in find_leakage_warnings(subjects.assign(protocol="one")))
            == warnings
        )


def test_a_subset_of_subjects_is_balanced_by_grade_and_keeps_its_images():
    whole = cohort.plan_cohort("benchmark-1", seed=0)
    part, fewer = cohort.select_subjects(whole, 50), cohort.select_subjects(whole, 25)
    assert set(fewer.cases) < set(part.cases) < set(whole.cases)
    subjects = {case.subject: case.knee.grade for case in part.cases}
    assert sorted(subjects.values()) == sorted([0, 1, 2, 3, 4] * 10)
    assert len(part.cases) > 50  # some subjects are bilateral
    for wrong in (0, 7, 1005):
        with pytest.raises(pssf.InputError, match=rf"subjects must be a multiple of 5, .* up to 1000, got {wrong}"):
            cohort.select_subjects(whole, wrong)


def test_a_subject_hash_depends_only_on_pixels_and_radiograph_names():
    images = {f"{k}.tif": np.full((4, 4), k, np.uint16) for k in range(3)}
    rows = [{"subject": k // 2, "radiograph": f"r{k}", "file": f"{k}.tif"} for k in range(3)]
    made = hash_subject_pixels(pd.DataFrame(rows), images.__getitem__)
    assert set(made) == {"0", "1"}
    assert hash_subject_pixels(pd.DataFrame(rows[::-1]), images.__getitem__) == made
    images["1.tif"] = images["1.tif"] + np.uint16(1)
    other = hash_subject_pixels(pd.DataFrame(rows), images.__getitem__)
    assert (other["0"] == made["0"], other["1"] == made["1"]) == (False, True)
    images["1.tif"] = images["1.tif"] - np.uint16(1)
    elsewhere = {row["file"]: f"moved/{row['file']}" for row in rows}
    moved = [row | {"file": elsewhere[row["file"]], "dose": 1.0} for row in rows]
    assert hash_subject_pixels(pd.DataFrame(moved), lambda file: images[file.removeprefix("moved/")]) == made
    renamed = hash_subject_pixels(
        pd.DataFrame([rows[0], rows[1], rows[2] | {"radiograph": "other"}]), images.__getitem__
    )
    assert (renamed["0"] == made["0"], renamed["1"] == made["1"]) == (True, False)
    assert count_matching_hashes(other, made) == (1, 2)
    assert count_matching_hashes(made, {}) == (0, 0)
    assert f'"0" = "{made["0"]}"' in format_hashes_toml(made)


def make_manifest_with_features(per_grade=12):
    """Return a manifest with features under two protocols: `signal` separates grades 0 and 2.

    One subject in five is bilateral.
    """
    rng, rows = np.random.default_rng(3), []
    for subject in range(2 * per_grade):
        for knee in range(2 if subject % 5 == 0 else 1):
            grade = 2 * (subject % 2)
            signal = grade + 0.3 * rng.normal()
            for protocol in ("one", "two"):
                row = {"radiograph": f"{subject}_{knee}_{protocol}", "knee": 2 * subject + knee, "subject": subject}
                row |= {
                    "grade": grade,
                    "protocol": protocol,
                    "nominal_jsw_medial_mm": 5.0 - grade,
                    "nominal_jsw_lateral_mm": 5.0,
                }
                rows.append(row | {"signal": signal + (4.0 if protocol == "two" else 0.0), "noise": rng.normal()})
    return pd.DataFrame(rows)


def test_baselines_train_on_one_protocol_and_on_training_subjects_only():
    usable = make_manifest_with_features()
    splits = make_splits(usable, LIGHT)
    parameters = usable.drop_duplicates("knee")[["knee", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]]

    def scores(table):
        predictions = predict_baselines(
            build_benchmark_data(table, ["signal", "noise"], parameters, LIGHT), splits, LIGHT, Execution()
        )
        return predictions.set_index(["repeat", "model", "radiograph"]).sort_index()

    first = scores(usable)
    within = first[first["scenario"] == "within"]
    assert ((within["p1"] > 0.5) == (within["truth"] == 1)).groupby("model").mean().min() > 0.9
    shifted = first[(first["scenario"] == "cross")]
    assert set(shifted.index.get_level_values("model")) == {"radiomics"}
    assert (shifted["p1"] > 0.5).all()  # a model trained on the other protocol would correct the shift
    test = splits[(splits["repeat"] == 0) & (splits["part"] == "test")]["subject"]
    spoilt = usable.copy()
    spoilt.loc[spoilt["subject"].isin(test), "signal"] *= -1.0
    spoilt.loc[~spoilt["subject"].isin(test) & (spoilt["protocol"] == "two"), "signal"] *= -1.0
    others = usable.loc[usable["subject"].isin(test) & (usable["protocol"] == "one"), "radiograph"]
    spoilt.loc[spoilt["radiograph"].isin(others), "signal"] = usable.loc[usable["radiograph"].isin(others), "signal"]
    again = scores(spoilt)
    keys = [("radiomics", name) for name in others]
    pd.testing.assert_frame_equal(again.loc[0].loc[keys], first.loc[0].loc[keys])


def test_baselines_without_training_data_are_rejected():
    usable = make_manifest_with_features()
    splits, names = make_splits(usable, LIGHT), ["signal", "noise"]
    parameters = usable.drop_duplicates("knee")[["knee", "nominal_jsw_medial_mm", "nominal_jsw_lateral_mm"]]
    for found in (usable[usable["protocol"] == "two"], usable[:0]):
        with pytest.raises(pssf.InputError, match="at least one region must be located under one, got 0"):
            build_benchmark_data(found, names, parameters, LIGHT)
    films = build_benchmark_data(usable[usable["grade"] == 2], names, parameters, LIGHT)
    with pytest.raises(
        pssf.InputError,
        match=r"grades with a located region must include all grades of at least one task among 0 vs 2, .*got \[2\]",
    ):
        predict_baselines(films, splits, LIGHT, Execution())


@pytest.mark.parametrize("side_px", [16, 110, 127, 128, 511, 512, 513])
def test_the_network_input_is_at_most_as_large_as_documented(side_px):
    network_input = small_network.make_network_input(np.full((side_px, side_px), 7, np.uint16), "left")
    assert min(side_px, small_network.INPUT_SIDE_PX) / 2 < network_input.shape[0] <= small_network.INPUT_SIDE_PX
    assert np.allclose(network_input, np.log(7))


def test_network_input_of_left_knees_is_mirrored_to_right_knees():
    region = np.arange(1, 129 * 128 + 1, dtype=np.uint16)[: 128 * 128].reshape(128, 128)
    right, left = (
        small_network.make_network_input(region, "right"),
        small_network.make_network_input(region[:, ::-1], "left"),
    )
    assert right.shape == (64, 64)
    assert np.array_equal(right, left)


def test_a_note_explains_that_pytorch_is_missing_for_the_network(monkeypatch):
    monkeypatch.setattr(small_network, "find_spec", lambda name: None)
    from pssf.study.learn.benchmark_baselines import explain_missing_network

    assert explain_missing_network() == "not run: PyTorch is not installed (pip install '.[cnn]')"


@pytest.mark.skipif(not small_network.is_pytorch_installed(), reason="PyTorch (`cnn` extra) is not installed")
def test_a_network_learns_a_signal_and_is_reproducible_by_its_seed():
    rng = np.random.default_rng(0)
    truth = np.arange(60) % 2
    images = rng.normal(size=(60, 32, 32)).astype(np.float32)
    images[truth == 1, 8:20, 8:20] += 1.5
    parts = (images[:40], truth[:40]), (images[40:50], truth[40:50])
    one, again, other = (small_network.train_network(*parts, 2, seed=seed)(images[50:]) for seed in (1, 1, 2))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert np.allclose(one.sum(axis=1), 1.0)
    assert ((one[:, 1] > 0.5) == (truth[50:] == 1)).mean() >= 0.9
    (train, known), (check, known_too) = parts
    # A network cannot learn shuffled labels, so it predicts some labels of the test images incorrectly.
    shuffled = small_network.train_network(
        (train, rng.permutation(known)), (check, rng.permutation(known_too)), 2, seed=1
    )
    assert ((shuffled(images[50:])[:, 1] > 0.5) == (truth[50:] == 1)).mean() < 1.0
    # The prediction for an image does not depend on the other images of the batch.
    trained = small_network.train_network(*parts, 2, seed=1)
    assert np.allclose(np.concatenate([trained(image[None]) for image in images[50:]]), one, atol=1e-6)


def test_invalid_numbers_of_benchmark_subjects_are_rejected(tmp_path):
    with pytest.raises(pssf.InputError, match=r"subjects must be a multiple of 5, .* got 3"):
        make_benchmark(tmp_path / "out", Execution(workers=1), subjects=3)
    with pytest.raises(pssf.InputError, match=r"grade 0 must have at least 3 subjects .*got 1"):
        make_benchmark(tmp_path / "out", Execution(workers=1), subjects=5)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_images_of_fifty_subjects_match_the_frozen_hashes(tmp_path):
    made = make_benchmark(tmp_path / "out", Execution(workers=2), subjects=50)
    manifest = read_csv(made.folder, "manifest.csv")
    assert manifest["subject"].nunique() == 50
    assert len(manifest) == 6 * manifest["knee"].nunique()
    assert set(made.baselines["task"]) == {"0 vs 2", "0 vs 3+4", "0/1/2/3/4"}
    require_valid_croissant(json.loads((made.folder / "croissant.json").read_text()))
    assert cohort.verify_cohort(made.folder).faults == ()
    assert "a part of it: 50 of 1000 subjects" in (made.folder / "datasheet.md").read_text()
    # A change that alters images needs a new version of the data set or new hashes.
    assert len(load_benchmark_hashes()) == 1000
    assert made.hash_agreement == (50, 50)


def test_the_benchmark_definition_names_an_existing_preset():
    assert load_benchmark_definition().preset in load_presets()
    assert load_presets()[load_benchmark_definition().preset].repeats == load_benchmark_definition().splits
