"""Test the map of the joint space error against beam angle and positioning."""

from dataclasses import replace

import numpy as np
import pytest

import pssf
from pssf.cli.trial_command import _parse_range
from pssf.core.checks import InputError
from pssf.trial.jsw_error import ErrorGrid, measure_jsw_errors
from pssf.trial.jsw_error_figure import draw_jsw_errors


@pytest.fixture(scope="module")
def measured():
    """Measure one knee at the best angle and at others."""
    knee = pssf.sample_knee(grade=2, rng=3)
    view = pssf.load_protocol("fixed_flexion")
    best = pssf.build(knee, view).aim_beam(replace(view, beam_along="medial_plateau", beam_angle_deg=0.0))
    angles = (best.beam_angle_deg - 12, best.beam_angle_deg, view.beam_angle_deg)
    grid = ErrorGrid(angles_deg=angles, axis="centre_z", values=(0.0, 40.0))
    return best.beam_angle_deg, measure_jsw_errors([knee], view, grid)


def test_the_error_is_zero_with_the_beam_along_the_plateau(measured):
    best, (errors, summary) = measured
    nominal = errors[errors["value"] == 0].set_index("beam_angle_deg")["error_mm"]
    assert nominal[best] == pytest.approx(0, abs=1e-9)
    assert abs(nominal[best - 12]) > 0.1
    assert summary["best_angle_deg"].iloc[0] == best
    assert summary["nominal_error_mm"].iloc[0] == pytest.approx(nominal.iloc[2])
    assert summary["within_1_mm"].iloc[0] <= summary["within_2_mm"].iloc[0] < abs(nominal[best - 12])


def test_the_map_covers_the_grid_and_is_drawn(measured):
    errors, summary = measured[1]
    assert len(errors) == 6
    assert np.isfinite(errors["medial_mm"]).all()
    assert draw_jsw_errors(errors, summary).startswith(b"\x89PNG")


def test_invalid_grids_and_views_are_refused():
    with pytest.raises(InputError, match="axis must be"):
        ErrorGrid(angles_deg=(0.0,), axis="tilt", values=(0.0,))
    with pytest.raises(InputError, match="must not be empty"):
        ErrorGrid(angles_deg=(), axis="rotation", values=(0.0,))
    grid = ErrorGrid(angles_deg=(0.0,), axis="rotation", values=(0.0,))
    with pytest.raises(InputError, match="view must be a frontal view"):
        measure_jsw_errors([pssf.Knee()], pssf.load_protocol("lateral"), grid)


def test_ranges_include_their_end():
    assert _parse_range("angles", "-5:15:5") == (-5.0, 0.0, 5.0, 10.0, 15.0)
    assert _parse_range("angles", "0:0.3:0.1") == (0.0, 0.1, 0.2, 0.3)
    assert _parse_range("angles", "4:4:1") == (4.0,)
    for text in ("1:2", "a:b:c", "0:10:0", "0:10:-1", "0:1:0.001", "nan:1:1", "0:inf:1"):
        with pytest.raises(InputError, match="angles must be"):
            _parse_range("angles", text)
