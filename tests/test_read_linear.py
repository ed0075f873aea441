"""Own images of linear pixels read by a saved model, and what is said of images that do not say what they are."""

import numpy as np
import pandas as pd
import pytest
import tifffile
from numpy.testing import assert_allclose
from phantoms import PIXEL_MM, SHAPE, TEMPLATE, phantom
from PIL import Image
from test_films import dicom
from test_read import files, film_of, linear, model_of, run  # noqa: F401 (fixtures among them)

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
    """The same pixels without any metadata, and what their owner knows of them."""
    made = pssf.load(linear[0])
    path = tmp_path / "plain.tif"
    tifffile.imwrite(path, made.pixels)
    return path, {"side": made.knee.side, "pixel_mm": made.protocol.pixel_mm}


@pytest.mark.parametrize("name", ["lr_l1_0v2_reference", "lr_l1_0v2_films"])
def test_own_linear_pixels_give_what_the_packages_own_file_of_them_gives(files, linear, plain, name):  # noqa: F811
    path, known = plain
    own = predict_films(model_of(files[name]), [film_of(linear[0], **known)], linear[0].parent)
    told = predict_films(model_of(files[name]), [film_of(path, **known)], path.parent, linear=True)
    assert own.table["status"].tolist() == told.table["status"].tolist() == ["found"]
    assert_allclose(told.table["p grade 2"], own.table["p grade 2"], rtol=1e-9)
    assert own.warnings == told.warnings == ()
    assert told.table["warning"].tolist() == [""]


@pytest.mark.parametrize("name", ["lr_l1_0v2_reference", "lr_l1_0v2_films"])
def test_an_image_that_does_not_say_what_it_is_has_a_warning_in_its_row(files, plain, name, tmp_path):  # noqa: F811
    path, known = plain
    done = predict_films(model_of(files[name]), [film_of(path, **known)], tmp_path)
    assert done.table["status"].tolist() == ["found"]
    assert "the file does not say whether its pixels are linear" in done.table["warning"].iloc[0]
    assert "--linear" in done.table["warning"].iloc[0]
    assert done.warnings == (f"{path.name}: {done.table['warning'].iloc[0]}",)


def test_the_command_warns_of_each_image_and_takes_the_owners_word(files, plain, tmp_path, monkeypatch, capsys):  # noqa: F811
    path, known = plain
    read = ("predict", files["lr_l1_0v2_reference"], path, "--workers", 1, "--side", known["side"])
    read += ("--pixel-mm", known["pixel_mm"])
    code, _, said = run(monkeypatch, capsys, *read, "--out", tmp_path / "a")
    assert code == 0
    assert f"{path}: the file does not say" in said
    assert "does not say" in pd.read_csv(tmp_path / "a" / "read.csv")["warning"].iloc[0]
    code, _, said = run(monkeypatch, capsys, *read, "--linear", "--out", tmp_path / "b")
    assert code == 0
    assert "does not say" not in said
    table = pd.read_csv(tmp_path / "b" / "read.csv")
    assert table["warning"].isna().all()
    assert table["film_polarity"].tolist() == ["linear"]
    assert (tmp_path / "b" / "pictures" / "plain.png").exists()


def test_linear_pixels_of_no_known_side_or_pitch_or_of_8_bit_are_refused_with_the_reason(files, plain, tmp_path):  # noqa: F811
    path, known = plain
    Image.fromarray(np.full((80, 80), 9, np.uint8)).save(tmp_path / "eight.png")
    films = [film_of(path, side=known["side"]), film_of(path, pixel_mm=0.6), film_of(tmp_path / "eight.png", **known)]
    done = predict_films(model_of(files["lr_l1_0v2_reference"]), films, tmp_path, linear=True)
    assert done.table["status"].tolist() == ["pixel_mm not given", "side not given", "unreadable"]
    assert done.table["p grade 0"].isna().all()


def test_linear_pixels_come_as_they_are_from_each_kind_of_file(tmp_path):
    pixels = np.arange(80 * 90, dtype=np.uint16).reshape(80, 90)
    tifffile.imwrite(tmp_path / "a.tif", pixels)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    said = {"PresentationIntentType": "FOR PROCESSING", "PixelIntensityRelationship": "LIN", "ImageLaterality": "L"}
    dicom(tmp_path / "a.dcm", pixels % 4096, ImagerPixelSpacing=[0.2, 0.2], **said)
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
            lambda path: dicom(path / "x.dcm", np.ones((80, 80))),
            "PresentationIntentType of linear pixels must be another value, got FOR PRESENTATION",
        ),
        (
            lambda path: dicom(
                path / "x.dcm", np.ones((80, 80)), PresentationIntentType="", PixelIntensityRelationship="LOG"
            ),
            "PixelIntensityRelationship of linear pixels must be another value, got LOG",
        ),
        (
            lambda path: _tiff(path, np.ones((80, 80), np.float32)),
            "must be one grey image of 8 to 16 bit, got .* of float32",
        ),
        (lambda path: _tiff(path, np.ones((80, 80, 3), np.uint16)), r"\(80, 80, 3\) of uint16"),
        (lambda path: _tiff(path, np.full((80, 80), -3, np.int16)), "-3 to -3 of 16 bit"),
    ],
)
def test_what_cannot_be_linear_pixels_is_refused(write, why, tmp_path):
    with pytest.raises(InputError, match=why):
        read_linear_pixels(write(tmp_path))


def _tiff(folder, pixels):
    tifffile.imwrite(folder / "x.tif", pixels)
    return folder / "x.tif"


def pair(gap_px: int = 0):
    """(320, 640 + gap) both knees of the phantom, the right one at the left, as a clinician hangs them."""
    gap = np.full((SHAPE[0], gap_px), 30000, np.uint16)
    return np.hstack([phantom(160, 180), gap, phantom(160, 140, side="left")])


@pytest.mark.parametrize(("side", "col"), [("right", 180), ("left", SHAPE[1] + 140)])
def test_a_second_knee_beside_the_one_that_is_read_is_noticed(side, col):
    assert has_second_knee(compute_density(pair()), side, col, PIXEL_MM, [TEMPLATE], TABLE)


def test_one_knee_in_a_wide_field_is_no_pair():
    air = np.full(SHAPE, 30000, np.uint16)
    alone = np.hstack([phantom(160, 180, noise=1.0), air])
    assert not has_second_knee(compute_density(alone), "right", 180, PIXEL_MM, [TEMPLATE], TABLE)
    assert not has_second_knee(compute_density(phantom(160, 180)), "right", 180, PIXEL_MM, [TEMPLATE], TABLE)


def test_a_record_says_how_many_knees_its_radiograph_shows():
    how = DisplayExtractionSettings(pixel_mm=PIXEL_MM, region_px=64, families=("shape2D",))
    said = [
        measure_linear(
            MeasurementJob(radiograph="a", file="a", sha256="0", side="right", pixel_mm=PIXEL_MM),
            load_pixels=lambda file, pixels=pixels: pixels,
            templates=[TEMPLATE],
            settings=how,
            tables=radiomics_tables(),
            code=compute_code_hashes(("core",)),
        )[0]
        for pixels in (pair(), phantom(160, 180))
    ]
    assert [record["status"] for record in said] == ["found", "found"]
    assert [record["film_knees"] for record in said] == ["two", "one"]
