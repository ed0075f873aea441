"""Compare features with the digital phantom of the Image Biomarker Standardisation Initiative (IBSI)."""

import csv
from math import floor, log10
from pathlib import Path

import numpy as np
import pytest
from test_radiomics import make_texture

from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import feature_family
from pssf.radiomics.features.ibsi_tags import find_ibsi_departure, find_ibsi_tag

pytest.importorskip("radiomics", reason="pyradiomics is not installed")

import SimpleITK as sitk  # noqa: N813
from radiomics import firstorder

from pssf.radiomics.features.pyradiomics_backend import TEXTURES, measure_family

FOLDER = Path(__file__).parent / "ibsi"
ENDS = {"glcm": "_2D_avg", "glrlm": "_2D_avg", "glszm": "_2D", "ngtdm": "_2D", "gldm": "_2D"}


def load_phantom() -> tuple[np.ndarray, np.ndarray]:
    """Return the (slices, rows, cols) grey values and mask of the phantom."""
    read = (sitk.GetArrayFromImage(sitk.ReadImage(str(FOLDER / f"{name}.nii.gz"))) for name in ("phantom", "mask"))
    values, mask = read
    assert mask.sum() == 74
    return values.astype(np.int64), mask.astype(np.uint8)


def load_reference_values() -> dict[str, tuple[float, float]]:
    """Return reference value and tolerance per IBSI tag."""
    with open(FOLDER / "ref.csv", newline="") as handle:
        rows = list(csv.DictReader(handle, delimiter=";"))
    return {row["tag"]: (float(row["reference value"]), float(row["tolerance"])) for row in rows}


def agrees(value: float, known: tuple[float, float]) -> bool:
    """Return whether a value rounds to a reference value within its tolerance."""
    digits = 2 - floor(log10(abs(value))) if value else 0
    return abs(round(value, digits) - known[0]) <= known[1] * (1 + 1e-9)


@pytest.mark.parametrize("family", list(TEXTURES))
def test_texture_features_of_the_phantom_match_ibsi(family):
    values, mask = load_phantom()
    slices = [measure_family(TEXTURES[family], one, of, 2.0, binWidth=1) for one, of in zip(values, mask, strict=True)]
    known, tags = load_reference_values(), load_ibsi_tags()[family]
    for name, tag in tags.items():
        mean = float(np.mean([found[name] for found in slices]))
        assert agrees(mean, known[tag + ENDS[family]]), f"{name}: {mean}, {tag}: {known[tag + ENDS[family]]}"
    assert len(tags) == {"glcm": 23, "glrlm": 16, "glszm": 16, "ngtdm": 5, "gldm": 14}[family]


def test_first_order_features_match_ibsi_except_for_the_kurtosis_offset():
    values, mask = load_phantom()
    # The arrangement of voxels does not affect first-order features.
    one = values[mask > 0][None, :]
    found = measure_family(firstorder.RadiomicsFirstOrder, one, np.ones(one.shape, np.uint8), 2.0, binWidth=1)
    known, tags = load_reference_values(), load_ibsi_tags()["firstorder"]
    assert len(tags) == 17
    for name, tag in tags.items():
        value = found[name] - (3 if name == "Kurtosis" else 0)
        assert agrees(value, known[tag]), f"{name}: {value}, {tag}: {known[tag]}"


def test_agreement_respects_the_tolerance():
    assert agrees(5.3349, (5.32, 0.01))
    assert not agrees(5.336, (5.32, 0.01))
    assert agrees(0.0, (0.0, 0.001))


def test_every_feature_has_an_ibsi_tag_or_a_documented_deviation():
    names = list(extract_features(make_texture(32, 1), 0.15, load_ibsi_tags()))
    assert all(find_ibsi_tag(name, load_ibsi_tags()) or find_ibsi_departure(name, load_ibsi_tags()) for name in names)
    assert find_ibsi_tag("firstorder_z_Mean", load_ibsi_tags()) == "stat_mean"
    assert find_ibsi_tag("glcm_Idmn", load_ibsi_tags()) == "cm_inv_diff_mom_norm"
    assert "IBSI value + 3" in find_ibsi_departure("firstorder_linear_Kurtosis", load_ibsi_tags())
    assert (
        sum(
            bool(find_ibsi_tag(name, load_ibsi_tags()))
            for name in names
            if feature_family(name) not in ("firstorder", "shape2D")
        )
        == 74
    )
