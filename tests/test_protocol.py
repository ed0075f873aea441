"""Check protocols: files, inheritance, validation, standard views and resampling."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pssf import InputError, load_protocol
from pssf.data import data_files
from pssf.data.data_files import list_protocols
from pssf.model.field_listing import list_fields
from pssf.model.protocol import protocol_from_dict, protocol_to_dict

STUDY = ("geometry_shift", "low_dose", "reference")
VIEWS = ("fixed_flexion", "lyon_schuss", "rosenberg", "ap_standing", "lateral", "skyline", "bilateral")


def test_the_three_protocols_of_the_study_come_with_the_package():
    assert set(STUDY) < set(list_protocols())
    for name in STUDY:
        protocol = load_protocol(name)
        assert protocol.name == name
        assert (protocol.rows, protocol.cols, protocol.pixel_mm) == (2048, 2048, 0.15)
        assert 1100 <= protocol.sdd_mm <= 1200
        assert 900 <= protocol.sod_mm <= 1000
        assert 60 <= protocol.tube_kv <= 80


def test_low_dose_differs_from_reference_only_in_mas():
    reference, low = load_protocol("reference"), load_protocol("low_dose")
    assert low.mas < reference.mas
    assert dataclasses.replace(low, name="reference", mas=reference.mas) == reference


@pytest.mark.parametrize("name", [name for name in list_protocols() if name not in (*STUDY, *VIEWS)])
def test_every_other_study_protocol_changes_a_single_factor(name):
    reference, other = (protocol_to_dict(load_protocol(one)) for one in ("reference", name))
    changed = {field for field in reference if other[field] != reference[field]} - {"name"}
    assert len(changed) == 1 or changed == {"sdd_mm", "sod_mm"}
    assert other["sdd_mm"] - other["sod_mm"] == reference["sdd_mm"] - reference["sod_mm"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("lyon_schuss", dict(projection="PA", beam_along="medial_plateau", beam_angle_deg=0.0)),
        ("rosenberg", dict(projection="PA", flexion_deg=45.0, beam_angle_deg=10.0, sdd_mm=1016.0)),
        ("ap_standing", dict(projection="AP", flexion_deg=0.0, beam_angle_deg=0.0)),
    ],
)
def test_standard_views_have_the_published_settings(name, expected):
    protocol = load_protocol(name)
    assert {field: getattr(protocol, field) for field in expected} == expected


def test_the_lateral_view_has_the_published_flexion_and_beam_angle():
    lateral = load_protocol("lateral")
    assert lateral.projection == "ML"
    assert 20 <= lateral.flexion_deg <= 30
    assert -7 <= lateral.beam_angle_deg <= -5


def test_the_skyline_view_has_the_angles_of_merchant():
    skyline = load_protocol("skyline")
    assert skyline.projection == "axial"
    assert skyline.flexion_deg == 45
    assert skyline.flexion_deg - skyline.tibia_forward_deg - skyline.beam_angle_deg == 30


@pytest.mark.parametrize(
    ("name", "more", "why"),
    [
        ("lateral", dict(beam_along="medial_plateau"), "are the plateau margins edge-on to the beam"),
        ("skyline", dict(beam_along="medial_plateau"), "are the plateau margins edge-on to the beam"),
        ("lateral", dict(knee_distance_mm=220.0), "one knee would cover the other"),
        ("rosenberg", dict(flexion_deg=60.1), "flexion_deg must be between 0 and 60 deg, got 60.1 deg"),
    ],
)
def test_an_impossible_posture_raises_an_error_with_the_reason(name, more, why):
    with pytest.raises(InputError, match=why):
        dataclasses.replace(load_protocol(name), **more)


def test_every_protocol_field_is_documented_once():
    rows = list_fields("protocol")
    assert [row["field"] for row in rows] == [field.name for field in dataclasses.fields(load_protocol("reference"))]
    assert all(row["what"] and row["allowed"] for row in rows)
    assert {row["field"] for row in rows} == set(data_files.load_data_table("protocol_fields"))


def test_a_protocol_inherits_missing_fields_from_its_base(tmp_path):
    (tmp_path / "soft.toml").write_text('base = "low_dose"\nname = "soft"\ntube_kv = 55\n')
    (tmp_path / "softer.toml").write_text('base = "soft.toml"\nname = "softer"\nnoise = "none"\n')
    expected = dataclasses.replace(load_protocol("low_dose"), name="softer", tube_kv=55, noise="none")
    assert load_protocol(tmp_path / "softer.toml") == expected


def test_a_circular_or_missing_base_raises_an_error(tmp_path):
    (tmp_path / "a.toml").write_text('base = "b.toml"\n')
    (tmp_path / "b.toml").write_text('base = "a.toml"\n')
    with pytest.raises(InputError, match=r"bases of protocol a.toml must not be circular, got a.toml twice"):
        load_protocol(tmp_path / "a.toml")
    (tmp_path / "c.toml").write_text('base = "refrence"\n')
    with pytest.raises(InputError, match=r"protocol must be .*, got 'refrence'"):
        load_protocol(tmp_path / "c.toml")
    (tmp_path / "d.toml").write_text("base = 3\n")
    with pytest.raises(InputError, match=r"base of protocol d.toml must be .*, got 3"):
        load_protocol(tmp_path / "d.toml")


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
def test_a_field_out_of_range_is_named_in_the_error(field, value):
    with pytest.raises(InputError, match=f"{field} must be "):
        dataclasses.replace(load_protocol("reference"), **{field: value})


def test_a_protocol_is_restored_from_its_dictionary():
    protocol = load_protocol("geometry_shift")
    assert protocol_from_dict(protocol_to_dict(protocol), "here") == protocol


def test_an_unknown_field_raises_an_error_with_a_suggestion(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("tube_kw = 70\n")
    with pytest.raises(InputError, match=r"fields must be .*, got 'tube_kw' \(did you mean 'tube_kv'"):
        load_protocol(path)


@pytest.mark.parametrize("content", [b"tube_kv = = 3", b"\xff\xfe\x00"])
def test_a_file_that_is_not_toml_raises_an_error(tmp_path, content):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"not (TOML|UTF-8)"):
        load_protocol(path)


def test_a_missing_protocol_file_raises_an_error():
    with pytest.raises(InputError, match="No such file"):
        load_protocol("nowhere.toml")


@pytest.mark.parametrize("kind", [int, np.float32, np.int64])
def test_numpy_numbers_are_converted_to_python_numbers(kind):
    protocol = dataclasses.replace(load_protocol("reference"), mono_kev=kind(60), rows=np.int64(64))
    assert (type(protocol.mono_kev), type(protocol.rows)) == (float, int)
    assert protocol == dataclasses.replace(load_protocol("reference"), mono_kev=60.0, rows=64)


@given(st.sampled_from(list_protocols()), st.integers(64, 4096))
def test_resampling_keeps_the_field_size_within_half_a_pixel(name, matrix):
    before = load_protocol(name)
    after = before.resample(matrix)
    assert max(after.rows, after.cols) == matrix
    for side in ("rows", "cols"):
        field_mm = [getattr(one, side) * one.pixel_mm for one in (before, after)]
        assert abs(field_mm[1] - field_mm[0]) <= after.pixel_mm / 2 + 1e-6
    same = {field: getattr(before, field) for field in ("rows", "cols", "pixel_mm")}
    assert dataclasses.replace(after, **same) == before


def test_resampling_to_the_same_matrix_changes_nothing():
    for name in list_protocols():
        protocol = load_protocol(name)
        assert protocol.resample(max(protocol.rows, protocol.cols)) == protocol


@pytest.mark.parametrize("matrix", [0, -1, 512.5, "512", True, None, 8193])
def test_an_invalid_matrix_raises_an_error(matrix):
    with pytest.raises(InputError, match="matrix"):
        load_protocol("reference").resample(matrix)
