"""Check the verification of cohorts: every fault of files, records and the manifest is reported."""

import csv
import dataclasses
import shutil

import pytest
from command_line import run_in_process

import pssf
from pssf import cohort
from pssf.io import cohort_records


@pytest.fixture
def folder(whole_cohort, tmp_path):
    """Copy a complete cohort for a test that damages it."""
    return shutil.copytree(whole_cohort, tmp_path / "c")


def find_first_file(folder, name):
    return min((folder / name).iterdir())


def append_byte(path):
    path.write_bytes(path.read_bytes() + b"x")


def change_cell(folder, column, value):
    """Change a value in the first row of the manifest."""
    path = folder / "manifest.csv"
    with open(path) as handle:
        rows = list(csv.DictReader(handle))
    rows[0][column] = value
    with open(path, "w", newline="") as handle:
        writer = csv.DictWriter(handle, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def replace_text(folder, name, old, new):
    path = folder / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def remove_last_line(path):
    """Remove the last line of a file."""
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))


def test_a_complete_cohort_has_no_faults_and_is_counted(folder):
    found = cohort.verify_cohort(folder)
    assert found.faults == ()
    assert (found.radiographs, found.files) == (6, len([p for p in folder.rglob("*") if p.is_file()]))


@pytest.mark.parametrize(
    ("damage", "lines"),
    [
        (lambda f: append_byte(find_first_file(f, "images")), ["images/s0000_k0000_low_dose.tif: changed (sha256 "]),
        (lambda f: find_first_file(f, "images").unlink(), ["images/s0000_k0000_low_dose.tif: missing"]),
        (lambda f: append_byte(find_first_file(f, "records")), ["records/k0000.json: damaged ("]),
        (lambda f: find_first_file(f, "records").unlink(), ["records/k0000.json: missing ("]),
        (lambda f: (f / "images" / "mine.tif").touch(), ["images/mine.tif: extra ("]),
        (lambda f: (f / "images" / ".pssf-a-1.tif").touch(), ["images/.pssf-a-1.tif: unfinished ("]),
        (lambda f: (f / ".pssf-a-1.csv").touch(), [".pssf-a-1.csv: unfinished ("]),
        (lambda f: change_cell(f, "jsw_medial_mm", "9.9"), ["manifest.csv: changed ("]),
        (lambda f: change_cell(f, "knee", "first"), ["manifest.csv: damaged ("]),
        (lambda f: (f / "manifest.csv").unlink(), ["manifest.csv: missing ("]),
        (lambda f: (f / "manifest.csv").write_text("file\nx\n"), ["manifest.csv: damaged ("]),
        (lambda f: (f / "manifest.csv").write_bytes(b"\xff"), ["manifest.csv: damaged ("]),
        (lambda f: (f / "cohort.json").write_text("{}"), ["cohort.json: damaged ("]),
        (lambda f: (f / "cohort.json").write_text("[" * 100_000), ["cohort.json: damaged ("]),
        (lambda f: replace_text(f, "cohort.json", '"seed": 5', '"seed": 6'), ["cohort.json: changed ("]),
        (
            lambda f: replace_text(f, "cohort.json", '"jsw_definition": "projected"', '"jsw_definition": "read"'),
            ["cohort.json: changed ("],
        ),
        (lambda f: replace_text(f, "cohort.json", '"seed": 5', '"seed": "5"'), ["cohort.json: damaged ("]),
        (lambda f: replace_text(f, "records/k0000.json", "{", "[{"), ["records/k0000.json: damaged ("]),
        (lambda f: (f / "records" / "k0000.json").write_text('{"rows": [1]}'), ["records/k0000.json: damaged ("]),
        (lambda f: change_cell(f, "file", "/etc/passwd"), ["manifest.csv: damaged ("]),
        (lambda f: change_cell(f, "file", "images/../../x.tif"), ["manifest.csv: damaged ("]),
        (
            lambda f: remove_last_line(f / "manifest.csv"),
            [
                "manifest.csv: has 5 radiographs, not the 6 that cohort.json requests",
                "manifest.csv: changed (",
                "images/s0002_k0002_low_dose.tif: extra (",
            ],
        ),
    ],
)
def test_every_fault_is_reported_in_one_line_with_the_file_name(folder, damage, lines):
    damage(folder)
    faults = cohort.verify_cohort(folder).faults
    assert len(faults) == len(lines)
    for fault, line in zip(faults, lines, strict=True):
        assert fault.startswith(line)


def test_changing_an_image_together_with_its_hash_is_detected(folder):
    image = find_first_file(folder, "images")
    append_byte(image)
    with open(folder / "manifest.csv") as handle:
        row = next(row for row in csv.DictReader(handle) if row["file"].endswith(image.name))
    path = folder / "manifest.csv"
    path.write_text(path.read_text().replace(row["sha256"], pssf.io.cohort_records.hash_file(image)))
    assert [fault.split(" (")[0] for fault in cohort.verify_cohort(folder).faults] == ["manifest.csv: changed"]


def test_verifying_a_folder_without_a_cohort_raises_an_error(tmp_path):
    with pytest.raises(pssf.InputError, match=r"has no cohort\.json"):
        cohort.verify_cohort(tmp_path)


def test_the_verify_command_prints_faults_and_sets_the_exit_code(folder):
    whole = run_in_process("cohort", "verify", folder)
    assert (whole.returncode, whole.stdout) == (0, "intact    6 radiographs, 11 files, all unchanged\n")
    for image in list((folder / "images").iterdir())[:2]:
        append_byte(image)
    broken = run_in_process("cohort", "verify", folder)
    assert broken.returncode == 2
    assert broken.stdout.count("\n") == broken.stdout.count(": changed (sha256 ") == 2
    assert broken.stderr == ""


def test_a_record_of_another_cohort_is_reported(folder):
    path = find_first_file(folder, "records")
    record = cohort_records.read_knee_record(path)
    cohort_records.write_knee_record(folder, 0, record.rows, "0" * 64)
    assert [fault.split(" (")[0] for fault in cohort.verify_cohort(folder).faults] == [
        "records/k0000.json: made for another cohort.json"
    ]


def test_a_complete_folder_of_repeats_has_no_faults(small_protocols, tmp_path):
    plan = cohort.plan_cohort("quick", seed=5, overrides={"knees": [0, 0, 1], "protocols": small_protocols})
    repeats = cohort.plan_retest(dataclasses.replace(plan, retested=1), reference="low_dose")
    cohort.make_cohort(repeats, tmp_path / "repeats", workers=1)
    assert cohort.verify_cohort(tmp_path / "repeats").faults == ()


def test_a_record_with_a_path_outside_its_folder_raises_an_error(folder):
    path = find_first_file(folder, "records")
    record = cohort_records.read_knee_record(path)
    rows = [{**row, "file": "/etc/passwd"} for row in record.rows]
    cohort_records.write_knee_record(folder, 0, rows, record.cohort_sha256)
    with pytest.raises(pssf.InputError, match=r"file .*k0000\.json is damaged") as raised:
        cohort_records.read_verified_rows(folder, 0, [row["radiograph"] for row in rows], record.cohort_sha256)
    assert "/etc/passwd" not in str(raised.value)
