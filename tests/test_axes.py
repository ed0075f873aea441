import pytest

import pssf
from pssf.data.bones import mean_shape
from pssf.model.axes import axes

FEMUR = mean_shape().femur


@pytest.mark.parametrize(("varus_deg", "angle_deg"), [(0.0, 175.0), (5.0, 180.0), (-3.5, 171.5)])
def test_the_femorotibial_angle_is_lateral_and_straight_at_180(varus_deg, angle_deg):
    assert axes(pssf.Knee(varus_deg=varus_deg), FEMUR)["femorotibial_deg"] == angle_deg


def test_what_a_knee_cannot_tell_is_not_told():
    read = axes(pssf.Knee(tibial_slope_deg=7.5, insall_salvati=1.3), FEMUR)
    assert read == {"femorotibial_deg": 175.0, "tibial_slope_deg": 7.5, "insall_salvati": 1.3}
