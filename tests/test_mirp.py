"""Features by MIRP 2.7 (Zwanenburg 2024), an independent implementation of the same definitions, beside pyradiomics.

Skipped unless both are installed, as `uv run --group peers` does.
"""

import logging

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_radiomics import texture

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
    """(192, 192) about the medial joint line of three knees, one a grade, under three protocols."""
    found = []
    for grade, name in enumerate(("reference", "low_dose", "geometry_shift")):
        knee = pssf.sample_knee(grade=grade, rng=np.random.default_rng(grade), grade_table="paper")
        radiograph = pssf.simulate(knee, pssf.load_protocol(name), rng=grade, engine="scanline")
        row, col = (round(at) - SIZE // 2 for at in radiograph.truth.medial_joint_line_px)
        found.append(radiograph.pixels[row : row + SIZE, col : col + SIZE])
    # Of one the edges of all bins are whole grey values, whatever chance gave its brightest pixel.
    low, range_dn = found[0].min(), int(np.ptp(found[0]))
    found[0] = np.minimum(found[0], low + range_dn // BINS * BINS)
    return found


def both(region: np.ndarray, **how) -> list[dict[str, float]]:
    """By pyradiomics, by MIRP."""
    return [extract_features(region, 0.15, load_ibsi_tags(), BINS, backend=name, **how) for name in BACKENDS]


@pytest.mark.parametrize("number", range(3))
def test_every_feature_that_mirp_has_is_the_same_in_the_same_order(regions, number):
    ours, theirs = both(regions[number])
    assert list(theirs) == [name for name in ours if name not in BACKENDS["mirp"].missing_features]
    for name, value in theirs.items():
        # What is nothing but for rounding: the mean of a z-score, and what follows from it.
        assert_allclose(value, ours[name], rtol=1e-9, atol=1e-9 if name == "firstorder_z_Mean" else 0, err_msg=name)
    assert len(theirs) == 18 + 14 + 9 + 23 + 16 + 16 + 5 + 14


def test_grey_values_on_edges_of_bins_are_among_the_sample(regions):
    # There two right programs may differ by floats alone; whole numbers leave no doubt.
    on_edges = [int(((one.astype(int) - int(one.min())) * BINS % int(np.ptp(one)) == 0).sum()) for one in regions]
    assert sum(on_edges) > 6


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_asked_for_alone_is_as_it_is_among_all(name):
    region = texture(40, 3)
    whole, part = (
        extract_features(region, 0.15, load_ibsi_tags(), backend="mirp", **how) for how in ({}, {"families": (name,)})
    )
    assert part == {feature: value for feature, value in whole.items() if feature_family(feature) == name}


def test_mirp_stays_silent_and_leaves_the_log_as_it_was(capfd):
    before = list(logging.getLogger().handlers), logging.getLogger().level
    extract_features(texture(32, 1), 0.15, load_ibsi_tags(), backend="mirp")
    assert capfd.readouterr() == ("", "")
    assert (list(logging.getLogger().handlers), logging.getLogger().level) == before
