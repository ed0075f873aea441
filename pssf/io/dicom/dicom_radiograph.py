"""DICOM Digital X-Ray objects: For Processing (linear pixels) and For Presentation (display processing)."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from uuid import UUID, uuid5

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import UID, ExplicitVRLittleEndian
from pydicom.valuerep import DSfloat

from ...core.checks import InputError, require_choice
from ...data.imaging.dicom_codes import DicomTables, load_dicom_tables
from ...data.imaging.display_table import FlatPanelProcessing, ScreenFilm
from ...detector import format_processing, render_for_display
from ...geometry.view import magnification, resolve_view
from ...model.detector import Detector, resolve_detector
from ...model.knee import Knee, knee_to_dict
from ...model.protocol import Protocol
from ...model.radiograph import Radiograph
from .dicom_pixels import decode_pixels

_UID_NAMESPACE = UUID("6f0c1d7e-3b52-5b7e-9a55-50535346646d")


def write_radiograph(
    radiograph: Radiograph,
    description: str,
    path: Path,
    intent: str,
    side: str | None,
    processing: FlatPanelProcessing | ScreenFilm | None,
) -> None:
    """Write a radiograph as a DICOM Digital X-Ray object.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to write.
    description : str
        JSON metadata. They are stored in the acquisition context, because archives delete private attributes.
    path : Path
        File to write.
    intent : {"processing", "presentation"}
        "processing" writes linear 16-bit pixels. "presentation" writes a 12-bit image with display processing.
    side : {"right", "left"} or None
        Knee side, for a side marker and a collimator edge on a presentation image. None to draw neither.
    processing : FlatPanelProcessing, ScreenFilm or None
        Display processing of a presentation image; None for the log display.
    """
    protocol, tables = radiograph.protocol, load_dicom_tables()
    detector = resolve_detector(protocol.detector)
    shown: NDArray[np.generic] = radiograph.pixels
    if intent == "presentation":
        shown = render_for_display(radiograph, bits=12, side=side, processing=processing or "log")
    pixels = shown.astype("<u2", copy=False)
    uids = make_uids(radiograph, description)
    item = make_common_attributes(radiograph, uids, ("radiograph", intent), tables)
    item.update(make_dataset({"SeriesInstanceUID": uids[f"{intent} series"], "SOPInstanceUID": uids[intent]}))
    item.SeriesDescription = f"{format_protocol_name(radiograph.protocol)[:40]}, for {intent}"
    text = {
        "ValueType": "TEXT",
        "ConceptNameCodeSequence": [make_code_item("parameters", tables)],
        "TextValue": description,
    }
    item.AcquisitionContextSequence = [make_dataset(text)]
    item.update(_make_anatomy_attributes((radiograph.knee, *radiograph.knees), protocol, tables))
    item.update(_make_technique_attributes(protocol, detector, tables))
    item.update(_make_geometry_attributes(radiograph.protocol))
    linear = "linear in absorbed energy" if detector.response is None else "with the response curve of the detector"
    remark = f"{linear}, offset {detector.offset_dn:g}"
    if intent == "presentation":
        remark = f"for display, not for measurement of intensity; processing {format_processing(processing)}"
        item.SourceImageSequence = [make_reference_item(uids, tables, "source_of_processing")]
        # Presentation images with different display processing are separate objects in the same series.
        item.SOPInstanceUID = make_uid(uids[intent], remark, side or "")
    item.ImageComments = f"SYNTHETIC, no patient. Pixels {remark}.{_describe_beam(radiograph.protocol)}"
    write_dataset(item, pixels, path)


def read_linear_radiograph(path: Path) -> tuple[NDArray[Any], str]:
    """Read the linear pixels and the metadata from a For Processing object that PSSF wrote.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    pixels : (rows, cols) array
        Linear pixels, in DN.
    metadata : str
        JSON metadata.

    Raises
    ------
    InputError
        The object was not written by PSSF, or is For Presentation. A damaged file can raise any exception.
    """
    item, description = read_radiograph_dataset(path)
    wanted = load_dicom_tables().processing["PresentationIntentType"]
    if item.PresentationIntentType != wanted:
        raise InputError(
            f"file {path}: PresentationIntentType must be {wanted}, which has linear pixels, got "
            f"{item.PresentationIntentType!r}: use load_parameters to read the parameters"
        )
    return decode_pixels(item, path), description


def read_metadata(path: Path) -> tuple[NDArray[Any] | None, str]:
    """Read the metadata, and the pixels if they are linear, from a Digital X-Ray object that PSSF wrote.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    pixels : (rows, cols) array or None
        Linear pixels, in DN; None if the object is For Presentation.
    metadata : str
        JSON metadata.

    Raises
    ------
    InputError
        The object was not written by PSSF, or is not a radiograph. A damaged file can raise any exception.
    """
    item, description = read_radiograph_dataset(path)
    linear = item.PresentationIntentType == load_dicom_tables().processing["PresentationIntentType"]
    return (decode_pixels(item, path) if linear else None), description


def read_radiograph_dataset(path: Path) -> tuple[FileDataset, str]:
    """Read a Digital X-Ray object that PSSF wrote, either For Processing or For Presentation.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    item : pydicom.dataset.FileDataset
        DICOM object.
    metadata : str
        JSON metadata.

    Raises
    ------
    InputError
        The object was not written by PSSF, or is not a radiograph. A damaged file can raise any exception.
    """
    item = read_own_dataset(path, "radiograph")
    return item, item.AcquisitionContextSequence[0].TextValue


def read_own_dataset(path: Path, kind: str) -> FileDataset:
    """Read a DICOM object that PSSF wrote.

    Parameters
    ----------
    path : Path
        File to read.
    kind : str
        Table in `data/dicom.toml` that contains the required modality, such as "radiograph" or "segmentation".

    Returns
    -------
    pydicom.dataset.FileDataset
        DICOM object.

    Raises
    ------
    InputError
        The object was not written by PSSF, or has another modality. A damaged file can raise any exception.
    """
    item = pydicom.dcmread(path)
    tables = load_dicom_tables()
    for keyword, among in (("Manufacturer", "every"), ("Modality", kind)):
        require_choice(f"file {path}: {keyword}", str(item.get(keyword, "")), [getattr(tables, among)[keyword]])
    return item


def make_common_attributes(
    radiograph: Radiograph, uids: Mapping[str, UID], kinds: Iterable[str], tables: DicomTables
) -> Dataset:
    """Create the attributes that all DICOM objects of a radiograph share: constants, patient, study and software.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph for which the DICOM object is created.
    uids : dict of str to UID
        UIDs that `make_uids` returned.
    kinds : iterable of str
        Names of tables in `data/dicom.toml` with constants to add, such as "radiograph".
    tables : DicomTables
        DICOM constants and codes.

    Returns
    -------
    pydicom.dataset.Dataset
        Data set with the common attributes.
    """
    item = Dataset()
    for kind in ("every", *kinds):
        item.update(make_dataset(getattr(tables, kind)))
    knee, version = radiograph.knee, radiograph.versions.get("pssf", "")
    item.StudyInstanceUID = uids["study"]
    item.PatientID = f"PSSF-{uids['study'][5:21]}"
    item.PatientSex = "" if knee is None else {"male": "M", "female": "F"}[knee.sex]
    if knee is not None:
        item.PatientAge = f"{round(knee.age_years):03d}Y"
        item.PatientSize = _make_decimal_string(knee.stature_mm / 1000)
    item.SoftwareVersions = f"pssf {version}".strip()
    item.Rows, item.Columns = radiograph.pixels.shape
    item.DerivationDescription = (
        f"Synthetic: rays cast through closed meshes by pssf {version}, engine {radiograph.engine}, "
        f"protocol {format_protocol_name(radiograph.protocol)}, seed {radiograph.seed}. Not an exposure of a person."
    )
    return item


def write_dataset(item: Dataset, pixels: NDArray[Any], path: Path) -> None:
    """Write a DICOM object with uncompressed little-endian pixels.

    Parameters
    ----------
    item : pydicom.dataset.Dataset
        Attributes of the object, to which the pixels are added in place.
    pixels : (rows, cols) array, DN, or (bytes,) array of packed bits of all frames
        Pixels of an image, or packed bits of all segmentation frames.
    path : Path
        File to write.
    """
    content = pixels.tobytes()
    item.PixelData = content + b"\0" * (len(content) % 2)
    item["PixelData"].VR = "OW" if item.BitsAllocated == 16 else "OB"
    item.file_meta = FileMetaDataset()
    item.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    item.file_meta.ImplementationClassUID = make_uid("implementation")
    item.file_meta.ImplementationVersionName = "PSSF"
    item.save_as(path, enforce_file_format=True)


def make_uids(radiograph: Radiograph, description: str) -> dict[str, UID]:
    """Derive DICOM UIDs from the content of a radiograph, so that identical content yields identical UIDs.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph for which DICOM objects are created.
    description : str
        JSON metadata of the radiograph.

    Returns
    -------
    dict of str to UID
        UIDs of the study (one study per knee), of the series and the object for each intent, and of the mask series.
    """
    content = hashlib.sha256(description.encode())
    content.update(np.ascontiguousarray(radiograph.pixels, "<u2").tobytes())
    exposure = content.hexdigest()
    subject = exposure if radiograph.knee is None else _dump_json(knee_to_dict(radiograph.knee))
    uids = {"study": make_uid("study", subject), "masks series": make_uid("masks series", exposure)}
    for kind in ("processing", "presentation"):
        uids[kind], uids[f"{kind} series"] = make_uid(kind, exposure), make_uid(f"{kind} series", exposure)
    return uids


def make_reference_item(uids: Mapping[str, UID], tables: DicomTables, purpose: str | None = None) -> Dataset:
    """Create a reference to the For Processing object of a radiograph.

    Parameters
    ----------
    uids : dict of str to UID
        UIDs that `make_uids` returned.
    tables : DicomTables
        DICOM constants and codes.
    purpose : str or None
        Name of the code that states the purpose of the reference; None to omit the purpose.

    Returns
    -------
    pydicom.dataset.Dataset
        Item for a DICOM reference sequence.
    """
    item = make_dataset({
        "ReferencedSOPClassUID": tables.processing["SOPClassUID"],
        "ReferencedSOPInstanceUID": uids["processing"],
    })  # fmt: skip
    if purpose:
        item.PurposeOfReferenceCodeSequence = [make_code_item(purpose, tables)]
    return item


def make_code_item(name: str, tables: DicomTables) -> Dataset:
    """Create a code sequence item from a code in `data/dicom.toml`.

    Parameters
    ----------
    name : str
        Name of the code in the table.
    tables : DicomTables
        DICOM constants and codes.

    Returns
    -------
    pydicom.dataset.Dataset
        Item for a DICOM code sequence.
    """
    scheme, value, meaning = tables.codes[name]
    return make_dataset({"CodeValue": value, "CodingSchemeDesignator": scheme, "CodeMeaning": meaning})


def _make_anatomy_attributes(subjects: tuple[Knee | None, ...], protocol: Protocol, tables: DicomTables) -> Dataset:
    """Create the attributes for side, anatomic region and view. The side is "U" for a scene without a knee."""
    knees = [knee for knee in subjects if knee is not None]
    if not knees:
        return make_dataset({"ImageLaterality": "U", "AnatomicRegionSequence": []})
    item = make_dataset(tables.knee)
    item.ImageLaterality = "B" if len(knees) > 1 else {"right": "R", "left": "L"}[knees[0].side]
    item.AnatomicRegionSequence = [make_code_item("knee", tables)]
    # DICOM defines view positions only for AP and PA projections, but view codes for all projections.
    if protocol.projection in ("AP", "PA"):
        item.ViewPosition = protocol.projection
    else:
        item.PatientOrientation = _patient_orientation(knees[0].side, protocol.projection)
    item.ViewCodeSequence = [make_code_item(protocol.projection, tables)]
    return item


def _patient_orientation(side: str, projection: str) -> list[str]:
    """Return the DICOM patient orientation: the directions of rows and of columns in the patient.

    In a lateral image, rows run posteriorly (right knee) or anteriorly (left knee), and columns run to the feet. In an
    axial image, rows run to the left and columns run posteriorly.
    """
    if projection == "axial":
        return ["L", "P"]
    return ["P" if side == "right" else "A", "F"]


def _make_technique_attributes(protocol: Protocol, detector: Detector, tables: DicomTables) -> Dataset:
    """Create the attributes for X-ray tube, exposure and detector."""
    item = make_dataset({
        "ProtocolName": format_protocol_name(protocol),
        "FocalSpots": _make_decimal_string(protocol.focal_spot_mm),
        "DetectorID": f"PSSF-{detector.name}".upper(),
        "DetectorDescription": f"{detector.formula}, {detector.thickness_mm:g} mm, packing {detector.packing:g}",
    })  # fmt: skip
    if protocol.mas > 0:
        item.ExposureInuAs = round(1000 * protocol.mas)
        if float(protocol.mas).is_integer():  # A rounded integer Exposure would contradict ExposureInuAs.
            item.Exposure = int(protocol.mas)
    if protocol.mono_kev is None and protocol.spectrum is None:
        item.update(make_dataset(tables.tube))
        item.KVP = _make_decimal_string(protocol.tube_kv)
        item.FilterThicknessMinimum = item.FilterThicknessMaximum = _make_decimal_string(protocol.filtration_mm_al)
    return item


def _describe_beam(protocol: Protocol) -> str:
    """Describe beam angle, energy and filters as text, because DICOM has no attributes for some of these values."""
    angle, kev = protocol.beam_angle_deg, protocol.mono_kev
    parts = [f" Beam {abs(angle):g} deg {'caudad' if angle > 0 else 'cephalad'}."] if angle else []
    if kev is not None:
        parts.append(f" Monoenergetic beam, {kev:g} keV.")
    if protocol.spectrum is not None:
        parts.append(" Spectrum specified by the user.")
    parts += [f" Added filter {mm:g} mm {name}." for name, mm in protocol.filters]
    return "".join(parts)


def _make_geometry_attributes(protocol: Protocol) -> Dataset:
    """Create the attributes for distances, magnification, and pixel spacing on the detector and in the joint plane.

    The distances are along the central ray, and the ratio of the distances is the magnification.
    """
    view = resolve_view(protocol)
    enlarged = magnification(view)
    # DICOM requires integer values for the dimensions of the field of view.
    field_mm = [round(n * protocol.pixel_mm) for n in (protocol.rows, protocol.cols)]
    item = make_dataset({
        "DistanceSourceToPatient": _make_decimal_string(protocol.sod_mm),
        "DistanceSourceToDetector": _make_decimal_string(enlarged * protocol.sod_mm),
        "EstimatedRadiographicMagnificationFactor": _make_decimal_string(enlarged),
        "ImagerPixelSpacing": [_make_decimal_string(protocol.pixel_mm)] * 2,
        "DetectorElementSpacing": [_make_decimal_string(protocol.pixel_mm)] * 2,
        "DetectorElementPhysicalSize": [_make_decimal_string(protocol.pixel_mm)] * 2,
        "PixelSpacing": [_make_decimal_string(protocol.pixel_mm / enlarged)] * 2,
    })  # fmt: skip
    if min(field_mm) > 0:
        item.FieldOfViewDimensions = field_mm
    return item


def make_dataset(values: Mapping[str, Any]) -> Dataset:
    """Create a DICOM data set from attribute values.

    Parameters
    ----------
    values : dict of str to object
        Attribute values, keyed by DICOM keyword.

    Returns
    -------
    pydicom.dataset.Dataset
        Data set with the given attributes.
    """
    item = Dataset()
    for keyword, value in values.items():
        setattr(item, keyword, value)
    return item


def format_protocol_name(protocol: Protocol) -> str:
    """Convert a protocol name to ASCII, because a DICOM long string is limited to 64 bytes.

    Parameters
    ----------
    protocol : Protocol
        Protocol with the name to convert. The JSON metadata contain the original name.

    Returns
    -------
    str
        Protocol name, in which question marks replace all non-ASCII characters.
    """
    return protocol.name.encode("ascii", "replace").decode()


def _make_decimal_string(number: float) -> DSfloat:
    """Convert a number to a DICOM decimal string, which has at most 16 characters."""
    return DSfloat(float(number), auto_format=True)


def _dump_json(table: Mapping[str, Any]) -> str:
    """Encode a mapping as JSON, and convert NumPy numbers to Python numbers."""
    return json.dumps(table, default=lambda number: number.item())


def make_uid(*parts: str) -> UID:
    """Derive a DICOM UID from strings, with the root 2.25, which is reserved for UUID-based UIDs.

    Parameters
    ----------
    *parts : str
        Strings that identify a DICOM object. Identical strings yield identical UIDs.

    Returns
    -------
    pydicom.uid.UID
        UID derived from the strings.
    """
    return UID(f"2.25.{uuid5(_UID_NAMESPACE, ' '.join(parts)).int}")
