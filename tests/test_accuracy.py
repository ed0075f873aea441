import csv
import dataclasses

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from pssf import accuracy, load_protocol
from pssf.geometry import view_of


def test_engines_meet_the_exact_polyhedron_and_leave_no_ray_unrepaired():
    rows = accuracy.engine_rows(2, subdivisions=(3,), sides=(128,))
    assert [row["engine"] for row in rows] == ["embree", "scanline"]
    for row in rows:
        assert row["engine_error_mm"] < 1e-5
        assert row["unrepaired"] == 0
        assert row["seconds"] > 0


def test_more_nodes_of_the_spectrum_err_less():
    errors = [row["max_relative_error"] for row in accuracy.spectrum_rows((4, 12, 36))]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-3


def test_the_exact_chord_of_a_box_through_its_middle_is_its_depth():
    box = trimesh.creation.box(extents=(20, 30, 20))
    view = view_of(dataclasses.replace(load_protocol("reference"), rows=3, cols=3, pixel_mm=50.0))
    middle = np.array([[1, 1], [0, 0]])
    assert_allclose(accuracy.polyhedron_chords(box, middle, view), [30.0, 0.0], rtol=1e-12)
    assert_allclose(accuracy.sphere_chords(15.0, middle, view), [30.0, 0.0], rtol=1e-12)


def test_a_whole_run_writes_its_tables(tmp_path, monkeypatch):
    for name in ("engine_rows", "spectrum_rows", "stage_rows", "physics_rows", "knee_rows"):
        monkeypatch.setattr(accuracy, name, lambda *a: [{"a": 1, "b": 2.5}])
    paths = accuracy.measure(tmp_path / "out", workers=1)
    assert [p.name for p in paths][:2] == ["engines.csv", "spectrum.csv"]
    with open(paths[0]) as handle:
        assert list(csv.DictReader(handle)) == [{"a": "1", "b": "2.5"}]


@pytest.mark.slow
def test_stages_are_measured_in_processes_of_their_own():
    rows = accuracy.stage_rows(2)
    assert [row["run"] for row in rows if row["engine"] == "embree"] == ["cold", "first", "second"]
