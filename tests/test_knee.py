"""Check the parameters of a knee and the sampling of knees by grade."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pssf import (
    InputError,
    Knee,
    Osteophyte,
    sample_knee,
)
from pssf.data.knees.grade_tables import load_grade_table
from pssf.model.knee import knee_from_dict, knee_to_dict


@given(seed=st.integers(0, 2**32), grade=st.sampled_from([0, 1, 2]))
@settings(max_examples=200)
def test_a_sampled_knee_is_within_the_ranges_of_its_grade(seed, grade):
    knee = sample_knee(grade=grade, rng=np.random.default_rng(seed), grade_table="paper")
    ranges = load_grade_table("paper").grade[str(grade)]
    for name in ("jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg"):
        low, high = getattr(ranges, name)
        assert low <= getattr(knee, name) <= high

    assert len(knee.osteophytes) <= ranges.osteophyte_count[1]
    assert all(osteophyte.size_mm <= ranges.largest_osteophyte_mm[1] for osteophyte in knee.osteophytes)
    assert knee.grade == grade


def test_a_sampled_grade_2_knee_has_an_osteophyte_of_at_least_1_mm():
    for seed in range(200):
        knee = sample_knee(grade=2, rng=np.random.default_rng(seed), grade_table="paper")
        assert max(osteophyte.size_mm for osteophyte in knee.osteophytes) >= 1.0


def test_the_same_random_seed_gives_the_same_knee():
    one, two = (sample_knee(grade=2, rng=np.random.default_rng(5), grade_table="paper") for _ in range(2))
    assert one == two
    assert one != sample_knee(grade=2, rng=np.random.default_rng(6), grade_table="paper")


def test_fixing_one_field_does_not_change_the_other_sampled_fields():
    free = sample_knee(grade=1, rng=np.random.default_rng(3), grade_table="paper")
    fixed = sample_knee(grade=1, rng=np.random.default_rng(3), jsw_medial_mm=4.0, grade_table="paper")
    assert fixed == dataclasses.replace(free, jsw_medial_mm=4.0)


def test_body_mass_index_changes_only_limb_and_fat_thickness():
    free = sample_knee(grade=1, rng=np.random.default_rng(3), grade_table="paper")
    heavy = sample_knee(grade=1, rng=np.random.default_rng(3), bmi=45.0, grade_table="paper")
    assert heavy.limb_ap_mm > free.limb_ap_mm
    assert heavy.fat_mm > free.fat_mm
    limb = dict(bmi=free.bmi, limb_ap_mm=free.limb_ap_mm, fat_mm=free.fat_mm)
    assert dataclasses.replace(heavy, **limb) == free


def test_limb_and_fat_thickness_can_be_set_for_any_body_mass_index():
    knee = Knee(bmi=45.0, fat_mm=6.0)
    assert (knee.limb_ap_mm, knee.fat_mm) == (Knee(bmi=45.0).limb_ap_mm, 6.0)
    sampled = sample_knee(grade=1, rng=np.random.default_rng(3), bmi=45.0, limb_ap_mm=100.0, grade_table="paper")
    assert sampled.limb_ap_mm == 100.0
    # Changing the BMI does not change limb and fat thickness unless they are None, which derives them from the BMI.
    again = dataclasses.replace(knee, bmi=20.0, limb_ap_mm=None, fat_mm=None)
    assert again == Knee(bmi=20.0)


@pytest.mark.parametrize("bmi", [14.0, 51.0, math.nan, "27"])
def test_a_body_mass_index_out_of_range_is_rejected(bmi):
    for make in (Knee, lambda bmi: sample_knee(grade=1, rng=np.random.default_rng(3), bmi=bmi, grade_table="paper")):
        with pytest.raises(InputError, match="bmi must be "):
            make(bmi=bmi)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("jsw_medial_mm", math.nan),
        ("jsw_medial_mm", -0.1),
        ("side", "up"),
        ("stature_mm", 1.75),
        ("grade", 5),
        ("varus_deg", "2"),
    ],
)
def test_a_field_out_of_range_is_named_in_the_error(field, value):
    with pytest.raises(InputError, match=f"{field} must be "):
        Knee(**{field: value})


def test_two_osteophytes_at_the_same_location_are_rejected():
    osteophyte = Osteophyte(site="medial_tibia", size_mm=1.0)
    with pytest.raises(InputError, match=r"osteophytes at medial_tibia must differ by at least 0.5 in place"):
        Knee(osteophytes=(osteophyte, osteophyte))


def test_osteophytes_on_the_same_margin_must_be_at_least_0_5_apart():
    Knee(osteophytes=tuple(Osteophyte(site="medial_tibia", size_mm=2.0, place=place) for place in (0.0, -0.5, 0.6)))
    with pytest.raises(InputError, match=r"must differ by at least 0.5 in place, got places 0 and 0.4"):
        Knee(osteophytes=tuple(Osteophyte(site="medial_tibia", size_mm=2.0, place=place) for place in (0.4, 0.0)))


@pytest.mark.parametrize(
    ("field", "value"),
    [("site", "medial_patella"), ("size_mm", 10.5), ("size_mm", math.nan), ("place", 1.1), ("curve_deg", -50.0)],
)
def test_an_osteophyte_field_out_of_range_is_named_in_the_error(field, value):
    with pytest.raises(InputError, match=f"{field} must be "):
        Osteophyte(**{"site": "medial_tibia", "size_mm": 2.0, field: value})


def test_the_place_of_a_spine_osteophyte_must_be_0():
    with pytest.raises(InputError, match=r"osteophyte at medial_spine: place .* must be 0 .*, got place = 0\.5"):
        Osteophyte(site="medial_spine", size_mm=2.0, place=0.5)


def test_osteophyte_position_and_curvature_survive_dict_conversion():
    osteophyte = Osteophyte(site="medial_tibia", size_mm=7.0, place=-0.25, curve_deg=30.0)
    assert knee_from_dict(knee_to_dict(Knee(osteophytes=(osteophyte,)))).osteophytes == (osteophyte,)


def test_a_knee_survives_conversion_to_a_dictionary():
    knee = sample_knee(grade=2, rng=np.random.default_rng(1), grade_table="paper")
    assert knee_from_dict(knee_to_dict(knee)) == knee


def test_sample_knee_rejects_a_misspelt_field():
    with pytest.raises(InputError, match=r"fields must be among .*, got 'jsw_medal_mm'"):
        sample_knee(grade=0, rng=np.random.default_rng(1), jsw_medal_mm=3.0, grade_table="paper")


def test_sample_knee_accepts_only_a_seed_or_a_generator():
    assert sample_knee(grade=0, rng=7) == sample_knee(grade=0, rng=np.random.default_rng(7))
    for seed in (None, -1, 2**63, 1.5, True, "7"):
        with pytest.raises(InputError, match="rng must be a whole number from 0 to 2"):
            sample_knee(grade=0, rng=seed)
