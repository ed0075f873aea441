"""Films of any source: folders and tables of them, and their pixels as displayed."""

import hashlib
import re
import shutil

import msgspec
import numpy as np
import pydicom
import pytest
import tifffile
from numpy.testing import assert_allclose
from PIL import Image
from pydicom.dataset import FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid
from scipy.stats import spearmanr

import pssf
from pssf.core.checks import InputError
from pssf.data.imaging.display_table import load_display_processing
from pssf.io.patients.patient_radiographs import (
    Film,
    list_films,
    parse_subject_and_side,
    read_film,
)

SHAPE = (72, 80)
RAMP = np.linspace(0.1, 0.9, SHAPE[0] * SHAPE[1]).reshape(SHAPE)


def grey(bits: int) -> np.ndarray:
    return np.rint(RAMP * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def dicom(path, stored, **more):
    """A minimal DX object of the stored values, For Presentation unless another intent is given."""
    item = pydicom.Dataset()
    item.SOPClassUID, item.SOPInstanceUID = "1.2.840.10008.5.1.4.1.1.1.1", generate_uid()
    item.Rows, item.Columns = stored.shape[-2:]
    item.SamplesPerPixel, item.PhotometricInterpretation = 1, "MONOCHROME2"
    item.BitsAllocated, item.BitsStored, item.HighBit, item.PixelRepresentation = 16, 12, 11, 0
    item.PresentationIntentType = "FOR PRESENTATION"
    for name, value in more.items():
        setattr(item, name, value)
    item.PixelData = stored.astype("<u2").tobytes()
    item.file_meta = FileMetaDataset()
    item.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    item.save_as(path, enforce_file_format=True)
    return path


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("bits", [8, 16])
def test_a_grey_picture_comes_back_over_the_range_of_its_bits(tmp_path, suffix, bits):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(grey(bits)).save(path)
    film = read_film(path)
    assert_allclose(film.pixels, RAMP, atol=0.6 / (2**bits - 1))
    assert film.pixels.dtype == np.float64
    assert (film.pixel_mm, film.side) == (None, None)


def test_a_jpeg_in_grey_and_one_in_colours_that_are_alike_are_read(tmp_path):
    Image.fromarray(grey(8)).save(tmp_path / "a.jpg", quality=95)
    Image.fromarray(np.repeat(grey(8)[..., None], 3, axis=2)).save(tmp_path / "b.JPEG", quality=95)
    for name in ("a.jpg", "b.JPEG"):
        assert_allclose(read_film(tmp_path / name).pixels, RAMP, atol=0.02)


def test_a_palette_of_greys_and_a_channel_of_full_opacity_are_read(tmp_path):
    Image.fromarray(grey(8)).convert("P").save(tmp_path / "a.png")
    Image.fromarray(grey(8)).convert("RGBA").save(tmp_path / "b.png")
    for name in ("a.png", "b.png"):
        assert_allclose(read_film(tmp_path / name).pixels, RAMP, atol=0.003)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_whose_zero_is_white_is_turned_round(tmp_path, bits):
    tifffile.imwrite(tmp_path / "a.tif", grey(bits), photometric="miniswhite")
    assert_allclose(read_film(tmp_path / "a.tif").pixels, 1 - RAMP, atol=0.003)


def test_a_picture_turned_by_its_camera_is_turned_back(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 3
    Image.fromarray(grey(8)).save(tmp_path / "a.png", exif=exif)
    assert_allclose(read_film(tmp_path / "a.png").pixels, RAMP[::-1, ::-1], atol=0.003)


def test_a_dicom_is_read_as_displayed_with_its_pitch_and_side(tmp_path):
    path = dicom(tmp_path / "a.dcm", grey(12), ImagerPixelSpacing=[0.2, 0.2], PixelSpacing=[0.19, 0.19], Laterality="L")
    film = read_film(path)
    assert_allclose(film.pixels, RAMP, atol=1e-3)
    assert (film.pixel_mm, film.side) == (0.2, "left")
    film = read_film(dicom(tmp_path / "b.dcm", grey(12), PixelSpacing=[0.19, 0.19], ImageLaterality="R"))
    assert (film.pixel_mm, film.side) == (0.19, "right")


def test_monochrome1_is_turned_round(tmp_path):
    film = read_film(dicom(tmp_path / "a.dcm", grey(12), PhotometricInterpretation="MONOCHROME1"))
    assert_allclose(film.pixels, 1 - RAMP, atol=1e-3)


def test_a_window_and_a_rescale_are_applied(tmp_path):
    window = {"WindowCenter": 2048, "WindowWidth": 1024}
    film = read_film(dicom(tmp_path / "a.dcm", grey(12), **window))
    assert_allclose(film.pixels, np.clip((RAMP * 4095 - 1536) / 1024, 0, 1), atol=2e-3)
    film = read_film(dicom(tmp_path / "b.dcm", grey(12), RescaleSlope=2, RescaleIntercept=-50))
    assert_allclose(film.pixels, RAMP, atol=1e-3)


def test_what_this_package_wrote_comes_alike_from_linear_pixels_and_from_those_for_eyes(tmp_path, knee, small):
    radiograph = pssf.simulate(knee, small, engine="scanline")
    films = []
    for name in ("a.tif", "a.dcm", "a.png"):
        pssf.save(radiograph, tmp_path / name)
        films.append(read_film(tmp_path / name))
    pssf.save(radiograph, tmp_path / "b.dcm", intent="presentation")
    films.append(read_film(tmp_path / "b.dcm"))
    for film in films:
        assert_allclose(film.pixels, films[0].pixels, atol=0.005)
        assert (film.pixel_mm, film.side) == (small.pixel_mm, "right")
    middle, corner = films[0].pixels[100:150, 100:150].mean(), films[0].pixels[:20, :20].mean()
    assert middle > corner + 0.3


@pytest.fixture
def refused(tmp_path):
    """Asks for the refusal of a file, which must be one line that names it."""

    def ask(name: str, why: str) -> None:
        with pytest.raises(InputError, match=why) as told:
            read_film(tmp_path / name)
        assert name in str(told.value)
        assert "\n" not in str(told.value)
        assert re.search("allowed|must", str(told.value))

    return ask


def test_each_file_that_is_no_film_is_refused_by_name(tmp_path, refused):
    (tmp_path / "empty.png").touch()
    refused("empty.png", "must be a radiograph, got 0 bytes")
    (tmp_path / "text.png").write_text("not a picture")
    refused("text.png", "damaged")
    (tmp_path / "text.dcm").write_text("not a picture")
    refused("text.dcm", "damaged")
    refused("missing.png", "No such file")
    refused("a.bmp", r"suffix must be one of .*, got '\.bmp'")
    Image.fromarray(grey(8)).save(tmp_path / "whole.png")
    content = (tmp_path / "whole.png").read_bytes()
    (tmp_path / "half.png").write_bytes(content[: len(content) // 2])
    refused("half.png", "damaged")


def test_each_picture_that_is_no_film_is_refused_by_name(tmp_path, refused):
    Image.fromarray(np.full(SHAPE, 7, np.uint8)).save(tmp_path / "constant.png")
    refused("constant.png", "must have more than one grey value")
    Image.fromarray(grey(8)[:20]).save(tmp_path / "small.png")
    refused("small.png", "rows must be .*, got 20 pixels")
    frames = [Image.fromarray(grey(8)), Image.fromarray(grey(8).T.copy().reshape(SHAPE))]
    for name in ("frames.tif", "frames.png"):
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
        refused(name, "frames must be 1, got 2")
    colour = np.repeat(grey(8)[..., None], 3, axis=2)
    colour[10:20, 10:20, 0] = 255
    Image.fromarray(colour).save(tmp_path / "colour.png")
    refused("colour.png", "channels must differ by at most")
    seen_through = Image.fromarray(grey(8)).convert("RGBA")
    seen_through.putalpha(Image.fromarray(grey(8)))
    seen_through.save(tmp_path / "through.png")
    refused("through.png", "opacity")
    Image.fromarray(RAMP.astype(np.float32)).save(tmp_path / "float.tif")
    refused("float.tif", "kind of pixel must be one of .*, got 'F'")


def test_each_dicom_that_is_no_film_is_refused_by_name(tmp_path, refused):
    dicom(tmp_path / "frames.dcm", np.stack([grey(12), grey(12)]), NumberOfFrames=2)
    refused("frames.dcm", "frames must be 1, got 2")
    dicom(tmp_path / "oblong.dcm", grey(12), PixelSpacing=[0.2, 0.3])
    refused("oblong.dcm", "0.2 by 0.3 mm")
    dicom(tmp_path / "metres.dcm", grey(12), PixelSpacing=[200, 200])
    refused("metres.dcm", "pixel_mm must be .*, got 200")
    dicom(tmp_path / "kind.dcm", grey(12), PhotometricInterpretation="RGB")
    refused("kind.dcm", "PhotometricInterpretation must be one of .*, got 'RGB'")


# Limb beside air: what goes through it, of 4000 in the air, with bone amid it.
ACROSS, DOWN = np.meshgrid(np.linspace(-1, 1, SHAPE[1]), np.linspace(-1, 1, SHAPE[0]))
DEPTH = 2.0 * np.sqrt(np.clip(1 - (ACROSS / 0.8) ** 2, 0, 1)) + 0.8 * (np.abs(ACROSS + 0.2 * DOWN) < 0.3)
BEAM = 4000 * np.exp(-DEPTH)
LINEAR = {
    "PresentationIntentType": "FOR PROCESSING",
    "PixelIntensityRelationship": "LIN",
    "PixelIntensityRelationshipSign": 1,
    "ImagerPixelSpacing": [1.5, 1.5],
}


def order(pixels):
    """Correlation of ranks with the depth of what the beam went through."""
    return spearmanr(pixels.ravel(), DEPTH.ravel()).statistic


@pytest.mark.parametrize("photometric", ["MONOCHROME1", "MONOCHROME2"])
def test_linear_pixels_of_others_are_shown_bone_bright_whatever_their_photometric_interpretation(tmp_path, photometric):
    film = read_film(dicom(tmp_path / "a.dcm", BEAM, **LINEAR, PhotometricInterpretation=photometric))
    assert order(film.pixels) > 0.9
    assert film.pixels[:, :4].max() < 1e-6
    assert film.pixel_mm == 1.5
    assert film.pixels.min() >= 0
    assert film.pixels.max() <= 1


def test_a_slope_and_a_forbidden_window_change_nothing_of_linear_pixels(tmp_path):
    plain = read_film(dicom(tmp_path / "a.dcm", BEAM, **LINEAR)).pixels
    window = {"WindowCenter": 100, "WindowWidth": 50}
    for more in ({"RescaleSlope": 0.01, "RescaleIntercept": 0}, window):
        assert_allclose(read_film(dicom(tmp_path / "b.dcm", BEAM, **LINEAR, **more)).pixels, plain, atol=1e-6)


def test_an_intercept_is_where_the_beam_is_zero(tmp_path):
    plain = read_film(dicom(tmp_path / "a.dcm", np.rint(BEAM), **LINEAR)).pixels
    shifted = {"RescaleSlope": 1, "RescaleIntercept": -90}
    assert_allclose(
        read_film(dicom(tmp_path / "b.dcm", np.rint(BEAM) + 90, **LINEAR, **shifted)).pixels, plain, atol=1e-6
    )


def test_linear_pixels_are_shown_with_the_look_that_is_asked_for(tmp_path):
    path, usual = dicom(tmp_path / "a.dcm", BEAM, **LINEAR), load_display_processing().processed
    assert_allclose(read_film(path).pixels, read_film(path, usual).pixels)
    other = read_film(path, msgspec.structs.replace(usual, bend=0.6))
    assert np.abs(other.pixels - read_film(path).pixels).max() > 0.01


TABLE = pydicom.Dataset()
TABLE.add_new("LUTDescriptor", "US", [2, 0, 16])
TABLE.add_new("LUTData", "OW", b"\0\0\1\0")
TABLE.ModalityLUTType = "US"


@pytest.mark.parametrize("sign", [1, -1])
def test_logarithms_of_the_beam_are_turned_by_their_sign(tmp_path, sign):
    stored = np.rint(2000 - sign * 500 * DEPTH)
    more = {**LINEAR, "PixelIntensityRelationship": "LOG", "PixelIntensityRelationshipSign": sign}
    film = read_film(dicom(tmp_path / "a.dcm", stored, **more, RescaleSlope=1, RescaleIntercept=-1000))
    assert_allclose(film.pixels, DEPTH / DEPTH.max(), atol=1e-3)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"PixelIntensityRelationship": None}, "PixelIntensityRelationship must be one of LIN, LOG, got ''"),
        ({"PixelIntensityRelationship": "DISP"}, "PixelIntensityRelationship must be one of LIN, LOG, got 'DISP'"),
        ({"PixelIntensityRelationshipSign": None}, "PixelIntensityRelationshipSign must be one of 1, -1, got ''"),
        ({"PixelIntensityRelationshipSign": -1}, "PixelIntensityRelationshipSign of linear pixels must be 1"),
        ({"ImagerPixelSpacing": None}, "linear pixels must have an ImagerPixelSpacing, got none"),
        (
            {"RescaleSlope": -1, "RescaleIntercept": 4095},
            "RescaleSlope of pixels FOR PROCESSING must be more than 0, got -1",
        ),
        ({"RescaleSlope": 1, "RescaleIntercept": -5000}, "the largest of linear pixels must be more than 0, got "),
        ({"ModalityLUTSequence": [TABLE]}, "pixels FOR PROCESSING must have a slope, .*, got a modality LUT"),
        ({"PresentationIntentType": "FOR LATER"}, "PresentationIntentType must be one of .*, got 'FOR LATER'"),
    ],
)
def test_pixels_for_processing_of_which_too_little_is_said_are_refused(tmp_path, refused, more, why):
    dicom(tmp_path / "a.dcm", BEAM, **{name: value for name, value in {**LINEAR, **more}.items() if value is not None})
    refused("a.dcm", why)


@pytest.mark.parametrize(
    ("stem", "told"),
    [
        ("9003175L", ("9003175", "left")),
        ("9003175_R", ("9003175", "right")),
        ("a-12 R", ("a-12", "right")),
        ("NormalG0_(115)", ("NormalG0_(115)", None)),
        ("ANNAL", ("ANNAL", None)),
        ("12l", ("12l", None)),
    ],
)
def test_a_name_gives_subject_and_side_by_the_rule(stem, told):
    assert parse_subject_and_side(stem) == told


def film_at(path):
    """A film of its own, since no other one has its name."""
    path.parent.mkdir(exist_ok=True, parents=True)
    pixels = grey(8)
    pixels[0, :8] = list(hashlib.sha256(path.name.encode()).digest()[:8])
    Image.fromarray(pixels).save(path)


def test_folders_by_grade_are_listed_by_grade_and_name(tmp_path):
    for name in ("2/9R.png", "0/8L.png", "0/7.jpg", "x.png", "9/ignored.png"):
        film_at(tmp_path / name)
    (tmp_path / "0" / "notes.txt").write_text("notes")
    films = list_films(tmp_path)
    assert [(f.file, f.grade, f.subject, f.side) for f in films] == [
        ("0/7.jpg", 0, "7", None),
        ("0/8L.png", 0, "8", "left"),
        ("2/9R.png", 2, "9", "right"),
        ("x.png", None, "x", None),
    ]
    assert all(len(film.sha256) == 64 for film in films)


def test_a_table_gives_what_it_has_and_the_name_the_rest(tmp_path):
    for name in ("a/1R.png", "b.png"):
        film_at(tmp_path / name)
    table = tmp_path / "films.csv"
    table.write_text("file,grade,subject,side,pixel_mm\na/1R.png,3,Anna,left,0.2\nb.png,,,,\n")
    one, other = list_films(tmp_path)
    assert one == Film(file="a/1R.png", grade=3, subject="Anna", side="left", pixel_mm=0.2, sha256=one.sha256)
    assert (other.grade, other.subject, other.side, other.pixel_mm) == (None, "b", None, None)
    table.write_text("file\na/1R.png\n")
    (only,) = list_films(table)
    assert (only.grade, only.subject, only.side) == (None, "1", "right")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("name\na.png\n", "must have the column file, got name"),
        ("file,KL\na.png,2\n", "column must be one of .*, got 'KL'"),
        ("file\na.png,2\n", "line 2: cells must be at most 1, as in the header, got 2"),
        ("file,grade\na.png,5\n", "line 2: grade must be one of .*, got '5'"),
        ("file,side\na.png,R\n", "line 2: side must be one of .*, got 'R'"),
        ("file,pixel_mm\na.png,wide\n", "line 2: pixel_mm must be a number of mm, or empty, got 'wide'"),
        ("file,pixel_mm\na.png,nan\n", "line 2: pixel_mm must be .*, got nan"),
        ("file\na.png\na.png\n", "line 3: file must be listed once, got 'a.png' again"),
        ("file\nb.png\n", "b.png must be .*No such file"),
        ("file\na.bmp\n", "line 2: suffix"),
        ("", "must have the column file, got none"),
    ],
)
def test_a_table_with_a_fault_is_refused_with_its_line(tmp_path, text, why):
    film_at(tmp_path / "a.png")
    (tmp_path / "films.csv").write_text(text)
    with pytest.raises(InputError, match=why):
        list_films(tmp_path)


@pytest.mark.parametrize(
    ("files", "told"),
    [
        (("0/7R.png", "2/7R.png"), "0/7R.png and 2/7R.png are copies and must have one grade, got 0 and 2"),
        (("1/7R.png", "1/8R.png"), "1/7R.png and 1/8R.png are copies and must have one subject, got 7 and 8"),
        (("1/7R.png", "8R.png"), "1/7R.png and 8R.png are copies and must have one subject, got 7 and 8"),
        (("1/7L.png", "1/7R.png"), "1/7L.png and 1/7R.png are copies and must have one side, got left and right"),
    ],
    ids=["grade", "subject", "without a grade", "side"],
)
def test_copies_of_a_film_that_are_told_of_differently_are_refused_by_both_names(tmp_path, files, told):
    film_at(tmp_path / files[0])
    (tmp_path / files[1]).parent.mkdir(exist_ok=True)
    shutil.copy(tmp_path / files[0], tmp_path / files[1])
    with pytest.raises(InputError, match=told):
        list_films(tmp_path)
    # A table that has one truth of both is taken.
    (tmp_path / "films.csv").write_text(f"file,grade,subject,side\n{files[0]},1,A,left\n{files[1]},,A,left\n")
    assert len(list_films(tmp_path)) == 2


def test_a_folder_without_films_and_one_with_two_tables_are_refused(tmp_path):
    with pytest.raises(InputError, match="got no radiographs"):
        list_films(tmp_path)
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("file\n")
    with pytest.raises(InputError, match=r"got the tables a\.csv, b\.csv"):
        list_films(tmp_path)
