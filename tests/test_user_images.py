"""Check features of images and masks of the user, in Python and on the command line."""

import sys

import numpy as np
import pandas as pd
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from PIL import Image
from test_patient_radiographs import make_grey_ramp, write_dicom
from test_radiomics import make_texture

import pssf
from pssf import cli
from pssf.core.checks import InputError
from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics.features.feature_backends import is_installed
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import feature_family

IMAGE = make_texture(40, 3)
MASK = np.hypot(*np.mgrid[-20:20, -20:20]) < 13


def run(monkeypatch, capsys, *arguments) -> tuple[int, str, str]:
    """Run the command line; return exit code, output and errors."""
    monkeypatch.setattr(sys, "argv", ["pssf", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    captured = capsys.readouterr()
    return ended.value.code or 0, captured.out, captured.err


def test_features_inside_a_mask_equal_those_of_pyradiomics():
    pytest.importorskip("radiomics", reason="no pyradiomics")
    import SimpleITK as sitk  # noqa: N813
    from radiomics.featureextractor import RadiomicsFeatureExtractor

    extractor = RadiomicsFeatureExtractor(force2D=True, force2Ddimension=0, binCount=64, additionalInfo=False)
    extractor.enableFeatureClassByName("shape2D")
    volumes = [sitk.GetImageFromArray(of[None]) for of in (IMAGE, MASK.astype(np.uint8))]
    for volume in volumes:
        volume.SetSpacing((0.15, 0.15, 1.0))
    theirs = {name.removeprefix("original_"): float(value) for name, value in extractor.execute(*volumes).items()}
    ours = pssf.features(IMAGE, MASK, 0.15, backend="pyradiomics")
    compared = {name: theirs.get(name.replace("firstorder_linear_", "firstorder_")) for name in ours}
    compared = {name: value for name, value in compared.items() if value is not None}
    assert {feature_family(name) for name in compared} >= {
        "firstorder",
        "shape2D",
        "glcm",
        "glrlm",
        "glszm",
        "ngtdm",
        "gldm",
    }
    assert len(compared) > 90
    assert_allclose([ours[name] for name in compared], list(compared.values()), rtol=1e-9)


def test_both_backends_agree_inside_a_mask():
    if not (is_installed("mirp") and is_installed("pyradiomics")):
        pytest.skip("one backend alone")
    one, other = (pssf.features(IMAGE, MASK, 0.15, backend=name) for name in ("pyradiomics", "mirp"))
    # NGTDM of pyradiomics counts pixels without neighbours, so it is excluded.
    both = [name for name in one if name in other and feature_family(name) != "ngtdm"]
    assert len(both) > 80
    assert_allclose([other[name] for name in both], [one[name] for name in both], rtol=1e-6)


def test_without_a_mask_the_whole_image_is_measured():
    whole = pssf.features(IMAGE, pixel_mm=0.2)
    assert whole == pssf.features(IMAGE, np.ones(IMAGE.shape), 0.2)
    assert whole["shape2D_PixelSurface"] == pytest.approx(IMAGE.size * 0.04)
    region = extract_features(IMAGE, 0.2, load_ibsi_tags())
    assert {name: value for name, value in whole.items() if feature_family(name) != "shape2D"} == {
        name: value for name, value in region.items() if feature_family(name) != "shape2D"
    }


@settings(max_examples=8)
@given(outside=st.integers(0, 60000), pad=st.integers(0, 5))
def test_pixels_outside_the_mask_do_not_affect_the_features(outside, pad):
    image, mask = np.pad(IMAGE, pad), np.pad(MASK, pad)
    image[~mask] = outside
    families = ["firstorder", "glcm", "glszm"]
    measured, alone = (pssf.features(*of, 0.15, bins=16, families=families) for of in ((image, mask), (IMAGE, MASK)))
    assert_allclose(list(measured.values()), list(alone.values()), rtol=1e-9)


def test_an_array_a_radiograph_and_a_file_give_the_same_features(tmp_path, small):
    pixels = np.tile(make_texture(32, 1), (8, 8))
    radiograph = pssf.Radiograph(pixels=pixels, protocol=small, seed=0)
    own = pssf.save(radiograph, tmp_path / "own.tif")
    tifffile.imwrite(tmp_path / "plain.tif", pixels)
    Image.fromarray(pixels).save(tmp_path / "plain.png")
    mask = np.zeros(pixels.shape, np.uint8)
    mask[40:90, 60:120] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    options = {"families": ["firstorder", "shape2D"]}
    wanted = pssf.features(pixels, mask, small.pixel_mm, **options)
    assert pssf.features(radiograph, mask, **options) == wanted
    assert pssf.features(own, tmp_path / "mask.png", **options) == wanted
    for name in ("plain.tif", "plain.png"):
        assert pssf.features(str(tmp_path / name), mask, small.pixel_mm, **options) == wanted
    assert pssf.features(pixels.astype(float), mask, small.pixel_mm, **options) == wanted


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ((IMAGE, MASK), "pixel_mm must be the pixel pitch in mm, got None"),
        ((IMAGE, MASK, 0.0), "pixel_mm must be .*, got 0.0 mm"),
        ((IMAGE, MASK[1:], 0.1), r"mask must be an array of numbers of shape \(40, 40\), got \(39, 40\) of bool"),
        ((IMAGE, np.zeros_like(MASK), 0.1), "mask must have at least 4 nonzero pixels, got 0"),
        ((IMAGE[None], None, 0.1), r"image must be a \(rows, cols\) array of numbers, .* got \(1, 40, 40\)"),
        ((IMAGE / 3, None, 0.1), "image must contain integers"),
        ((IMAGE * np.nan, None, 0.1), "image must contain integers"),
        ((None, None, 0.1), "image must be"),
        (("nothing.png", None, 0.1), "nothing.png must be .*No such file"),
    ],
)
def test_invalid_images_and_masks_raise_an_error(given, why):
    with pytest.raises(InputError, match=why):
        pssf.features(*given)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"families": ["glcmm"]}, "did you mean 'glcm'"),
        ({"bins": 4}, "bins must be .*, got 4"),
        ({"backend": "x"}, "backend"),
    ],
)
def test_an_invalid_option_raises_an_error(options, why):
    with pytest.raises(InputError, match=why):
        pssf.features(IMAGE, MASK, 0.1, **options)


@pytest.mark.parametrize("rows", [slice(3, 4), slice(3, 5)])
def test_a_mask_of_one_or_two_lines_of_pixels_has_features(rows):
    thin = np.zeros(IMAGE.shape, bool)
    thin[rows, 5:20] = True
    assert pssf.features(IMAGE, thin, 0.1, families=["firstorder", "glcm"])["firstorder_linear_Mean"] > 0


def test_the_command_pairs_images_and_masks_of_a_folder_by_name(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "mine"
    (folder / "masks").mkdir(parents=True)
    for name in ("a", "b", "c"):
        Image.fromarray(IMAGE).save(folder / f"{name}.png")
    Image.fromarray(MASK.astype(np.uint8)).save(folder / "a_mask.png")
    tifffile.imwrite(folder / "masks" / "b.tif", MASK.astype(np.uint8))
    (folder / "._a.png").write_bytes(b"resource fork")
    (folder / "torn.png").write_bytes(b"torn")
    write_dicom(folder / "d.dcm", make_grey_ramp(8), ImagerPixelSpacing=[0.3, 0.3])
    code, output, errors = run(
        monkeypatch, capsys, "features", folder, "--out", tmp_path / "o", "--pixel-mm", 0.2, "--workers", 1,
        "--families", "firstorder,shape2D",
    )  # fmt: skip
    assert code == 0
    table = pd.read_csv(tmp_path / "o" / "features.csv")
    assert [name.rsplit("/", 1)[1] for name in table["file"]] == ["a.png", "b.png", "c.png", "d.dcm", "torn.png"]
    assert table["mask"].tolist() == ["mask", "mask", "whole image", "whole image", "whole image"]
    assert (table["status"] == "measured").tolist() == [True, True, True, True, False]
    wanted = pssf.features(IMAGE, MASK, 0.2, families=["firstorder", "shape2D"])
    assert_allclose(table.loc[0, list(wanted)].astype(float), list(wanted.values()))
    assert_allclose(table.loc[1, list(wanted)].astype(float), list(wanted.values()))
    assert "torn.png" in errors
    assert "2 of 4 images have no mask" in errors
    assert "4 of 5 rows measured" in output


def test_every_mask_in_a_mask_file_has_a_table_row(tmp_path, knee, small):
    radiograph = pssf.simulate(knee, small, engine="scanline", keep=("masks",), seed=1)
    (tmp_path / "images").mkdir()
    pssf.save(radiograph, tmp_path / "images" / "k.tif")
    pssf.save_masks(radiograph, tmp_path / "masks" / "k.tif")
    from pssf.study.prediction.feature_folder import measure_folder

    table = measure_folder(tmp_path / "images", families=["shape2D"])
    assert radiograph.truth is not None
    assert table["mask"].tolist() == list(radiograph.truth.masks)
    measured = table.set_index("mask").loc["femur"]
    assert measured["shape2D_PixelSurface"] == pytest.approx(radiograph.truth.masks["femur"].sum() * small.pixel_mm**2)
    with pytest.raises(InputError, match="mask must be one mask, got"):
        pssf.features(radiograph, tmp_path / "masks" / "k.tif")


@pytest.mark.parametrize(
    ("names", "why"),
    [
        ((), "contains no image"),
        (("a_mask.png",), "has no image: add an image named a"),
        (("a.png", "a_mask.png", "a_mask.tif"), "has several mask files"),
        (("a.png",), "must contain an image that can be measured, got none"),
    ],
)
def test_a_folder_without_valid_images_exits_with_an_error(names, why, tmp_path, monkeypatch, capsys):
    for name in names:
        Image.fromarray(IMAGE).save(tmp_path / name)
    code, _, errors = run(monkeypatch, capsys, "features", tmp_path, "--out", tmp_path / "o", "--workers", 1)
    assert code == 2
    assert why in errors
