import dataclasses
import math

import pytest

from pssf import InputError, load_protocol
from pssf.files.tables import protocol_names
from pssf.protocol import protocol_from, protocol_table


def test_three_protocols_come_with_the_package():
    assert protocol_names() == ["geometry_shift", "low_dose", "reference"]
    for name in protocol_names():
        protocol = load_protocol(name)
        assert protocol.name == name
        assert (protocol.rows, protocol.cols, protocol.pixel_mm) == (2048, 2048, 0.15)
        assert 1100 <= protocol.sdd_mm <= 1200
        assert 900 <= protocol.sod_mm <= 1000
        assert 60 <= protocol.tube_kv <= 80


def test_low_dose_differs_from_reference_in_mas_alone():
    reference, low = load_protocol("reference"), load_protocol("low_dose")
    assert low.mas < reference.mas
    assert dataclasses.replace(low, name="reference", mas=reference.mas) == reference


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("tube_kv", 0),
        ("mas", -1.0),
        ("sdd_mm", math.nan),
        ("rows", 0),
        ("rows", 12.5),
        ("noise", "loud"),
        ("name", "a/b"),
        ("name", ""),
        ("sod_mm", 1150.0),
    ],
)
def test_a_field_out_of_range_is_named(field, value):
    with pytest.raises(InputError, match=f"{field} = "):
        dataclasses.replace(load_protocol("reference"), **{field: value})


def test_a_protocol_survives_its_table():
    protocol = load_protocol("geometry_shift")
    assert protocol_from(protocol_table(protocol), "here") == protocol


def test_a_protocol_file_with_an_unknown_field_is_refused_by_file_and_field(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("tube_kw = 70\n")
    with pytest.raises(InputError, match=r"protocol mine.toml: unknown field 'tube_kw' \(did you mean 'tube_kv'"):
        load_protocol(path)


@pytest.mark.parametrize("content", [b"tube_kv = = 3", b"\xff\xfe\x00"])
def test_a_file_that_is_not_toml_is_refused(tmp_path, content):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not TOML"):
        load_protocol(path)


def test_a_missing_file_is_refused():
    with pytest.raises(InputError, match="No such file"):
        load_protocol("nowhere.toml")
