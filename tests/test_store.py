"""What is kept on disk is what would be made, and is made anew when what makes it has changed."""

import numpy as np
import pytest

import pssf
from pssf.anatomy.femur import mean_femur
from pssf.anatomy.mean_bone import Plates
from pssf.data import code, store
from pssf.data.anatomy import anatomy_tables
from pssf.xray.spectrum import tube_spectrum

ORIGIN = store.Origin(sources=("core",), libraries=("numpy",))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("PSSF_CACHE_DIR", str(tmp_path))
    return tmp_path


def forget():
    store.digest_of.cache_clear()
    code.code_digest.cache_clear()


def counted():
    calls = []

    def make():
        calls.append(1)
        return {"a": np.arange(3.0)}

    return make, calls


def test_arrays_are_made_once_and_come_back_bit_for_bit(folder):
    make, calls = counted()
    for _ in range(2):
        np.testing.assert_array_equal(store.kept("thing", ORIGIN, make)["a"], np.arange(3.0))
    assert len(calls) == 1
    assert len(list(folder.iterdir())) == 1


def test_a_change_of_code_or_library_makes_them_anew_and_few_versions_are_kept(folder, tmp_path, monkeypatch):
    make, calls = counted()
    store.kept("thing", ORIGIN, make)
    package = tmp_path / "package"
    (package / "core").mkdir(parents=True)
    monkeypatch.setattr(code, "ROOT", package)
    for version in range(7):
        (package / "core" / "checks.py").write_text(f"version = {version}\n")
        forget()
        store.kept("thing", ORIGIN, make)
        store.kept("thing", ORIGIN, make)
    store.kept("thing", store.Origin(sources=("core",), libraries=("numpy", "scipy")), make)
    forget()
    assert len(calls) == 9
    assert len(list(folder.glob("thing-*"))) == 4


def test_a_damaged_file_a_folder_that_cannot_be_written_and_off_cost_time_alone(folder, monkeypatch):
    make, calls = counted()
    store.kept("thing", ORIGIN, make)
    next(folder.iterdir()).write_bytes(b"PK nothing of the kind")
    assert store.kept("thing", ORIGIN, make)["a"][2] == 2.0
    for named in ("off", "/proc/nowhere"):
        monkeypatch.setenv("PSSF_CACHE_DIR", named)
        assert store.kept("thing", ORIGIN, make)["a"][2] == 2.0
    assert len(calls) == 4


def test_a_knee_of_kept_solids_is_the_knee_of_solids_made_now(folder, monkeypatch):
    knees = []
    for named in ("off", str(folder), str(folder)):
        monkeypatch.setenv("PSSF_CACHE_DIR", named)
        mean_femur.cache_clear()
        knees.append(pssf.build(pssf.Knee(osteophytes=(pssf.Osteophyte(site="medial_femur", size_mm=2.0),))))
    for other in knees[1:]:
        for one, two in zip(knees[0].scene.surfaces, other.scene.surfaces, strict=True):
            np.testing.assert_array_equal(one.mesh.vertices, two.mesh.vertices)
            np.testing.assert_array_equal(one.mesh.faces, two.mesh.faces)


def test_a_spectrum_from_the_folder_is_the_one_that_is_computed(folder):
    beams = []
    for _ in range(2):
        tube_spectrum.cache_clear()
        beams.append(tube_spectrum(71.5, 12.0, 3.0))
    for one, two in zip(*beams, strict=True):
        np.testing.assert_array_equal(one, two)
    assert [path.name.rsplit("-", 1)[0] for path in folder.iterdir()] == ["spectrum-71.5-12.0-3.0-0.0"]


def test_the_solids_of_the_mean_femur_are_kept(folder):
    mean_femur.cache_clear()
    mean = mean_femur(anatomy_tables().shape.femur, anatomy_tables().forms)
    assert mean.outer.num_tri() > mean.inner(1.0, Plates(1.0, 1.0, 10.0)).num_tri() > 1000
    assert [path.name.split("-")[0] for path in folder.iterdir()] == ["femur"]
    mean_femur.cache_clear()
