"""Check mask files: TIFF pages and DICOM segmentations."""

import dataclasses

import numpy as np
import pydicom
import pytest
import SimpleITK
import tifffile
from test_dicom import find_dciodvfy_messages

import pssf

SUFFIXES = (".tif", ".dcm")


@pytest.fixture(scope="module")
def radiograph(built, small):
    return pssf.simulate(built, small, rng=7, engine="scanline", keep=("masks",))


@pytest.fixture(scope="module")
def unusual(radiograph):
    """Make random masks of 7 x 5 pixels, which is not a multiple of 8 pixels; one mask is empty."""
    rng = np.random.default_rng(5)
    masks = {name: rng.random((7, 5)) < 0.5 for name in ("patella", "roi", "lateral_spine_osteophyte", "meniscus")}
    masks["patella"][:] = False
    truth = dataclasses.replace(radiograph.truth, masks=masks)
    protocol = dataclasses.replace(radiograph.protocol, rows=7, cols=5)
    return dataclasses.replace(radiograph, truth=truth, protocol=protocol, pixels=np.ones((7, 5), np.uint16))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("which", ["radiograph", "unusual"])
def test_saved_masks_are_loaded_unchanged_in_the_same_order(which, tmp_path, suffix, request):
    truth = request.getfixturevalue(which).truth
    back = pssf.load_masks(pssf.save_masks(request.getfixturevalue(which), tmp_path / f"masks{suffix}"))
    assert list(back) == list(truth.masks)
    for name, mask in truth.masks.items():
        assert back[name].dtype == np.bool_
        assert np.array_equal(back[name], mask), name


def test_masks_of_projected_bones_may_overlap(radiograph, tmp_path):
    back = pssf.load_masks(pssf.save_masks(radiograph, tmp_path / "masks.dcm"))
    assert (back["femur"] & back["patella"]).any()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_masks_give_an_identical_file(radiograph, tmp_path, suffix):
    one, two = (pssf.save_masks(radiograph, tmp_path / f"{k}{suffix}").read_bytes() for k in "ab")
    assert one == two


def test_a_mask_tiff_is_small_and_has_a_named_page_for_each_mask(radiograph, tmp_path):
    path = pssf.save_masks(radiograph, tmp_path / "masks.tif")
    with tifffile.TiffFile(path) as tiff:
        assert [page.tags["PageName"].value for page in tiff.pages] == list(radiograph.truth.masks)
        assert set(np.unique(tiff.pages[0].asarray())) == {0, 255}
    assert path.stat().st_size < 0.05 * len(radiograph.truth.masks) * radiograph.pixels.size


@pytest.mark.parametrize("side", ["right", "left"])
def test_dciodvfy_reports_no_error_in_a_segmentation(radiograph, tmp_path, side):
    image = dataclasses.replace(radiograph, knee=dataclasses.replace(radiograph.knee, side=side, grade=None))
    assert find_dciodvfy_messages(pssf.save_masks(image, tmp_path / "masks.dcm")) == []


def test_dciodvfy_accepts_masks_of_scenes_and_of_unusual_names(unusual, tmp_path):
    assert find_dciodvfy_messages(pssf.save_masks(unusual, tmp_path / "masks.dcm")) == []
    assert (
        find_dciodvfy_messages(pssf.save_masks(dataclasses.replace(unusual, knee=None), tmp_path / "scene.dcm")) == []
    )


def test_a_segmentation_refers_to_the_dicom_of_its_radiograph(radiograph, tmp_path):
    image = pydicom.dcmread(pssf.save(radiograph, tmp_path / "knee.dcm"))
    found = pydicom.dcmread(pssf.save_masks(radiograph, tmp_path / "masks.dcm"))
    series = found.ReferencedSeriesSequence[0]
    assert series.SeriesInstanceUID == image.SeriesInstanceUID
    assert series.ReferencedInstanceSequence[0].ReferencedSOPInstanceUID == image.SOPInstanceUID
    for frame in found.PerFrameFunctionalGroupsSequence:
        source = frame.DerivationImageSequence[0].SourceImageSequence[0]
        assert source.ReferencedSOPInstanceUID == image.SOPInstanceUID
    assert (found.StudyInstanceUID, found.PatientID) == (image.StudyInstanceUID, image.PatientID)
    assert found.SyntheticData == "YES"


def test_other_masks_of_a_radiograph_form_a_new_object_of_the_series(radiograph, tmp_path):
    fewer = {name: mask for name, mask in radiograph.truth.masks.items() if name != "fibula"}
    other = dataclasses.replace(radiograph, truth=dataclasses.replace(radiograph.truth, masks=fewer))
    one, two = (pydicom.dcmread(pssf.save_masks(image, tmp_path / "m.dcm")) for image in (radiograph, other))
    assert one.SOPInstanceUID != two.SOPInstanceUID
    assert one.SeriesInstanceUID == two.SeriesInstanceUID


def test_segments_have_the_codes_of_their_anatomy(radiograph, tmp_path):
    found = pydicom.dcmread(pssf.save_masks(radiograph, tmp_path / "masks.dcm"))
    codes = {s.SegmentLabel: s.SegmentedPropertyTypeCodeSequence[0].CodeValue for s in found.SegmentSequence}
    assert codes == {
        "femur": "71341001",
        "tibia": "12611008",
        "fibula": "87342007",
        "patella": "64234005",
        "medial_tibia_osteophyte": "M25.7",
        "lateral_femur_osteophyte": "M25.7",
    }
    where = {s.SegmentLabel: s.AnatomicRegionSequence[0] for s in found.SegmentSequence}
    assert where["lateral_femur_osteophyte"].CodeMeaning == "Femur"
    assert where["femur"].AnatomicRegionModifierSequence[0].CodeMeaning == "Right"


def test_simpleitk_reads_the_same_segments(radiograph, tmp_path):
    path = pssf.save_masks(radiograph, tmp_path / "masks.dcm")
    frames = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path)))
    for frame, mask in zip(frames, radiograph.truth.masks.values(), strict=True):
        assert ((frame > 0) == mask).all()


def test_saving_a_radiograph_without_masks_as_masks_raises_an_error(knee, small, radiograph, tmp_path):
    for image in (
        dataclasses.replace(radiograph, truth=None),
        dataclasses.replace(radiograph, truth=dataclasses.replace(radiograph.truth, masks={})),
    ):
        with pytest.raises(pssf.InputError, match=r"must have masks, got masks = none: simulate the knee with keep="):
            pssf.save_masks(image, tmp_path / "masks.tif")
    assert not list(tmp_path.iterdir())


def test_a_mask_with_another_shape_than_the_image_raises_an_error(radiograph, tmp_path):
    truth = dataclasses.replace(radiograph.truth, masks={"femur": np.zeros((4, 4), bool)})
    with pytest.raises(pssf.InputError, match=r"mask femur: shape must be \(256, 256\), got \(4, 4\)"):
        pssf.save_masks(dataclasses.replace(radiograph, truth=truth), tmp_path / "masks.tif")


@pytest.mark.parametrize("name", ["", "a\\b", "f" * 65, "tibia "])
def test_an_invalid_mask_name_raises_an_error(radiograph, tmp_path, name):
    truth = dataclasses.replace(radiograph.truth, masks={name: radiograph.truth.masks["tibia"]})
    with pytest.raises(pssf.InputError, match=r"mask name must be 1 to 64 letters, .*, got "):
        pssf.save_masks(dataclasses.replace(radiograph, truth=truth), tmp_path / "masks.dcm")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_single_mask_can_be_saved_and_loaded(radiograph, tmp_path, suffix):
    tibia = radiograph.truth.masks["tibia"]
    alone = dataclasses.replace(radiograph, truth=dataclasses.replace(radiograph.truth, masks={"tibia": tibia}))
    path = pssf.save_masks(alone, tmp_path / f"masks{suffix}")
    assert suffix == ".tif" or find_dciodvfy_messages(path) == []
    assert (pssf.load_masks(path)["tibia"] == tibia).all()


def test_an_unsupported_suffix_for_masks_raises_an_error(radiograph, tmp_path):
    with pytest.raises(pssf.InputError, match=r"suffix must be one of .tif, .tiff, .dcm, got '.png'"):
        pssf.save_masks(radiograph, tmp_path / "masks.png")
    with pytest.raises(pssf.InputError, match=r"suffix must be one of .tif, .tiff, .dcm, got '.npz'"):
        pssf.load_masks(tmp_path / "masks.npz")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("damage", ["cut", "text", "missing", "radiograph"])
def test_a_damaged_or_wrong_mask_file_raises_an_error_with_its_name(radiograph, tmp_path, suffix, damage):
    path = tmp_path / f"masks{suffix}"
    whole = pssf.save_masks(radiograph, path).read_bytes()
    if damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "text":
        path.write_text("hello")
    elif damage == "radiograph":
        pssf.save(radiograph, path)
    else:
        path.unlink()
    with pytest.raises(pssf.InputError, match=rf"masks\{suffix}.* must be ") as raised:
        pssf.load_masks(path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_mask_file_cannot_be_loaded_as_a_radiograph(radiograph, tmp_path, suffix):
    path = pssf.save_masks(radiograph, tmp_path / f"masks{suffix}")
    with pytest.raises(pssf.InputError, match=rf"masks\{suffix}.* must be "):
        pssf.load(path)
