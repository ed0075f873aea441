"""Check cohorts: plans, manifests, resumed and interrupted runs, and retests."""

import csv
import dataclasses
import errno
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from conftest import append_byte, forget_built_knees

import pssf
from pssf import cohort
from pssf.cohort import cohort_maker, run_environment
from pssf.cohort import cohort_plan as plan_module
from pssf.data import code_hash
from pssf.io import atomic_write, cohort_records


@pytest.fixture
def protocols(small_protocols):
    return small_protocols


@pytest.fixture
def made(whole_cohort, tmp_path):
    """Copy the finished cohort of `plan_tiny_cohort` and return its folder."""
    return shutil.copytree(whole_cohort, tmp_path / "c")


def plan_tiny_cohort(protocols, knees=(1, 1, 1), **more):
    """Plan a cohort of a few knees."""
    return cohort.plan_cohort("quick", seed=5, overrides={"knees": list(knees), "protocols": protocols, **more})


def compute_digests(folder):
    return {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()}


def read_rows(manifest):
    with open(manifest) as handle:
        return list(csv.DictReader(handle))


def test_the_quick_preset_has_24_subjects_3_grades_and_3_protocols():
    plan = cohort.plan_cohort("quick", seed=0)
    assert len({case.subject for case in plan.cases}) == 24
    assert Counter(case.knee.grade for case in plan.cases) == {0: 8, 1: 8, 2: 8}
    assert {tuple(e.protocol.name for e in case.exposures) for case in plan.cases} == {
        ("reference", "low_dose", "geometry_shift")
    }


def test_the_paper_preset_has_180_subjects_and_780_radiographs():
    plan = cohort.plan_cohort("paper", seed=0)
    assert len({case.subject for case in plan.cases}) == 180
    assert Counter(case.knee.grade for case in plan.cases) == {0: 130, 1: 78, 2: 52}
    assert sum(len(case.exposures) for case in plan.cases) == 780
    assert len({e.seed for case in plan.cases for e in case.exposures}) == 780


def test_both_knees_of_a_subject_have_the_same_body_and_opposite_sides():
    plan = cohort.plan_cohort("paper", seed=0)
    pairs = [
        knees
        for subject in range(60)
        if len(knees := [case.knee for case in plan.cases if case.subject == subject]) == 2
    ]
    assert len(pairs) > 10
    for one, two in pairs:
        assert {one.side, two.side} == {"left", "right"}
        assert (one.sex, one.stature_mm, one.bone_scale) == (two.sex, two.stature_mm, two.bone_scale)
        assert one.jsw_medial_mm != two.jsw_medial_mm


def test_both_knees_of_a_subject_are_correlated_only_through_the_grade():
    plan = cohort.plan_cohort("paper", seed=1, overrides={"knees": [800, 800, 800], "bilateral": 1200})
    by_grade = sorted(plan.cases, key=lambda case: (case.knee.grade, case.subject, case.index))
    one, two = by_grade[::2], by_grade[1::2]
    assert [case.subject for case in one] == [case.subject for case in two]
    for name in ("jsw_medial_mm", "jsw_lateral_mm", "varus_deg"):
        pairs = np.array([[getattr(case.knee, name) for case in side] for side in (one, two)]).reshape(2, 3, 400)
        within = pairs - pairs.mean(axis=2, keepdims=True)
        # The tolerance is four standard deviations (0.03 each) of the correlation of 1200 uncorrelated pairs.
        assert abs(np.corrcoef(within[0].ravel(), within[1].ravel())[0, 1]) < 0.12
        if name == "jsw_medial_mm":
            assert np.corrcoef(pairs[0].ravel(), pairs[1].ravel())[0, 1] > 0.5


def test_a_plan_of_4000_knees_is_recorded_unchanged(tmp_path):
    plan = cohort.plan_cohort("quick", seed=0, overrides={"knees": [2000, 1000, 1000], "bilateral": 1000})
    assert len(plan.cases) == 4000
    for _ in range(2):
        cohort_records.claim_folder(tmp_path / "cohort.json", plan.build_request())
    assert json.loads((tmp_path / "cohort.json").read_text()) == json.loads(json.dumps(plan.build_request()))


def test_each_manifest_row_matches_its_radiograph(protocols, made):
    rows = read_rows(cohort.make_cohort(plan_tiny_cohort(protocols), made, workers=1))
    assert len(rows) == 6
    for row in rows:
        file = made / row["file"]
        assert hashlib.sha256(file.read_bytes()).hexdigest() == row["sha256"]
        radiograph = pssf.load(file)
        assert float(row["jsw_medial_mm"]) == radiograph.truth.jsw_medial_mm
        assert float(row["nominal_jsw_medial_mm"]) == radiograph.knee.jsw_medial_mm
        assert int(row["grade"]) == radiograph.truth.grade == radiograph.knee.grade
        assert int(row["seed"]) == radiograph.seed
        assert float(row["mas"]) == radiograph.protocol.mas
        assert float(row["truth_medial_row_px"]) == pytest.approx(radiograph.truth.medial_joint_line_px[0], abs=1e-3)


def test_the_number_of_workers_does_not_change_the_cohort(protocols, whole_cohort, tmp_path):
    cohort.make_cohort(plan_tiny_cohort(protocols), tmp_path / "2", workers=2)
    assert compute_digests(tmp_path / "2") == compute_digests(whole_cohort)


def test_a_radiograph_is_reproduced_from_its_manifest_row(whole_cohort):
    row = read_rows(whole_cohort / "manifest.csv")[-1]
    original = pssf.load(whole_cohort / row["file"])
    forget_built_knees()
    again = pssf.simulate(original.knee, original.protocol, rng=int(row["seed"]), engine=row["engine"])
    assert (again.pixels == original.pixels).all()


def test_only_a_deleted_image_of_a_finished_cohort_is_created_again(protocols, made):
    plan, folder = plan_tiny_cohort(protocols), made
    before = compute_digests(folder)
    deleted = next((folder / "images").iterdir())
    unchanged = max((folder / "images").iterdir())
    deleted.unlink()
    stamp = unchanged.stat().st_mtime_ns
    cohort.make_cohort(plan, folder, workers=1)
    assert compute_digests(folder) == before
    assert unchanged.stat().st_mtime_ns == stamp


def test_a_damaged_image_is_named_in_the_error(protocols, made):
    plan, folder = plan_tiny_cohort(protocols), made
    image = min((folder / "images").iterdir())
    image.write_bytes(image.read_bytes()[:-1] + b"x")
    with pytest.raises(pssf.InputError, match=rf"{image.name} is damaged"):
        cohort.make_cohort(plan, folder, workers=1)


@pytest.mark.parametrize("content", ["", "{", "[1, 2]", "[]", "{}", "null"])
def test_a_damaged_record_is_named_in_the_error(protocols, made, content):
    plan, folder = plan_tiny_cohort(protocols), made
    record = min((folder / "records").iterdir())
    record.write_text(content)
    with pytest.raises(pssf.InputError, match=rf"{record.name} is damaged"):
        cohort.make_cohort(plan, folder, workers=1)


def test_a_changed_record_or_a_record_of_another_knee_is_rejected(protocols, made):
    plan, folder = plan_tiny_cohort(protocols), made
    one, two, _ = sorted((folder / "records").iterdir())
    whole = one.read_text()
    for content in (whole.replace('"jsw_medial_mm": ', '"jsw_medial_mm": 1'), two.read_text()):
        one.write_text(content)
        with pytest.raises(pssf.InputError, match=rf"{one.name} (is damaged|does not list the radiographs of knee 0)"):
            cohort.make_cohort(plan, folder, workers=1)


def test_a_folder_with_another_seed_is_rejected(protocols, made):
    other = cohort.plan_cohort("quick", seed=6, overrides={"knees": [1, 1, 1], "protocols": protocols})
    with pytest.raises(pssf.InputError, match=r"contains a different cohort \(seed = 5, requested 6\)"):
        cohort.make_cohort(other, made, workers=1)


@pytest.mark.parametrize("name", ["data/detector.toml", "raycast/engines/scanline.py"])
def test_the_error_for_a_cohort_of_other_code_names_the_changed_code(protocols, tmp_path, copied_code, name):
    cohort.make_cohort(plan_tiny_cohort(protocols, knees=(0, 0, 1)), tmp_path / "c", workers=1)
    before = compute_digests(tmp_path / "c")
    append_byte(copied_code / name)
    part = name if name.startswith("data") else name.split("/")[0]
    with pytest.raises(pssf.InputError, match=rf"a different version of the code, with differences in {part}; "):
        cohort.make_cohort(plan_tiny_cohort(protocols, knees=(0, 0, 1)), tmp_path / "c", workers=1)
    assert compute_digests(tmp_path / "c") == before


def test_changing_a_table_without_effect_on_pixels_keeps_a_cohort_valid(protocols, tmp_path, copied_code):
    plan = plan_tiny_cohort(protocols, knees=(0, 0, 1))
    cohort.make_cohort(plan, tmp_path / "c", workers=1)
    before = compute_digests(tmp_path / "c")
    for names in code_hash.TABLES_NOT_AFFECTING_PIXELS:
        for name in names:
            append_byte(copied_code / "data" / name)
    cohort.make_cohort(plan, tmp_path / "c", workers=1)
    assert compute_digests(tmp_path / "c") == before
    (copied_code / "data" / "new.toml").write_text("")
    with pytest.raises(pssf.InputError, match=r"version of the code, with differences in data/new\.toml;"):
        cohort.make_cohort(plan, tmp_path / "c", workers=1)


def test_a_cohort_record_without_code_hashes_is_treated_as_other_code(tmp_path):
    cohort_records.claim_folder(tmp_path / "cohort.json", {"seed": 1})
    with pytest.raises(pssf.InputError, match=r"version of the code, with differences in core, data;"):
        cohort_records.claim_folder(tmp_path / "cohort.json", {"seed": 1, "code": {"core": "a", "data": "b"}})


def test_retests_are_balanced_by_grade_and_use_the_reference_protocol():
    plan = cohort.plan_cohort("paper", seed=0)
    repeats = cohort.plan_retest(plan)
    known = {case.index: case for case in plan.cases}
    again = [case for case in repeats.cases if case.index in known]
    assert sorted(Counter(case.knee.grade for case in again).values()) == [6, 7, 7]
    assert len({case.subject for case in again}) == len(again) == 20
    assert len({case.index for case in repeats.cases}) == len(repeats.cases) == 60
    assert all(case.knee == known[case.index].knee for case in again)
    exposures = [exposure for case in repeats.cases for exposure in case.exposures]
    assert len(exposures) == 80
    seeds = {exposure.seed for exposure in exposures} | {e.seed for case in plan.cases for e in case.exposures}
    assert len(seeds) == 80 + 780
    assert {exposure.protocol.name for exposure in exposures} == {"reference"}


def test_repositioned_knees_differ_in_opposite_directions_and_only_in_pose():
    plan = cohort.plan_cohort("quick", seed=0, overrides={"retested": 24})
    repositioned: dict[int, list] = {}
    for case in cohort.plan_retest(plan).cases:
        for exposure in case.exposures:
            if exposure.retest_kind == "perturbation":
                repositioned.setdefault(exposure.source_knee, []).append((case.knee, exposure.protocol))
    assert len(repositioned) == 24
    for index, ((one, beam), (two, other)) in repositioned.items():
        knee = plan.cases[index].knee
        assert one.rotation_deg + two.rotation_deg == pytest.approx(2 * knee.rotation_deg)
        assert abs(one.rotation_deg - knee.rotation_deg) == pytest.approx(2)
        assert {beam.beam_angle_deg, other.beam_angle_deg} == {-1.0, 1.0}
        low, high = sorted((one.flexion_deg, two.flexion_deg))
        assert high == pytest.approx(knee.flexion_deg + 2)
        assert low == pytest.approx(max(0.0, knee.flexion_deg - 2))
        for again in (one, two):
            back = dataclasses.replace(again, rotation_deg=knee.rotation_deg, flexion_deg=knee.flexion_deg)
            assert back == knee


def test_the_retest_manifest_lists_the_kind_and_number_of_each_repeat(tmp_path):
    small = tmp_path / "small.toml"
    small.write_text('base = "reference"\nname = "reference"\nrows = 64\ncols = 64\npixel_mm = 4.8\ntexture = "none"\n')
    plan = plan_tiny_cohort([str(small)], retested=1)
    repeats = cohort.plan_retest(plan)
    rows = read_rows(cohort.make_cohort(repeats, tmp_path / "r", workers=1))
    turns = (("noise", "1"), ("noise", "2"), ("perturbation", "1"), ("perturbation", "2"))
    assert Counter((row["kind"], row["repeat_index"]) for row in rows) == dict.fromkeys(turns, 1)
    assert {row["subject"] for row in rows} == {str(plan.cases[int(row["source_knee"])].subject) for row in rows}
    assert len({row["sha256"] for row in rows}) == 4
    beams = {entry["beam_angle_deg"] for entry in json.loads((tmp_path / "r" / "cohort.json").read_text())["protocols"]}
    assert beams == {-1.0, 0.0, 1.0}


def test_a_retest_requires_at_least_one_knee_and_a_known_protocol(protocols):
    assert cohort.plan_retest(plan_tiny_cohort(protocols, retested=0)) is None
    with pytest.raises(pssf.InputError, match=r"protocol must be one of reference, low_dose, .*got 'x'"):
        cohort.plan_retest(plan_tiny_cohort(protocols), reference="x")


RUN = """
import sys
from pssf import cohort
if __name__ == "__main__":
    knees = [int(number) for number in sys.argv[3].split(",")]
    plan = cohort.plan_cohort("quick", seed=5, overrides={"knees": knees, "protocols": sys.argv[4:]})
    print("start", flush=True)
    cohort.make_cohort(plan, sys.argv[1], workers=int(sys.argv[2]), progress=lambda made: print("made", flush=True))
"""


def test_a_killed_run_resumes_and_ends_with_the_same_files(protocols, whole_cohort, tmp_path):
    cut, script = tmp_path / "cut", tmp_path / "run.py"
    script.write_text(RUN)
    command = [sys.executable, str(script), str(cut), "1", "1,1,1", *protocols]
    for delay in (0.0, 0.4):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        while "made" not in (process.stdout.readline() or "made"):
            pass
        time.sleep(delay)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.close()
        for path in (p for p in cut.rglob("*.tif") if not p.name.startswith(".")):
            pssf.load(path)
    subprocess.run(command, check=True, capture_output=True)
    assert compute_digests(cut) == compute_digests(whole_cohort)


def start_run(script, folder, workers, protocols):
    """Start a run in its own process group and wait until it has a plan."""
    command = [sys.executable, str(script), str(folder), str(workers), "2,2,2", *protocols]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout.readline() == "start\n"
    return process


@pytest.mark.slow
def test_runs_killed_at_50_random_times_leave_no_partial_files(protocols, tmp_path):
    whole, script, rng = tmp_path / "whole", tmp_path / "run.py", np.random.default_rng(0)
    script.write_text(RUN)
    cohort.make_cohort(plan_tiny_cohort(protocols, knees=(2, 2, 2)), whole, workers=1)
    kills, cohorts, leftovers = 0, 0, 0
    while kills < 50:
        folder, workers = tmp_path / f"cut{cohorts}", 1 + cohorts % 2
        cohorts += 1
        for _ in range(10):  # the run after this loop is not interrupted
            with start_run(script, folder, workers, protocols) as process:
                try:
                    assert process.wait(rng.uniform(0, 3 * workers)) == 0
                    break
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
            kills += 1
            leftovers += sum(len(atomic_write.find_temporary_files(folder / name)) for name in cohort_maker.SUBFOLDERS)
            for path in (p for p in folder.rglob("*.tif") if not p.name.startswith(".")):
                pssf.load(path)
        with start_run(script, folder, workers, protocols) as process:
            assert process.wait() == 0
        assert compute_digests(folder) == compute_digests(whole)
        assert cohort.verify_cohort(folder).faults == ()
    print(f"{kills} kills, {cohorts} cohorts, {leftovers} temporary files left by them and removed")


def test_a_full_disk_leaves_no_partial_files_and_the_run_resumes(protocols, whole_cohort, tmp_path, monkeypatch):
    plan, folder, sync = plan_tiny_cohort(protocols), tmp_path / "c", os.fsync
    # A run writes cohort.json, two images and one record per knee, and the manifest; unfinished knees are repeated.
    for writes, files in ((0, 0), (2, 2), (3, 4), (2, 6), (6, 10)):
        remaining = iter(range(writes))

        def fail_when_full(handle, remaining=remaining):
            if next(remaining, None) is None:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            sync(handle)

        with monkeypatch.context() as patch:
            patch.setattr(atomic_write.os, "fsync", fail_when_full)
            with pytest.raises(pssf.InputError, match="No space left on device: use a writable folder"):
                cohort.make_cohort(plan, folder, workers=1)
        assert len([p for p in folder.rglob("*") if p.is_file()]) == files
        for image in (folder / "images").glob("*"):
            pssf.load(image)
    cohort.make_cohort(plan, folder, workers=1)
    assert compute_digests(folder) == compute_digests(whole_cohort)


DISK = """
import sys
from pssf import cli
if __name__ == "__main__":
    size = ["--knees", "1,1,1", "--protocols", ",".join(sys.argv[2:])]
    sys.argv = ["pssf", "cohort", "--out", sys.argv[1], "--workers", "2", "--seed", "5", *size]
    cli.main()
"""


@pytest.fixture
def disk(tmp_path):
    """Mount a disk of 64 KiB; yield its folder and a function that enlarges it."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o"]
    if subprocess.run([*mount, "size=64k", "none", str(folder)], capture_output=True, check=False).returncode:
        pytest.skip("mounting a disk needs root; the test above simulates a full disk")
    yield folder, lambda: subprocess.run([*mount, "remount,size=4m", "none", str(folder)], check=True)
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow
def test_a_full_disk_gives_a_one_line_error_and_the_command_can_resume(protocols, whole_cohort, tmp_path, disk):
    folder, enlarge = disk
    script = tmp_path / "run.py"
    script.write_text(DISK)
    command = [sys.executable, str(script), str(folder / "c"), *protocols]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    # Progress lines are not counted.
    assert sum(not line.startswith("radiographs: ") for line in done.stderr.splitlines()) == 1
    # If the disk is full, numpy reports the number of written items instead of the cause.
    reason = r"(No space left on device|not enough free space \(\d+ requested and \d+ written\))"
    assert re.search(rf"\.\w+ must be writable, got {reason}: use a writable folder with free space\n$", done.stderr)
    assert not list(folder.rglob(".*"))
    for image in (folder / "c" / "images").glob("*"):
        pssf.load(image)
    enlarge()
    subprocess.run(command, capture_output=True, text=True, check=True)
    assert compute_digests(folder / "c") == compute_digests(whole_cohort)


def test_progress_distinguishes_existing_from_new_radiographs(protocols, tmp_path):
    plan, folder = plan_tiny_cohort(protocols), tmp_path / "c"
    counted = []
    for _ in range(2):
        cohort.make_cohort(
            plan,
            folder,
            workers=1,
            progress=lambda n: counted.append(("made", n)),
            on_kept=lambda n: counted.append(("kept", n)),
        )
        min((folder / "images").iterdir()).unlink()
    assert counted == [("made", 2)] * 3 + [("kept", 2)] * 2 + [("made", 2)]


def test_a_worker_with_another_folder_library_or_code_raises_an_error(protocols, tmp_path):
    plan, folder = plan_tiny_cohort(protocols), tmp_path / "c"
    claim = cohort_records.claim_folder(folder / "cohort.json", plan.build_request())
    environment = {
        "folder": folder,
        "claim": "cohort.json",
        "claim_sha256": claim,
        "code_hashes": code_hash.compute_code_hashes((*cohort_maker.CODE_PATHS, *code_hash.list_pixel_data_files())),
        "versions": run_environment.collect_versions(),
    }
    site = run_environment.RunEnvironment(
        **{**environment, "versions": {**run_environment.collect_versions(), "numpy": "1.0"}}
    )
    with pytest.raises(pssf.InputError, match=r"numpy on .* must be 1\.0, the version on the machine .*, got .*"):
        cohort_maker.make_case(plan.cases[0], site=site, engine="scanline", threads=1)
    site = run_environment.RunEnvironment(
        **{**environment, "code_hashes": {**environment["code_hashes"], "detector": "0"}}
    )
    with pytest.raises(pssf.InputError, match=r"code of pssf on .* must be .*, got other code \(detector\)"):
        cohort_maker.make_case(plan.cases[0], site=site, engine="scanline", threads=1)
    (folder / "cohort.json").write_text("{}")
    with pytest.raises(pssf.InputError, match=r"on .*: folder .* contains a different cohort; all workers"):
        cohort_maker.make_case(plan.cases[0], site=site, engine="scanline", threads=1)
    (folder / "cohort.json").unlink()
    with pytest.raises(pssf.InputError, match=r"on .*: file .*cohort\.json .*No such file or directory; all workers"):
        cohort_maker.make_case(plan.cases[0], site=site, engine="scanline", threads=1)
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("overrides", "match"),
    [
        ({"knees": [0, 0, 0]}, r"sum\(knees\) = 0"),
        ({"knees": [-1, 0, 3]}, "knees with grade 0 must be .*, got -1"),
        ({"bilateral": 20}, "bilateral must be .*, got 20"),
        ({"retested": -1}, "retested must be .*, got -1"),
        ({"protocols": ["reference", "reference"]}, "different names"),
        ({"knee": [1]}, "did you mean 'knees'"),
    ],
)
def test_an_impossible_plan_is_rejected(overrides, match):
    with pytest.raises(pssf.InputError, match=match):
        cohort.plan_cohort("quick", seed=0, overrides=overrides)


def test_an_unwritable_cohort_folder_is_rejected(protocols, tmp_path):
    Path(tmp_path / "file").write_text("not a folder")
    with pytest.raises(pssf.InputError, match="use a writable folder"):
        cohort.make_cohort(plan_tiny_cohort(protocols), tmp_path / "file" / "c", workers=1)


def test_the_manifest_lists_knee_flexion_and_posture_flexion(tmp_path):
    small = tmp_path / "small.toml"
    small.write_text('base = "fixed_flexion"\nname = "small"\nrows = 64\ncols = 64\npixel_mm = 4.8\ntexture = "none"\n')
    plan = plan_tiny_cohort([str(small)], acquisition="sampled")
    rows = read_rows(cohort.make_cohort(plan, tmp_path / "made", workers=1))
    for case, row in zip(plan.cases, rows, strict=True):
        assert float(row["flexion_deg"]) == case.knee.flexion_deg
        assert float(row["posture_flexion_deg"]) == case.exposures[0].protocol.flexion_deg
        assert float(row["centre_x_mm"]) == case.exposures[0].protocol.centre_x_mm
    assert len({row["posture_flexion_deg"] for row in rows}) == 3
    assert not cohort.verify_cohort(tmp_path / "made").faults


def test_the_paper_preset_uses_fixed_acquisition():
    plan = cohort.plan_cohort("paper", seed=0)
    assert {exposure.protocol.name: exposure.protocol for case in plan.cases for exposure in case.exposures} == {
        name: pssf.load_protocol(name) for name in ("reference", "low_dose", "geometry_shift")
    }
    with pytest.raises(pssf.InputError, match="acquisition must be one of fixed, sampled, got 'any'"):
        plan_tiny_cohort(["reference"], acquisition="any")


def test_repositioned_knees_of_a_subset_have_new_indices():
    part = cohort.select_subjects(plan_tiny_cohort(["reference"], knees=(20, 20, 20), bilateral=0, retested=10), 12)
    again = cohort.plan_retest(part)
    repositioned = [case.index for case in again.cases if case.exposures[0].retest_kind == "perturbation"]
    assert len(set(repositioned)) == len(repositioned)
    assert min(repositioned) > max(case.index for case in part.cases)


def test_subject_numbers_are_random_and_change_no_knee(monkeypatch):
    numbered = plan_tiny_cohort(["reference"], knees=(9, 9, 9))
    monkeypatch.setattr(plan_module, "_renumber_subjects", lambda cases, seed: cases)
    as_sampled = plan_tiny_cohort(["reference"], knees=(9, 9, 9))
    assert {case.knee for case in numbered.cases} == {case.knee for case in as_sampled.cases}
    assert [case.knee.grade for case in as_sampled.cases] == sorted(case.knee.grade for case in numbered.cases)
    assert [case.knee.grade for case in numbered.cases] != sorted(case.knee.grade for case in numbered.cases)


def test_the_benchmark_has_1000_subjects_at_two_tilts_and_three_doses():
    plan = cohort.plan_cohort("benchmark-1", seed=0)
    assert len({case.subject for case in plan.cases}) == 1000
    assert Counter(case.knee.grade for case in plan.cases) == dict.fromkeys(range(5), 220)
    protocols = [exposure.protocol for exposure in plan.cases[0].exposures]
    assert [one.name for one in protocols] == [
        f"fixed_flexion{tilt}{dose}" for tilt in ("", "_beam5") for dose in ("", "_dose50", "_dose25")
    ]
    assert [one.beam_angle_deg for one in protocols] == [10.0] * 3 + [5.0] * 3
    assert [one.mas for one in protocols] == [20.0, 10.0, 5.0] * 2
    assert len({exposure.seed for case in plan.cases for exposure in case.exposures}) == 6600


def test_matrix_resamples_the_protocols_of_a_cohort_and_keeps_its_knees(small_protocols):
    plain, fewer = (plan_tiny_cohort(["reference", "fixed_flexion"], **more) for more in ({}, {"matrix": 512}))
    assert [case.knee for case in fewer.cases] == [case.knee for case in plain.cases]
    for one, other in zip(plain.cases, fewer.cases, strict=True):
        for before, after in zip(one.exposures, other.exposures, strict=True):
            assert after == dataclasses.replace(before, protocol=before.protocol.resample(512))


@pytest.mark.parametrize("acquisition", ["fixed", "sampled"])
def test_cohort_settings_apply_to_every_knee_and_protocol(acquisition):
    settings = ("mas=3", "sdd_mm=1200", "jsw_medial_mm=4.25")
    plain, changed = (
        plan_tiny_cohort(["reference", "low_dose"], acquisition=acquisition, settings=given) for given in ((), settings)
    )
    for one, other in zip(plain.cases, changed.cases, strict=True):
        assert other.knee == dataclasses.replace(one.knee, jsw_medial_mm=4.25)
        for before, after in zip(one.exposures, other.exposures, strict=True):
            assert (after.protocol.mas, after.protocol.sdd_mm) == (3.0, 1200.0)
            # Protocol fields without a cohort setting have the same sampled values as before.
            for field in ("centre_x_mm", "beam_angle_deg", "tube_kv", "field_width_mm", "marker"):
                assert getattr(after.protocol, field) == getattr(before.protocol, field)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"settings": ("mass=3",)}, "did you mean 'mas'"),
        ({"settings": ("mas",)}, "FIELD=VALUE"),
        ({"matrix": -1}, "matrix"),
    ],
)
def test_invalid_cohort_settings_are_rejected(more, why):
    with pytest.raises(pssf.InputError, match=why):
        plan_tiny_cohort(["reference"], **more)
