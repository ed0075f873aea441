"""Check that huge integers, very long paths and unknown elements give a readable one-line error."""

import dataclasses

import numpy as np
import pytest
import trimesh
from command_line import run

import pssf
from pssf.core.checks import format_one_line, format_value, require_integer
from pssf.io.radiograph_files import save_parameters

NUMBERS = ["9" * 5000, "0x" + "f" * 5000, "9" * 4000, "-" + "9" * 5000, "9" * 400, "1e" + "9" * 5000]
PATH = "p" * 5000


def run_with_error(*arguments):
    """Run a command, require exit code 2 and return its single error line."""
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    line = done.stderr.strip()
    assert line.startswith("pssf: ")
    assert "\n" not in line
    assert len(line) < 1200
    return line


@pytest.mark.parametrize("number", NUMBERS, ids=lambda text: f"{text[:3]}_{len(text)}")
@pytest.mark.parametrize("field", ["rows", "tube_kv", "texture_seed", "jsw_medial_mm"])
def test_a_setting_of_thousands_of_digits_gives_a_one_line_error(tmp_path, number, field):
    assert field in run_with_error("simulate", "--out", tmp_path, "--set", f"{field}={number}")


@pytest.mark.parametrize("number", NUMBERS, ids=lambda text: f"{text[:3]}_{len(text)}")
@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("--knee", "texture_seed = {}"),
        ("--knee", "jsw_medial_mm = {}"),
        ("--knee", "osteophytes = [{{ site = 'medial_tibia', size_mm = {} }}]"),
        ("--protocol", "base = 'reference'\nname = 'x'\nrows = {}"),
        ("--scene", "[[surface]]\nfile = 'a.stl'\ninside = {}\noutside = 'air'"),
    ],
)
def test_a_huge_number_in_a_toml_file_gives_a_one_line_error(tmp_path, number, option, text):
    (tmp_path / "a.toml").write_text(text.format(number) + "\n")
    assert "a.toml" in run_with_error("simulate", "--out", tmp_path, option, tmp_path / "a.toml")


@pytest.mark.parametrize("number", ["9" * 5000, "9" * 400, "1e400"])
@pytest.mark.parametrize("field", ["seed", "rows", "tube_kv"])
def test_a_huge_number_in_a_json_file_gives_a_one_line_error(tmp_path, number, field):
    small = dataclasses.replace(
        pssf.load_protocol("reference"), rows=32, cols=32, pixel_mm=9.6, scatter="none", texture="none"
    )
    box = pssf.Scene([pssf.Surface(trimesh.creation.box(extents=(20, 20, 20)), "water", "air")])
    path = save_parameters(pssf.simulate(box, small, engine="scanline"), tmp_path / "a.json")
    text = path.read_text()
    value = text.partition(f'"{field}": ')[2].split(",")[0].split("\n")[0]
    path.write_text(text.replace(f'"{field}": {value}', f'"{field}": {number}', 1))
    with pytest.raises(pssf.InputError) as error:
        pssf.load_parameters(path)
    assert len(str(error.value)) < 1200
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "arguments",
    [
        *(("simulate", "--out", "o", option, PATH) for option in ("--knee", "--protocol", "--scene", "--grade-table")),
        *((command, "--out", PATH) for command in ("simulate", "meshes", "cohort", "quality")),
        *(
            ("cohort", command, PATH, *(("--out", "o") if command == "labels" else ()))
            for command in ("verify", "labels")
        ),
        ("cohort", "--out", "o", "--knees", "1", "--protocols", PATH),
        ("cohort", "--out", "o", "--preset", PATH),
        ("protocols", PATH),
        ("predict", PATH, "x.png", "--out", "o"),
    ],
    ids=lambda arguments: " ".join(word[:12] for word in arguments),
)
def test_a_path_of_thousands_of_characters_gives_a_one_line_error(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    run_with_error(*arguments)


def test_error_messages_shorten_long_words_but_not_typical_paths():
    usual = "/".join(["folder_of_a_long_name"] * 20)
    assert format_one_line(usual) == usual
    assert format_one_line(f"file {PATH} is") == f"file {'p' * 80}...(5000 characters)...{'p' * 80} is"


def test_error_messages_state_the_digit_count_of_huge_integers():
    assert format_value(7) == "7"
    assert format_value(16**5000) == "an integer of about 6021 digits"
    assert "more than 4300 digits" in format_value([16**5000])
    with pytest.raises(pssf.InputError, match=r"seed must be .*, got an integer of about 6021 digits"):
        require_integer("seed", 16**5000, 0, 9, "")


@pytest.mark.parametrize("material", ["Es@8", "Lr@5", "Fm2O3@5"])
@pytest.mark.parametrize("scatter", ["none", "kernel", "monte_carlo"])
def test_an_element_without_cross_sections_is_named_in_the_error(small, material, scatter):
    box = pssf.Scene([pssf.Surface(trimesh.creation.box(extents=(20, 20, 20)), material, "air")])
    symbol = material[:2]
    with pytest.raises(pssf.InputError, match=rf"must contain only elements up to Cf \(98\), got {symbol}"):
        pssf.simulate(box, dataclasses.replace(small, scatter=scatter), engine="scanline")


def test_the_heaviest_element_of_the_cross_section_tables_is_simulated(small):
    box = pssf.Scene([pssf.Surface(trimesh.creation.box(extents=(20, 20, 20)), "Cf@8", "air")])
    assert np.isfinite(pssf.simulate(box, small, engine="scanline").pixels).all()
