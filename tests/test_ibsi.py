"""The digital phantom of the Image Biomarker Standardisation Initiative, measured as regions are."""

import csv
from math import floor, log10
from pathlib import Path

import numpy as np
import pytest
from test_radiomics import texture

from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import feature_family
from pssf.radiomics.features.ibsi_tags import find_ibsi_departure, find_ibsi_tag

pytest.importorskip("radiomics", reason="no pyradiomics, which is held against the phantom")

import SimpleITK as sitk  # noqa: N813
from radiomics import firstorder

from pssf.radiomics.features.pyradiomics_backend import TEXTURES, measure_family

FOLDER = Path(__file__).parent / "ibsi"
ENDS = {"glcm": "_2D_avg", "glrlm": "_2D_avg", "glszm": "_2D", "ngtdm": "_2D", "gldm": "_2D"}


def volumes() -> tuple[np.ndarray, np.ndarray]:
    """(slices, rows, cols) grey values and mask"""
    read = (sitk.GetArrayFromImage(sitk.ReadImage(str(FOLDER / f"{name}.nii.gz"))) for name in ("phantom", "mask"))
    values, mask = read
    assert mask.sum() == 74
    return values.astype(np.int64), mask.astype(np.uint8)


def reference() -> dict[str, tuple[float, float]]:
    """tag -> value and tolerance"""
    with open(FOLDER / "ref.csv", newline="") as handle:
        rows = list(csv.DictReader(handle, delimiter=";"))
    return {row["tag"]: (float(row["reference value"]), float(row["tolerance"])) for row in rows}


def agrees(value: float, known: tuple[float, float]) -> bool:
    digits = 2 - floor(log10(abs(value))) if value else 0
    return abs(round(value, digits) - known[0]) <= known[1] * (1 + 1e-9)


@pytest.mark.parametrize("family", list(TEXTURES))
def test_texture_of_the_phantom_is_that_of_the_initiative(family):
    values, mask = volumes()
    slices = [measure_family(TEXTURES[family], one, of, 2.0, binWidth=1) for one, of in zip(values, mask, strict=True)]
    known, tags = reference(), load_ibsi_tags()[family]
    for name, tag in tags.items():
        mean = float(np.mean([found[name] for found in slices]))
        assert agrees(mean, known[tag + ENDS[family]]), f"{name}: {mean}, {tag}: {known[tag + ENDS[family]]}"
    assert len(tags) == {"glcm": 23, "glrlm": 16, "glszm": 16, "ngtdm": 5, "gldm": 14}[family]


def test_first_order_of_the_phantom_is_that_of_the_initiative_but_for_kurtosis():
    values, mask = volumes()
    # Of no consequence for first order: how the voxels lie.
    one = values[mask > 0][None, :]
    found = measure_family(firstorder.RadiomicsFirstOrder, one, np.ones(one.shape, np.uint8), 2.0, binWidth=1)
    known, tags = reference(), load_ibsi_tags()["firstorder"]
    assert len(tags) == 17
    for name, tag in tags.items():
        value = found[name] - (3 if name == "Kurtosis" else 0)
        assert agrees(value, known[tag]), f"{name}: {value}, {tag}: {known[tag]}"


def test_a_value_outside_its_tolerance_does_not_agree():
    assert agrees(5.3349, (5.32, 0.01))
    assert not agrees(5.336, (5.32, 0.01))
    assert agrees(0.0, (0.0, 0.001))


def test_every_feature_has_a_tag_or_says_how_it_departs():
    names = list(extract_features(texture(32, 1), 0.15, load_ibsi_tags()))
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
