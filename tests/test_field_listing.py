"""Check the lists of knee and protocol fields, and field settings on the command line."""

import dataclasses
import tomllib

import pytest

import pssf
from pssf.model.field_listing import (
    apply_settings,
    format_knee_template,
    list_fields,
    parse_settings,
)
from pssf.model.knee import (
    Cyst,
    Knee,
    Osteophyte,
    knee_from_dict,
)


def test_every_field_of_a_knee_is_listed_once_with_a_description():
    rows = {row["field"]: row for row in list_fields("knee")}
    list_fields_of_knee = {"osteophytes", "cysts"}
    assert {field.name for field in dataclasses.fields(Knee)} - list_fields_of_knee == {n for n in rows if "." not in n}
    for each in (Osteophyte, Cyst):
        name = f"{each.__name__.lower()}s"
        assert {f"{name}.{field.name}" for field in dataclasses.fields(each)} <= set(rows)
    assert all(row["what"] and row["allowed"] for row in rows.values() if row["field"] != "texture_seed")
    assert rows["jsw_medial_mm"]["allowed"] == "0 to 10"


def test_the_knee_template_is_the_default_knee_with_every_field():
    text = format_knee_template()
    assert knee_from_dict(tomllib.loads(text)) == Knee()
    for field in dataclasses.fields(Knee):
        assert f"{field.name} = " in text


def test_a_setting_needs_only_the_name_of_its_field():
    knee, protocol = parse_settings(["mas=2", "rows = 512", "jsw_medial_mm=3.1", "side=left", "mono_kev=none"])
    assert (knee, protocol) == (
        {"jsw_medial_mm": 3.1, "side": "left"},
        {"mas": 2, "rows": 512, "mono_kev": "none"},
    )
    changed = apply_settings(pssf.load_protocol("reference"), protocol)
    assert (changed.mas, changed.rows, changed.mono_kev) == (2.0, 512, None)
    taller = pssf.Knee(stature_mm=1700.0)
    assert apply_settings(taller, knee) == dataclasses.replace(taller, jsw_medial_mm=3.1, side="left")


def test_list_fields_of_a_knee_are_written_as_in_toml():
    knee, _ = parse_settings(['osteophytes=[{site="medial_tibia", size_mm=2}]', "shape=[1.0]"])
    assert apply_settings(Knee(), knee) == Knee(
        osteophytes=(Osteophyte(site="medial_tibia", size_mm=2.0),), shape=(1.0,)
    )


def test_a_field_of_both_knee_and_protocol_needs_a_prefix():
    with pytest.raises(pssf.InputError, match=r"set must name knee\.flexion_deg or protocol\.flexion_deg"):
        parse_settings(["flexion_deg=5"])
    assert parse_settings(["knee.flexion_deg=5", "protocol.flexion_deg=20"]) == (
        {"flexion_deg": 5},
        {"flexion_deg": 20},
    )


@pytest.mark.parametrize(
    ("setting", "why"),
    [
        ("mas", "set must be FIELD=VALUE, .* got 'mas'"),
        ("mass=2", r"did you mean 'mas'"),
        ("foot.mas=2", "must be one of knee, protocol"),
        ("knee.mas=2", "set must be one of .*, got 'mas'"),
        ("=2", "set must be one of .*, got ''"),
    ],
)
def test_a_malformed_setting_raises_an_error(setting, why):
    with pytest.raises(pssf.InputError, match=why):
        parse_settings([setting])


def test_a_value_out_of_range_raises_an_error_that_names_the_field():
    with pytest.raises(pssf.InputError, match=r"mas must be .*, got 2000"):
        apply_settings(pssf.load_protocol("reference"), {"mas": 2000})
    with pytest.raises(pssf.InputError, match=r"jsw_medial_mm must be .*, got 'wide'"):
        apply_settings(Knee(), {"jsw_medial_mm": "wide"})
