"""Check the checkpoints of a comparison with patients: rows of knees and complete sections."""

import numpy as np
import pandas as pd
import pytest

import pssf
from pssf.core.processes.execution import Execution
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.geometry.mesh import Mesh
from pssf.patient_comparison import comparison_run
from pssf.patient_comparison.bones import bone_comparison
from pssf.patient_comparison.checkpoint import (
    RowCheckpoint,
    SectionCheckpoint,
    compute_key,
    hash_bones,
)
from pssf.patient_comparison.contours import landmark_comparison

ROWS = [{"bone": "femur", "bones": 2, "rms_mm": 0.1 + 0.2, "scale": ""}, {"bone": "tibia", "bones": 3, "rms_mm": 1e-17}]


@pytest.fixture
def landmark_calls(monkeypatch):
    """Record the knees whose landmarks are computed, and interrupt the run after a maximum number of knees."""
    computed, original = [], landmark_comparison._compute_landmarks
    calls = {"computed": computed, "maximum": 100, "function": original}

    def compute_landmarks(acquisition, **more):
        if len(computed) == calls["maximum"]:
            raise KeyboardInterrupt
        computed.append(acquisition)
        return calls["function"](acquisition, **more)

    monkeypatch.setattr(landmark_comparison, "_compute_landmarks", compute_landmarks)
    return calls


@pytest.fixture(scope="module")
def reference_landmarks_mm():
    """Return the (16, 2) landmarks of the default knee in mm."""
    knee = pssf.Knee()
    return landmark_comparison._compute_landmarks(
        (knee, pssf.load_protocol("reference")), load_anatomy_tables(), comparison_run.load_jsw_protocol(knee)
    )


@pytest.fixture
def synthetic_landmarks(landmark_calls, reference_landmarks_mm):
    """Replace computed landmarks by those of the default knee plus noise, to avoid building knees."""
    landmark_calls["function"] = lambda acquisition, **more: (
        reference_landmarks_mm + np.random.default_rng(acquisition[0].texture_seed).normal(size=(16, 2))
    )
    return landmark_calls


def read_table_bytes(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.csv"))}


def run_comparison(out, **more):
    return comparison_run.compare_with_patients(out, Execution(), **{"knees": 10, "seed": 4} | more)


def test_an_interrupted_comparison_resumes_with_the_same_results(synthetic_landmarks, tmp_path):
    synthetic_landmarks["maximum"] = 3
    with pytest.raises(KeyboardInterrupt):
        run_comparison(tmp_path / "interrupted")
    assert len(pd.read_csv(tmp_path / "interrupted" / "contours_knees.csv")) == 3
    synthetic_landmarks["maximum"] = 100
    run_comparison(tmp_path / "interrupted")
    assert len(synthetic_landmarks["computed"]) == 10
    run_comparison(tmp_path / "interrupted")
    assert len(synthetic_landmarks["computed"]) == 10
    run_comparison(tmp_path / "uninterrupted")
    assert len(synthetic_landmarks["computed"]) == 20
    assert read_table_bytes(tmp_path / "interrupted") == read_table_bytes(tmp_path / "uninterrupted")
    pages = [(tmp_path / name / "patient_comparison.html").read_text() for name in ("interrupted", "uninterrupted")]
    assert pages[0] == pages[1]


def test_contours_from_a_checkpoint_are_bit_identical(landmark_calls, tmp_path):
    protocol = pssf.load_protocol("reference")
    knees = comparison_run.sample_knees(
        comparison_run.load_knee_distributions("population"), 2, 4, side="right", jsw_definition="read"
    )
    given = [(knee, protocol) for knee in knees], load_anatomy_tables(), comparison_run.load_jsw_protocol(knees[0])
    checkpoint = RowCheckpoint(path=tmp_path / "knees.csv", code={"a": "b"})
    made, first, again = (
        landmark_comparison.compute_simulated_landmarks(*given, 1, rows) for rows in (None, checkpoint, checkpoint)
    )
    assert len(landmark_calls["computed"]) == 4
    for sample in (first, again):
        np.testing.assert_array_equal(sample.landmarks_mm, made.landmarks_mm)
        np.testing.assert_array_equal(sample.grades, made.grades)


def test_checkpoint_rows_are_recomputed_if_code_or_inputs_change(tmp_path):
    made = []

    def make(missing, arrived):
        for nth, number in enumerate(missing):
            made.append(number)
            arrived(nth, {"x": number / 3})

    checkpoint = RowCheckpoint(path=tmp_path / "rows.csv", code={"anatomy": "1"})
    assert [row["x"] for row in checkpoint.complete([b"one", b"two"], make)] == [0.0, 1 / 3]
    assert [row["x"] for row in checkpoint.complete([b"two", b"three", b"one"], make)] == [1 / 3, 1 / 3, 0.0]
    assert made == [0, 1, 1]
    other = RowCheckpoint(path=tmp_path / "rows.csv", code={"anatomy": "2"})
    other.complete([b"one"], make)
    assert made == [0, 1, 1, 0]


def test_a_damaged_checkpoint_is_named_in_the_error(tmp_path):
    (tmp_path / "rows.csv").write_bytes(b"key,x\na,b\n")
    with pytest.raises(pssf.InputError, match=r"rows\.csv is damaged .*delete the file, and pssf makes it again"):
        RowCheckpoint(path=tmp_path / "rows.csv", code={}).complete([b"one"], lambda missing, arrived: None)


def make_section(folder, key):
    return SectionCheckpoint(folder=folder, name="bones", tables=("bones", "bones_forms"), key=key)


def test_a_section_is_recomputed_only_for_a_new_key_or_damaged_files(tmp_path):
    made = []

    def make():
        made.append(1)
        return (ROWS, ROWS[:1]), b"a picture"

    first = make_section(tmp_path, "k").complete(make)
    assert first == ([[ROWS[0], ROWS[1] | {"scale": ""}], ROWS[:1]], b"a picture")
    assert make_section(tmp_path, "k").complete(make) == first
    assert len(made) == 1
    (tmp_path / "bones.csv").write_text("bone\nfemur\n")
    assert make_section(tmp_path, "k").complete(make) == first
    (tmp_path / "pictures" / "bones.png").unlink()
    assert make_section(tmp_path, "k").complete(make) == first
    (tmp_path / "bones_kept.json").write_text("torn")
    assert make_section(tmp_path, "k").complete(make) == first
    assert make_section(tmp_path, "other").complete(make) == first
    assert len(made) == 5


def test_the_checkpoint_key_depends_on_code_inputs_and_bones():
    mesh = Mesh(np.arange(9.0).reshape(3, 3), np.array([[0, 1, 2]]))
    moved = Mesh(mesh.vertices + 1e-12, mesh.faces)
    given = [{"femur": [mesh]}, {"femur": [moved]}, {"tibia": [mesh]}, {"femur": [mesh, mesh]}]
    keys = [compute_key({"a": "1"}, hash_bones(one)) for one in given]
    keys += [
        compute_key({"a": "2"}, hash_bones(given[0])),
        compute_key({"a": "1"}, b"12"),
        compute_key({"a": "1"}, b"1", b"2"),
    ]
    assert len(set(keys)) == len(keys)
    assert compute_key({"a": "1"}, hash_bones({"femur": [mesh]})) == keys[0]


def test_bones_are_compared_again_only_if_the_seed_changes(synthetic_landmarks, tmp_path, monkeypatch):
    mesh = bone_comparison.build_bones(pssf.Knee(), load_anatomy_tables())["patella"]
    for number in range(2):
        (tmp_path / "given" / "patella").mkdir(parents=True, exist_ok=True)
        larger = Mesh(mesh.vertices * (1.0, 1.0, 1.0 + 0.1 * number), mesh.faces)
        larger.as_trimesh().export(tmp_path / "given" / "patella" / f"{number}.stl")
    calls, original = [], bone_comparison.compare_bones
    monkeypatch.setattr(bone_comparison, "compare_bones", lambda *args: calls.append(1) or original(*args))
    settings = {"bones_folder": tmp_path / "given"}
    first = run_comparison(tmp_path / "out", **settings)
    page, tables = first.page.read_text(), read_table_bytes(tmp_path / "out")
    again = run_comparison(tmp_path / "out", **settings)
    assert len(calls) == 1
    assert again.page.read_text() == page
    assert read_table_bytes(tmp_path / "out") == tables
    comparisons = set(pd.read_csv(tmp_path / "out" / "bones.csv")["comparison"])
    assert {"built mean to patient mean", "sampled bones to built mean"} < comparisons
    run_comparison(tmp_path / "out", **settings, seed=5)
    assert len(calls) == 2
