"""Check the messages for invalid arguments."""

import math

import numpy as np
import pytest

from pssf.core.checks import (
    InputError,
    build_from_table,
    require_choice,
    require_in_range,
    require_integer,
)
from pssf.model.protocol import Protocol


@pytest.mark.parametrize("value", [math.nan, math.inf, -1, 11, "5", None, True])
def test_a_number_outside_its_range_gives_an_error_with_name_and_range(value):
    with pytest.raises(InputError, match=r"gap_mm must be between 0 and 10 mm, got .* mm"):
        require_in_range("gap_mm", value, 0, 10, "mm")


@pytest.mark.parametrize("value", [1.5, -1, 9, "3", True])
def test_a_count_must_be_an_integer(value):
    with pytest.raises(InputError, match="rows must be a whole number from 0 to 8 pixels, got "):
        require_integer("rows", value, 0, 8, "pixels")


def test_a_misspelt_choice_gives_an_error_with_the_nearest_valid_one():
    with pytest.raises(InputError, match="did you mean 'reference'"):
        require_choice("protocol", "refrence", ("reference", "low_dose"))


def test_a_misspelt_field_gives_an_error_with_the_nearest_valid_one():
    with pytest.raises(InputError, match=r"fields must be among .*, got 'tube_kvp' \(did you mean 'tube_kv'\?\)"):
        build_from_table(Protocol, {"tube_kvp": 70}, "protocol x.toml")


def test_a_missing_field_is_named_in_the_error():
    with pytest.raises(InputError, match=r"fields must include .*; 'tube_kv' is missing"):
        build_from_table(Protocol, {"name": "x"}, "protocol x.toml")


@pytest.mark.parametrize("value", [True, 1.0, "1", None, np.bool_(True)])
def test_a_choice_of_another_type_is_rejected(value):
    with pytest.raises(InputError, match=r"grade must be one of 0, 1, got "):
        require_choice("grade", value, (0, 1))
    require_choice("grade", np.int64(1), (0, 1))


def test_an_error_message_is_one_line_even_with_line_breaks_in_names():
    assert str(InputError("file a\nb\u2028: é")) == "file a\\nb\\u2028: é"
