"""Check that altered masks and parameters in files are detected by their hashes."""

import dataclasses
import json
import warnings

import numpy as np
import pydicom
import pytest
import tifffile

import pssf

FILES = ("a.json", "a.png", "a.dcm", "b.dcm", "a.tif")


@pytest.fixture(scope="module")
def radiograph():
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=64, cols=64, pixel_mm=4.8, texture="none")
    return pssf.simulate(pssf.Knee(), protocol, engine="scanline", keep=("masks",))


@pytest.fixture
def folder(radiograph, tmp_path):
    """Write the radiograph in every file format."""
    from pssf.io.radiograph_files import save_parameters

    save_parameters(radiograph, tmp_path / "a.json")
    for name in ("a.png", "a.tif", "b.dcm"):
        pssf.save(radiograph, tmp_path / name)
    pssf.save(radiograph, tmp_path / "a.dcm", intent="presentation")
    return tmp_path


def read_metadata_text(path):
    """Return the metadata text of a file."""
    if path.suffix == ".dcm":
        return pydicom.dcmread(path).AcquisitionContextSequence[0].TextValue
    if path.suffix == ".tif":
        return tifffile.TiffFile(path).pages[0].description
    from PIL import Image

    return path.read_text() if path.suffix == ".json" else Image.open(path).info["Description"]


def write_metadata_text(path, text):
    """Replace the metadata text of a file."""
    if path.suffix == ".json":
        path.write_text(text)
    elif path.suffix == ".dcm":
        item = pydicom.dcmread(path)
        item.AcquisitionContextSequence[0].TextValue = text
        item.save_as(path)
    elif path.suffix == ".tif":
        tifffile.tiffcomment(path, text.encode())
    else:
        from PIL import Image, PngImagePlugin

        note = PngImagePlugin.PngInfo()
        note.add_text("Description", text)
        Image.open(path).save(path, pnginfo=note)


def convert_to_earlier_version(path):
    """Convert metadata to an earlier version, which had a single hash for all fields and pixels."""
    from pssf.io import metadata

    fields = json.loads(read_metadata_text(path))
    del fields["parameters_sha256"], fields["sha256"]
    pixels = pssf.load(path.with_name("a.tif")).pixels
    write_metadata_text(
        path, json.dumps({**fields, "sha256": metadata._hash_text_and_pixels(json.dumps(fields), pixels)})
    )


@pytest.mark.parametrize("name", FILES)
def test_unaltered_parameters_are_read_without_a_warning(radiograph, folder, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = pssf.load_parameters(folder / name)
    assert made["protocol"] == radiograph.protocol
    assert made["knee"] == radiograph.knee


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(
    ("old", "new"), [('"tube_kv": 70.0', '"tube_kv": 79.0'), ('"seed": 0', '"seed": 5'), ('"male"', '"female"')]
)
def test_altered_parameters_are_rejected(folder, name, old, new):
    text = read_metadata_text(folder / name)
    assert old in text
    write_metadata_text(folder / name, text.replace(old, new, 1))
    with pytest.raises(pssf.InputError, match=r"do not match their hash .* recorded "):
        pssf.load_parameters(folder / name)


@pytest.mark.parametrize("name", FILES)
def test_parameters_of_an_earlier_version_are_verified_or_give_a_warning(folder, name):
    convert_to_earlier_version(folder / name)
    if name in ("a.tif", "b.dcm"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            pssf.load_parameters(folder / name)
        write_metadata_text(folder / name, read_metadata_text(folder / name).replace('"seed": 0', '"seed": 5', 1))
        with pytest.raises(pssf.InputError, match="damaged"):
            pssf.load_parameters(folder / name)
        return
    with pytest.warns(pssf.UnverifiedNotice, match=rf"{name}: the parameters have no hash"):
        pssf.load_parameters(folder / name)


@pytest.mark.parametrize("offset", [-1, -100, -400])
def test_a_flipped_bit_of_a_segmentation_is_rejected(radiograph, tmp_path, offset):
    path = pssf.save_masks(radiograph, tmp_path / "m.dcm")
    content = bytearray(path.read_bytes())
    content[offset] ^= 4
    path.write_bytes(content)
    with pytest.raises(pssf.InputError, match="masks do not match their hash"):
        pssf.load_masks(path)


def test_a_renamed_segment_is_rejected(radiograph, tmp_path):
    path = pssf.save_masks(radiograph, tmp_path / "m.dcm")
    path.write_bytes(path.read_bytes().replace(b"patella", b"fabella", 1))
    with pytest.raises(pssf.InputError, match="masks do not match their hash"):
        pssf.load_masks(path)


@pytest.mark.parametrize("uid", [None, "1.2.3.4"])
def test_a_segmentation_of_an_earlier_version_is_verified_by_its_uid(radiograph, tmp_path, uid):
    path = pssf.save_masks(radiograph, tmp_path / "m.dcm")
    item = pydicom.dcmread(path)
    del item.ImageComments
    item.SOPInstanceUID = item.file_meta.MediaStorageSOPInstanceUID = uid or item.SOPInstanceUID
    item.save_as(path)
    if uid:
        with pytest.warns(pssf.UnverifiedNotice, match="the masks have no hash"):
            pssf.load_masks(path)
        return
    masks = pssf.load_masks(path)
    assert all(np.array_equal(masks[name], mask) for name, mask in radiograph.truth.masks.items())
    item.PixelData = item.PixelData[:-3] + b"\1\2\3"
    item.save_as(path)
    with pytest.raises(pssf.InputError, match="masks do not match their hash"):
        pssf.load_masks(path)


def rewrite_mask_tiff(path, change):
    """Change the header and pages of a mask TIFF, and write a valid TIFF."""
    with tifffile.TiffFile(path) as tiff:
        header = json.loads(tiff.pages[0].description)
        pages = [page.asarray() for page in tiff.pages]
    change(header, pages)
    with tifffile.TiffWriter(path) as tiff:
        for number, page in enumerate(pages):
            tiff.write(page, metadata=None, description=None if number else json.dumps(header))


@pytest.mark.parametrize("which", ["pixel", "name", "order", "size"])
def test_an_altered_mask_tiff_is_rejected(radiograph, tmp_path, which):
    def change(header, pages):
        if which == "pixel":
            pages[1][5, 5] ^= 255
        elif which == "name":
            header["masks"][0] = "fabella"
        elif which == "order":
            header["masks"].reverse()
        else:
            pages[:] = [np.ascontiguousarray(page.reshape(32, 128)) for page in pages]

    path = pssf.save_masks(radiograph, tmp_path / "m.tif")
    rewrite_mask_tiff(path, change)
    with pytest.raises(pssf.InputError, match="masks do not match their hash"):
        pssf.load_masks(path)


def test_a_mask_tiff_of_an_earlier_version_gives_a_warning(radiograph, tmp_path):
    path = pssf.save_masks(radiograph, tmp_path / "m.tif")
    rewrite_mask_tiff(path, lambda header, pages: header.pop("sha256"))
    with pytest.warns(pssf.UnverifiedNotice, match=r"m\.tif: the masks have no hash"):
        masks = pssf.load_masks(path)
    assert all(np.array_equal(masks[name], mask) for name, mask in radiograph.truth.masks.items())
