"""Room for a leg before its detector."""

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
def bent(too_near):
    return pssf.build(pssf.Knee(), too_near)


def test_a_leg_stands_off_the_detector_by_no_more_than_it_needs(bent, too_near):
    with pytest.raises(InputError, match=r"the leg reaches \d+\.\d mm behind the detector"):
        require_detector_clearance(bent.scene, too_near)
    stood = move_clear_of_detector(bent.scene, too_near)
    off_mm = too_near.sod_mm - stood.sod_mm
    assert off_mm == round(off_mm) > 0
    assert replace(stood, sod_mm=too_near.sod_mm) == too_near
    require_detector_clearance(bent.scene, stood)
    with pytest.raises(InputError):
        require_detector_clearance(bent.scene, replace(stood, sod_mm=stood.sod_mm + 1.0))
    assert move_clear_of_detector(bent.scene, stood) is stood


def test_what_is_not_in_the_picture_needs_no_room(bent, too_near):
    upwards = replace(too_near, rows=16, cols=16, pixel_mm=0.5)
    assert move_clear_of_detector(bent.scene, upwards) is upwards


def test_a_cohort_takes_people_whom_a_detector_is_too_near_and_tells_where_they_stood(too_near, tmp_path):
    plan = cohort.plan_cohort("population", seed=1, overrides={"knees": [1, 0, 0, 0, 0]})
    (case,) = plan.cases
    near = tuple(replace(one, protocol=too_near) for one in case.exposures)
    manifest = cohort.make_cohort(replace(plan, cases=(replace(case, exposures=near),)), tmp_path / "c", workers=1)
    rows = read_manifest(manifest)
    assert (rows["sod_mm"] < too_near.sod_mm).all()
    assert (rows["sdd_mm"] == too_near.sdd_mm).all()
    stood = pssf.load(tmp_path / "c" / rows["file"][0]).protocol
    assert stood.sod_mm == rows["sod_mm"][0]
