"""Check that feature extraction avoids known silent errors of PyRadiomics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_radiomics import make_texture

from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics import FAMILIES
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import feature_family

pytest.importorskip("radiomics", reason="pyradiomics is not installed")

import SimpleITK as sitk  # noqa: N813
from radiomics import firstorder, glcm, imageoperations
from radiomics.featureextractor import RadiomicsFeatureExtractor

from pssf.radiomics.features import pyradiomics_backend
from pssf.radiomics.features.pyradiomics_backend import TEXTURES, measure_family


def make_2d_image(values: np.ndarray) -> sitk.Image:
    """Return a two-dimensional SimpleITK image."""
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((0.15, 0.15))
    return image


def compute_glcm(region: np.ndarray, **options) -> dict[str, float]:
    """Return the GLCM features of the inner pixels of a region."""
    mask = np.zeros(region.shape, np.uint8)
    mask[1:-1, 1:-1] = 1
    found = glcm.RadiomicsGLCM(make_2d_image(region), make_2d_image(mask), binCount=64, **options)
    found.enableAllFeatures()
    return {f"glcm_{name}": float(value) for name, value in found.execute().items()}


def test_features_equal_true_2d_features_but_not_those_with_force2d():
    region = np.pad(make_texture(48, 2), 1, mode="edge")
    ours = extract_features(region[1:-1, 1:-1], 0.15, load_ibsi_tags())
    right, wrong = compute_glcm(region), compute_glcm(region, force2D=True, force2Ddimension=0)
    for name, value in right.items():
        assert_allclose(ours[name], value, rtol=1e-9, err_msg=name)
    assert sum(abs(wrong[name] / right[name] - 1) > 0.01 for name in right) > 5


def test_regions_are_normalised_without_their_surroundings():
    region = make_texture(40, 4)
    around = np.pad(region, 20, constant_values=60000)
    mask = np.pad(np.ones(region.shape, np.uint8), 20)
    image, of = (sitk.GetImageFromArray(values[None]) for values in (around, mask))
    extractor = RadiomicsFeatureExtractor(force2D=True, normalize=True, binCount=64, additionalInfo=False)
    assert abs(float(extractor.execute(image, of)["original_firstorder_Mean"])) > 0.5
    assert abs(extract_features(region, 0.15, load_ibsi_tags())["firstorder_z_Mean"]) < 1e-12


@pytest.mark.parametrize("name", list(TEXTURES))
def test_grey_values_on_bin_edges_are_binned_by_integer_arithmetic(name):
    # The range is 64 x 50 grey values, and every value is on a bin edge.
    rng = np.random.default_rng(5)
    region = (3000 + np.minimum(rng.integers(0, 66, (48, 48)) * 50, 3200)).astype(np.uint16)
    on_edges = (region - region.min()) % 50 == 0
    assert on_edges.all()
    levels = np.minimum((region.astype(np.int64) - region.min()) * 64 // int(np.ptp(region)), 63) + 1
    exact = measure_family(TEXTURES[name], levels, np.ones(region.shape, np.uint8), 0.15, binWidth=1)
    found = extract_features(region, 0.15, load_ibsi_tags(), families=(name,))
    for feature, value in exact.items():
        assert_allclose(found[f"{name}_{feature}"], value, rtol=1e-12, err_msg=feature)
    # With floating-point z-scores, rounding would put some values into the bin below.
    z = (region - region.mean()) / region.std()
    float_levels = np.digitize(z, np.linspace(z.min(), z.max(), 65)[:-1])
    assert (float_levels != levels).any()


def test_shared_binning_gives_the_same_features_as_separate_binning(monkeypatch):
    binned, plain = [], imageoperations.binImage
    monkeypatch.setattr(imageoperations, "binImage", lambda *a, **k: binned.append(1) or plain(*a, **k))
    for size, seed in ((32, 1), (64, 2), (96, 3)):
        region = make_texture(size, seed)
        binned.clear()
        whole = extract_features(region, 0.15, load_ibsi_tags())
        # Grey values are binned once for first-order features and once for all texture families.
        assert len(binned) == 2
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


def test_omitting_feature_families_does_not_change_the_others(monkeypatch):
    region = make_texture(32, 1)
    whole = extract_features(region, 0.15, load_ibsi_tags())
    assert {feature_family(name) for name in whole} == set(FAMILIES)
    measured = []
    monkeypatch.setattr(
        pyradiomics_backend,
        "measure_family",
        lambda kind, *a, **k: measured.append(kind) or measure_family(kind, *a, **k),
    )
    for name in FAMILIES:
        measured.clear()
        part = extract_features(region, 0.15, load_ibsi_tags(), families=(name,))
        assert part == {feature: value for feature, value in whole.items() if feature_family(feature) == name}
        assert len(measured) == (2 if name == "firstorder" else 1)
