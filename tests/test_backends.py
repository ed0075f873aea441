"""Which program measures the features, and what of them is measured by the package itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from phantoms import TEMPLATE
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
def only(monkeypatch):
    """Makes believe that of the backends these alone are installed."""
    return lambda *names: monkeypatch.setattr(feature_backends, "is_installed", lambda name: name in names)


def test_pyradiomics_is_taken_where_it_is_installed_and_mirp_elsewhere(only):
    only("pyradiomics", "mirp")
    assert default_backend() == ExtractionSettings().backend == study.StudySettings().backend == "pyradiomics"
    only("mirp")
    assert default_backend() == ExtractionSettings().backend == study.StudySettings().backend == "mirp"


def test_without_a_backend_the_refusal_names_both_and_the_command(only):
    only()
    with pytest.raises(InputError, match=r"pyradiomics or mirp, got none: .* pip install 'pssf\[study\]'"):
        study.require_extra()


def test_a_backend_that_is_not_there_or_unknown_is_refused(only):
    only("pyradiomics")
    with pytest.raises(InputError, match=r"backend must be one that is installed \(pyradiomics\), got 'mirp'"):
        study.StudySettings(backend="mirp")
    with pytest.raises(InputError, match=r"backend must be one of pyradiomics, mirp.*, got 'radiomic'"):
        require_backend("radiomic")


def test_the_backend_is_in_the_key_of_every_record(monkeypatch):
    monkeypatch.setattr(feature_table, "version", lambda name: "1")
    assert hash_settings([TEMPLATE], ExtractionSettings(backend="mirp")) != hash_settings(
        [TEMPLATE], ExtractionSettings(backend="pyradiomics")
    )


def test_another_version_of_the_backend_is_another_key_and_that_of_the_other_one_is_none(monkeypatch):
    versions = dict.fromkeys(("numpy", "scipy", "scikit-image", "pyradiomics", "simpleitk", "mirp"), "1")
    monkeypatch.setattr(feature_table, "version", versions.__getitem__)
    how = ExtractionSettings(backend="mirp")
    before = hash_settings([TEMPLATE], how)
    versions["simpleitk"] = "2"
    assert hash_settings([TEMPLATE], how) == before
    versions["mirp"] = "2"
    assert hash_settings([TEMPLATE], how) != before


def test_a_model_is_read_by_another_backend_only_if_that_has_its_features(only):
    only("mirp")
    assert select_backend("pyradiomics", ["glcm_Contrast", "shape2D_Perimeter"], "model a") == "mirp"
    with pytest.raises(InputError, match="model a must have glcm_MCC, got mirp, which lacks them: install pyradiomics"):
        select_backend("pyradiomics", ["glcm_Contrast", "glcm_MCC"], "model a")
    only("pyradiomics", "mirp")
    assert [select_backend(name, ["glcm_Contrast"], "model a") for name in BACKENDS] == list(BACKENDS)


def blobs(seed: int, size: int, share: float, smooth: float) -> np.ndarray:
    field = np.random.default_rng(seed).standard_normal((size, size))
    field = gaussian_filter(field, smooth) if smooth else field
    return field >= np.quantile(field, 1 - share)


@given(
    seed=st.integers(0, 2**32), size=st.integers(2, 96), share=st.floats(0.02, 1), smooth=st.sampled_from([0, 1, 3, 8])
)
def test_shape_in_the_plane_is_that_of_pyradiomics(seed, size, share, smooth):
    by_pyradiomics = pytest.importorskip(
        "pssf.radiomics.features.pyradiomics_backend", exc_type=ImportError, reason="no pyradiomics"
    )
    mask = blobs(seed, size, share, smooth)
    theirs, ours = by_pyradiomics.shape(mask, 0.15), shape2d.measure_shape(mask, 0.15)
    assert list(ours) == list(theirs)
    for name, value in theirs.items():
        # The axis of pixels in a row has no length, but for rounding.
        assert_allclose(ours[name], value, rtol=1e-9, atol=1e-7, err_msg=name)


def test_shape_of_a_disc_is_that_of_a_circle():
    rows, cols = np.mgrid[-120:121, -120:121]
    found = shape2d.measure_shape(rows**2 + cols**2 <= 100**2, 0.2)
    assert_allclose(found["PixelSurface"], np.pi * 20**2, rtol=0.002)
    assert_allclose([found["MajorAxisLength"], found["MinorAxisLength"]], 40, rtol=0.005)
    assert_allclose(found["MaximumDiameter"], 40, atol=0.3)
    # Marching squares half way overrates a circle's length by some 5 %.
    assert 0.94 < found["Sphericity"] < 0.97
    assert_allclose(found["Elongation"], 1, rtol=1e-9)


def test_no_pixel_has_no_shape_and_the_same_names():
    nothing, one = (shape2d.measure_shape(np.full((4, 4), kind), 1.0) for kind in (False, True))
    assert list(nothing) == list(one)
    assert np.isnan(list(nothing.values())).all()


def test_two_pixels_across_a_diagonal_are_two_bodies():
    one, two = shape2d.measure_shape(np.eye(1, dtype=bool), 1.0), shape2d.measure_shape(np.eye(2, dtype=bool), 1.0)
    assert two["MeshSurface"] == 2 * one["MeshSurface"] == 1.0
    assert two["Perimeter"] == 2 * one["Perimeter"]
