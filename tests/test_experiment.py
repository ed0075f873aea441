"""Check an experiment from its plan to the study, and the reuse of an earlier run."""

import dataclasses
import json

import pandas as pd
import pytest
from conftest import write_small_protocol

import pssf
from pssf import experiment
from pssf.core.processes.execution import Execution
from pssf.experiment import (
    _load_masks,
    _prefix_files,
    load_radiograph_pixels,
    make_experiment,
    run_experiment,
)
from pssf.io import study_results
from pssf.study import StudyResult, StudySettings, resume
from pssf.study.measurement import _make_jobs


def write_tiny_cohort_settings(folder):
    """Write a protocol of 64 x 64 pixels and return settings for a cohort of two knees."""
    return {"knees": [0, 1, 1], "protocols": [write_small_protocol(folder, "reference")], "retested": 1}


def make_tiny_experiment(folder, cohort, **settings):
    """Make an experiment and return it with its execution."""
    execution = Execution()
    return make_experiment(folder / "out", execution, {"seed": 1, **cohort, **settings}), execution


def count_items(execution):
    """Return the numbers of existing and new items of each stage."""
    return {name: (stage.already_done, stage.newly_done) for name, stage in execution.timer.stages.items()}


def test_the_retest_manifest_lists_the_files_of_every_repeat(tmp_path):
    experiment, execution = make_tiny_experiment(tmp_path, write_tiny_cohort_settings(tmp_path))
    first, retest = experiment.manifest.iloc[0], experiment.retest
    assert list(retest["kind"]) == ["noise", "noise", "perturbation", "perturbation"]
    assert list(retest["repeat_index"]) == [1, 2, 1, 2]
    assert (retest["knee"] == first["knee"]).all()
    assert (retest["subject"] == first["subject"]).all()
    for file in [*retest["file"], *experiment.manifest["file"]]:
        assert load_radiograph_pixels(experiment.out, file).shape == (64, 64)
    assert {"femur", "tibia"} <= set(_load_masks(experiment.out, retest["masks"].iloc[0]))
    assert count_items(execution) == {"cohort": (0, 2), "repeats": (0, 4)}
    once_more, execution = make_tiny_experiment(tmp_path, write_tiny_cohort_settings(tmp_path))
    assert count_items(execution) == {"cohort": (2, 0), "repeats": (4, 0)}
    assert once_more.manifest.equals(experiment.manifest)


def test_an_experiment_without_retested_knees_has_no_retest_manifest(tmp_path):
    assert make_tiny_experiment(tmp_path, write_tiny_cohort_settings(tmp_path) | {"retested": 0})[0].retest is None


def test_invalid_settings_are_rejected_before_any_radiograph_is_made(tmp_path):
    with pytest.raises(pssf.InputError, match=r"families must be one of .*, got 'glmc'"):
        make_tiny_experiment(tmp_path, write_tiny_cohort_settings(tmp_path), families=("glmc",))
    assert not (tmp_path / "out").exists()


def test_large_pixels_are_rejected_before_any_radiograph_is_made(tmp_path):
    cohort = write_tiny_cohort_settings(tmp_path)
    with pytest.raises(pssf.InputError, match="pixel_mm must be at most"):
        make_tiny_experiment(tmp_path, cohort, families=["glcm", "vot"])
    assert not (tmp_path / "out" / "manifest.csv").exists()


def test_areas_are_placed_by_the_labels_of_each_radiograph(tmp_path):
    settings = {"families": ["glcm"], "areas": ["square", "epiphysis"], "regions": "truth", "retested": 0}
    made, _ = make_tiny_experiment(tmp_path, write_tiny_cohort_settings(tmp_path), **settings)
    assert made.settings.areas == ("square", "epiphysis")
    for job in _make_jobs(made.manifest, made.settings):
        truth = pssf.load(made.out / job.file).truth
        for name, place in job.landmarks_px.items():
            assert place == pytest.approx(truth.landmarks_px[name], abs=1e-3)
    with pytest.raises(pssf.InputError, match="must have true tibial landmarks"):
        _make_jobs(made.manifest.drop(columns="truth_medial_spine_row_px"), made.settings)


def test_the_first_protocol_replaces_a_missing_reference_protocol(tmp_path):
    cohort = write_tiny_cohort_settings(tmp_path)
    path = tmp_path / "reference.toml"
    path.write_text(path.read_text().replace('name = "reference"', 'name = "mine"'))
    experiment, _ = make_tiny_experiment(tmp_path, cohort)
    assert experiment.settings.reference == "mine"
    assert set(experiment.retest["protocol"]) == {"mine"}


def test_manifest_paths_are_relative_to_the_experiment_folder():
    assert list(_prefix_files("cohort", pd.DataFrame({"file": ["images/a.tif"]}))["file"]) == ["cohort/images/a.tif"]


def write_study_result(out) -> StudyResult:
    """Write the files of a minimal study result."""
    tables = {name: out / f"{name}.csv" for name in ("scores", "differences", "reliability", "localisation")}
    value = pd.DataFrame({"name": ["a", "b"], "value": [0.1 + 0.2, float("nan")]})
    for path in tables.values():
        study_results.save_table(path, value)
    for name in ("study.json", "environment.json", "checklist.json", "report.html"):
        study_results.save_text(out / name, "{}")
    return StudyResult(
        report=out / "report.html", pictures={}, tables=tables, models={}, seconds={"cohort": 2.0},
        **dict.fromkeys(tables, value),
    )  # fmt: skip


def test_a_finished_study_is_reused_without_running_again(tmp_path, monkeypatch):
    requested, execution = make_tiny_experiment(tmp_path, write_tiny_cohort_settings(tmp_path))
    monkeypatch.setattr(experiment, "make_standard_templates", lambda engine, workers: None)
    runs = []
    monkeypatch.setattr(experiment, "run", lambda *args, **kwargs: runs.append(1) or write_study_result(requested.out))
    first = run_experiment(requested, execution)
    again = run_experiment(requested, execution)
    assert runs == [1]
    assert (first.origin, again.origin) == ("this run", "an earlier run")
    assert again.tables == first.tables
    assert again.seconds == first.seconds
    pd.testing.assert_frame_equal(again.scores, first.scores, check_exact=True)
    settings = dataclasses.replace(requested.settings, bins=32)
    run_experiment(dataclasses.replace(requested, settings=settings), execution)
    assert runs == [1, 1]


@pytest.mark.parametrize("damage", ["change", "delete"])
def test_a_study_with_a_changed_or_deleted_file_is_not_reused(tmp_path, damage):
    key = resume.compute_run_key([pd.DataFrame({"a": [1]})], StudySettings(), "scanline")
    resume.save_finished_run(write_study_result(tmp_path), tmp_path, key)
    assert resume.load_finished_run(tmp_path, key) is not None
    assert resume.load_finished_run(tmp_path, "another key") is None
    path = tmp_path / "scores.csv"
    path.write_text("name\n") if damage == "change" else path.unlink()
    assert resume.load_finished_run(tmp_path, key) is None


@pytest.mark.parametrize(
    "text", ["[]", "1", '"x"', "{}", "[" * 100_000, "lacks sha256", "lacks scores", "lacks a hash", "wrong type"]
)
def test_an_invalid_completion_file_does_not_mark_a_study_as_finished(tmp_path, text):
    key = resume.compute_run_key([pd.DataFrame({"a": [1]})], StudySettings(), "scanline")
    resume.save_finished_run(write_study_result(tmp_path), tmp_path, key)
    path = tmp_path / "finished.json"
    end = json.loads(path.read_text())
    if text == "lacks sha256":
        del end["sha256"]
    elif text == "lacks scores":
        del end["tables"]["scores"]
        del end["sha256"]["scores.csv"]
    elif text == "lacks a hash":
        del end["sha256"]["report.html"]
    elif text == "wrong type":
        end["seconds"] = {"cohort": "2"}
    path.write_text(json.dumps(end) if text.startswith(("lacks", "wrong")) else text)
    assert resume.load_finished_run(tmp_path, key) is None


def test_the_run_key_depends_on_manifest_settings_engine_and_code(monkeypatch):
    def key(value=1, engine="scanline", **settings):
        return resume.compute_run_key([pd.DataFrame({"a": [value]})], StudySettings(**settings), engine)

    keys = {key(), key(2), key(engine="embree"), key(seed=3)}
    assert len(keys) == 4
    assert key() in keys
    monkeypatch.setattr(resume, "compute_code_hashes", lambda: {".": "other"})
    assert key() not in keys
