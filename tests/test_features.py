"""Ways in which a feature extractor is silently wrong, each shown, and that regions are measured without it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_radiomics import texture

from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics import FAMILIES
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import feature_family

pytest.importorskip("radiomics", reason="no pyradiomics, whose traps these are")

import SimpleITK as sitk  # noqa: N813
from radiomics import firstorder, glcm, imageoperations
from radiomics.featureextractor import RadiomicsFeatureExtractor

from pssf.radiomics.features import pyradiomics_backend
from pssf.radiomics.features.pyradiomics_backend import TEXTURES, measure_family


def flat(values: np.ndarray) -> sitk.Image:
    """A true two-dimensional image."""
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((0.15, 0.15))
    return image


def glcm_of(region: np.ndarray, **how) -> dict[str, float]:
    mask = np.zeros(region.shape, np.uint8)
    mask[1:-1, 1:-1] = 1
    found = glcm.RadiomicsGLCM(flat(region), flat(mask), binCount=64, **how)
    found.enableAllFeatures()
    return {f"glcm_{name}": float(value) for name, value in found.execute().items()}


def test_a_true_2d_image_taken_as_a_slice_is_wrong_and_regions_are_slices():
    region = np.pad(texture(48, 2), 1, mode="edge")
    ours = extract_features(region[1:-1, 1:-1], 0.15, load_ibsi_tags())
    right, wrong = glcm_of(region), glcm_of(region, force2D=True, force2Ddimension=0)
    for name, value in right.items():
        assert_allclose(ours[name], value, rtol=1e-9, err_msg=name)
    assert sum(abs(wrong[name] / right[name] - 1) > 0.01 for name in right) > 5


def test_normalising_takes_the_whole_image_and_regions_are_normalised_by_themselves():
    region = texture(40, 4)
    around = np.pad(region, 20, constant_values=60000)
    mask = np.pad(np.ones(region.shape, np.uint8), 20)
    image, of = (sitk.GetImageFromArray(values[None]) for values in (around, mask))
    extractor = RadiomicsFeatureExtractor(force2D=True, normalize=True, binCount=64, additionalInfo=False)
    assert abs(float(extractor.execute(image, of)["original_firstorder_Mean"])) > 0.5
    assert abs(extract_features(region, 0.15, load_ibsi_tags())["firstorder_z_Mean"]) < 1e-12


@pytest.mark.parametrize("name", list(TEXTURES))
def test_grey_values_on_the_edge_of_a_bin_fall_as_whole_numbers_have_it(name):
    # A range of 64 x 50 grey values: every fiftieth of them lies on an edge.
    rng = np.random.default_rng(5)
    region = (3000 + np.minimum(rng.integers(0, 66, (48, 48)) * 50, 3200)).astype(np.uint16)
    on_edges = (region - region.min()) % 50 == 0
    assert on_edges.all()
    levels = np.minimum((region.astype(np.int64) - region.min()) * 64 // int(np.ptp(region)), 63) + 1
    exact = measure_family(TEXTURES[name], levels, np.ones(region.shape, np.uint8), 0.15, binWidth=1)
    found = extract_features(region, 0.15, load_ibsi_tags(), families=(name,))
    for feature, value in exact.items():
        assert_allclose(found[f"{name}_{feature}"], value, rtol=1e-12, err_msg=feature)
    # By floats the last bit decides: a z-score puts some of them into the bin below.
    z = (region - region.mean()) / region.std()
    places = np.digitize(z, np.linspace(z.min(), z.max(), 65)[:-1])
    assert (places != levels).any()


def test_what_is_taken_once_is_as_each_family_takes_it_by_itself_to_the_last_bit(monkeypatch):
    binned, plain = [], imageoperations.binImage
    monkeypatch.setattr(imageoperations, "binImage", lambda *a, **k: binned.append(1) or plain(*a, **k))
    for size, seed in ((32, 1), (64, 2), (96, 3)):
        region = texture(size, seed)
        binned.clear()
        whole = extract_features(region, 0.15, load_ibsi_tags())
        assert len(binned) == 2  # one for first order, one for all textures
        square = np.ones(region.shape, np.uint8)
        z = (region - region.mean()) / region.std()
        alone = {"firstorder_linear": (firstorder.RadiomicsFirstOrder, region)}
        alone |= {"firstorder_z": (firstorder.RadiomicsFirstOrder, z)}
        alone |= {name: (kind, region) for name, kind in TEXTURES.items()}
        for name, (kind, values) in alone.items():
            expected = measure_family(kind, values, square, 0.15, binCount=64)
            ours = {feature: value for feature, value in whole.items() if feature.startswith(f"{name}_")}
            assert ours == {feature: expected[feature.removeprefix(f"{name}_")] for feature in ours}
            assert len(expected) - len(ours) == (4 if name == "firstorder_z" else 0)


def test_a_family_that_is_left_out_costs_nothing_and_changes_no_other(monkeypatch):
    region = texture(32, 1)
    whole = extract_features(region, 0.15, load_ibsi_tags())
    assert {feature_family(name) for name in whole} == set(FAMILIES)
    asked = []
    monkeypatch.setattr(
        pyradiomics_backend, "measure_family", lambda kind, *a, **k: asked.append(kind) or measure_family(kind, *a, **k)
    )
    for name in FAMILIES:
        asked.clear()
        part = extract_features(region, 0.15, load_ibsi_tags(), families=(name,))
        assert part == {feature: value for feature, value in whole.items() if feature_family(feature) == name}
        assert len(asked) == (2 if name == "firstorder" else 1)
