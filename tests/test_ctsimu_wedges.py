"""Step wedges of the CTSimU test suite: transmission and scatter against two Monte Carlo codes, and wire pairs."""

import dataclasses
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter1d

from pssf import InputError, load_protocol, trace
from pssf.data.imaging.ctsimu_table import load_ctsimu
from pssf.geometry.view import View
from pssf.validation.imaging.ctsimu_images import compare_images_with_ctsimu, find_blur_of_resolution
from pssf.validation.imaging.ctsimu_scatter import compute_wedge_scatter, make_wedge_scene
from pssf.validation.imaging.ctsimu_wedges import compare_with_ctsimu, compute_wedge_signals
from pssf.xray.materials import attenuation_per_mm, parse_compound

TABLE = load_ctsimu()
WEDGES = {f"{wedge.detector}-{wedge.material}-{wedge.beam}": wedge for wedge in TABLE.wedge}


def compute_codes(wedge):
    """Return the transmissions of the two codes and their standard deviations, each (2, 10)."""
    codes, spread = np.array([wedge.rosi, wedge.mcray]), np.array([wedge.rosi_sd, wedge.mcray_sd])
    return codes / codes[:, -1:], spread / codes[:, -1:]


def test_the_table_contains_each_detector_beam_and_wedge():
    assert len(WEDGES) == 16
    assert {wedge.detector for wedge in TABLE.wedge} == {"ideal", "csi_200", "csi_500", "gos_500"}


@pytest.mark.parametrize("name", [name for name in WEDGES if name.endswith("keV")])
def test_monochromatic_primary_agrees_with_both_codes(name):
    codes, spread = compute_codes(WEDGES[name])
    signal = compute_wedge_signals(WEDGES[name], TABLE)
    assert (np.abs(signal - codes) <= spread).any(axis=0).all()
    # The means of the codes differ by up to 1 % at the thickest step, where each has a standard error of 0.2 %.
    assert np.abs(signal / codes.mean(axis=0) - 1).max() < 0.012


@pytest.mark.parametrize("name", ["ideal-Al-120 kV", "ideal-Fe-200 kV"])
def test_polychromatic_primary_of_an_ideal_detector_is_within_1_5_percent(name):
    codes, _ = compute_codes(WEDGES[name])
    assert np.abs(compute_wedge_signals(WEDGES[name], TABLE) / codes.mean(axis=0) - 1).max() < 0.015


@pytest.mark.parametrize("name", ["csi_200-Al-120 kV", "csi_500-Al-120 kV", "gos_500-Fe-200 kV"])
def test_escape_from_the_scintillator_brings_the_signal_nearer_to_the_codes(name):
    codes, _ = compute_codes(WEDGES[name])
    deviation = [
        np.abs(compute_wedge_signals(WEDGES[name], TABLE, escape=escape) / codes.mean(axis=0) - 1).max()
        for escape in (True, False)
    ]
    assert deviation[0] < 0.75 * deviation[1]


def test_the_validation_table_has_a_row_per_wedge():
    rows = compare_with_ctsimu()
    assert len(rows) == 16
    assert all(row["steps_within"] == 10 for row in rows if row["beam"].endswith("keV"))


def test_rays_through_the_steps_have_the_path_lengths_of_the_table():
    geometry, known = TABLE.geometry, TABLE.material["Al"]
    view = View(
        source_mm=(0.0, -geometry.middle_mm, 0.0), centre_mm=(0.0, geometry.sdd_mm - geometry.middle_mm, 0.0),
        rows=91, cols=5, pixel_mm=4.0,
    )  # fmt: skip
    paths = trace(make_wedge_scene("Al", TABLE), view, engine="scanline").path_mm["Al@2.6989"]
    heights = 4.0 * (45 - np.arange(91))
    centres = 36.4 * (np.arange(10) - 4.5)
    for number, centre in enumerate(centres):
        expected = known.thinnest_mm + known.step_mm * (8 - number) if number < 9 else 0.0
        assert_allclose(paths[np.abs(heights - centre) < 15.0], expected, atol=0.01)


def test_scatter_of_an_ideal_detector_is_within_5_percent_of_the_codes():
    wedge = WEDGES["ideal-Al-50 keV"]
    free = np.array([[wedge.rosi[-1]], [wedge.mcray[-1]]])
    primary, total = (
        (np.array(pair) / free).mean(axis=0)
        for pair in ([wedge.rosi, wedge.mcray], [wedge.rosi_total, wedge.mcray_total])
    )
    scatter = compute_wedge_scatter(wedge, TABLE, photons=2_000_000)
    # The free beam and the thinnest step beside it depend most on the assumed width of the wedge.
    assert_allclose(scatter[:8].sum(), (total - primary)[:8].sum(), rtol=0.05)
    assert_allclose(scatter[:8], (total - primary)[:8], rtol=0.15)


@pytest.mark.parametrize("resolution_mm", [0.075, 0.15])
def test_the_blur_gives_a_wire_pair_its_modulation_depth(resolution_mm):
    protocol = dataclasses.replace(load_protocol("reference"), mono_kev=60.0)
    sigma = find_blur_of_resolution(resolution_mm, protocol)
    x = np.linspace(-1.0, 1.0, 8001)
    mu = attenuation_per_mm(parse_compound("Pt@21.45"), np.array([60.0]))[0]
    radius = resolution_mm / 2
    chord = sum(2 * np.sqrt(np.maximum(radius**2 - (x - at) ** 2, 0)) for at in (-resolution_mm, resolution_mm))
    blurred = gaussian_filter1d(1 - np.exp(-mu * chord), sigma / (x[1] - x[0]))
    assert_allclose(1 - blurred[4000] / blurred.max(), 0.2, atol=0.005)


@pytest.mark.skipif(find_spec("ctsimu") is not None, reason="the package ctsimu is installed")
def test_images_without_the_program_of_the_suite_are_refused():
    with pytest.raises(InputError, match="needs the package ctsimu"):
        compare_images_with_ctsimu()
