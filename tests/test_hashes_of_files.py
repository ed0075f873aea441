"""What is altered in a file is seen: masks, and parameters where there are no linear pixels beside them."""

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
    """The radiograph in every kind of file."""
    from pssf.io.radiograph_files import save_parameters

    save_parameters(radiograph, tmp_path / "a.json")
    for name in ("a.png", "a.tif", "b.dcm"):
        pssf.save(radiograph, tmp_path / name)
    pssf.save(radiograph, tmp_path / "a.dcm", intent="presentation")
    return tmp_path


def text_of(path):
    """The description in a file, as it is written there."""
    if path.suffix == ".dcm":
        return pydicom.dcmread(path).AcquisitionContextSequence[0].TextValue
    if path.suffix == ".tif":
        return tifffile.TiffFile(path).pages[0].description
    from PIL import Image

    return path.read_text() if path.suffix == ".json" else Image.open(path).info["Description"]


def put(path, text):
    """The file with another description."""
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


def without_hash(path):
    """As an earlier version wrote it, whose one hash was over all but itself, and the pixels."""
    from pssf.io import metadata

    fields = json.loads(text_of(path))
    del fields["parameters_sha256"], fields["sha256"]
    pixels = pssf.load(path.with_name("a.tif")).pixels
    put(path, json.dumps({**fields, "sha256": metadata._hash_text_and_pixels(json.dumps(fields), pixels)}))


@pytest.mark.parametrize("name", FILES)
def test_parameters_are_read_as_they_were_written_without_a_warning(radiograph, folder, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = pssf.load_parameters(folder / name)
    assert made["protocol"] == radiograph.protocol
    assert made["knee"] == radiograph.knee


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(
    ("old", "new"), [('"tube_kv": 70.0', '"tube_kv": 79.0'), ('"seed": 0', '"seed": 5'), ('"male"', '"female"')]
)
def test_altered_parameters_are_refused(folder, name, old, new):
    text = text_of(folder / name)
    assert old in text
    put(folder / name, text.replace(old, new, 1))
    with pytest.raises(pssf.InputError, match=r"must be as pssf wrote them .* got "):
        pssf.load_parameters(folder / name)


@pytest.mark.parametrize("name", FILES)
def test_parameters_of_an_earlier_version_are_read_with_a_warning_or_verified_by_their_pixels(folder, name):
    without_hash(folder / name)
    if name in ("a.tif", "b.dcm"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            pssf.load_parameters(folder / name)
        put(folder / name, text_of(folder / name).replace('"seed": 0', '"seed": 5', 1))
        with pytest.raises(pssf.InputError, match="damaged"):
            pssf.load_parameters(folder / name)
        return
    with pytest.warns(pssf.UnverifiedNotice, match=rf"{name}: its parameters have no hash"):
        pssf.load_parameters(folder / name)


@pytest.mark.parametrize("place", [-1, -100, -400])
def test_a_flipped_bit_of_a_segmentation_is_refused(radiograph, tmp_path, place):
    path = pssf.save_masks(radiograph, tmp_path / "m.dcm")
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)
    with pytest.raises(pssf.InputError, match="masks must be as pssf wrote them"):
        pssf.load_masks(path)


def test_a_renamed_segment_is_refused(radiograph, tmp_path):
    path = pssf.save_masks(radiograph, tmp_path / "m.dcm")
    path.write_bytes(path.read_bytes().replace(b"patella", b"fabella", 1))
    with pytest.raises(pssf.InputError, match="masks must be as pssf wrote them"):
        pssf.load_masks(path)


@pytest.mark.parametrize("uid", [None, "1.2.3.4"])
def test_a_segmentation_of_an_earlier_version_is_verified_by_its_uid(radiograph, tmp_path, uid):
    path = pssf.save_masks(radiograph, tmp_path / "m.dcm")
    item = pydicom.dcmread(path)
    del item.ImageComments
    item.SOPInstanceUID = item.file_meta.MediaStorageSOPInstanceUID = uid or item.SOPInstanceUID
    item.save_as(path)
    if uid:
        with pytest.warns(pssf.UnverifiedNotice, match="its masks have no hash"):
            pssf.load_masks(path)
        return
    masks = pssf.load_masks(path)
    assert all(np.array_equal(masks[name], mask) for name, mask in radiograph.truth.masks.items())
    item.PixelData = item.PixelData[:-3] + b"\1\2\3"
    item.save_as(path)
    with pytest.raises(pssf.InputError, match="masks must be as pssf wrote them"):
        pssf.load_masks(path)


def rewritten(path, change):
    """A TIFF of masks with other pages or another header, as its own checks take it."""
    with tifffile.TiffFile(path) as tiff:
        header = json.loads(tiff.pages[0].description)
        pages = [page.asarray() for page in tiff.pages]
    change(header, pages)
    with tifffile.TiffWriter(path) as tiff:
        for number, page in enumerate(pages):
            tiff.write(page, metadata=None, description=None if number else json.dumps(header))


@pytest.mark.parametrize("which", ["pixel", "name", "order", "size"])
def test_an_altered_tiff_of_masks_is_refused(radiograph, tmp_path, which):
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
    rewritten(path, change)
    with pytest.raises(pssf.InputError, match="masks must be as pssf wrote them"):
        pssf.load_masks(path)


def test_a_tiff_of_masks_of_an_earlier_version_is_read_with_a_warning(radiograph, tmp_path):
    path = pssf.save_masks(radiograph, tmp_path / "m.tif")
    rewritten(path, lambda header, pages: header.pop("sha256"))
    with pytest.warns(pssf.UnverifiedNotice, match=r"m\.tif: its masks have no hash"):
        masks = pssf.load_masks(path)
    assert all(np.array_equal(masks[name], mask) for name, mask in radiograph.truth.masks.items())
