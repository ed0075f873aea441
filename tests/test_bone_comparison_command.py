"""Check the bone comparison command: it recovers known displacements and rejects invalid folders."""

import json

import numpy as np
import pandas as pd
import pytest
from command_line import run as run_pssf

from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.geometry.mesh import Mesh
from pssf.model.knee import Knee
from pssf.patient_comparison.bones import bone_comparison

# Surface waves, which no similarity transform removes: mean amplitude, deviation of each knee, wavelength; and scale.
MEAN_MM, SPREAD_MM, WAVE_MM, SIZE = 0.4, 0.3, 12.0, 1.1


def displace_mesh(mesh, heights_mm):
    """Scale a mesh by SIZE and displace its vertices along their normals by waves in the x and y directions."""
    shape = mesh.as_trimesh()
    vertices = SIZE * np.asarray(shape.vertices)
    waves = np.sin(2 * np.pi / WAVE_MM * vertices[:, :2])
    return Mesh(vertices + np.asarray(shape.vertex_normals) * (waves @ heights_mm)[:, None], mesh.faces)


@pytest.fixture(scope="module")
def patient_bones():
    """Make two scaled and displaced copies of each bone of the package."""
    built = bone_comparison.build_bones(Knee(), load_anatomy_tables())
    heights_mm = [(MEAN_MM, sign * SPREAD_MM) for sign in (-1, 1)]
    return {name: [displace_mesh(mesh, pair) for pair in heights_mm] for name, mesh in built.items()}


def write_archive(path, patient_bones):
    arrays = {f"{name}_mm": np.stack([mesh.vertices for mesh in meshes]) for name, meshes in patient_bones.items()}
    arrays |= {f"{name}_faces": meshes[0].faces for name, meshes in patient_bones.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **arrays)


def run_comparison(folder, out):
    done = run_pssf(
        "compare-patients", "--bones", folder, "--knees", "6", "--grade-table", "paper", "--workers", "1", "--out", out
    )
    assert done.returncode == 0, done.stderr
    return done, pd.read_csv(out / "bones.csv").set_index(["bone", "comparison"])


@pytest.mark.slow  # Bones of several subjects are built and compared.
def test_known_displacements_of_bones_are_recovered(patient_bones, tmp_path):
    write_archive(tmp_path / "given" / "knees.npz", patient_bones)
    done, table = run_comparison(tmp_path / "given", tmp_path / "out")
    for name in patient_bones:
        mean, spread = table.loc[name, "built mean to patient mean"], table.loc[name, "patient bones to their mean"]
        assert mean["scale"] == pytest.approx(SIZE, rel=0.01)
        assert mean["rms_mm"] == pytest.approx(MEAN_MM / np.sqrt(2), rel=0.15)
        assert spread["rms_mm"] == pytest.approx(SPREAD_MM / np.sqrt(2), rel=0.15)
        assert (mean["bones"], spread["bones"]) == (2, 2)
    facts = json.loads((tmp_path / "out" / "patient_comparison.json").read_text())
    assert [row["rms_mm"] for row in facts["bones"]["rows"]] == pytest.approx(table["rms_mm"].tolist())
    assert f"femur built mean to patient mean {table['rms_mm'].iloc[0]:.2f} mm" in done.stdout
    page = (tmp_path / "out" / "patient_comparison.html").read_text()
    assert "Bones of the default knee, coloured by distance" in page
    assert (tmp_path / "out" / "pictures" / "bones.png").stat().st_size > 10_000
    assert set(pd.read_csv(tmp_path / "out" / "bones_shape_measures.csv")["bone"]) == set(patient_bones)


def test_a_missing_bone_is_omitted_from_the_comparison(patient_bones, tmp_path):
    for index, mesh in enumerate(patient_bones["patella"]):
        (tmp_path / "given" / "patella").mkdir(parents=True, exist_ok=True)
        mesh.as_trimesh().export(tmp_path / "given" / "patella" / f"{index}.stl")
    done, table = run_comparison(tmp_path / "given", tmp_path / "out")
    assert set(table.index.get_level_values("bone")) == {"patella"}
    assert "femur" not in done.stdout


def make_empty_folder(folder, patient_bones):
    folder.mkdir()


def write_text_file(folder, patient_bones):
    folder.mkdir()
    (folder / "letter.txt").write_text("no bones")


def write_other_arrays(folder, patient_bones):
    folder.mkdir()
    np.savez(folder / "knees.npz", skull_mm=np.zeros((2, 3, 3)))


def write_invalid_archive(folder, patient_bones):
    folder.mkdir()
    (folder / "knees.npz").write_text("no arrays")


def write_archive_without_faces(folder, patient_bones):
    write_archive(folder / "knees.npz", patient_bones)
    with np.load(folder / "knees.npz") as whole:
        np.savez(folder / "knees.npz", **{name: whole[name] for name in whole.files if name != "tibia_faces"})


def make_empty_bone_folders(folder, patient_bones):
    for name in ("femur", "tibia"):
        (folder / name).mkdir(parents=True)
    patient_bones["patella"][0].as_trimesh().export(folder / "femur" / "a.stl")


@pytest.mark.parametrize(
    ("write", "line"),
    [
        (make_empty_folder, "must contain one .npz with femur_mm"),
        (write_text_file, "must contain one .npz with femur_mm"),
        (write_other_arrays, "must contain one .npz with femur_mm"),
        (write_invalid_archive, "no arrays"),
        (write_archive_without_faces, "must contain tibia_mm and tibia_faces, got only tibia_mm"),
        (make_empty_bone_folders, "tibia contains no STL, PLY or OBJ files"),
    ],
)
def test_an_invalid_folder_of_bones_gives_a_one_line_error_and_no_files(write, line, patient_bones, tmp_path):
    write(tmp_path / "given", patient_bones)
    done = run_pssf(
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
