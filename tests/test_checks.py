import math

import pytest

from pssf.core.checks import InputError, from_table, require, require_choice, require_whole
from pssf.model.protocol import Protocol


@pytest.mark.parametrize("value", [math.nan, math.inf, -1, 11, "5", None, True])
def test_a_number_outside_its_range_is_refused_by_name_value_and_range(value):
    with pytest.raises(InputError, match=r"gap_mm = .* mm; allowed: 0 to 10 mm"):
        require("gap_mm", value, 0, 10, "mm")


@pytest.mark.parametrize("value", [1.5, -1, 9, "3", True])
def test_a_count_must_be_whole(value):
    with pytest.raises(InputError, match="whole numbers from 0 to 8"):
        require_whole("rows", value, 0, 8, "pixels")


def test_a_misspelt_choice_is_answered_with_the_nearest():
    with pytest.raises(InputError, match="did you mean 'reference'"):
        require_choice("protocol", "refrence", ("reference", "low_dose"))


def test_a_misspelt_field_is_answered_with_the_nearest():
    with pytest.raises(InputError, match=r"unknown field 'tube_kvp' \(did you mean 'tube_kv'\?\)"):
        from_table(Protocol, {"tube_kvp": 70}, "protocol x.toml")


def test_a_missing_field_is_named():
    with pytest.raises(InputError, match="field 'tube_kv' is missing"):
        from_table(Protocol, {"name": "x"}, "protocol x.toml")
