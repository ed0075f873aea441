"""The bones' part through the command line: known displacements come back, what is no folder of bones is refused."""

import json

import numpy as np
import pandas as pd
import pytest
from command import run as pssf_command

from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.geometry.mesh import Mesh
from pssf.model.knee import Knee
from pssf.patient_comparison.bones import bone_comparison

# Of the mean, and of two knees about it: waves along the normals, which no similarity takes out.
MEAN_MM, ABOUT_MM, WAVE_MM, SIZE = 0.4, 0.3, 12.0, 1.1


def waved(mesh, heights_mm):
    """A mesh SIZE times as large, each vertex moved along its normal by one wave along x and one along y."""
    shape = mesh.as_trimesh()
    vertices = SIZE * np.asarray(shape.vertices)
    waves = np.sin(2 * np.pi / WAVE_MM * vertices[:, :2])
    return Mesh(vertices + np.asarray(shape.vertex_normals) * (waves @ heights_mm)[:, None], mesh.faces)


@pytest.fixture(scope="module")
def people():
    """Bone -> two bones: the package's own, larger and displaced."""
    built = bone_comparison.build_bones(Knee(), load_anatomy_tables())
    return {name: [waved(mesh, (MEAN_MM, sign * ABOUT_MM)) for sign in (-1, 1)] for name, mesh in built.items()}


def archive(path, people):
    arrays = {f"{name}_mm": np.stack([mesh.vertices for mesh in meshes]) for name, meshes in people.items()}
    arrays |= {f"{name}_faces": meshes[0].faces for name, meshes in people.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **arrays)


def measured(folder, out):
    done = pssf_command(
        "compare-patients", "--bones", folder, "--knees", "6", "--grade-table", "paper", "--workers", "1", "--out", out
    )
    assert done.returncode == 0, done.stderr
    return done, pd.read_csv(out / "bones.csv").set_index(["bone", "what"])


def test_known_displacements_of_bones_come_back_in_tables_and_page(people, tmp_path):
    archive(tmp_path / "given" / "knees.npz", people)
    done, table = measured(tmp_path / "given", tmp_path / "out")
    for name in people:
        mean, about = table.loc[name, "built mean to patient mean"], table.loc[name, "patient bones to their mean"]
        assert mean["scale"] == pytest.approx(SIZE, rel=0.01)
        assert mean["rms_mm"] == pytest.approx(MEAN_MM / np.sqrt(2), rel=0.15)
        assert about["rms_mm"] == pytest.approx(ABOUT_MM / np.sqrt(2), rel=0.15)
        assert (mean["bones"], about["bones"]) == (2, 2)
    facts = json.loads((tmp_path / "out" / "realism.json").read_text())
    assert [row["rms_mm"] for row in facts["bones"]["rows"]] == pytest.approx(table["rms_mm"].tolist())
    assert f"femur built mean to patient mean {table['rms_mm'].iloc[0]:.2f} mm" in done.stdout
    page = (tmp_path / "out" / "realism.html").read_text()
    assert "Built mean bones coloured by distance" in page
    assert (tmp_path / "out" / "pictures" / "bones.png").stat().st_size > 10_000
    assert set(pd.read_csv(tmp_path / "out" / "bones_forms.csv")["bone"]) == set(people)


def test_a_bone_that_is_not_given_is_left_out(people, tmp_path):
    for at, mesh in enumerate(people["patella"]):
        (tmp_path / "given" / "patella").mkdir(parents=True, exist_ok=True)
        mesh.as_trimesh().export(tmp_path / "given" / "patella" / f"{at}.stl")
    done, table = measured(tmp_path / "given", tmp_path / "out")
    assert set(table.index.get_level_values("bone")) == {"patella"}
    assert "femur" not in done.stdout


def empty(folder, people):
    folder.mkdir()


def of_something_else(folder, people):
    folder.mkdir()
    (folder / "letter.txt").write_text("no bones")


def other_arrays(folder, people):
    folder.mkdir()
    np.savez(folder / "knees.npz", skull_mm=np.zeros((2, 3, 3)))


def no_archive(folder, people):
    folder.mkdir()
    (folder / "knees.npz").write_text("no arrays")


def without_faces(folder, people):
    archive(folder / "knees.npz", people)
    with np.load(folder / "knees.npz") as whole:
        np.savez(folder / "knees.npz", **{name: whole[name] for name in whole.files if name != "tibia_faces"})


def empty_kind(folder, people):
    for name in ("femur", "tibia"):
        (folder / name).mkdir(parents=True)
    people["patella"][0].as_trimesh().export(folder / "femur" / "a.stl")


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (empty, "must have one .npz with femur_mm"),
        (of_something_else, "must have one .npz with femur_mm"),
        (other_arrays, "must have one .npz with femur_mm"),
        (no_archive, "no arrays"),
        (without_faces, "must have tibia_faces, got none"),
        (empty_kind, "tibia must have meshes, got none"),
    ],
)
def test_what_is_no_folder_of_bones_is_one_line_and_leaves_nothing(given, line, people, tmp_path):
    given(tmp_path / "given", people)
    done = pssf_command(
        "compare-patients",
        "--bones",
        tmp_path / "given",
        "--knees",
        "6",
        "--grade-table",
        "paper",
        "--out",
        tmp_path / "o",
    )
    assert done.returncode == 2
    assert done.stderr.startswith("pssf: ")
    assert line in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
