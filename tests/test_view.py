import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pssf import load_protocol
from pssf.geometry.view import magnification, project, view_of


@given(angle=st.floats(-20, 20), sod=st.floats(900, 1000), gap=st.floats(10, 200))
def test_the_central_ray_passes_the_origin_and_meets_the_detector_centre(angle, sod, gap):
    protocol = dataclasses.replace(load_protocol("reference"), beam_angle_deg=angle, sod_mm=sod, sdd_mm=sod + gap)
    view = view_of(protocol)
    assert_allclose(np.linalg.norm(view.source_mm), sod)
    centre = (protocol.rows - 1) / 2, (protocol.cols - 1) / 2
    assert_allclose(project(np.zeros((1, 3)), view)[0], centre, atol=1e-6)


def test_a_positive_angle_moves_the_source_proximally():
    protocol = dataclasses.replace(load_protocol("reference"), beam_angle_deg=5.0)
    assert view_of(protocol).source_mm[2] > 0


def test_rows_run_distally_and_columns_towards_plus_x():
    view = view_of(load_protocol("reference"))
    (row, col), (up, _), (_, right) = project(np.array([[0.0, 0, 0], [0, 0, 10], [10, 0, 0]]), view)
    assert up < row
    assert right > col
    assert right - col == pytest.approx(10 * magnification(view) / view.pixel_mm)


def test_reference_magnifies_the_joint_plane_by_sdd_over_sod():
    assert magnification(view_of(load_protocol("reference"))) == pytest.approx(1150 / 950)
