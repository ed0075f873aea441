"""Check reading of user files: devices, size limits, malformed content and invalid paths."""

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
def test_pipes_and_devices_raise_an_error_without_waiting(name, tmp_path):
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(pssf.InputError, match="got a pipe, socket or device"):
        READERS[name](path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(pssf.InputError, match="got a pipe, socket or device"):
        READERS[name](path)


def test_a_file_above_the_size_limit_raises_an_error_before_reading(tmp_path):
    (tmp_path / "p.toml").write_bytes(b" " * (2**20 + 1))
    with pytest.raises(pssf.InputError, match="must have at most 1048576 bytes, got 1048577 bytes"):
        pssf.load_protocol(tmp_path / "p.toml")


@pytest.mark.parametrize(
    ("text", "message"),
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
def test_a_malformed_protocol_file_raises_a_one_line_error(text, message, tmp_path):
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    path = tmp_path / "p.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(pssf.InputError, match=message) as raised:
        pssf.load_protocol(path)
    assert "\n" not in str(raised.value)


def test_a_byte_order_mark_is_accepted(tmp_path):
    path = tmp_path / "p.toml"
    path.write_bytes(b"\xef\xbb\xbfbase = 'reference'\n")
    assert pssf.load_protocol(path) == pssf.load_protocol("reference")
    assert data_files.read_toml(path) == {"base": "reference"}


@pytest.mark.parametrize("text", ["[" * 100_000, "[1, 2", '{"a": "x"}', "9" * 5000, "[]"])
def test_malformed_json_raises_a_one_line_error(text, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(pssf.InputError, match=r"a\.json is damaged") as raised:
        user_files.read_json(path, dict[str, int])
    assert "\n" not in str(raised.value)


def test_valid_json_is_read(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": 1}')
    assert user_files.read_json(path, dict[str, int]) == {"a": 1}


@pytest.mark.parametrize("path", [None, b"x.tif", "a\0b.tif", 3])
@pytest.mark.parametrize("read", [pssf.load, pssf.load_parameters, pssf.load_masks, pssf.load_protocol, read_mesh])
def test_an_invalid_path_raises_an_error(read, path):
    with pytest.raises(pssf.InputError, match="must be text or a Path without null bytes"):
        read(path)


def test_reading_a_directory_raises_an_error(tmp_path):
    with pytest.raises(pssf.InputError, match="got a directory"):
        user_files.read_bytes(Path(tmp_path))
