"""Check the metadata that is saved with the pixels of a radiograph."""

import json
import re

import numpy as np
import pytest
import tifffile
import trimesh

import pssf


@pytest.fixture(scope="module")
def radiograph(built, small):
    return pssf.simulate(built, small, rng=7)


@pytest.mark.parametrize("suffix", [".tif", ".dcm"])
def test_a_flipped_bit_in_pixels_or_metadata_is_rejected(radiograph, tmp_path, suffix):
    path = pssf.save(radiograph, tmp_path / f"r{suffix}")
    content = path.read_bytes()
    if suffix == ".tif":
        with tifffile.TiffFile(path) as tiff:
            pixels_at = tiff.pages[0].dataoffsets[0]
    else:
        pixels_at = content.index(radiograph.pixels.astype("<u2").tobytes())
    offsets = {
        "pixels": pixels_at + 5000,
        "seed": content.index(b'"seed": 7') + 8,
    }
    mismatch = "pixels and metadata do not match their hash (sha256"
    # Deflate has its own checksum, so damaged pixels of a TIFF cannot be decoded.
    reasons = {"pixels": "must be a TIFF" if suffix == ".tif" else mismatch, "seed": mismatch}
    for part, offset in offsets.items():
        changed = bytearray(content)
        changed[offset] ^= 1
        path.write_bytes(changed)
        with pytest.raises(pssf.InputError, match=rf"r\{suffix}:? {re.escape(reasons[part])}"):
            pssf.load(path)
    path.write_bytes(content)
    assert pssf.load(path) == radiograph


@pytest.mark.parametrize("suffix", [".tif", ".dcm"])
def test_a_saved_radiograph_contains_a_description_of_its_scene(small, tmp_path, suffix):
    ball = pssf.Surface(trimesh.creation.icosphere(radius=30), "cortical_bone", "air", "ball")
    scene = pssf.Scene([ball])
    made = pssf.simulate(scene, small, rng=7)
    assert made.scene == scene.table()
    read = pssf.load(pssf.save(made, tmp_path / f"r{suffix}"))
    assert read == made
    assert read.scene["surfaces"][0]["sha256"] == ball.table()["sha256"]


def test_pixels_of_another_type_with_the_same_metadata_are_rejected(radiograph, tmp_path):
    path = pssf.save(radiograph, tmp_path / "r.tif")
    with tifffile.TiffFile(path) as tiff:
        text = tiff.pages[0].description
    tifffile.imwrite(path, radiograph.pixels.astype(np.float32), description=text, metadata=None)
    with pytest.raises(pssf.InputError, match="pixels must be uint16, as written by pssf, got float32"):
        pssf.load(path)


@pytest.mark.parametrize("change", [{"seed": "7"}, {"seed": None}, {"truth": []}, {"sha256": 3}, {"extra": 1}])
def test_the_error_for_invalid_metadata_names_the_entry(radiograph, tmp_path, change):
    path = pssf.save(radiograph, tmp_path / "r.tif")
    with tifffile.TiffFile(path) as tiff:
        metadata = json.loads(tiff.pages[0].description)
    tifffile.imwrite(path, radiograph.pixels, description=json.dumps({**metadata, **change}), metadata=None)
    with pytest.raises(pssf.InputError, match=f"file written by pssf, got invalid metadata.*{next(iter(change))}"):
        pssf.load(path)
