"""Compare features of pyradiomics with those of the independent implementation MIRP 2.7 (Zwanenburg 2024).

The tests are skipped unless both libraries are installed, as with `uv run --group peers`.
"""

import logging

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_radiomics import make_texture

import pssf
from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics.features.feature_backends import BACKENDS
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import FAMILIES, feature_family

pytest.importorskip("mirp")
pytest.importorskip("radiomics")

SIZE, BINS = 192, 64


@pytest.fixture(scope="module")
def regions() -> list[np.ndarray]:
    """Crop (192, 192) pixels around the medial joint line of three knees, one per grade, under three protocols."""
    found = []
    for grade, name in enumerate(("reference", "low_dose", "geometry_shift")):
        knee = pssf.sample_knee(grade=grade, rng=np.random.default_rng(grade), grade_table="paper")
        radiograph = pssf.simulate(knee, pssf.load_protocol(name), rng=grade, engine="scanline")
        row, col = (round(at) - SIZE // 2 for at in radiograph.truth.medial_joint_line_px)
        found.append(radiograph.pixels[row : row + SIZE, col : col + SIZE])
    # Clipping the brightest pixels of the first region makes all of its bin edges integer grey values.
    low, range_dn = found[0].min(), int(np.ptp(found[0]))
    found[0] = np.minimum(found[0], low + range_dn // BINS * BINS)
    return found


def extract_with_backends(region: np.ndarray, **options) -> list[dict[str, float]]:
    """Extract features with pyradiomics and with MIRP."""
    return [extract_features(region, 0.15, load_ibsi_tags(), BINS, backend=name, **options) for name in BACKENDS]


@pytest.mark.parametrize("number", range(3))
def test_mirp_features_equal_pyradiomics_features_in_the_same_order(regions, number):
    ours, theirs = extract_with_backends(regions[number])
    assert list(theirs) == [name for name in ours if name not in BACKENDS["mirp"].missing_features]
    for name, value in theirs.items():
        # The mean of z-scores is zero except for rounding, so it is compared with an absolute tolerance.
        assert_allclose(value, ours[name], rtol=1e-9, atol=1e-9 if name == "firstorder_z_Mean" else 0, err_msg=name)
    assert len(theirs) == 18 + 14 + 9 + 23 + 16 + 16 + 5 + 14


def test_the_regions_contain_grey_values_on_bin_edges(regions):
    # Integer arithmetic decides without rounding whether a grey value is on a bin edge.
    on_edges = [int(((one.astype(int) - int(one.min())) * BINS % int(np.ptp(one)) == 0).sum()) for one in regions]
    assert sum(on_edges) > 6


@pytest.mark.parametrize("name", FAMILIES)
def test_a_single_feature_family_has_the_values_of_the_complete_set(name):
    region = make_texture(40, 3)
    whole, part = (
        extract_features(region, 0.15, load_ibsi_tags(), backend="mirp", **options)
        for options in ({}, {"families": (name,)})
    )
    assert part == {feature: value for feature, value in whole.items() if feature_family(feature) == name}


def test_mirp_prints_nothing_and_does_not_change_the_log_settings(capfd):
    before = list(logging.getLogger().handlers), logging.getLogger().level
    extract_features(make_texture(32, 1), 0.15, load_ibsi_tags(), backend="mirp")
    assert capfd.readouterr() == ("", "")
    assert (list(logging.getLogger().handlers), logging.getLogger().level) == before
