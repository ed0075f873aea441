"""Features of regions beside MIRP 2.7 (Zwanenburg 2024), an independent implementation of the same definitions.

Skipped unless mirp is installed: it brings 1.5 GB, so it is in the group `peers`.
"""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pssf
from pssf.data.ibsi import ibsi_tags
from pssf.radiomics.families import family
from pssf.radiomics.features import extract
from pssf.radiomics.ibsi import tag_of

mirp = pytest.importorskip("mirp")

SIZE, BINS = 192, 64
# How MIRP's names go on after a tag: distance, aggregation, bins.
ENDS = {"firstorder": "_fbn", "glcm": "_d1_", "glrlm": "_2d", "glszm": "_2d", "ngtdm": "_2d", "gldm": "_d1_"}


@pytest.fixture(scope="module")
def regions() -> list[np.ndarray]:
    """(192, 192) about the medial joint line of three knees, one a grade, under three protocols."""
    found = []
    for grade, name in enumerate(("reference", "low_dose", "geometry_shift")):
        knee = pssf.draw_knee(grade=grade, rng=np.random.default_rng(grade))
        radiograph = pssf.simulate(knee, pssf.load_protocol(name), seed=grade, engine="scanline")
        row, col = (round(at) - SIZE // 2 for at in radiograph.truth.medial_joint_line_px)
        found.append(radiograph.pixels[row : row + SIZE, col : col + SIZE])
    return found


def theirs(region: np.ndarray) -> dict[str, float]:
    """Every feature of MIRP, by its own names."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (table,) = mirp.extract_features(
            image=region[None].astype(np.float64),
            mask=np.ones((1, *region.shape), np.uint8),
            by_slice=True,
            ibsi_compliant=False,
            stack_images="no",
            stack_masks="no",
            base_feature_families=["statistics", "intensity_histogram", "glcm", "glrlm", "glszm", "ngtdm", "ngldm"],
            base_discretisation_method="fixed_bin_number",
            base_discretisation_n_bins=BINS,
            glcm_distance=1.0,
            glcm_spatial_method="2d_average",
            glrlm_spatial_method="2d_average",
            glszm_spatial_method="2d",
            ngtdm_spatial_method="2d",
            ngldm_spatial_method="2d",
            ngldm_distance=1.0,
            ngldm_difference_level=0.0,
        )
    return {name: float(table[name].iloc[0]) for name in table.columns if table[name].dtype.kind == "f"}


@pytest.mark.parametrize("number", range(3))
def test_every_feature_that_mirp_has_is_the_same(regions, number):
    region = regions[number]
    ours, other, compared = extract(region, 0.15, BINS), theirs(region), set()
    for name, value in ours.items():
        tag = tag_of(name, ibsi_tags())
        if not tag or name.startswith("firstorder_z"):
            continue
        (known,) = (v for k, v in other.items() if k == tag or k.startswith(tag + ENDS[family(name)]))
        # Kurtosis is not excess in pyradiomics.
        known += 3 if name.endswith("_Kurtosis") else 0
        assert_allclose(value, known, rtol=1e-9, err_msg=name)
        compared.add(name)
    assert len(compared) == 17 + 23 + 16 + 16 + 5 + 14


def test_grey_values_on_edges_of_bins_are_among_the_sample(regions):
    # There two right programs may differ by floats alone; whole numbers leave no doubt.
    on_edges = [int(((one.astype(int) - int(one.min())) * BINS % int(np.ptp(one)) == 0).sum()) for one in regions]
    assert sum(on_edges) > 6
