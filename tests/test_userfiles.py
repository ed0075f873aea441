import os
from pathlib import Path

import pytest

import pssf
from pssf.data import data_files, user_files
from pssf.io.meshes.mesh_reader import read_mesh
from pssf.io.patients.patient_radiographs import read_film

READERS = {
    "p.toml": pssf.load_protocol,
    "r.tif": pssf.load,
    "r.dcm": pssf.load,
    "r.json": pssf.load_parameters,
    "m.tif": pssf.load_masks,
    "f.png": read_film,
    "m.stl": read_mesh,
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_and_a_device_are_refused_and_not_waited_for(name, tmp_path):
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(pssf.InputError, match="no regular file"):
        READERS[name](path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(pssf.InputError, match="no regular file"):
        READERS[name](path)


def test_a_file_above_the_size_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "p.toml").write_bytes(b" " * (2**20 + 1))
    with pytest.raises(pssf.InputError, match="must have at most 1048576 bytes, got 1048577 bytes"):
        pssf.load_protocol(tmp_path / "p.toml")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a = " + "[" * 2000, "not TOML"),
        ("rows = " + "1" * 5000, "not TOML"),
        ("base = 'a\nb'", "not TOML"),
        ('base = "a\\u0000b.toml"', "null byte"),
        ('base = "loop.toml"', "symbolic links"),
        ('base = "a\\nb.toml"', r"a\\nb.toml must be .*No such file"),
        (f'base = "{"a" * 300}.toml"', "name too long"),
        (b"\xff\xfe", "not UTF-8"),
    ],
)
def test_a_protocol_that_no_reader_expects_is_refused_in_one_line(text, what, tmp_path):
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    path = tmp_path / "p.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(pssf.InputError, match=what) as refused:
        pssf.load_protocol(path)
    assert "\n" not in str(refused.value)


def test_a_byte_order_mark_is_no_fault(tmp_path):
    path = tmp_path / "p.toml"
    path.write_bytes(b"\xef\xbb\xbfbase = 'reference'\n")
    assert pssf.load_protocol(path) == pssf.load_protocol("reference")
    assert data_files.read_toml(path) == {"base": "reference"}


@pytest.mark.parametrize("text", ["[" * 100_000, "[1, 2", '{"a": "x"}', "9" * 5000, "[]"])
def test_json_of_another_form_is_refused_in_one_line(text, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(pssf.InputError, match=r"a\.json must be .*damaged") as refused:
        user_files.read_json(path, dict[str, int])
    assert "\n" not in str(refused.value)


def test_json_of_the_form_that_is_wanted_is_read(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": 1}')
    assert user_files.read_json(path, dict[str, int]) == {"a": 1}


@pytest.mark.parametrize("path", [None, b"x.tif", "a\0b.tif", 3])
@pytest.mark.parametrize("read", [pssf.load, pssf.load_parameters, pssf.load_masks, pssf.load_protocol, read_mesh])
def test_what_is_no_path_is_refused(read, path):
    with pytest.raises(pssf.InputError, match="must be text or a Path, without a null byte"):
        read(path)


def test_a_directory_is_refused(tmp_path):
    with pytest.raises(pssf.InputError, match="Is a directory"):
        user_files.read_bytes(Path(tmp_path))
