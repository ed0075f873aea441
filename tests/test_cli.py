"""Check the commands of `pssf`: files, exit codes and one-line errors."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest
import trimesh
from command_line import run, run_in_process

import pssf
from pssf import cli
from pssf.data.data_files import read_toml
from pssf.model.knee import knee_from_dict

NO_GRADE_5 = "grade must be one of 0, 1, 2, 3, 4 in grade table population, got 5"

SMALL = {"rows": 64, "cols": 64, "pixel_mm": 4.8}


@pytest.fixture
def protocol_file(tmp_path):
    path = tmp_path / "small.toml"
    text = (Path(pssf.__file__).parents[1] / "protocols" / "reference.toml").read_text()
    for name, value in SMALL.items():
        text = "\n".join(f"{name} = {value}" if line.startswith(f"{name} =") else line for line in text.splitlines())
    path.write_text(f'{text}\ntexture = "none"\n')
    return path


def test_simulate_writes_tiff_png_and_parameters(protocol_file, tmp_path):
    done = run("simulate", "--grade", 2, "--protocol", protocol_file, "--seed", 3, "--out", tmp_path / "o")
    assert done.returncode == 0, done.stderr
    stem = "knee_grade2_reference_seed3"
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == [f"{stem}.json", f"{stem}.png", f"{stem}.tif"]
    assert json.loads((tmp_path / "o" / f"{stem}.json").read_text())["knee"]["grade"] == 2
    assert pssf.load(tmp_path / "o" / f"{stem}.tif").seed == 3


def test_a_knee_file_is_used_without_changes(protocol_file, tmp_path):
    knee = tmp_path / "mine.toml"
    knee.write_text('jsw_medial_mm = 2.8\nosteophytes = [{ site = "medial_tibia", size_mm = 1.5 }]\n')
    assert run("simulate", "--knee", knee, "--protocol", protocol_file, "--out", tmp_path / "o").returncode == 0
    loaded = pssf.load(tmp_path / "o" / "mine_reference_seed0.tif")
    assert loaded.knee == pssf.Knee(jsw_medial_mm=2.8, osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=1.5),))


def test_meshes_writes_only_the_requested_formats(tmp_path):
    done = run("meshes", "--grade", 2, "--formats", "glb", "--out", tmp_path / "m")
    assert done.returncode == 0, done.stderr
    assert [p.name for p in (tmp_path / "m").iterdir()] == ["knee_grade2.glb"]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("simulate", "--grade", 5), f"pssf: {NO_GRADE_5}"),
        (
            ("simulate", "--protocol", "refrence"),
            "pssf: protocol must be ap_standing, bilateral, caudal_beam, fixed_flexion, ",
        ),
        (
            ("simulate", "--engine", "embre"),
            "pssf: engine must be one of embree, scanline, got 'embre' (did you mean 'embree'?)",
        ),
        (("simulate", "--workers", "0"), "pssf: workers must be a whole number from 1 to 256 threads, got 0 threads"),
        (("simulate", "--seed", "-1"), "pssf: seed must be a whole number from 0 "),
        (
            ("simulate", "--protocol", "rosenberg", "--set", "protocol.flexion_deg=80"),
            "pssf: set: flexion_deg must be between 0 and 60 deg, got 80 deg",
        ),
        (
            ("simulate", "--knee", "nowhere.toml"),
            "pssf: file nowhere.toml must be a readable TOML file, got: No such file or directory",
        ),
        (
            ("simulate", "--protocol", "bilateral", "--knee", "my.toml"),
            "pssf: knee my.toml must be used with a protocol for one knee, got bilateral, which images both knees",
        ),
        (("meshes", "--formats", "obj3"), "pssf: format must be one of stl, ply, glb"),
        (
            ("cohort", "--preset", "quik"),
            "pssf: preset must be one of quick, paper, population, benchmark-1, got 'quik' (did you mean 'quick'?)",
        ),
        (("cohort", "--workers", "0"), "pssf: workers must be a whole number from 1 to 256 processes, got 0 processes"),
        (
            ("cohort", "--engine", "embre"),
            "pssf: engine must be one of embree, scanline, got 'embre' (did you mean 'embree'?)",
        ),
        (
            ("study", "--preset", "quik"),
            "pssf: preset must be one of quick, paper, population, benchmark-1, got 'quik' (did you mean 'quick'?)",
        ),
        (
            ("study", "--films", "nowhere"),
            "pssf: folder nowhere contains no radiographs: the folder must contain subfolders named 0 to 4 ",
        ),
        (
            ("compare-patients", "--films", "a", "--knees", "20", "--films=b"),
            "pssf: --films must be used only once, got it 2 times",
        ),
        (("study", "--until", "end"), "pssf: until must be one of features, report, got 'end'"),
        (("study", "--config", "mine.toml"), "pssf: file mine.toml must be a readable TOML file, "),
    ],
)
def test_invalid_input_exits_with_code_2_and_writes_no_files(arguments, line, tmp_path):
    done = run(*arguments, "--out", tmp_path / "o")
    assert done.returncode == 2
    assert done.stderr.startswith(line)
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.rglob("*"))


def test_a_detector_too_close_to_the_leg_gives_a_one_line_error(tmp_path):
    done = run("simulate", "--protocol", "ap_standing", "--set", "sod_mm=1010", "--out", tmp_path)
    assert done.returncode == 2
    assert re.match(r"pssf: sod_mm must be at most 9\d\d mm with sdd_mm = 1016 mm, got 1010 mm: ", done.stderr)
    assert re.search(r"the leg extends .* mm behind the detector\n$", done.stderr)
    assert not list(tmp_path.iterdir())


def test_a_command_line_error_exits_with_code_2_and_prints_one_line(tmp_path):
    done = run_in_process("simulate", "--grade", 5, "--out", tmp_path)
    assert (done.returncode, done.stderr) == (2, f"pssf: {NO_GRADE_5}\n")


def test_an_unknown_option_exits_with_code_2(tmp_path):
    done = run("simulate", "--grad", 2, "--out", tmp_path)
    assert done.returncode == 2
    assert "No such option" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("text", "word"), [("jsw_medal_mm = 3.0", "jsw_medal_mm"), ("jsw_medial_mm = nan", "jsw_medial_mm")]
)
def test_the_error_for_an_invalid_knee_file_names_the_field(text, word, tmp_path):
    path = tmp_path / "knee.toml"
    path.write_text(text)
    done = run("simulate", "--knee", path, "--out", tmp_path / "o")
    assert done.returncode == 2
    assert word in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("command", ["simulate", "meshes", "cohort", "study", "validate", "quality"])
def test_an_unwritable_folder_gives_a_one_line_error_before_computation(command, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = run(command, "--out", tmp_path / "file")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "use a writable folder" in done.stderr


# Each command runs longer than the longest delay, because a Python process that ends restores default handlers.
@pytest.mark.parametrize("command", [("simulate", "--set", "scatter=monte_carlo"), ("cohort", "--workers", 2)])
@pytest.mark.parametrize("seconds", [0.5, 5])
def test_an_interrupt_ends_a_command_in_one_line_without_partial_files(command, seconds, tmp_path):
    script = [sys.executable, "-m", "pssf", *map(str, command), "--out", str(tmp_path / "o")]
    # Ctrl+C in a terminal interrupts the entire process group, including the workers.
    ran = subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    time.sleep(seconds)
    os.killpg(ran.pid, signal.SIGINT)
    _, message = ran.communicate(timeout=20)
    assert ran.returncode == 130
    assert message == "pssf: stopped; run the same command again to continue\n"
    assert not list(tmp_path.rglob(".pssf-*"))


SMALL_OPTIONS = [part for name, value in (SMALL | {"texture": "none"}).items() for part in ("--set", f"{name}={value}")]


def test_simulate_changes_fields_and_writes_masks(tmp_path):
    done = run(
        *("simulate", *SMALL_OPTIONS, "--set", "mas=2", "--set", "jsw_medial_mm=2.5", "--set", "knee.rotation_deg=3"),
        *("--masks", "--formats", "tif,dcm", "--out", tmp_path / "o"),
    )
    assert done.returncode == 0, done.stderr
    stem = tmp_path / "o" / "knee_grade0_reference_seed0"
    radiograph = pssf.load(f"{stem}.tif")
    assert (radiograph.protocol.mas, radiograph.pixels.shape) == (2.0, (64, 64))
    assert (radiograph.knee.jsw_medial_mm, radiograph.knee.rotation_deg) == (2.5, 3.0)
    masks = [pssf.load_masks(f"{stem}_masks.{kind}") for kind in ("tif", "dcm")]
    assert {"femur", "tibia"} <= set(masks[0]) == set(masks[1])
    assert done.stdout.count("\n") == 5


def test_sampled_acquisition_follows_the_seed_and_keeps_set_fields(protocol_file, tmp_path):
    command = (
        "simulate",
        "--protocol",
        protocol_file,
        "--formats",
        "json",
        "--set",
        "mas=3",
        "--acquisition",
        "sampled",
    )
    angles = []
    for seed in (1, 1, 2):
        done = run(*command, "--seed", seed, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        made = pssf.load_parameters(done.stdout.strip())
        angles.append(made["protocol"].beam_angle_deg)
        assert made["protocol"].mas == 3
    assert angles[0] == angles[1] != angles[2]


def write_scene(folder: Path, ball: trimesh.Trimesh, outside: str, name: str) -> Path:
    """Write a scene file with a leg of muscle and a ball of bone."""
    trimesh.creation.box((60, 60, 60)).export(folder / "leg.stl")
    ball.export(folder / "ball.stl")
    scene = folder / "phantom.toml"
    scene.write_text(
        "[[surface]]\nfile = 'leg.stl'\ninside = 'muscle'\noutside = 'air'\n"
        f"[[surface]]\nfile = 'ball.stl'\ninside = 'cortical_bone'\noutside = '{outside}'\nname = '{name}'\n"
    )
    return scene


def test_user_meshes_are_simulated_from_a_scene_file(tmp_path):
    scene = write_scene(tmp_path, trimesh.creation.icosphere(radius=10), "muscle", "bone")
    done = run("simulate", "--scene", scene, *SMALL_OPTIONS, "--formats", "tif", "--out", tmp_path / "o")
    assert done.returncode == 0, done.stderr
    radiograph = pssf.load(tmp_path / "o" / "phantom_reference_seed0.tif")
    assert radiograph.pixels[32, 32] < radiograph.pixels[32, 28] < radiograph.pixels[2, 2]
    for arguments, why in (
        (("--knee", "a.toml"), "must not be combined with a knee, got a.toml"),
        (("--set", "side=left"), "must not be combined with a knee, got side"),
        (("--masks",), "masks must belong to one knee or both knees"),
        (("--grade", 3), "grade must not be combined with scene "),
        (("--grade-table", "paper"), "grade_table must not be combined with scene "),
    ):
        rejected = run("simulate", "--scene", scene, *arguments, "--out", tmp_path / "p")
        assert (rejected.returncode, rejected.stderr.count("\n")) == (2, 1)
        assert why in rejected.stderr


def test_warnings_about_user_meshes_are_printed(tmp_path):
    far = trimesh.creation.icosphere(radius=10).apply_translation((2000, 0, 0))
    scene = write_scene(tmp_path, far, "air", "far")
    done = run("simulate", "--scene", scene, *SMALL_OPTIONS, "--formats", "json", "--out", tmp_path / "o")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == ["pssf: warning: far: covers no pixel; surface is not in the image"]
    rejected = run("simulate", "--scene", scene, *SMALL_OPTIONS, "--border", "marked", "--out", tmp_path / "p")
    assert (rejected.returncode, rejected.stderr) == (2, "pssf: border must be none for a scene, got 'marked'\n")
    assert not (tmp_path / "p").exists()


def test_a_radiograph_with_other_parameters_is_not_overwritten(tmp_path):
    command = ("simulate", *SMALL_OPTIONS, "--out", tmp_path)
    assert run(*command, "--set", "mas=2").returncode == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for others, name in ((("mas=4",), "protocol"), (("mas=2", "--set", "jsw_medial_mm=3"), "knee")):
        rejected = run(*command, "--set", *others)
        assert (rejected.returncode, rejected.stderr.count("\n")) == (2, 1)
        assert (
            f"knee_grade0_reference_seed0.tif must contain the same radiograph, got another {name}: " in rejected.stderr
        )
    # Writing the same radiograph again is allowed.
    assert run(*command, "--set", "mas=2").returncode == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    (tmp_path / "knee_grade0_reference_seed0.tif").write_bytes(b"my own")
    rejected = run(*command, "--set", "mas=2")
    assert (rejected.returncode, rejected.stderr.count("\n")) == (2, 1)
    assert (tmp_path / "knee_grade0_reference_seed0.tif").read_bytes() == b"my own"


def test_pssf_without_a_command_prints_the_help():
    done = run()
    assert done.returncode == 2
    assert done.stderr.splitlines() == run("--help").stdout.splitlines()


def test_a_package_warning_is_printed_in_one_line(tmp_path):
    kernel = ("--protocol", "skyline", "--set", "scatter=kernel")
    done = run_in_process("simulate", *kernel, *SMALL_OPTIONS, "--formats", "json", "--out", tmp_path)
    assert done.returncode == 0
    assert done.stderr.startswith("pssf: ")
    assert done.stderr.count("\n") == 1


def test_a_cohort_with_custom_grades_and_protocols_has_masks(protocol_file, tmp_path):
    done = run(
        *("cohort", "--knees", "0,0,1,1", "--grade-table", "population", "--protocols", protocol_file, "--masks"),
        *("--workers", 1, "--out", tmp_path / "c"),
    )
    assert done.returncode == 0, done.stderr
    with open(tmp_path / "c" / "manifest.csv") as handle:
        rows = list(csv.DictReader(handle))
    assert sorted((row["grade"], row["grade_table"], row["protocol"]) for row in rows) == [
        ("2", "population", "reference"),
        ("3", "population", "reference"),
    ]
    for row in rows:
        assert "femur" in pssf.load_masks(tmp_path / "c" / row["masks"])
    assert run("cohort", "verify", tmp_path / "c").returncode == 0
    masks = tmp_path / "c" / rows[0]["masks"]
    masks.write_bytes(masks.read_bytes() + b"x")
    assert run("cohort", "verify", tmp_path / "c").stdout.startswith(f"{rows[0]['masks']}: changed (")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("simulate", "--mas", "2"), "pssf: No such option: --mas"),
        (("simulate", "--set", "mass=2"), "pssf: set must be one of "),
        (("simulate", "--set", "flexion_deg=2"), "pssf: set must name knee.flexion_deg or protocol.flexion_deg, got "),
        (("simulate", "--acquisition", "draw"), "pssf: acquisition must be one of fixed, sampled, got 'draw'"),
        (("simulate", "--processing", "films"), "pssf: processing must be one of log, processed, film, got 'films'"),
        (("cohort", "--protocols", "bilateral"), "pssf: protocols must image one knee, got bilateral"),
        (("cohort", "--acquisition", "some"), "pssf: acquisition must be one of fixed, sampled, got 'some'"),
        (
            ("compare-patients", "--protocol", "lateral"),
            "pssf: protocol must image one knee in a frontal view, got lateral",
        ),
        (
            ("compare-patients", "--protocol", "bilateral"),
            "pssf: protocol must image one knee in a frontal view, got bilateral",
        ),
        (("simulate", "--scene", "no.toml"), "pssf: file no.toml must be a readable TOML file, got: No such file"),
        (("meshes", "--set", "mas=2"), "pssf: set must name fields of a knee, got mas"),
        (("cohort", "--knees", "1,x"), "pssf: knees must be integers separated by commas, "),
        (
            ("cohort", "--knees", "1,1,1", "--bilateral", "5"),
            "pssf: bilateral must be a whole number from 0 to 1 subjects, got 5 subjects",
        ),
        (("cohort", "--grade-table", "mine"), "pssf: "),
        (("simulate", "--knee", "a.toml", "--grade", "2"), "pssf: grade must not be combined with knee a.toml, got 2"),
        (
            ("simulate", "--protocol", "bilateral", "--border", "marked"),
            "pssf: border must be none for both knees, got 'marked'",
        ),
        (("study", "--knees", "1,x"), "pssf: knees must be integers separated by commas, "),
    ],
)
def test_an_invalid_change_gives_a_one_line_error(arguments, line, tmp_path):
    done = run(*arguments, "--out", tmp_path / "o")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(line)
    assert not list(tmp_path.rglob("*"))


def test_the_error_for_a_field_used_as_an_option_recommends_set(tmp_path):
    done = run("simulate", "--jsw-medial-mm", "2", "--out", tmp_path / "o")
    assert "To change a field of a knee, use --set jsw_medial_mm=VALUE" in done.stderr


@pytest.mark.parametrize("command", [("protocols",), ("protocols", "skyline"), ("knees",)])
def test_lists_of_fields_fit_80_columns(command):
    done = run(*command)
    assert done.returncode == 0
    assert max(map(len, done.stdout.splitlines())) < 80
    assert ("tube_kv" if command[0] == "protocols" else "stature_mm = 1755.0 mm  [1400 to 2100]") in done.stdout


def test_the_knee_template_is_a_valid_knee_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(run("knees", "--template").stdout)
    assert knee_from_dict(read_toml(path)) == pssf.Knee()


def test_version_prints_the_version():
    assert run("--version").stdout == f"pssf {version('pssf')}\n"


def test_too_little_memory_gives_a_one_line_error(monkeypatch, capsys):
    def fail(*_, **__):
        raise MemoryError("Unable to allocate 1.00 GiB")

    monkeypatch.setattr(cli, "app", fail)
    monkeypatch.setattr(sys, "argv", ["pssf", "simulate"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 1
    message = capsys.readouterr().err
    assert message.startswith("pssf: not enough memory (Unable to allocate 1.00 GiB): use fewer rows")
    assert message.count("\n") == 1


def test_the_option_matrix_preserves_the_field_of_view(tmp_path):
    given = ("simulate", "--engine", "scanline", "--out", tmp_path, "--set", "noise=none")
    done = run(*given, "--matrix", 64)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    protocol = pssf.load(tmp_path / "knee_grade0_reference_seed0.tif").protocol
    assert (protocol.rows, protocol.cols, protocol.pixel_mm) == (64, 64, 4.8)


def test_setting_only_rows_and_cols_warns_of_a_changed_field(tmp_path):
    done = run("simulate", "--engine", "scanline", "--out", tmp_path, "--set", "rows=64", "--set", "cols=64")
    assert done.returncode == 0, done.stderr
    (warning,) = (line for line in done.stderr.splitlines() if "--matrix" in line)
    assert warning.startswith("pssf: warning: setting rows and cols without pixel_mm changes the field")


def test_a_cohort_applies_matrix_and_settings(tmp_path):
    given = ("--knees", "1,0,0", "--protocols", "reference", "--workers", 1, "--out", tmp_path / "c")
    done = run("cohort", *given, "--matrix", 64, "--set", "mas=3", "--set", "jsw_medial_mm=4.25")
    assert done.returncode == 0, done.stderr
    (path,) = (tmp_path / "c" / "images").glob("*.tif")
    radiograph = pssf.load(path)
    assert (radiograph.protocol.rows, radiograph.protocol.pixel_mm, radiograph.protocol.mas) == (64, 4.8, 3.0)
    assert radiograph.knee.jsw_medial_mm == 4.25


def test_a_scene_outside_the_field_of_view_gives_one_warning(protocol_file, tmp_path):
    trimesh.creation.box((40, 40, 40)).apply_translation((900, 0, 0)).export(tmp_path / "box.stl")
    (tmp_path / "scene.toml").write_text('[[surface]]\nfile = "box.stl"\ninside = "muscle"\noutside = "air"\n')
    wanted = ("simulate", "--scene", tmp_path / "scene.toml", "--protocol", protocol_file, "--out", tmp_path / "o")
    done = run_in_process(*wanted)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("outside the field of view") == 1
    assert "covers no pixel" not in done.stderr
