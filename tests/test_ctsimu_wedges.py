"""Step wedges of the CTSimU test suite: transmissions against two Monte Carlo codes."""

import numpy as np
import pytest

from pssf.data.imaging.ctsimu_table import load_ctsimu
from pssf.validation.imaging.ctsimu_wedges import compare_with_ctsimu, compute_wedge_signals

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
