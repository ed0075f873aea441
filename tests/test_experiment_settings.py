"""Check the settings file of a study: names, types, precedence, and the settings that a study writes."""

import re
import tomllib

import pytest
from command_line import run

from pssf import InputError, experiment
from pssf.core.processes.execution import Execution
from pssf.study.design.experiment_settings import SETTING_TYPES, merge_settings, read_settings

# Settings of a cohort with one radiograph of 64 x 64 pixels, on which no joint is located.
TINY = {"knees": (0, 0, 1), "protocols": ("reference",), "matrix": 64, "retested": 0}


def write_file(path, text):
    """Write a settings file and return its path."""
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Make the tiny cohort with modified settings and return the written settings file."""
    folder = tmp_path_factory.mktemp("tiny")
    changed = {"seed": 3, "bins": 32, "strengths": [0, 0.5], "models": ["lr"], "set": ["mas=3"]}
    experiment.make_experiment(folder, Execution(), TINY | changed)
    return folder / "study.toml"


def test_an_option_replaces_the_file_and_the_file_replaces_the_preset(tmp_path, monkeypatch):
    path = write_file(tmp_path / "s.toml", 'preset = "paper"\nseed = 4\nbins = 32\nknees = [4, 4, 4]\nbilateral = 1\n')
    given = []

    def stop(out, execution, settings):
        given.append(settings)
        raise InputError("out must be another folder, got this one")

    monkeypatch.setattr(experiment, "make_experiment", stop)
    run("study", "--config", path, "--out", tmp_path / "o")
    run("study", "--config", path, "--seed", 0, "--knees", "2,2,2", "--matrix", 512, "--out", tmp_path / "o")
    run("study", "--out", tmp_path / "o")
    of_file, of_both, of_none = given
    assert (of_file.preset, of_file.seed, dict(of_file.study)) == ("paper", 4, {"bins": 32})
    assert dict(of_file.cohort) == {"knees": (4, 4, 4), "bilateral": 1}
    assert (of_both.preset, of_both.seed, dict(of_both.study)) == ("paper", 0, {"bins": 32, "region_px": 128})
    assert dict(of_both.cohort) == {"knees": (2, 2, 2), "bilateral": 0, "matrix": 512}
    assert of_none == merge_settings()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bin = 32", r"s\.toml: setting must be one of preset, .*, got 'bin' \(did you mean 'bins'\?\)"),
        ("bins = '32'", r"s\.toml: bins must be a whole number, got '32'"),
        ("knees = 3", r"s\.toml: knees must be a list of integers, got 3"),
        ("rho = [0.9]", r"s\.toml: rho must be a number, got \[0\.9\]"),
        ("models = ['lr', 1]", r"s\.toml: models must be a list of strings, got \['lr', 1\]"),
        ("preset = true", r"s\.toml: preset must be text, got True"),
        ("bins = ", r"file .*s\.toml must be a readable TOML file, got: not TOML"),
        ("bins = 7", r"bins must be a whole number from 8 to 256 grey values, got 7"),
        ("films_pixel_mm = 0.2", "films must be a folder if films_pixel_mm is used, got films = none"),
    ],
)
def test_an_invalid_settings_file_gives_a_one_line_error_and_no_files(text, message, tmp_path):
    path = write_file(tmp_path / "s.toml", text)
    done = run("study", "--config", path, "--out", tmp_path / "o")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert re.search(message, done.stderr)
    assert not (tmp_path / "o").exists()


def test_a_study_writes_every_setting_that_has_a_value(written):
    held = tomllib.loads(written.read_text(encoding="utf-8"))
    absent = {"films", "films_protocol", "films_pixel_mm", "films_region_mm"}
    assert set(held) == set(SETTING_TYPES) - absent
    assert (held["seed"], held["bins"], held["strengths"]) == (3, 32, [0, 0.5])
    assert (held["knees"], held["bilateral"], held["region_px"], held["repeats"]) == ([0, 0, 1], 0, 16, 10)
    assert (held["grade_table"], held["set"], held["reference"]) == ("paper", ["mas=3"], "reference")


def test_repeating_a_study_from_its_settings_gives_identical_bytes(written, tmp_path):
    again = experiment.make_experiment(tmp_path, Execution(), read_settings(written))
    assert again.settings.bins == 32
    for name in ("study.toml", "cohort/cohort.json", "cohort/manifest.csv"):
        assert (tmp_path / name).read_bytes() == (written.parent / name).read_bytes()


def test_a_run_resumes_only_with_the_same_settings(written):
    before, execution = written.read_bytes(), Execution()
    experiment.make_experiment(written.parent, execution, read_settings(written))
    stage = execution.timer.stages["cohort"]
    assert (stage.already_done, stage.newly_done) == (1, 0)
    with pytest.raises(InputError, match="seed"):
        experiment.make_experiment(written.parent, Execution(), read_settings(written) | {"seed": 4})
    assert written.read_bytes() == before


def test_special_characters_survive_the_settings_file(tmp_path):
    text = 'a "quoted" \\ path, α, \x7f and a tab\t'
    settings = merge_settings({"films": text})
    plan = experiment.plan_cohort("quick", seed=0, overrides=TINY)
    study = experiment.StudySettings()
    path = write_file(tmp_path / "s.toml", experiment.format_settings(settings, plan.definition, study))
    assert read_settings(path)["films"] == text


def test_a_deprecated_option_gives_a_warning_and_sets_its_setting(tmp_path):
    done = run("study", "--films-pixel-mm", "0.5", "--out", tmp_path / "o")
    moved, error = done.stderr.splitlines()
    assert moved.startswith(
        "pssf: --films-pixel-mm is now a setting of the settings file, and the option will be removed; set films_"
    )
    assert error == "pssf: films must be a folder if films_pixel_mm is used, got films = none"
    done = run("study", "--strengths", "0,much", "--out", tmp_path / "o")
    assert done.stderr.splitlines()[1] == "pssf: strengths must be numbers separated by commas, got '0,much'"
