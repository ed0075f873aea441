"""Check predictions for linear images of the user, and warnings about images with an unknown pixel type."""

import numpy as np
import pandas as pd
import pytest
import tifffile
from block_phantom import PIXEL_MM, SHAPE, TEMPLATE, make_phantom
from numpy.testing import assert_allclose
from PIL import Image
from test_film_prediction import describe_film, files, linear, load_model, run  # noqa: F401 (fixtures among them)
from test_patient_radiographs import write_dicom

import pssf
from pssf.core.checks import InputError
from pssf.data.code_hash import compute_code_hashes
from pssf.io.patients.stored_pixels import has_declared_pixel_meaning, read_linear_pixels
from pssf.radiomics.displayed_radiograph import DisplayExtractionSettings, measure_linear
from pssf.radiomics.features.feature_table import MeasurementJob
from pssf.radiomics.localisation.second_knee import has_second_knee
from pssf.radiomics.localisation.templates import compute_density
from pssf.radiomics.radiomics_tables import radiomics_tables
from pssf.study.prediction.film_prediction import predict_films

TABLE = radiomics_tables().localisation


@pytest.fixture
def plain(linear, tmp_path):  # noqa: F811
    """Save the pixels of `linear` without metadata; return the path, and the known side and pixel size."""
    radiograph = pssf.load(linear[0])
    path = tmp_path / "plain.tif"
    tifffile.imwrite(path, radiograph.pixels)
    return path, {"side": radiograph.knee.side, "pixel_mm": radiograph.protocol.pixel_mm}


@pytest.mark.parametrize("name", ["lr_l1_0v2_reference", "lr_l1_0v2_films"])
def test_linear_pixels_without_metadata_give_the_same_prediction(files, linear, plain, name):  # noqa: F811
    path, known = plain
    own = predict_films(load_model(files[name]), [describe_film(linear[0], **known)], linear[0].parent)
    plain_result = predict_films(load_model(files[name]), [describe_film(path, **known)], path.parent, linear=True)
    assert own.table["status"].tolist() == plain_result.table["status"].tolist() == ["found"]
    assert_allclose(plain_result.table["p grade 2"], own.table["p grade 2"], rtol=1e-9)
    assert own.warnings == plain_result.warnings == ()
    assert plain_result.table["warning"].tolist() == [""]


@pytest.mark.parametrize("name", ["lr_l1_0v2_reference", "lr_l1_0v2_films"])
def test_an_image_with_an_unknown_pixel_type_has_a_warning_in_its_row(files, plain, name, tmp_path):  # noqa: F811
    path, known = plain
    done = predict_films(load_model(files[name]), [describe_film(path, **known)], tmp_path)
    assert done.table["status"].tolist() == ["found"]
    assert "the file does not state whether its pixels are linear" in done.table["warning"].iloc[0]
    assert "--linear" in done.table["warning"].iloc[0]
    assert done.warnings == (f"{path.name}: {done.table['warning'].iloc[0]}",)


def test_the_option_linear_suppresses_warnings_of_unknown_pixels(files, plain, tmp_path, monkeypatch, capsys):  # noqa: F811
    path, known = plain
    read = ("predict", files["lr_l1_0v2_reference"], path, "--workers", 1, "--side", known["side"])
    read += ("--pixel-mm", known["pixel_mm"])
    code, _, errors = run(monkeypatch, capsys, *read, "--out", tmp_path / "a")
    assert code == 0
    assert f"{path}: the file does not state" in errors
    assert "does not state" in pd.read_csv(tmp_path / "a" / "film_predictions.csv")["warning"].iloc[0]
    code, _, errors = run(monkeypatch, capsys, *read, "--linear", "--out", tmp_path / "b")
    assert code == 0
    assert "does not state" not in errors
    table = pd.read_csv(tmp_path / "b" / "film_predictions.csv")
    assert table["warning"].isna().all()
    assert table["film_polarity"].tolist() == ["linear"]
    assert (tmp_path / "b" / "pictures" / "plain.png").exists()


def test_linear_pixels_require_a_side_a_pixel_size_and_16_bits(files, plain, tmp_path):  # noqa: F811
    path, known = plain
    Image.fromarray(np.full((80, 80), 9, np.uint8)).save(tmp_path / "eight.png")
    films = [
        describe_film(path, side=known["side"]),
        describe_film(path, pixel_mm=0.6),
        describe_film(tmp_path / "eight.png", **known),
    ]
    done = predict_films(load_model(files["lr_l1_0v2_reference"]), films, tmp_path, linear=True)
    assert done.table["status"].tolist() == ["pixel_mm not given", "side not given", "unreadable"]
    assert done.table["p grade 0"].isna().all()


def test_linear_pixels_are_read_unchanged_from_every_format(tmp_path):
    pixels = np.arange(80 * 90, dtype=np.uint16).reshape(80, 90)
    tifffile.imwrite(tmp_path / "a.tif", pixels)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    tags = {"PresentationIntentType": "FOR PROCESSING", "PixelIntensityRelationship": "LIN", "ImageLaterality": "L"}
    write_dicom(tmp_path / "a.dcm", pixels % 4096, ImagerPixelSpacing=[0.2, 0.2], **tags)
    for name in ("a.tif", "a.png"):
        np.testing.assert_array_equal(read_linear_pixels(tmp_path / name).pixels, pixels)
        assert not has_declared_pixel_meaning(tmp_path / name)
    read = read_linear_pixels(tmp_path / "a.dcm")
    np.testing.assert_array_equal(read.pixels, pixels % 4096)
    assert (read.pixel_mm, read.side) == (0.2, "left")
    assert has_declared_pixel_meaning(tmp_path / "a.dcm")


@pytest.mark.parametrize(
    ("write", "why"),
    [
        (
            lambda path: write_dicom(path / "x.dcm", np.ones((80, 80))),
            "PresentationIntentType must declare linear pixels, got FOR PRESENTATION",
        ),
        (
            lambda path: write_dicom(
                path / "x.dcm", np.ones((80, 80)), PresentationIntentType="", PixelIntensityRelationship="LOG"
            ),
            "PixelIntensityRelationship must declare linear pixels, got LOG",
        ),
        (
            lambda path: _write_tiff(path, np.ones((80, 80), np.float32)),
            "must be one grey image with 8 to 16 bits, got .* of float32",
        ),
        (lambda path: _write_tiff(path, np.ones((80, 80, 3), np.uint16)), r"\(80, 80, 3\) of uint16"),
        (lambda path: _write_tiff(path, np.full((80, 80), -3, np.int16)), "-3 to -3 of 16 bit"),
    ],
)
def test_pixels_that_cannot_be_linear_raise_an_error(write, why, tmp_path):
    with pytest.raises(InputError, match=why):
        read_linear_pixels(write(tmp_path))


def _write_tiff(folder, pixels):
    tifffile.imwrite(folder / "x.tif", pixels)
    return folder / "x.tif"


def make_phantom_pair(gap_px: int = 0):
    """Make a phantom of both knees, (320, 640 + gap) pixels, with the right knee on the left of the image."""
    gap = np.full((SHAPE[0], gap_px), 30000, np.uint16)
    return np.hstack([make_phantom(160, 180), gap, make_phantom(160, 140, side="left")])


@pytest.mark.parametrize(("side", "col"), [("right", 180), ("left", SHAPE[1] + 140)])
def test_a_second_knee_in_the_image_is_detected(side, col):
    assert has_second_knee(compute_density(make_phantom_pair()), side, col, PIXEL_MM, [TEMPLATE], TABLE)


def test_a_single_knee_in_a_wide_field_is_not_detected_as_two():
    air = np.full(SHAPE, 30000, np.uint16)
    alone = np.hstack([make_phantom(160, 180, noise=1.0), air])
    assert not has_second_knee(compute_density(alone), "right", 180, PIXEL_MM, [TEMPLATE], TABLE)
    assert not has_second_knee(compute_density(make_phantom(160, 180)), "right", 180, PIXEL_MM, [TEMPLATE], TABLE)


def test_a_record_contains_the_number_of_knees_in_the_image():
    settings = DisplayExtractionSettings(pixel_mm=PIXEL_MM, region_px=64, families=("shape2D",))
    records = [
        measure_linear(
            MeasurementJob(radiograph="a", file="a", sha256="0", side="right", pixel_mm=PIXEL_MM),
            load_pixels=lambda file, pixels=pixels: pixels,
            templates=[TEMPLATE],
            settings=settings,
            tables=radiomics_tables(),
            code=compute_code_hashes(("core",)),
        )[0]
        for pixels in (make_phantom_pair(), make_phantom(160, 180))
    ]
    assert [record["status"] for record in records] == ["found", "found"]
    assert [record["film_knees"] for record in records] == ["two", "one"]
