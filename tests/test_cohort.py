import csv
import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

import pssf
from pssf import cohort


@pytest.fixture
def protocols(tmp_path):
    """Two protocols on tiny detectors, as files."""
    paths = []
    for name in ("reference", "low_dose"):
        protocol = dataclasses.replace(pssf.load_protocol(name), rows=64, cols=64, pixel_mm=4.8)
        fields = {k: v for k, v in dataclasses.asdict(protocol).items() if v is not None}
        path = tmp_path / f"{name}.toml"
        path.write_text("".join(f"{k} = {json.dumps(v)}\n" for k, v in fields.items()))
        paths.append(str(path))
    return paths


def tiny(protocols, knees=(1, 1, 1), **more):
    return cohort.plan_cohort("quick", seed=5, overrides={"knees": list(knees), "protocols": protocols, **more})


def digests(folder):
    return {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()}


def rows_of(manifest):
    with open(manifest) as handle:
        return list(csv.DictReader(handle))


def test_the_quick_cohort_has_24_subjects_of_three_grades_under_three_protocols():
    plan = cohort.plan_cohort("quick", seed=0)
    assert len({case.subject for case in plan.cases}) == 24
    assert Counter(case.knee.grade for case in plan.cases) == {0: 8, 1: 8, 2: 8}
    assert {tuple(s.protocol.name for s in case.shots) for case in plan.cases} == {
        ("reference", "low_dose", "geometry_shift")
    }


def test_the_paper_cohort_has_180_subjects_260_knees_and_780_radiographs():
    plan = cohort.plan_cohort("paper", seed=0)
    assert len({case.subject for case in plan.cases}) == 180
    assert Counter(case.knee.grade for case in plan.cases) == {0: 130, 1: 78, 2: 52}
    assert sum(len(case.shots) for case in plan.cases) == 780
    assert len({shot.seed for case in plan.cases for shot in case.shots}) == 780


def test_both_knees_of_a_subject_share_their_body_and_differ_in_side():
    plan = cohort.plan_cohort("paper", seed=0)
    for subject in range(10):
        one, two = (case.knee for case in plan.cases if case.subject == subject)
        assert {one.side, two.side} == {"left", "right"}
        assert (one.sex, one.stature_mm, one.bone_scale) == (two.sex, two.stature_mm, two.bone_scale)
        assert one.jsw_medial_mm != two.jsw_medial_mm


def test_a_manifest_has_a_row_a_radiograph_with_parameters_seed_and_hash(protocols, tmp_path):
    plan = tiny(protocols)
    rows = rows_of(cohort.make_cohort(plan, tmp_path / "c", workers=1))
    assert len(rows) == 6
    for row in rows:
        file = tmp_path / "c" / row["file"]
        assert hashlib.sha256(file.read_bytes()).hexdigest() == row["sha256"]
        radiograph = pssf.load(file)
        assert float(row["jsw_medial_mm"]) == radiograph.knee.jsw_medial_mm
        assert int(row["seed"]) == radiograph.seed
        assert float(row["mas"]) == radiograph.protocol.mas
        assert float(row["truth_medial_row_px"]) == pytest.approx(radiograph.truth.medial_joint_line_px[0], abs=1e-3)


def test_the_number_of_workers_changes_no_byte(protocols, tmp_path):
    plan = tiny(protocols)
    for workers in (1, 2):
        cohort.make_cohort(plan, tmp_path / str(workers), workers=workers)
    assert digests(tmp_path / "1") == digests(tmp_path / "2")


def test_a_radiograph_can_be_made_again_from_its_row_alone(protocols, tmp_path):
    row = rows_of(cohort.make_cohort(tiny(protocols, knees=(0, 0, 1)), tmp_path / "c", workers=1))[1]
    kept = pssf.load(tmp_path / "c" / row["file"])
    again = pssf.simulate(kept.knee, kept.protocol, seed=int(row["seed"]), engine=row["engine"])
    assert (again.pixels == kept.pixels).all()


def test_a_finished_cohort_is_kept_and_a_lost_image_made_again(protocols, tmp_path):
    plan, folder = tiny(protocols), tmp_path / "c"
    cohort.make_cohort(plan, folder, workers=1)
    before = digests(folder)
    lost = next((folder / "images").iterdir())
    kept = max((folder / "images").iterdir())
    lost.unlink()
    stamp = kept.stat().st_mtime_ns
    cohort.make_cohort(plan, folder, workers=1)
    assert digests(folder) == before
    assert kept.stat().st_mtime_ns == stamp


def test_a_damaged_image_is_refused_by_name(protocols, tmp_path):
    plan, folder = tiny(protocols), tmp_path / "c"
    cohort.make_cohort(plan, folder, workers=1)
    image = min((folder / "images").iterdir())
    image.write_bytes(image.read_bytes()[:-1] + b"x")
    with pytest.raises(pssf.InputError, match=rf"{image.name}: damaged"):
        cohort.make_cohort(plan, folder, workers=1)


@pytest.mark.parametrize("content", ["", "{", "[1, 2]", "[]", "{}", "null"])
def test_a_damaged_record_is_refused_by_name(protocols, tmp_path, content):
    plan, folder = tiny(protocols), tmp_path / "c"
    cohort.make_cohort(plan, folder, workers=1)
    record = min((folder / "records").iterdir())
    record.write_text(content)
    with pytest.raises(pssf.InputError, match=rf"{record.name}: damaged"):
        cohort.make_cohort(plan, folder, workers=1)


def test_a_record_that_was_changed_or_belongs_to_another_knee_is_refused(protocols, tmp_path):
    plan, folder = tiny(protocols), tmp_path / "c"
    cohort.make_cohort(plan, folder, workers=1)
    one, two, _ = sorted((folder / "records").iterdir())
    whole = one.read_text()
    for content in (whole.replace('"jsw_medial_mm": ', '"jsw_medial_mm": 1'), two.read_text()):
        one.write_text(content)
        with pytest.raises(pssf.InputError, match=rf"{one.name}: (damaged|not of knee 0)"):
            cohort.make_cohort(plan, folder, workers=1)


def test_a_folder_of_another_seed_is_refused(protocols, tmp_path):
    cohort.make_cohort(tiny(protocols), tmp_path / "c", workers=1)
    other = cohort.plan_cohort("quick", seed=6, overrides={"knees": [1, 1, 1], "protocols": protocols})
    with pytest.raises(pssf.InputError, match="holds another cohort: seed = 5, asked for 6"):
        cohort.make_cohort(other, tmp_path / "c", workers=1)


def test_repeats_are_of_single_subjects_evenly_over_the_grades_under_the_reference_protocol():
    plan = cohort.plan_cohort("paper", seed=0)
    repeats = cohort.plan_repeats(plan)
    known = {case.index: case for case in plan.cases}
    again = [case for case in repeats.cases if case.index in known]
    assert Counter(case.knee.grade for case in again) == {0: 7, 1: 7, 2: 6}
    assert len({case.subject for case in again}) == len(again) == 20
    assert len({case.index for case in repeats.cases}) == len(repeats.cases) == 60
    assert all(case.knee == known[case.index].knee for case in again)
    shots = [shot for case in repeats.cases for shot in case.shots]
    assert len(shots) == 80
    seeds = {shot.seed for shot in shots} | {shot.seed for case in plan.cases for shot in case.shots}
    assert len(seeds) == 80 + 780
    assert {shot.protocol.name for shot in shots} == {"reference"}


def test_a_knee_is_placed_anew_to_opposite_sides_and_changes_in_nothing_else():
    plan = cohort.plan_cohort("quick", seed=0, overrides={"retested": 24})
    known = {f"k{case.index:04d}": case.knee for case in plan.cases}
    placed: dict[str, list] = {}
    for case in cohort.plan_repeats(plan).cases:
        for shot in case.shots:
            if "perturbation" in shot.name:
                placed.setdefault(shot.name.split("_")[1], []).append((case.knee, shot.protocol))
    assert len(placed) == 24
    for name, ((one, beam), (two, other)) in placed.items():
        knee = known[name]
        assert one.rotation_deg + two.rotation_deg == pytest.approx(2 * knee.rotation_deg)
        assert abs(one.rotation_deg - knee.rotation_deg) == pytest.approx(2)
        assert {beam.beam_angle_deg, other.beam_angle_deg} == {-1.0, 1.0}
        low, high = sorted((one.flexion_deg, two.flexion_deg))
        assert high == pytest.approx(knee.flexion_deg + 2)
        assert low == pytest.approx(max(0.0, knee.flexion_deg - 2))
        for again in (one, two):
            back = dataclasses.replace(again, rotation_deg=knee.rotation_deg, flexion_deg=knee.flexion_deg)
            assert back == knee


def test_repeats_can_be_made_as_a_cohort_and_name_what_they_are(protocols, tmp_path):
    plan = tiny(protocols, retested=2)
    repeats = cohort.plan_repeats(plan)
    rows = rows_of(cohort.make_cohort(repeats, tmp_path / "r", workers=1))
    kinds = Counter(row["radiograph"].rsplit("_", 1)[1] for row in rows)
    assert kinds == {"noise1": 2, "noise2": 2, "perturbation1": 2, "perturbation2": 2}
    assert len({row["sha256"] for row in rows}) == 8
    beams = {entry["beam_angle_deg"] for entry in json.loads((tmp_path / "r" / "cohort.json").read_text())["protocols"]}
    assert beams == {-1.0, 0.0, 1.0}


def test_a_plan_that_retests_no_knee_has_no_repeats_and_an_unknown_protocol_is_refused(protocols):
    assert cohort.plan_repeats(tiny(protocols, retested=0)) is None
    with pytest.raises(pssf.InputError, match=r"protocol = 'x'; allowed: reference, low_dose"):
        cohort.plan_repeats(tiny(protocols), reference="x")


RUN = """
import sys
from pssf import cohort
if __name__ == "__main__":
    plan = cohort.plan_cohort("quick", seed=5, overrides={"knees": [2, 2, 2], "protocols": sys.argv[2:]})
    print("start", flush=True)
    cohort.make_cohort(plan, sys.argv[1], workers=1, progress=lambda made: print("made", flush=True))
"""


def test_a_run_that_is_killed_goes_on_where_it_stopped_and_ends_with_the_same_bytes(protocols, tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    script = tmp_path / "run.py"
    script.write_text(RUN)
    cohort.make_cohort(tiny(protocols, knees=(2, 2, 2)), whole, workers=1)
    for delay in (0.0, 0.4):
        process = subprocess.Popen(
            [sys.executable, str(script), str(cut), *protocols], stdout=subprocess.PIPE, text=True
        )
        while "made" not in (process.stdout.readline() or "made"):
            pass
        time.sleep(delay)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.close()
        for path in (p for p in cut.rglob("*.tif") if not p.name.startswith(".")):
            pssf.load(path)
    subprocess.run([sys.executable, str(script), str(cut), *protocols], check=True, capture_output=True)
    assert {p: d for p, d in digests(cut).items() if not p.name.startswith(".")} == digests(whole)


@pytest.mark.parametrize(
    ("overrides", "match"),
    [
        ({"knees": [0, 0, 0]}, "knees = 0"),
        ({"knees": [-1, 0, 3]}, "knees of grade 0 = -1"),
        ({"bilateral": 20}, "bilateral = 20"),
        ({"retested": -1}, "retested = -1"),
        ({"protocols": ["reference", "reference"]}, "each once"),
        ({"knee": [1]}, "did you mean 'knees'"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(overrides, match):
    with pytest.raises(pssf.InputError, match=match):
        cohort.plan_cohort("quick", seed=0, overrides=overrides)


def test_a_cohort_needs_a_folder_that_can_be_written(protocols, tmp_path):
    Path(tmp_path / "file").write_text("in the way")
    with pytest.raises(pssf.InputError, match="allowed: a folder that can be written"):
        cohort.make_cohort(tiny(protocols), tmp_path / "file" / "c", workers=1)
