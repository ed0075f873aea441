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
def test_a_drawn_knee_keeps_within_the_table_of_its_grade(seed, grade):
    knee = sample_knee(grade=grade, rng=np.random.default_rng(seed), grade_table="paper")
    ranges = load_grade_table("paper").grade[str(grade)]
    for name in ("jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg"):
        low, high = getattr(ranges, name)
        assert low <= getattr(knee, name) <= high

    assert len(knee.osteophytes) <= ranges.osteophyte_count[1]
    assert all(beak.size_mm <= ranges.largest_osteophyte_mm[1] for beak in knee.osteophytes)
    assert knee.grade == grade


def test_a_grade_2_knee_always_has_an_osteophyte_of_a_millimetre():
    for seed in range(200):
        knee = sample_knee(grade=2, rng=np.random.default_rng(seed), grade_table="paper")
        assert max(beak.size_mm for beak in knee.osteophytes) >= 1.0


def test_the_same_stream_draws_the_same_knee():
    one, two = (sample_knee(grade=2, rng=np.random.default_rng(5), grade_table="paper") for _ in range(2))
    assert one == two
    assert one != sample_knee(grade=2, rng=np.random.default_rng(6), grade_table="paper")


def test_holding_one_field_leaves_the_draw_of_the_others_alone():
    free = sample_knee(grade=1, rng=np.random.default_rng(3), grade_table="paper")
    held = sample_knee(grade=1, rng=np.random.default_rng(3), jsw_medial_mm=4.0, grade_table="paper")
    assert held == dataclasses.replace(free, jsw_medial_mm=4.0)


def test_a_body_mass_index_moves_limb_and_fat_and_nothing_else():
    free = sample_knee(grade=1, rng=np.random.default_rng(3), grade_table="paper")
    heavy = sample_knee(grade=1, rng=np.random.default_rng(3), bmi=45.0, grade_table="paper")
    assert heavy.limb_ap_mm > free.limb_ap_mm
    assert heavy.fat_mm > free.fat_mm
    limb = dict(bmi=free.bmi, limb_ap_mm=free.limb_ap_mm, fat_mm=free.fat_mm)
    assert dataclasses.replace(heavy, **limb) == free


def test_limb_and_fat_can_be_given_whatever_the_body_mass_index():
    knee = Knee(bmi=45.0, fat_mm=6.0)
    assert (knee.limb_ap_mm, knee.fat_mm) == (Knee(bmi=45.0).limb_ap_mm, 6.0)
    drawn = sample_knee(grade=1, rng=np.random.default_rng(3), bmi=45.0, limb_ap_mm=100.0, grade_table="paper")
    assert drawn.limb_ap_mm == 100.0
    # A knee keeps what it measures; None asks for what its BMI gives.
    again = dataclasses.replace(knee, bmi=20.0, limb_ap_mm=None, fat_mm=None)
    assert again == Knee(bmi=20.0)


@pytest.mark.parametrize("bmi", [14.0, 51.0, math.nan, "27"])
def test_a_body_mass_index_out_of_range_is_refused_by_the_draw_too(bmi):
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
def test_a_field_out_of_range_is_named(field, value):
    with pytest.raises(InputError, match=f"{field} must be "):
        Knee(**{field: value})


def test_two_osteophytes_at_one_site_are_refused():
    beak = Osteophyte(site="medial_tibia", size_mm=1.0)
    with pytest.raises(InputError, match=r"osteophytes at medial_tibia must be at least 0.5 apart"):
        Knee(osteophytes=(beak, beak))


def test_several_osteophytes_of_one_margin_lie_apart():
    Knee(osteophytes=tuple(Osteophyte(site="medial_tibia", size_mm=2.0, place=place) for place in (0.0, -0.5, 0.6)))
    with pytest.raises(InputError, match=r"must be at least 0.5 apart in place, got places 0 and 0.4"):
        Knee(osteophytes=tuple(Osteophyte(site="medial_tibia", size_mm=2.0, place=place) for place in (0.4, 0.0)))


@pytest.mark.parametrize(
    ("field", "value"),
    [("site", "medial_patella"), ("size_mm", 10.5), ("size_mm", math.nan), ("place", 1.1), ("curve_deg", -50.0)],
)
def test_a_field_of_an_osteophyte_out_of_range_is_named(field, value):
    with pytest.raises(InputError, match=f"{field} must be "):
        Osteophyte(**{"site": "medial_tibia", "size_mm": 2.0, field: value})


def test_a_spike_on_a_spine_has_neither_place_nor_curve():
    with pytest.raises(InputError, match=r"osteophyte at medial_spine: place .* must be 0 .*, got place = 0\.5"):
        Osteophyte(site="medial_spine", size_mm=2.0, place=0.5)


def test_an_osteophytes_place_and_curve_survive_the_table():
    beak = Osteophyte(site="medial_tibia", size_mm=7.0, place=-0.25, curve_deg=30.0)
    assert knee_from_dict(knee_to_dict(Knee(osteophytes=(beak,)))).osteophytes == (beak,)


def test_a_knee_survives_its_table():
    knee = sample_knee(grade=2, rng=np.random.default_rng(1), grade_table="paper")
    assert knee_from_dict(knee_to_dict(knee)) == knee


def test_a_misspelt_field_of_a_drawn_knee_is_refused():
    with pytest.raises(InputError, match=r"fields must be among .*, got 'jsw_medal_mm'"):
        sample_knee(grade=0, rng=np.random.default_rng(1), jsw_medal_mm=3.0, grade_table="paper")


def test_chance_is_a_seed_or_a_generator_and_nothing_else():
    assert sample_knee(grade=0, rng=7) == sample_knee(grade=0, rng=np.random.default_rng(7))
    for chance in (None, -1, 2**63, 1.5, True, "7"):
        with pytest.raises(InputError, match="rng must be a whole number from 0 to 2"):
            sample_knee(grade=0, rng=chance)
