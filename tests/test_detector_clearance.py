"""Check the clearance between a leg and the detector."""

from dataclasses import replace

import pytest

import pssf
from pssf import cohort
from pssf.core.checks import InputError
from pssf.io.cohort_records import read_manifest
from pssf.raycast.detector_clearance import move_clear_of_detector, require_detector_clearance


@pytest.fixture(scope="module")
def too_near():
    protocol = pssf.load_protocol("fixed_flexion")
    return replace(protocol, rows=64, cols=64, pixel_mm=4.8, sod_mm=protocol.sdd_mm - 70.0)


@pytest.fixture(scope="module")
def flexed(too_near):
    return pssf.build(pssf.Knee(), too_near)


def test_a_leg_is_moved_away_from_the_detector_by_the_least_distance(flexed, too_near):
    with pytest.raises(InputError, match=r"the leg extends \d+\.\d mm behind the detector"):
        require_detector_clearance(flexed.scene, too_near)
    cleared = move_clear_of_detector(flexed.scene, too_near)
    off_mm = too_near.sod_mm - cleared.sod_mm
    assert off_mm == round(off_mm) > 0
    assert replace(cleared, sod_mm=too_near.sod_mm) == too_near
    require_detector_clearance(flexed.scene, cleared)
    with pytest.raises(InputError):
        require_detector_clearance(flexed.scene, replace(cleared, sod_mm=cleared.sod_mm + 1.0))
    assert move_clear_of_detector(flexed.scene, cleared) is cleared


def test_parts_of_a_leg_outside_the_field_need_no_clearance(flexed, too_near):
    narrow = replace(too_near, rows=16, cols=16, pixel_mm=0.5)
    assert move_clear_of_detector(flexed.scene, narrow) is narrow


def test_a_cohort_records_how_far_legs_are_moved_from_the_detector(too_near, tmp_path):
    plan = cohort.plan_cohort("population", seed=1, overrides={"knees": [1, 0, 0, 0, 0]})
    (case,) = plan.cases
    near = tuple(replace(one, protocol=too_near) for one in case.exposures)
    manifest = cohort.make_cohort(replace(plan, cases=(replace(case, exposures=near),)), tmp_path / "c", workers=1)
    rows = read_manifest(manifest)
    assert (rows["sod_mm"] < too_near.sod_mm).all()
    assert (rows["sdd_mm"] == too_near.sdd_mm).all()
    cleared = pssf.load(tmp_path / "c" / rows["file"][0]).protocol
    assert cleared.sod_mm == rows["sod_mm"][0]
