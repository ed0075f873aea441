"""Check frontal bone measures on solids with known outlines."""

import numpy as np
import pytest
import trimesh

from pssf.geometry.mesh import Mesh
from pssf.patient_comparison.bones.frontal_measures import measure_front_view

# Width of a column of the outline, in mm.
PITCH_MM = 0.5


def make_boxes(*spans):
    """Return a mesh of boxes; each box is specified by its limits in x, y and z."""
    boxes = [trimesh.creation.box(bounds=np.transpose(ends)) for ends in spans]
    whole = trimesh.util.concatenate(boxes)
    return Mesh(np.array(whole.vertices), np.array(whole.faces))


@pytest.mark.parametrize("lower", [0.0, -3.0])
def test_a_notch_between_box_condyles_has_its_depth_and_width(lower):
    femur = make_boxes(
        ((8, 40), (-20, 20), (lower, 60)), ((-40, -8), (-20, 20), (0, 60)), ((-40, 40), (-20, 20), (20, 60))
    )
    found = measure_front_view("femur", femur)
    depth = 20 - lower / 2
    assert found["notch's depth, from in front"] == pytest.approx(depth / 80, abs=0.05 / 80)
    assert found["notch's width at half its depth"] == pytest.approx(16 / 80, abs=2 * PITCH_MM / 80)
    assert found["ratio of notch depth to notch width"] == pytest.approx(depth / 16, abs=depth / 16 * 2 * PITCH_MM / 15)


def test_the_eminence_is_measured_along_the_sloping_plateau():
    slope = np.deg2rad(5.0)
    turn = trimesh.transformations.rotation_matrix(-slope, [1, 0, 0])
    tibia = make_boxes(((-40, 40), (-20, 20), (-40, 0)), ((-9, 9), (-6, 6), (0, 10)))
    found = measure_front_view("tibia", Mesh(trimesh.transform_points(tibia.vertices, turn), tibia.faces))
    assert found["eminence's height, from in front"] == pytest.approx(10 / 80, abs=0.05 / 80)
    assert found["eminence's width at half its height"] == pytest.approx(18 / 80, abs=2 * PITCH_MM / 80)


def test_a_patella_has_no_frontal_measures():
    assert measure_front_view("patella", make_boxes(((-20, 20), (-10, 10), (-20, 20)))) == {}
