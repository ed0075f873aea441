"""Check the selection of the radiomics backend and the shape features that the package computes without a backend."""

import numpy as np
import pytest
from block_phantom import TEMPLATE
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from pssf import study
from pssf.core.checks import InputError
from pssf.radiomics.features import feature_backends, feature_table, shape2d
from pssf.radiomics.features.feature_backends import (
    BACKENDS,
    default_backend,
    require_backend,
    select_backend,
)
from pssf.radiomics.features.feature_table import ExtractionSettings, hash_settings


@pytest.fixture
def set_installed(monkeypatch):
    """Return a function that simulates an environment in which only the named backends are installed."""
    return lambda *names: monkeypatch.setattr(feature_backends, "is_installed", lambda name: name in names)


def test_the_default_backend_is_pyradiomics_if_installed_otherwise_mirp(set_installed):
    set_installed("pyradiomics", "mirp")
    assert default_backend() == ExtractionSettings().backend == study.StudySettings().backend == "pyradiomics"
    set_installed("mirp")
    assert default_backend() == ExtractionSettings().backend == study.StudySettings().backend == "mirp"


def test_the_error_without_a_backend_names_both_and_how_to_install_one(set_installed):
    set_installed()
    with pytest.raises(InputError, match=r"pyradiomics or mirp\) is installed: .* pip install 'pssf\[study\]'"):
        study.require_extra()


def test_a_missing_or_unknown_backend_is_rejected(set_installed):
    set_installed("pyradiomics")
    with pytest.raises(InputError, match=r"backend must be an installed backend \(pyradiomics\), got 'mirp'"):
        study.StudySettings(backend="mirp")
    with pytest.raises(InputError, match=r"backend must be one of pyradiomics, mirp.*, got 'radiomic'"):
        require_backend("radiomic")


def test_the_settings_hash_depends_on_the_backend(monkeypatch):
    monkeypatch.setattr(feature_table, "version", lambda name: "1")
    assert hash_settings([TEMPLATE], ExtractionSettings(backend="mirp")) != hash_settings(
        [TEMPLATE], ExtractionSettings(backend="pyradiomics")
    )


def test_the_settings_hash_depends_on_the_version_of_its_backend_only(monkeypatch):
    versions = dict.fromkeys(("numpy", "scipy", "scikit-image", "pyradiomics", "simpleitk", "mirp"), "1")
    monkeypatch.setattr(feature_table, "version", versions.__getitem__)
    extraction = ExtractionSettings(backend="mirp")
    before = hash_settings([TEMPLATE], extraction)
    versions["simpleitk"] = "2"
    assert hash_settings([TEMPLATE], extraction) == before
    versions["mirp"] = "2"
    assert hash_settings([TEMPLATE], extraction) != before


def test_a_model_accepts_another_backend_only_if_it_has_its_features(set_installed):
    set_installed("mirp")
    assert select_backend("pyradiomics", ["glcm_Contrast", "shape2D_Perimeter"], "model a") == "mirp"
    expected = "model a needs glcm_MCC, which backend mirp does not measure: install pyradiomics"
    with pytest.raises(InputError, match=expected):
        select_backend("pyradiomics", ["glcm_Contrast", "glcm_MCC"], "model a")
    set_installed("pyradiomics", "mirp")
    assert [select_backend(name, ["glcm_Contrast"], "model a") for name in BACKENDS] == list(BACKENDS)


def make_blobs(seed: int, size: int, area_fraction: float, smooth: float) -> np.ndarray:
    """Return a random mask in which `area_fraction` of the pixels are set."""
    field = np.random.default_rng(seed).standard_normal((size, size))
    field = gaussian_filter(field, smooth) if smooth else field
    return field >= np.quantile(field, 1 - area_fraction)


@given(
    seed=st.integers(0, 2**32),
    size=st.integers(2, 96),
    area_fraction=st.floats(0.02, 1),
    smooth=st.sampled_from([0, 1, 3, 8]),
)
def test_2d_shape_features_agree_with_pyradiomics(seed, size, area_fraction, smooth):
    by_pyradiomics = pytest.importorskip(
        "pssf.radiomics.features.pyradiomics_backend", exc_type=ImportError, reason="no pyradiomics"
    )
    mask = make_blobs(seed, size, area_fraction, smooth)
    theirs, ours = by_pyradiomics.shape(mask, 0.15), shape2d.measure_shape(mask, 0.15)
    assert list(ours) == list(theirs)
    for name, value in theirs.items():
        # The minor axis of a single row of pixels is zero except for rounding.
        assert_allclose(ours[name], value, rtol=1e-9, atol=1e-7, err_msg=name)


def test_shape_features_of_a_disc_match_a_circle():
    rows, cols = np.mgrid[-120:121, -120:121]
    found = shape2d.measure_shape(rows**2 + cols**2 <= 100**2, 0.2)
    assert_allclose(found["PixelSurface"], np.pi * 20**2, rtol=0.002)
    assert_allclose([found["MajorAxisLength"], found["MinorAxisLength"]], 40, rtol=0.005)
    assert_allclose(found["MaximumDiameter"], 40, atol=0.3)
    # Marching squares at half height overestimates a circle's perimeter by about 5 %.
    assert 0.94 < found["Sphericity"] < 0.97
    assert_allclose(found["Elongation"], 1, rtol=1e-9)


def test_all_shape_features_of_an_empty_mask_are_nan():
    nothing, one = (shape2d.measure_shape(np.full((4, 4), kind), 1.0) for kind in (False, True))
    assert list(nothing) == list(one)
    assert np.isnan(list(nothing.values())).all()


def test_diagonally_adjacent_pixels_count_as_two_components():
    one, two = shape2d.measure_shape(np.eye(1, dtype=bool), 1.0), shape2d.measure_shape(np.eye(2, dtype=bool), 1.0)
    assert two["MeshSurface"] == 2 * one["MeshSurface"] == 1.0
    assert two["Perimeter"] == 2 * one["Perimeter"]
