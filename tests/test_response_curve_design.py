"""Check the plan of response curves, in which the same knees are imaged at every step of a protocol axis."""

import dataclasses

import pytest

from pssf import InputError, load_protocol
from pssf.cohort import plan_cohort
from pssf.study.design.response_curve_design import PROTOCOL_AXES, plan_response_curves

PLAN = plan_cohort("quick", seed=3, overrides={"knees": [3, 1, 3], "protocols": ["reference"]})


def list_changed_fields(one, other) -> set[str]:
    """Return the names of fields in which two protocols differ."""
    return {field.name for field in dataclasses.fields(one) if getattr(one, field.name) != getattr(other, field.name)}


@pytest.mark.parametrize("name", PROTOCOL_AXES)
@pytest.mark.parametrize("protocol", ["reference", "fixed_flexion", "geometry_shift"])
def test_an_axis_has_seven_steps_and_its_reference_step_changes_nothing(name, protocol):
    axis, known = PROTOCOL_AXES[name], load_protocol(protocol)
    assert len(set(axis.steps)) == 7
    assert axis.vary(known, axis.reference_step) == known
    for step in set(axis.steps) - {axis.reference_step}:
        fields = list_changed_fields(axis.vary(known, step), known)
        assert axis.field in fields
        assert fields <= {axis.field, "mas", "sod_mm", "rows", "cols"}


def test_an_axis_keeps_dose_geometry_and_field_of_view():
    known = load_protocol("reference")
    far = PROTOCOL_AXES["distance"].vary(known, 1.3)
    assert far.sdd_mm - far.sod_mm == pytest.approx(known.sdd_mm - known.sod_mm)
    assert far.mas / far.sdd_mm**2 == pytest.approx(known.mas / known.sdd_mm**2, rel=1e-4)
    coarse = PROTOCOL_AXES["pixel_size"].vary(known, 2.0)
    assert coarse.rows * coarse.pixel_mm == pytest.approx(known.rows * known.pixel_mm)
    # By the 15 % rule, a tube voltage that is 15 % higher halves the mAs.
    harder = PROTOCOL_AXES["kv"].coupled_fields(known, 1.15 * known.tube_kv)
    assert harder["mas"] == pytest.approx(known.mas / 2, rel=1e-4)


def test_a_plan_uses_the_same_knees_at_every_step_with_independent_noise():
    plan = plan_response_curves(PLAN, knees=4, reference="reference")
    assert sorted(case.knee.grade for case in plan.cases) == [0, 0, 2, 2]
    known = {case.index: case.knee for case in PLAN.cases}
    assert all(known[case.index] == case.knee for case in plan.cases)
    exposures = [exposure for case in plan.cases for exposure in case.exposures]
    assert len({exposure.name for exposure in exposures}) == len({exposure.seed for exposure in exposures}) == 4 * 56
    seeds = {exposure.seed for case in PLAN.cases for exposure in case.exposures}
    assert not seeds & {exposure.seed for exposure in exposures}


@pytest.mark.parametrize(
    ("counts", "knees", "grades"),
    [
        ([4, 4, 4, 4, 4], 8, [0, 0, 0, 0, 3, 3, 4, 4]),
        ([4, 1, 1, 4, 4], 6, [0, 0, 0, 3, 4, 4]),
        ([2, 1, 1, 0, 2], 4, [0, 0, 4, 4]),
    ],
)
def test_response_curves_use_the_widest_grade_contrast_of_a_cohort(counts, knees, grades):
    population = plan_cohort("population", seed=3, overrides={"knees": counts})
    plan = plan_response_curves(population, knees=knees, reference="fixed_flexion")
    assert sorted(case.knee.grade for case in plan.cases) == grades
    assert len({case.subject for case in plan.cases}) == knees


def test_omitting_axes_does_not_change_the_remaining_ones():
    whole = plan_response_curves(PLAN, knees=4, reference="reference")
    part = plan_response_curves(PLAN, knees=4, reference="reference", axes=("tilt",))
    assert [e for e in whole.cases[0].exposures if e.retest_kind == "tilt"] == list(part.cases[0].exposures)


def test_impossible_response_curves_are_rejected():
    with pytest.raises(InputError, match=r"must be a whole number from .*, got 2 knees"):
        plan_response_curves(PLAN, knees=2, reference="reference")
    with pytest.raises(InputError, match=r"protocol must be one of .*, got 'other'"):
        plan_response_curves(PLAN, knees=4, reference="other")
    without = plan_cohort("quick", seed=3, overrides={"knees": [3, 3], "protocols": ["reference"]})
    with pytest.raises(InputError, match="grades must include 0 and at least one of 2, 3 and 4, got 0, 1"):
        plan_response_curves(without, knees=4, reference="reference")
