"""Check lists of patient radiographs: files, names of subjects and sides, and invalid tables."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_patient_radiographs import make_grey_ramp, write_dicom, write_film

from pssf.core.checks import InputError
from pssf.io import cohort_records, file_conditions, study_results
from pssf.io.csv_rows import read_csv_rows
from pssf.io.meshes.bone_folder import read_bones
from pssf.io.patients.patient_radiographs import (
    Film,
    list_films,
    parse_subject_and_side,
    read_film,
)

CELLS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs", "Zl", "Zp"]), max_size=6)


@pytest.mark.parametrize(
    ("one", "other", "subject"),
    [
        ("P1_left", "P1_right", "P1"),
        ("P1-LEFT", "P1-Right", "P1"),
        ("left_P1", "right_P1", "P1"),
        ("P1_left_knee", "P1_right_knee", "P1_knee"),
        ("smith left", "smith right", "smith"),
        ("12links", "12rechts", "12"),
        ("12_gauche", "12_droite", "12"),
        ("12_l", "12_r", "12"),
        ("p12a_L", "p12a_R", "p12a"),
    ],
)
def test_file_names_of_both_knees_give_one_subject(one, other, subject):
    assert parse_subject_and_side(one) == (subject, "left")
    assert parse_subject_and_side(other) == (subject, "right")


@pytest.mark.parametrize("stem", ["bright_1", "cleft2", "Smith_L", "12_left_right", "leftover", "ANNAL", "12l", "R_12"])
def test_an_ambiguous_file_name_gives_no_side(stem):
    assert parse_subject_and_side(stem) == (stem, None)


def test_the_subject_of_a_file_named_by_side_is_the_folder_name(tmp_path):
    for name in ("P1/left.png", "P1/right.png", "P2/left.png"):
        write_film(tmp_path / name)
    (tmp_path / "P2" / "left.png").write_bytes((tmp_path / "P1" / "right.png").read_bytes()[:-1] + b"x")
    (tmp_path / "films.csv").write_text("file\nP1/left.png\nP1/right.png\nP2/left.png\n")
    assert [(f.subject, f.side) for f in list_films(tmp_path)] == [("P1", "left"), ("P1", "right"), ("P2", "left")]


def test_hidden_and_lock_files_are_not_listed(tmp_path):
    write_film(tmp_path / "0" / "7.png")
    for name in ("0/._7.png", "0/.hidden.png", "0/.DS_Store", "0/Thumbs.db", ".DS_Store"):
        (tmp_path / name).write_bytes(b"\x00\x05\x16\x07 not a picture")
    for name in ("~$films.csv", "._films.csv"):
        (tmp_path / name).write_bytes(b"\x00 lock")
    assert [film.file for film in list_films(tmp_path)] == ["0/7.png"]
    (tmp_path / "FILMS.CSV").write_text("file\n0/7.png\n")
    assert [film.grade for film in list_films(tmp_path)] == [
        None
    ]  # the table is read although its suffix is upper-case


def test_hidden_files_are_not_read_as_bones(tmp_path):
    np.savez(tmp_path / "bones.npz", femur_mm=np.eye(3)[None], femur_faces=[[0, 1, 2]])
    (tmp_path / "._bones.npz").write_bytes(b"\x00\x05\x16\x07")
    assert len(read_bones(tmp_path)["femur"]) == 1


def test_dicom_files_are_found_with_any_file_name(tmp_path):
    for name in ("a.dcm", "b.write_dicom", "c.IMA", "1.2.840.113619.7", "IM0001", "DICOMDIR"):
        write_dicom(tmp_path / name, make_grey_ramp(8))
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / "README").write_text("no image")
    films = list_films(tmp_path)
    assert [film.file for film in films] == ["1.2.840.113619.7", "IM0001", "a.dcm", "b.write_dicom", "c.IMA"]
    assert films[0].subject == "1.2.840.113619.7"
    expected = read_film(tmp_path / "a.dcm")
    assert all(np.array_equal(read_film(tmp_path / film.file).pixels, expected.pixels) for film in films[:2])


def test_a_grade_written_as_a_float_is_read_as_an_integer(tmp_path):
    for name in ("a.png", "b.png"):
        write_film(tmp_path / name)
    (tmp_path / "films.csv").write_text("file,grade,subject\na.png,2.0,9003175.0\nb.png,,\n")
    one, other = list_films(tmp_path)
    assert (one.grade, one.subject, other.grade) == (2, "9003175", None)
    (tmp_path / "films.csv").write_text("file,grade\na.png,1.5\n")
    with pytest.raises(InputError, match=r"line 2: grade must be one of .*, got '1\.5'"):
        list_films(tmp_path)


@pytest.mark.parametrize(
    "read",
    [
        list_films,
        read_csv_rows,
        lambda path: cohort_records.read_csv(path, ("file",)),
        cohort_records.read_manifest,
        study_results.load_table,
        study_results.load_typed_table,
    ],
    ids=["films", "rows", "records", "manifest", "table", "typed table"],
)
def test_every_table_reader_rejects_a_duplicate_column(read, tmp_path):
    write_film(tmp_path / "a.png")
    path = tmp_path / "films.csv"
    path.write_text("file,grade,grade\na.png,2,3\n")
    with pytest.raises(InputError, match="column name 'grade' must be unique, got 2 columns"):
        read(path)
    # A checklist condition on a table with duplicate columns is not met.
    assert file_conditions.find_unmet_condition(tmp_path, "films.csv grade = 3")


def test_two_spellings_of_a_path_count_as_a_duplicate(tmp_path):
    write_film(tmp_path / "a.png")
    (tmp_path / "films.csv").write_text("file,grade\na.png,2\n./a.png,2\n")
    with pytest.raises(InputError, match=r"line 3: file must be listed once, got '\./a\.png' again"):
        list_films(tmp_path)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"grade": 1.5}, "grade must be one of 0, 1, 2, 3, 4, .*got 1.5"),
        ({"grade": float("nan")}, "grade must be one of .*, got nan"),
        ({"side": "up"}, "side must be one of .*, got 'up'"),
        ({"pixel_mm": "0.15"}, "pixel_mm must be .*, got '0.15' mm"),
        ({"pixel_mm": float("nan")}, "pixel_mm must be .*, got nan mm"),
        ({"subject": float("nan")}, "subject must be text, got nan"),
    ],
)
def test_a_film_created_in_python_is_checked_like_a_table_row(more, why):
    with pytest.raises(InputError, match=why):
        Film(**{"file": "a.png", "grade": None, "subject": "1", "side": None, "pixel_mm": None, "sha256": "0"} | more)


@given(rows=st.lists(st.lists(CELLS, min_size=2, max_size=2), max_size=4))
def test_csv_rows_are_read_as_written(rows, tmp_path_factory):
    import csv

    path = tmp_path_factory.mktemp("rows") / "table.csv"
    with open(path, "w", newline="", encoding="utf-8") as handle:
        csv.writer(handle).writerows([["a", "b"], *rows])
    assert read_csv_rows(path) == (["a", "b"], [{"a": one, "b": two} for one, two in rows])
