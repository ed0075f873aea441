"""Check patient radiographs: folders and tables of files, and their displayed pixels."""

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


def make_grey_ramp(bits: int) -> np.ndarray:
    """Return a ramp of grey values of a bit depth."""
    return np.rint(RAMP * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def write_dicom(path, stored, **more):
    """Write a minimal DX image with the intent "for presentation" unless another intent is specified."""
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
def test_a_grey_image_is_scaled_by_its_bit_depth(tmp_path, suffix, bits):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(make_grey_ramp(bits)).save(path)
    film = read_film(path)
    assert_allclose(film.pixels, RAMP, atol=0.6 / (2**bits - 1))
    assert film.pixels.dtype == np.float64
    assert (film.pixel_mm, film.side) == (None, None)


def test_grey_images_in_grey_and_colour_jpegs_are_read(tmp_path):
    Image.fromarray(make_grey_ramp(8)).save(tmp_path / "a.jpg", quality=95)
    Image.fromarray(np.repeat(make_grey_ramp(8)[..., None], 3, axis=2)).save(tmp_path / "b.JPEG", quality=95)
    for name in ("a.jpg", "b.JPEG"):
        assert_allclose(read_film(tmp_path / name).pixels, RAMP, atol=0.02)


def test_a_grey_palette_and_an_opaque_alpha_channel_are_read(tmp_path):
    Image.fromarray(make_grey_ramp(8)).convert("P").save(tmp_path / "a.png")
    Image.fromarray(make_grey_ramp(8)).convert("RGBA").save(tmp_path / "b.png")
    for name in ("a.png", "b.png"):
        assert_allclose(read_film(tmp_path / name).pixels, RAMP, atol=0.003)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_whose_zero_is_white_is_inverted(tmp_path, bits):
    tifffile.imwrite(tmp_path / "a.tif", make_grey_ramp(bits), photometric="miniswhite")
    assert_allclose(read_film(tmp_path / "a.tif").pixels, 1 - RAMP, atol=0.003)


def test_an_image_is_rotated_by_its_exif_orientation(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 3
    Image.fromarray(make_grey_ramp(8)).save(tmp_path / "a.png", exif=exif)
    assert_allclose(read_film(tmp_path / "a.png").pixels, RAMP[::-1, ::-1], atol=0.003)


def test_a_dicom_is_read_with_its_pixel_spacing_and_side(tmp_path):
    path = write_dicom(
        tmp_path / "a.dcm", make_grey_ramp(12), ImagerPixelSpacing=[0.2, 0.2], PixelSpacing=[0.19, 0.19], Laterality="L"
    )
    film = read_film(path)
    assert_allclose(film.pixels, RAMP, atol=1e-3)
    assert (film.pixel_mm, film.side) == (0.2, "left")
    film = read_film(
        write_dicom(tmp_path / "b.dcm", make_grey_ramp(12), PixelSpacing=[0.19, 0.19], ImageLaterality="R")
    )
    assert (film.pixel_mm, film.side) == (0.19, "right")


def test_monochrome1_images_are_inverted(tmp_path):
    film = read_film(write_dicom(tmp_path / "a.dcm", make_grey_ramp(12), PhotometricInterpretation="MONOCHROME1"))
    assert_allclose(film.pixels, 1 - RAMP, atol=1e-3)


def test_window_and_rescale_values_are_applied(tmp_path):
    window = {"WindowCenter": 2048, "WindowWidth": 1024}
    film = read_film(write_dicom(tmp_path / "a.dcm", make_grey_ramp(12), **window))
    assert_allclose(film.pixels, np.clip((RAMP * 4095 - 1536) / 1024, 0, 1), atol=2e-3)
    film = read_film(write_dicom(tmp_path / "b.dcm", make_grey_ramp(12), RescaleSlope=2, RescaleIntercept=-50))
    assert_allclose(film.pixels, RAMP, atol=1e-3)


def test_all_file_formats_of_a_radiograph_are_displayed_equally(tmp_path, knee, small):
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
def require_rejection(tmp_path):
    """Return a function that requires a one-line error that names the file."""

    def require(name: str, why: str) -> None:
        with pytest.raises(InputError, match=why) as error:
            read_film(tmp_path / name)
        assert name in str(error.value)
        assert "\n" not in str(error.value)
        assert re.search("allowed|must", str(error.value))

    return require


def test_an_unreadable_file_is_named_in_the_error(tmp_path, require_rejection):
    (tmp_path / "empty.png").touch()
    require_rejection("empty.png", "must be a radiograph, got an empty file")
    (tmp_path / "text.png").write_text("not a picture")
    require_rejection("text.png", "damaged")
    (tmp_path / "text.dcm").write_text("not a picture")
    require_rejection("text.dcm", "damaged")
    require_rejection("missing.png", "No such file")
    require_rejection("a.bmp", r"suffix must be one of .*, got '\.bmp'")
    Image.fromarray(make_grey_ramp(8)).save(tmp_path / "whole.png")
    content = (tmp_path / "whole.png").read_bytes()
    (tmp_path / "half.png").write_bytes(content[: len(content) // 2])
    require_rejection("half.png", "damaged")


def test_an_unsuitable_image_is_named_in_the_error(tmp_path, require_rejection):
    Image.fromarray(np.full(SHAPE, 7, np.uint8)).save(tmp_path / "constant.png")
    require_rejection("constant.png", "must have more than one grey value")
    Image.fromarray(make_grey_ramp(8)[:20]).save(tmp_path / "small.png")
    require_rejection("small.png", "rows must be .*, got 20 pixels")
    frames = [Image.fromarray(make_grey_ramp(8)), Image.fromarray(make_grey_ramp(8).T.copy().reshape(SHAPE))]
    for name in ("frames.tif", "frames.png"):
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
        require_rejection(name, "frames must be 1, got 2")
    colour = np.repeat(make_grey_ramp(8)[..., None], 3, axis=2)
    colour[10:20, 10:20, 0] = 255
    Image.fromarray(colour).save(tmp_path / "colour.png")
    require_rejection("colour.png", "channels must differ by at most")
    translucent = Image.fromarray(make_grey_ramp(8)).convert("RGBA")
    translucent.putalpha(Image.fromarray(make_grey_ramp(8)))
    translucent.save(tmp_path / "translucent.png")
    require_rejection("translucent.png", "opacity")
    Image.fromarray(RAMP.astype(np.float32)).save(tmp_path / "float.tif")
    require_rejection("float.tif", "pixel format must be one of .*, got 'F'")


def test_an_unsuitable_dicom_is_named_in_the_error(tmp_path, require_rejection):
    write_dicom(tmp_path / "frames.dcm", np.stack([make_grey_ramp(12), make_grey_ramp(12)]), NumberOfFrames=2)
    require_rejection("frames.dcm", "frames must be 1, got 2")
    write_dicom(tmp_path / "oblong.dcm", make_grey_ramp(12), PixelSpacing=[0.2, 0.3])
    require_rejection("oblong.dcm", "0.2 by 0.3 mm")
    write_dicom(tmp_path / "metres.dcm", make_grey_ramp(12), PixelSpacing=[200, 200])
    require_rejection("metres.dcm", "pixel_mm must be .*, got 200")
    write_dicom(tmp_path / "kind.dcm", make_grey_ramp(12), PhotometricInterpretation="RGB")
    require_rejection("kind.dcm", "PhotometricInterpretation must be one of .*, got 'RGB'")


# Example image: a limb with central bone, surrounded by air with a signal of 4000.
ACROSS, DOWN = np.meshgrid(np.linspace(-1, 1, SHAPE[1]), np.linspace(-1, 1, SHAPE[0]))
DEPTH = 2.0 * np.sqrt(np.clip(1 - (ACROSS / 0.8) ** 2, 0, 1)) + 0.8 * (np.abs(ACROSS + 0.2 * DOWN) < 0.3)
BEAM = 4000 * np.exp(-DEPTH)
LINEAR = {
    "PresentationIntentType": "FOR PROCESSING",
    "PixelIntensityRelationship": "LIN",
    "PixelIntensityRelationshipSign": 1,
    "ImagerPixelSpacing": [1.5, 1.5],
}


def correlate_with_depth(pixels):
    """Return the rank correlation of pixels with the depth of the limb."""
    return spearmanr(pixels.ravel(), DEPTH.ravel()).statistic


@pytest.mark.parametrize("photometric", ["MONOCHROME1", "MONOCHROME2"])
def test_linear_pixels_are_displayed_with_bright_bone(tmp_path, photometric):
    film = read_film(write_dicom(tmp_path / "a.dcm", BEAM, **LINEAR, PhotometricInterpretation=photometric))
    assert correlate_with_depth(film.pixels) > 0.9
    assert film.pixels[:, :4].max() < 1e-6
    assert film.pixel_mm == 1.5
    assert film.pixels.min() >= 0
    assert film.pixels.max() <= 1


def test_rescale_slope_and_window_do_not_change_linear_pixels(tmp_path):
    plain = read_film(write_dicom(tmp_path / "a.dcm", BEAM, **LINEAR)).pixels
    window = {"WindowCenter": 100, "WindowWidth": 50}
    for more in ({"RescaleSlope": 0.01, "RescaleIntercept": 0}, window):
        assert_allclose(read_film(write_dicom(tmp_path / "b.dcm", BEAM, **LINEAR, **more)).pixels, plain, atol=1e-6)


def test_the_rescale_intercept_is_the_pixel_value_without_signal(tmp_path):
    plain = read_film(write_dicom(tmp_path / "a.dcm", np.rint(BEAM), **LINEAR)).pixels
    shifted = {"RescaleSlope": 1, "RescaleIntercept": -90}
    assert_allclose(
        read_film(write_dicom(tmp_path / "b.dcm", np.rint(BEAM) + 90, **LINEAR, **shifted)).pixels, plain, atol=1e-6
    )


def test_linear_pixels_are_displayed_with_the_requested_processing(tmp_path):
    path, usual = write_dicom(tmp_path / "a.dcm", BEAM, **LINEAR), load_display_processing().processed
    assert_allclose(read_film(path).pixels, read_film(path, usual).pixels)
    other = read_film(path, msgspec.structs.replace(usual, bend=0.6))
    assert np.abs(other.pixels - read_film(path).pixels).max() > 0.01


TABLE = pydicom.Dataset()
TABLE.add_new("LUTDescriptor", "US", [2, 0, 16])
TABLE.add_new("LUTData", "OW", b"\0\0\1\0")
TABLE.ModalityLUTType = "US"


@pytest.mark.parametrize("sign", [1, -1])
def test_logarithmic_pixels_are_inverted_by_their_sign(tmp_path, sign):
    stored = np.rint(2000 - sign * 500 * DEPTH)
    more = {**LINEAR, "PixelIntensityRelationship": "LOG", "PixelIntensityRelationshipSign": sign}
    film = read_film(write_dicom(tmp_path / "a.dcm", stored, **more, RescaleSlope=1, RescaleIntercept=-1000))
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
            "RescaleSlope of pixels FOR PROCESSING must be greater than 0, got -1",
        ),
        ({"RescaleSlope": 1, "RescaleIntercept": -5000}, "the largest linear pixel value must be greater than 0, got "),
        ({"ModalityLUTSequence": [TABLE]}, "pixels FOR PROCESSING must have a rescale slope, got a modality LUT"),
        ({"PresentationIntentType": "FOR LATER"}, "PresentationIntentType must be one of .*, got 'FOR LATER'"),
    ],
)
def test_linear_pixels_without_a_sufficient_description_are_rejected(tmp_path, require_rejection, more, why):
    write_dicom(
        tmp_path / "a.dcm", BEAM, **{name: value for name, value in {**LINEAR, **more}.items() if value is not None}
    )
    require_rejection("a.dcm", why)


@pytest.mark.parametrize(
    ("stem", "expected"),
    [
        ("9003175L", ("9003175", "left")),
        ("9003175_R", ("9003175", "right")),
        ("a-12 R", ("a-12", "right")),
        ("NormalG0_(115)", ("NormalG0_(115)", None)),
        ("ANNAL", ("ANNAL", None)),
        ("12l", ("12l", None)),
    ],
)
def test_subject_and_side_are_read_from_the_file_name(stem, expected):
    assert parse_subject_and_side(stem) == expected


def write_film(path):
    """Write a PNG whose pixels depend on its name, so that no two files are copies."""
    path.parent.mkdir(exist_ok=True, parents=True)
    pixels = make_grey_ramp(8)
    pixels[0, :8] = list(hashlib.sha256(path.name.encode()).digest()[:8])
    Image.fromarray(pixels).save(path)


def test_folders_named_by_grade_are_listed_by_grade_and_name(tmp_path):
    for name in ("2/9R.png", "0/8L.png", "0/7.jpg", "x.png", "9/ignored.png"):
        write_film(tmp_path / name)
    (tmp_path / "0" / "notes.txt").write_text("notes")
    films = list_films(tmp_path)
    assert [(f.file, f.grade, f.subject, f.side) for f in films] == [
        ("0/7.jpg", 0, "7", None),
        ("0/8L.png", 0, "8", "left"),
        ("2/9R.png", 2, "9", "right"),
        ("x.png", None, "x", None),
    ]
    assert all(len(film.sha256) == 64 for film in films)


def test_missing_table_entries_are_derived_from_the_file_name(tmp_path):
    for name in ("a/1R.png", "b.png"):
        write_film(tmp_path / name)
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
        ("name\na.png\n", "must have a column named file, got name"),
        ("file,KL\na.png,2\n", "column must be one of .*, got 'KL'"),
        ("file\na.png,2\n", "line 2: number of cells must be at most 1, as in the header, got 2"),
        ("file,grade\na.png,5\n", "line 2: grade must be one of .*, got '5'"),
        ("file,side\na.png,R\n", "line 2: side must be one of .*, got 'R'"),
        ("file,pixel_mm\na.png,wide\n", "line 2: pixel_mm must be a number in mm, or empty, got 'wide'"),
        ("file,pixel_mm\na.png,nan\n", "line 2: pixel_mm must be .*, got nan"),
        ("file\na.png\na.png\n", "line 3: file must be listed once, got 'a.png' again"),
        ("file\nb.png\n", "b.png must be .*No such file"),
        ("file\na.bmp\n", "line 2: suffix"),
        ("", "must have a column named file, got no columns"),
    ],
)
def test_an_invalid_table_is_rejected_with_its_line_number(tmp_path, text, why):
    write_film(tmp_path / "a.png")
    (tmp_path / "films.csv").write_text(text)
    with pytest.raises(InputError, match=why):
        list_films(tmp_path)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (("0/7R.png", "2/7R.png"), "0/7R.png and 2/7R.png are copies, so their grade must be equal, got 0 and 2"),
        (("1/7R.png", "1/8R.png"), "1/7R.png and 1/8R.png are copies, so their subject must be equal, got 7 and 8"),
        (("1/7R.png", "8R.png"), "1/7R.png and 8R.png are copies, so their subject must be equal, got 7 and 8"),
        (("1/7L.png", "1/7R.png"), "1/7L.png and 1/7R.png are copies, so their side must be equal, got left and right"),
    ],
    ids=["grade", "subject", "without a grade", "side"],
)
def test_the_error_for_contradictory_copies_of_a_film_names_both_files(tmp_path, files, message):
    write_film(tmp_path / files[0])
    (tmp_path / files[1]).parent.mkdir(exist_ok=True)
    shutil.copy(tmp_path / files[0], tmp_path / files[1])
    with pytest.raises(InputError, match=message):
        list_films(tmp_path)
    # A table that describes both copies consistently is accepted.
    (tmp_path / "films.csv").write_text(f"file,grade,subject,side\n{files[0]},1,A,left\n{files[1]},,A,left\n")
    assert len(list_films(tmp_path)) == 2


def test_a_folder_without_films_or_with_two_tables_is_rejected(tmp_path):
    with pytest.raises(InputError, match="contains no radiographs"):
        list_films(tmp_path)
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("file\n")
    with pytest.raises(InputError, match=r"got CSV files a\.csv, b\.csv"):
        list_films(tmp_path)
