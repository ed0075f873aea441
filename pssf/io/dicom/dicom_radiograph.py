"""Read and write DICOM Digital X-Ray objects: For Processing (linear pixels) and For Presentation (for display)."""

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
from ...data.imaging.detector_table import Detector, load_detectors
from ...data.imaging.dicom_codes import DicomTables, load_dicom_tables
from ...data.imaging.display_table import FlatPanelProcessing, ScreenFilm
from ...detector import format_processing, render_for_display
from ...geometry.view import magnification, resolve_view
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
        JSON metadata, stored in the acquisition context, because archives delete private attributes.
    path : Path
        File to write.
    intent : {"processing", "presentation"}
        "processing" writes linear pixels with 16 bits, "presentation" an image with display processing and 12 bits.
    side : {"right", "left"} or None
        Side of the marker that is drawn on a presentation image with the edge of the collimator. None draws neither.
    processing : FlatPanelProcessing, ScreenFilm or None
        Display processing of a presentation image; None for the log display.
    """
    protocol, tables = radiograph.protocol, load_dicom_tables()
    detector = load_detectors()[protocol.detector]
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
    remark = f"linear in absorbed energy, offset {detector.offset_dn:g}"
    if intent == "presentation":
        remark = f"for display, not for measurement of intensity; processing {format_processing(processing)}"
        item.SourceImageSequence = [make_reference_item(uids, tables, "source_of_processing")]
        # Presentation images of one radiograph with different processing are separate objects of the same series.
        item.SOPInstanceUID = make_uid(uids[intent], remark, side or "")
    item.ImageComments = f"SYNTHETIC, no patient. Pixels {remark}.{_describe_beam(radiograph.protocol)}"
    write_dataset(item, pixels, path)


def read_linear_radiograph(path: Path) -> tuple[NDArray[Any], str]:
    """Read the linear pixels and the metadata of a For Processing object that this package wrote.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    pixels : (rows, cols) array
        Linear pixels, DN.
    metadata : str
        JSON metadata.

    Raises
    ------
    InputError
        Another program wrote the object, or the object is For Presentation. A damaged file can raise any error.
    """
    item, description = read_radiograph_dataset(path)
    wanted = load_dicom_tables().processing["PresentationIntentType"]
    if item.PresentationIntentType != wanted:
        raise InputError(
            f"file {path}: PresentationIntentType must be {wanted}, which has linear pixels, got "
            f"{item.PresentationIntentType!r}: load_parameters reads the parameters of both intents"
        )
    return decode_pixels(item, path), description


def read_metadata(path: Path) -> tuple[NDArray[Any] | None, str]:
    """Read the metadata of a Digital X-Ray object of this package, and its pixels if they are linear.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    pixels : (rows, cols) array or None
        Linear pixels, DN; None if the object is For Presentation.
    metadata : str
        JSON metadata.

    Raises
    ------
    InputError
        Another program wrote the object, or the object is not a radiograph. A damaged file can raise any error.
    """
    item, description = read_radiograph_dataset(path)
    linear = item.PresentationIntentType == load_dicom_tables().processing["PresentationIntentType"]
    return (decode_pixels(item, path) if linear else None), description


def read_radiograph_dataset(path: Path) -> tuple[FileDataset, str]:
    """Read a Digital X-Ray object of this package, For Processing or For Presentation.

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
        Another program wrote the object, or the object is not a radiograph. A damaged file can raise any error.
    """
    item = read_own_dataset(path, "radiograph")
    return item, item.AcquisitionContextSequence[0].TextValue


def read_own_dataset(path: Path, kind: str) -> FileDataset:
    """Read a DICOM object that this package wrote.

    Parameters
    ----------
    path : Path
        File to read.
    kind : str
        Table of `data/dicom.toml` with the required modality, such as "radiograph" or "segmentation".

    Returns
    -------
    pydicom.dataset.FileDataset
        DICOM object.

    Raises
    ------
    InputError
        Another program wrote the object, or its modality differs. A damaged file can raise any error.
    """
    item = pydicom.dcmread(path)
    tables = load_dicom_tables()
    for keyword, among in (("Manufacturer", "every"), ("Modality", kind)):
        require_choice(f"file {path}: {keyword}", str(item.get(keyword, "")), [getattr(tables, among)[keyword]])
    return item


def make_common_attributes(
    radiograph: Radiograph, uids: Mapping[str, UID], kinds: Iterable[str], tables: DicomTables
) -> Dataset:
    """Make the common attributes of DICOM objects of a radiograph: constants, patient, study and software.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph that the object represents.
    uids : dict of str to UID
        UIDs from `make_uids`.
    kinds : iterable of str
        Tables of `data/dicom.toml` whose constants are added, such as "radiograph".
    tables : DicomTables
        DICOM constants and codes.

    Returns
    -------
    pydicom.dataset.Dataset
        Attributes of the object.
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
    """Write a DICOM object with its pixels, uncompressed and little-endian.

    Parameters
    ----------
    item : pydicom.dataset.Dataset
        Attributes of the object; the pixels are added in place.
    pixels : (rows, cols) array, DN, or (bytes,) array of packed bits of all frames
        Pixel data.
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
    """Derive UIDs from the content of a radiograph; the same content gives the same UIDs.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph that the objects represent.
    description : str
        JSON metadata of the radiograph.

    Returns
    -------
    dict of str to UID
        UID of the study (one study per knee), UIDs of the series and object of each intent, and UID of the mask series.
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
    """Make a reference to the For Processing object of a radiograph.

    Parameters
    ----------
    uids : dict of str to UID
        UIDs from `make_uids`.
    tables : DicomTables
        DICOM constants and codes.
    purpose : str or None
        Name of the code for the purpose of the reference; None states no purpose.

    Returns
    -------
    pydicom.dataset.Dataset
        Item of a sequence of references.
    """
    item = make_dataset({
        "ReferencedSOPClassUID": tables.processing["SOPClassUID"],
        "ReferencedSOPInstanceUID": uids["processing"],
    })  # fmt: skip
    if purpose:
        item.PurposeOfReferenceCodeSequence = [make_code_item(purpose, tables)]
    return item


def make_code_item(name: str, tables: DicomTables) -> Dataset:
    """Make the item of a code sequence from a code of `data/dicom.toml`.

    Parameters
    ----------
    name : str
        Name of the code in the table.
    tables : DicomTables
        DICOM constants and codes.

    Returns
    -------
    pydicom.dataset.Dataset
        Item of a code sequence.
    """
    scheme, value, meaning = tables.codes[name]
    return make_dataset({"CodeValue": value, "CodingSchemeDesignator": scheme, "CodeMeaning": meaning})


def _make_anatomy_attributes(subjects: tuple[Knee | None, ...], protocol: Protocol, tables: DicomTables) -> Dataset:
    """Make the attributes for side, anatomic region and view; without a knee the side is unknown ("U")."""
    knees = [knee for knee in subjects if knee is not None]
    if not knees:
        return make_dataset({"ImageLaterality": "U", "AnatomicRegionSequence": []})
    item = make_dataset(tables.knee)
    item.ImageLaterality = "B" if len(knees) > 1 else {"right": "R", "left": "L"}[knees[0].side]
    item.AnatomicRegionSequence = [make_code_item("knee", tables)]
    # DICOM defines a view position for AP and PA only, and a view code for every projection.
    if protocol.projection in ("AP", "PA"):
        item.ViewPosition = protocol.projection
    else:
        item.PatientOrientation = _patient_orientation(knees[0].side, protocol.projection)
    item.ViewCodeSequence = [make_code_item(protocol.projection, tables)]
    return item


def _patient_orientation(side: str, projection: str) -> list[str]:
    """Return the directions of columns and rows in the patient: row direction first, then column direction.

    Rows of a lateral image run posteriorly or anteriorly, and columns run to the feet. Rows of an axial image run to
    the left, and columns run posteriorly.
    """
    if projection == "axial":
        return ["L", "P"]
    return ["P" if side == "right" else "A", "F"]


def _make_technique_attributes(protocol: Protocol, detector: Detector, tables: DicomTables) -> Dataset:
    """Make the attributes for tube, exposure and detector."""
    item = make_dataset({
        "ProtocolName": format_protocol_name(protocol),
        "FocalSpots": _make_decimal_string(protocol.focal_spot_mm),
        "DetectorID": f"PSSF-{protocol.detector}".upper(),
        "DetectorDescription": f"{detector.formula}, {detector.thickness_mm:g} mm, packing {detector.packing:g}",
    })  # fmt: skip
    if protocol.mas > 0:
        item.ExposureInuAs = round(1000 * protocol.mas)
        if float(protocol.mas).is_integer():  # Exposure is an integer; a rounded value would contradict ExposureInuAs.
            item.Exposure = int(protocol.mas)
    if protocol.mono_kev is None:
        item.update(make_dataset(tables.tube))
        item.KVP = _make_decimal_string(protocol.tube_kv)
        item.FilterThicknessMinimum = item.FilterThicknessMaximum = _make_decimal_string(protocol.filtration_mm_al)
    return item


def _describe_beam(protocol: Protocol) -> str:
    """Describe the beam angle and the energy of a monoenergetic beam, for which DICOM has no attributes."""
    angle, kev = protocol.beam_angle_deg, protocol.mono_kev
    tilt = f" Beam {abs(angle):g} deg {'caudad' if angle > 0 else 'cephalad'}." if angle else ""
    return tilt if kev is None else f"{tilt} Beam of one energy, {kev:g} keV."


def _make_geometry_attributes(protocol: Protocol) -> Dataset:
    """Make the attributes for distances along the central ray, magnification, and pixel spacing in both planes.

    The ratio of the distances is the magnification.
    """
    view = resolve_view(protocol)
    enlarged = magnification(view)
    field_mm = [round(n * protocol.pixel_mm) for n in (protocol.rows, protocol.cols)]  # DICOM requires integers.
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
    """Make a DICOM data set from attribute values.

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
    """Convert the name of a protocol to ASCII, because a DICOM long string has at most 64 bytes.

    Parameters
    ----------
    protocol : Protocol
        Protocol whose name is converted. The JSON metadata keep the exact name.

    Returns
    -------
    str
        Name in which question marks replace other characters.
    """
    return protocol.name.encode("ascii", "replace").decode()


def _make_decimal_string(number: float) -> DSfloat:
    """Make a DICOM decimal string, which has at most 16 characters."""
    return DSfloat(float(number), auto_format=True)


def _dump_json(table: Mapping[str, Any]) -> str:
    """Encode a table as JSON; convert NumPy numbers to Python numbers."""
    return json.dumps(table, default=lambda number: number.item())


def make_uid(*parts: str) -> UID:
    """Derive a UID from texts, under the root 2.25 for UIDs that are made from UUIDs.

    Parameters
    ----------
    *parts : str
        Texts that identify a DICOM object. The same texts give the same UID.

    Returns
    -------
    pydicom.uid.UID
        UID derived from the texts.
    """
    return UID(f"2.25.{uuid5(_UID_NAMESPACE, ' '.join(parts)).int}")
