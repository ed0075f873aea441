"""What a run of the meter goes on from: rows of knees, and a part that is made whole."""

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
def counted(monkeypatch):
    """The knees that landmarks are sought of, and how many may be before the run breaks off."""
    seen, whole = [], landmark_comparison._compute_landmarks
    seen_of = {"seen": seen, "most": 100, "of": whole}

    def landmarks_of(taking, **more):
        if len(seen) == seen_of["most"]:
            raise KeyboardInterrupt
        seen.append(taking)
        return seen_of["of"](taking, **more)

    monkeypatch.setattr(landmark_comparison, "_compute_landmarks", landmarks_of)
    return seen_of


@pytest.fixture(scope="module")
def usual_mm():
    """(16, 2) landmarks of the reference knee."""
    knee = pssf.Knee()
    return landmark_comparison._compute_landmarks(
        (knee, pssf.load_protocol("reference")), load_anatomy_tables(), comparison_run.load_jsw_protocol(knee)
    )


@pytest.fixture
def made_up(counted, usual_mm):
    """As `counted`, with landmarks about those of the reference knee, of which none is built."""
    counted["of"] = lambda taking, **more: usual_mm + np.random.default_rng(taking[0].texture_seed).normal(size=(16, 2))
    return counted


def tables_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.csv"))}


def measure(out, **more):
    return comparison_run.compare_with_patients(out, Execution(), **{"knees": 10, "seed": 4} | more)


def test_contours_go_on_where_a_run_broke_off_and_are_those_of_a_run_that_did_not(made_up, tmp_path):
    made_up["most"] = 3
    with pytest.raises(KeyboardInterrupt):
        measure(tmp_path / "broken")
    assert len(pd.read_csv(tmp_path / "broken" / "contours_knees.csv")) == 3
    made_up["most"] = 100
    measure(tmp_path / "broken")
    assert len(made_up["seen"]) == 10
    measure(tmp_path / "broken")
    assert len(made_up["seen"]) == 10
    measure(tmp_path / "whole")
    assert len(made_up["seen"]) == 20
    assert tables_of(tmp_path / "broken") == tables_of(tmp_path / "whole")
    pages = [(tmp_path / name / "realism.html").read_text() for name in ("broken", "whole")]
    assert pages[0] == pages[1]


def test_kept_contours_are_those_that_are_made_bit_for_bit(counted, tmp_path):
    protocol = pssf.load_protocol("reference")
    knees = comparison_run.sample_knees(
        comparison_run.load_knee_distributions("population"), 2, 4, side="right", jsw_definition="read"
    )
    given = [(knee, protocol) for knee in knees], load_anatomy_tables(), comparison_run.load_jsw_protocol(knees[0])
    kept = RowCheckpoint(path=tmp_path / "knees.csv", code={"a": "b"})
    made, first, again = (
        landmark_comparison.compute_simulated_landmarks(*given, 1, where) for where in (None, kept, kept)
    )
    assert len(counted["seen"]) == 4
    for sample in (first, again):
        np.testing.assert_array_equal(sample.landmarks_mm, made.landmarks_mm)
        np.testing.assert_array_equal(sample.grades, made.grades)


def test_rows_of_other_code_or_facts_are_made_anew_and_the_others_stay(tmp_path):
    made = []

    def make(missing, arrived):
        for nth, number in enumerate(missing):
            made.append(number)
            arrived(nth, {"x": number / 3})

    kept = RowCheckpoint(path=tmp_path / "rows.csv", code={"anatomy": "1"})
    assert [row["x"] for row in kept.complete([b"one", b"two"], make)] == [0.0, 1 / 3]
    assert [row["x"] for row in kept.complete([b"two", b"three", b"one"], make)] == [1 / 3, 1 / 3, 0.0]
    assert made == [0, 1, 1]
    other = RowCheckpoint(path=tmp_path / "rows.csv", code={"anatomy": "2"})
    other.complete([b"one"], make)
    assert made == [0, 1, 1, 0]


def test_a_damaged_table_of_knees_is_refused_by_name(tmp_path):
    (tmp_path / "rows.csv").write_bytes(b"key,x\na,b\n")
    with pytest.raises(pssf.InputError, match=r"rows\.csv must be undamaged .*got: damaged"):
        RowCheckpoint(path=tmp_path / "rows.csv", code={}).complete([b"one"], lambda missing, arrived: None)


def part(folder, key):
    return SectionCheckpoint(folder=folder, name="bones", tables=("bones", "bones_forms"), key=key)


def test_a_part_is_made_once_and_anew_for_another_key_or_where_a_file_is_gone_or_changed(tmp_path):
    made = []

    def make():
        made.append(1)
        return (ROWS, ROWS[:1]), b"a picture"

    first = part(tmp_path, "k").complete(make)
    assert first == ([[ROWS[0], ROWS[1] | {"scale": ""}], ROWS[:1]], b"a picture")
    assert part(tmp_path, "k").complete(make) == first
    assert len(made) == 1
    (tmp_path / "bones.csv").write_text("bone\nfemur\n")
    assert part(tmp_path, "k").complete(make) == first
    (tmp_path / "pictures" / "bones.png").unlink()
    assert part(tmp_path, "k").complete(make) == first
    (tmp_path / "bones_kept.json").write_text("torn")
    assert part(tmp_path, "k").complete(make) == first
    assert part(tmp_path, "other").complete(make) == first
    assert len(made) == 5


def test_a_key_is_another_for_other_code_other_facts_and_other_bones():
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


def test_bones_are_measured_once_and_anew_for_another_seed(made_up, tmp_path, monkeypatch):
    mesh = bone_comparison.build_bones(pssf.Knee(), load_anatomy_tables())["patella"]
    for number in range(2):
        (tmp_path / "given" / "patella").mkdir(parents=True, exist_ok=True)
        larger = Mesh(mesh.vertices * (1.0, 1.0, 1.0 + 0.1 * number), mesh.faces)
        larger.as_trimesh().export(tmp_path / "given" / "patella" / f"{number}.stl")
    seen, whole = [], bone_comparison.compare_bones
    monkeypatch.setattr(bone_comparison, "compare_bones", lambda *given: seen.append(1) or whole(*given))
    settings = {"bones_folder": tmp_path / "given"}
    first = measure(tmp_path / "out", **settings)
    page, tables = first.page.read_text(), tables_of(tmp_path / "out")
    again = measure(tmp_path / "out", **settings)
    assert len(seen) == 1
    assert again.page.read_text() == page
    assert tables_of(tmp_path / "out") == tables
    assert again.rows == first.rows
    assert {"built mean to patient mean", "sampled bones to built mean"} < {row["what"] for row in first.rows["bones"]}
    measure(tmp_path / "out", **settings, seed=5)
    assert len(seen) == 2
