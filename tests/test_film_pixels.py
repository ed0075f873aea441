"""Check that grey values of DICOM and TIFF radiographs are read correctly or rejected with a reason."""

import itertools
import struct
import zlib

import numpy as np
import pydicom
import pydicom.data
import pytest
import tifffile
from PIL import Image, ImageOps
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, JPEGLSLossless, RLELossless, generate_uid

import pssf
from pssf.io.dicom import dicom_pixels
from pssf.io.patients.patient_radiographs import read_film
from pssf.io.patients.stored_pixels import read_stored_pixels

GREY = (np.add.outer(np.arange(96), np.arange(128)) * 18).astype("<u2")
PLAIN = GREY / 4095
# DICOM window and the expected display, clipped to the range from black (0) to white (1).
WINDOW = {"WindowCenter": 2048, "WindowWidth": 2000}
WINDOWED = np.clip((GREY - 2047.5) / 1999 + 0.5, 0, 1)


def make_empty_lut():
    """Return a DICOM LUT sequence whose item has empty data."""
    item = Dataset()
    item.add_new(0x00283002, "SS", None)
    item.add_new(0x00283006, "OW", None)
    return Sequence([item])


def write_dicom(path, pixels=GREY, **fields):
    """Write a DX image for presentation with 12 of 16 bits."""
    item = Dataset()
    item.file_meta = FileMetaDataset()
    item.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    item.SOPClassUID = item.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.1.1"
    item.SOPInstanceUID = item.file_meta.MediaStorageSOPInstanceUID = generate_uid()
    item.Rows, item.Columns = pixels.shape
    item.SamplesPerPixel, item.PhotometricInterpretation = 1, "MONOCHROME2"
    item.BitsAllocated, item.BitsStored, item.HighBit, item.PixelRepresentation = 16, 12, 11, 0
    for name, value in fields.items():
        setattr(item, name, value)
    item.PixelData = pixels.tobytes()
    item.save_as(path, enforce_file_format=True)
    return path


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, PLAIN),
        (WINDOW, WINDOWED),
        ({**WINDOW, "VOILUTFunction": ""}, WINDOWED),
        ({**WINDOW, "VOILUTSequence": make_empty_lut()}, WINDOWED),
        ({**WINDOW, "VOILUTSequence": Sequence([])}, WINDOWED),
        ({"ModalityLUTSequence": make_empty_lut()}, PLAIN),
        ({"RescaleSlope": None, "RescaleIntercept": None}, PLAIN),
        ({"RescaleSlope": 1}, PLAIN),
        ({"RescaleIntercept": -1024}, PLAIN),
        ({"RescaleSlope": 2, "RescaleIntercept": None}, PLAIN),
        ({"WindowCenter": 2048}, PLAIN),
        ({"WindowCenter": None, "WindowWidth": 2000}, PLAIN),
        ({"PhotometricInterpretation": "MONOCHROME1"}, 1 - PLAIN),
        ({"PresentationLUTShape": "IDENTITY"}, PLAIN),
        ({"PresentationLUTShape": "INVERSE"}, 1 - PLAIN),
        ({"PhotometricInterpretation": "MONOCHROME1", "PresentationLUTShape": "INVERSE"}, 1 - PLAIN),
        ({**WINDOW, "PresentationLUTShape": "INVERSE"}, 1 - WINDOWED),
    ],
)
def test_a_valid_dicom_is_displayed_as_the_standard_defines(tmp_path, fields, expected):
    np.testing.assert_allclose(read_film(write_dicom(tmp_path / "a.dcm", **fields)).pixels, expected, atol=1e-3)


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize(("value", "limit", "hit"), [(0, None, 0), (4095, None, 4095), (4090, 4095, 4093)])
def test_pixel_padding_is_displayed_black(tmp_path, inverse, value, limit, hit):
    pixels = GREY.copy()
    pixels[:, :20] = hit
    fields = {"PhotometricInterpretation": "MONOCHROME1"} if inverse else {}
    fields |= {"PixelPaddingValue": value} | ({} if limit is None else {"PixelPaddingRangeLimit": limit})
    expected = read_film(write_dicom(tmp_path / "a.dcm", pixels, **fields)).pixels
    padded = (pixels >= value) & (pixels <= (value if limit is None else limit))
    assert (expected[padded] == 0).all()
    np.testing.assert_allclose(expected[~padded], (1 - pixels / 4095 if inverse else pixels / 4095)[~padded], atol=1e-9)


@pytest.mark.parametrize("relationship", ["LIN", "LOG"])
def test_pixel_padding_does_not_affect_the_grey_scale(tmp_path, relationship):
    pixels = GREY // 2 + 500
    fields = {
        "PresentationIntentType": "FOR PROCESSING",
        "PixelIntensityRelationship": relationship,
        "PixelIntensityRelationshipSign": 1,
        "ImagerPixelSpacing": [1.0, 1.0],
    }
    padded = pixels.copy()
    padded[0, 0] = 4095
    expected = read_film(write_dicom(tmp_path / "b.dcm", padded, PixelPaddingValue=4095, **fields)).pixels
    filled = pixels.copy()
    filled[0, 0] = padded[padded < 4095].max()
    np.testing.assert_array_equal(expected, read_film(write_dicom(tmp_path / "c.dcm", filled, **fields)).pixels)
    # If the padding value is not declared, the same image has a different grey scale.
    without_padding_value = read_film(write_dicom(tmp_path / "d.dcm", padded, **fields)).pixels
    assert abs(expected[60:] - without_padding_value[60:]).max() > 0.01


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({**WINDOW, "WindowWidth": 0}, "WindowWidth must be at least 1, got 0"),
        ({"ImagerPixelSpacing": 0.2}, r"pixel spacing must be two numbers, got 0\.2"),
    ],
)
def test_an_invalid_dicom_attribute_is_named_in_the_error(tmp_path, fields, message):
    with pytest.raises(pssf.InputError, match=message):
        read_film(write_dicom(tmp_path / "a.dcm", **fields))


@pytest.mark.parametrize("name", ["JPGExtended.dcm", "MR_small_jpeg_ls_lossless.dcm", "MR_small_RLE.dcm"])
def test_compressed_dicom_pixels_are_read(name):
    pytest.importorskip("libjpeg")
    read = read_film(pydicom.data.get_testdata_file(name)).pixels
    assert read.max() > read.min()


def test_lossless_compression_changes_no_grey_value(tmp_path):
    path = write_dicom(tmp_path / "a.dcm")
    item = pydicom.dcmread(path)
    item.compress(RLELossless)
    item.save_as(tmp_path / "b.dcm")
    np.testing.assert_array_equal(read_film(tmp_path / "b.dcm").pixels, read_film(path).pixels)


def write_invalid_jpeg_ls(path):
    """Write a DICOM whose JPEG-LS pixel data cannot be decoded."""
    item = pydicom.dcmread(write_dicom(path))
    item.file_meta.TransferSyntaxUID = JPEGLSLossless
    item.PixelData = pydicom.encaps.encapsulate([b"\xff\xd8 no picture"])
    item["PixelData"].is_undefined_length = True
    item.save_as(path)
    return path


def test_the_error_for_a_missing_decoder_names_the_install_command(tmp_path, monkeypatch):
    class MissingDecoder:
        is_available = False
        missing_dependencies = ("pylibjpeg - requires pylibjpeg>=2.0 and pylibjpeg-libjpeg>=2.1",)

    monkeypatch.setattr(dicom_pixels, "get_decoder", lambda syntax: MissingDecoder())
    with pytest.raises(pssf.InputError) as error:
        read_film(write_invalid_jpeg_ls(tmp_path / "a.dcm"))
    for word in ("JPEG-LS Lossless", "1.2.840.10008.1.2.4.80", "pip install 'pssf[compressed]'", "pylibjpeg-libjpeg"):
        assert word in str(error.value)
    assert "damaged" not in str(error.value)


@pytest.mark.parametrize("syntax", ["1.2.840.10008.1.2.4.100", "1.2.840.10008.1.2.4.94", "1.2.3.4.5"])
def test_an_unsupported_transfer_syntax_is_named_in_the_error(tmp_path, syntax):
    item = pydicom.dcmread(write_invalid_jpeg_ls(tmp_path / "a.dcm"))
    item.file_meta.TransferSyntaxUID = syntax
    with pytest.raises(pssf.InputError, match=syntax):
        dicom_pixels.require_decoder(item, tmp_path / "a.dcm")


@pytest.mark.parametrize("lossless", [RLELossless])
def test_a_compressed_dicom_of_this_package_is_loaded(tmp_path, lossless):
    protocol = pssf.load_protocol("reference")
    from dataclasses import replace

    small = replace(protocol, rows=64, cols=64, pixel_mm=4.8, scatter="none", texture="none")
    radiograph = pssf.simulate(pssf.Knee(), small, engine="scanline", keep=("masks",))
    item = pydicom.dcmread(pssf.save(radiograph, tmp_path / "a.dcm"))
    item.compress(lossless, generate_instance_uid=False)
    item.save_as(tmp_path / "b.dcm")
    np.testing.assert_array_equal(pssf.load(tmp_path / "b.dcm").pixels, radiograph.pixels)


def make_tiff(bits, endian, photometric, compression, orientation=1):
    """Return the bytes of a single-strip TIFF, and the expected display from 0 (black) to 1 (white)."""
    grey = (GREY % 4096).astype(int) if bits == 12 else (GREY.astype(int) * 8191 % 2**bits)
    rows = ["".join(f"{value:0{bits}b}" for value in row) for row in grey]
    packed = b"".join(int(row + "0" * (-len(row) % 8), 2).to_bytes(-(-len(row) // 8), "big") for row in rows)
    data = packed if bits % 8 else grey.astype(f"{endian}u{bits // 8}").tobytes()
    data = zlib.compress(data) if compression == 8 else data
    tags = {
        **{256: GREY.shape[1], 257: GREY.shape[0], 258: bits, 259: compression, 262: photometric, 273: 8},
        **{274: orientation, 277: 1, 278: GREY.shape[0], 279: len(data)},
    }
    data += b"\0" * (len(data) % 2)
    start = b"II*\0" if endian == "<" else b"MM\0*"
    entries = b"".join(struct.pack(f"{endian}HHII", tag, 4, 1, value) for tag, value in sorted(tags.items()))
    head = struct.pack(f"{endian}I", 8 + len(data))
    content = start + head + data + struct.pack(f"{endian}H", len(tags)) + entries + bytes(4)
    fraction = grey / (2**bits - 1)
    return content, fraction if photometric else 1 - fraction


@pytest.mark.parametrize(
    ("bits", "endian", "photometric", "compression"),
    list(itertools.product((8, 10, 12, 14, 16), "<>", (1, 0), (1, 8))),
)
def test_a_tiff_is_scaled_by_its_bit_depth(tmp_path, bits, endian, photometric, compression):
    content, expected = make_tiff(bits, endian, photometric, compression)
    (tmp_path / "a.tif").write_bytes(content)
    np.testing.assert_allclose(read_film(tmp_path / "a.tif").pixels, expected, atol=1e-12)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tiff_of_any_bit_depth_is_rotated_by_its_orientation_tag(tmp_path, orientation):
    for bits, endian, photometric, compression in itertools.product((8, 12, 16), "<>", (1, 0), (1, 8)):
        content, expected = make_tiff(bits, endian, photometric, compression, orientation)
        (tmp_path / "a.tif").write_bytes(content)
        turned = ImageOps.exif_transpose(_set_orientation(Image.fromarray(expected.astype(np.float32)), orientation))
        np.testing.assert_allclose(read_film(tmp_path / "a.tif").pixels, np.asarray(turned), atol=1e-6)


def _set_orientation(image, orientation):
    image.getexif()[274] = orientation
    return image


def test_a_rotated_colour_tiff_is_read_correctly_or_rejected(tmp_path):
    grey = np.repeat((GREY % 256).astype(np.uint8)[..., None], 3, axis=2)
    for orientation, compression in ((6, None), (6, "zlib"), (3, None)):
        tag = (274, 3, 1, orientation, True)
        tifffile.imwrite(tmp_path / "a.tif", grey, photometric="rgb", compression=compression, extratags=[tag])
        if orientation == 6 and compression is None:
            with pytest.raises(pssf.InputError, match="orientation of a colour image must be 1 to 4, got 6"):
                read_film(tmp_path / "a.tif")
        else:
            expected = (grey[..., 0].T[:, ::-1] if orientation == 6 else grey[::-1, ::-1, 0]) / 255
            np.testing.assert_allclose(read_film(tmp_path / "a.tif").pixels, expected)


def test_an_unsupported_tiff_compression_is_named_in_the_error(tmp_path):
    content = make_tiff(12, ">", 1, 1)[0]
    for old, new, message in ((b"\x01\x03\x00\x04\0\0\0\1\0\0\0\1", b"\x01\x03\x00\x04\0\0\0\1\0\0\0\5", "LZW"),):
        (tmp_path / "a.tif").write_bytes(content.replace(old, new))
        with pytest.raises(pssf.InputError, match=message):
            read_film(tmp_path / "a.tif")


@pytest.mark.parametrize("fields", [{"RescaleSlope": None, "RescaleIntercept": None}, {"RescaleSlope": 1}])
def test_stored_pixel_values_do_not_depend_on_an_incomplete_rescale(tmp_path, fields):
    np.testing.assert_array_equal(read_stored_pixels(write_dicom(tmp_path / "a.dcm", **fields)).pixels, GREY)


def test_stored_pixels_with_an_unsupported_syntax_are_rejected(tmp_path):
    path = write_invalid_jpeg_ls(tmp_path / "a.dcm")
    item = pydicom.dcmread(path)
    item.file_meta.TransferSyntaxUID = "1.2.840.10008.1.2.4.94"
    item.save_as(path)
    with pytest.raises(pssf.InputError, match="transfer syntax must be one that pydicom can decode to single images"):
        read_stored_pixels(path)
