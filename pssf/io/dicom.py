"""Radiographs as DICOM Digital X-Ray objects: For Processing (linear pixels) and For Presentation (for eyes)."""

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

from ..core.checks import InputError, require_choice
from ..data.detectors import Detector, detectors
from ..data.dicom import DicomTables, dicom_tables
from ..data.looks import Film, Processed
from ..detector import named_look, present
from ..geometry.view import magnification, view_of
from ..model.knee import Knee, knee_table
from ..model.protocol import Protocol
from ..model.radiograph import Radiograph
from .dicom_pixels import pixels_of

_UIDS = UUID("6f0c1d7e-3b52-5b7e-9a55-50535346646d")


def write(
    radiograph: Radiograph, description: str, path: Path, intent: str, side: str | None, look: Processed | Film | None
) -> None:
    """Write a radiograph as a Digital X-Ray object.

    description    JSON of all it was made from; kept in the acquisition context, since archives drop private attributes
    intent  "processing": 16 bit, the pixels as they are; "presentation": 12 bit, as `present` renders them
    side    of which a presentation bears the marker, with the collimator's edge; None for neither
    look    of a presentation; None for linear
    """
    protocol, tables = radiograph.protocol, dicom_tables()
    detector = detectors()[protocol.detector]
    shown: NDArray[np.generic] = radiograph.pixels
    if intent == "presentation":
        shown = present(radiograph, bits=12, side=side, look=look or "linear")
    pixels = shown.astype("<u2", copy=False)
    uids = uids_of(radiograph, description)
    item = start(radiograph, uids, ("radiograph", intent), tables)
    item.update(dataset({"SeriesInstanceUID": uids[f"{intent} series"], "SOPInstanceUID": uids[intent]}))
    item.SeriesDescription = f"{name_of(radiograph.protocol)[:40]}, for {intent}"
    text = {"ValueType": "TEXT", "ConceptNameCodeSequence": [code("parameters", tables)], "TextValue": description}
    item.AcquisitionContextSequence = [dataset(text)]
    item.update(_anatomy((radiograph.knee, *radiograph.knees), protocol, tables))
    item.update(_technique(protocol, detector, tables))
    item.update(_geometry(radiograph.protocol))
    remark = f"linear in absorbed energy, offset {detector.offset_dn:g}"
    if intent == "presentation":
        remark = f"for eyes, not for measurement of intensity; look {named_look(look)}"
        item.SourceImageSequence = [reference(uids, tables, "source_of_processing")]
        # Of one radiograph seen in two ways both are objects of the series.
        item.SOPInstanceUID = uid(uids[intent], remark, side or "")
    item.ImageComments = f"SYNTHETIC, no patient. Pixels {remark}.{_beam(radiograph.protocol)}"
    finish(item, pixels, path)


def read(path: Path) -> tuple[NDArray[Any], str]:
    """Pixels (rows, cols) of a For Processing object by this package, and the JSON of what it was made from.

    raises  InputError for another's DICOM, or one For Presentation; whatever its reader has for damage
    """
    item, description = opened(path)
    wanted = dicom_tables().processing["PresentationIntentType"]
    if item.PresentationIntentType != wanted:
        raise InputError(
            f"file {path}: PresentationIntentType = {item.PresentationIntentType!r}; allowed: {wanted}, "
            "whose pixels are linear (load_parameters tells what either was made from)"
        )
    return pixels_of(item, path), description


def opened_parameters(path: Path) -> tuple[NDArray[Any] | None, str]:
    """Linear pixels (rows, cols), DN, where the object has them, and the JSON of what a radiograph was made from.

    raises  InputError as `opened`
    """
    item, description = opened(path)
    linear = item.PresentationIntentType == dicom_tables().processing["PresentationIntentType"]
    return (pixels_of(item, path) if linear else None), description


def opened(path: Path) -> tuple[FileDataset, str]:
    """A radiograph of either kind by this package, and the JSON of what it was made from.

    raises  InputError for another's DICOM, or one that is no radiograph; whatever its reader has for damage
    """
    item = ours(path, "radiograph")
    return item, item.AcquisitionContextSequence[0].TextValue


def ours(path: Path, kind: str) -> FileDataset:
    """A DICOM object by this package, of a kind that `data/dicom.toml` describes.

    raises  InputError for another's DICOM, or one of another modality; whatever its reader has for damage
    """
    item = pydicom.dcmread(path)
    tables = dicom_tables()
    for keyword, among in (("Manufacturer", "every"), ("Modality", kind)):
        require_choice(f"file {path}: {keyword}", str(item.get(keyword, "")), [getattr(tables, among)[keyword]])
    return item


def start(radiograph: Radiograph, uids: Mapping[str, UID], kinds: Iterable[str], tables: DicomTables) -> Dataset:
    """What every object of a radiograph has: the constants of its kinds (`data/dicom.toml`), subject and maker."""
    item = Dataset()
    for kind in ("every", *kinds):
        item.update(dataset(getattr(tables, kind)))
    knee, version = radiograph.knee, radiograph.versions.get("pssf", "")
    item.StudyInstanceUID = uids["study"]
    item.PatientID = f"PSSF-{uids['study'][5:21]}"
    item.PatientSex = "" if knee is None else {"male": "M", "female": "F"}[knee.sex]
    if knee is not None:
        item.PatientAge = f"{round(knee.age_years):03d}Y"
        item.PatientSize = _ds(knee.stature_mm / 1000)
    item.SoftwareVersions = f"pssf {version}".strip()
    item.Rows, item.Columns = radiograph.pixels.shape
    item.DerivationDescription = (
        f"Synthetic: rays cast through closed meshes by pssf {version}, engine {radiograph.engine}, "
        f"protocol {name_of(radiograph.protocol)}, seed {radiograph.seed}. Not an exposure of a person."
    )
    return item


def finish(item: Dataset, pixels: NDArray[Any], path: Path) -> None:
    """Write an object with its pixels, uncompressed and little-endian.

    pixels  (rows, cols), or (frames, rows, cols) packed into bits
    """
    content = pixels.tobytes()
    item.PixelData = content + b"\0" * (len(content) % 2)
    item["PixelData"].VR = "OW" if item.BitsAllocated == 16 else "OB"
    item.file_meta = FileMetaDataset()
    item.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    item.file_meta.ImplementationClassUID = uid("implementation")
    item.file_meta.ImplementationVersionName = "PSSF"
    item.save_as(path, enforce_file_format=True)


def uids_of(radiograph: Radiograph, description: str) -> dict[str, UID]:
    """UIDs made from the content: of the study (one a knee), series and object of each kind, and the masks' series."""
    content = hashlib.sha256(description.encode())
    content.update(np.ascontiguousarray(radiograph.pixels, "<u2").tobytes())
    exposure = content.hexdigest()
    subject = exposure if radiograph.knee is None else _text(knee_table(radiograph.knee))
    uids = {"study": uid("study", subject), "masks series": uid("masks series", exposure)}
    for kind in ("processing", "presentation"):
        uids[kind], uids[f"{kind} series"] = uid(kind, exposure), uid(f"{kind} series", exposure)
    return uids


def reference(uids: Mapping[str, UID], tables: DicomTables, purpose: str | None = None) -> Dataset:
    """A reference to the For Processing object of a radiograph, if need be with its purpose."""
    item = dataset({
        "ReferencedSOPClassUID": tables.processing["SOPClassUID"],
        "ReferencedSOPInstanceUID": uids["processing"],
    })  # fmt: skip
    if purpose:
        item.PurposeOfReferenceCodeSequence = [code(purpose, tables)]
    return item


def code(name: str, tables: DicomTables) -> Dataset:
    """A code of `data/dicom.toml` as the item of a code sequence."""
    scheme, value, meaning = tables.codes[name]
    return dataset({"CodeValue": value, "CodingSchemeDesignator": scheme, "CodeMeaning": meaning})


def _anatomy(taken: tuple[Knee | None, ...], protocol: Protocol, tables: DicomTables) -> Dataset:
    """Which knee, or both, seen from where; of a scene of one's own neither is known."""
    knees = [knee for knee in taken if knee is not None]
    if not knees:
        return dataset({"ImageLaterality": "U", "AnatomicRegionSequence": []})
    item = dataset(tables.knee)
    item.ImageLaterality = "B" if len(knees) > 1 else {"right": "R", "left": "L"}[knees[0].side]
    item.AnatomicRegionSequence = [code("knee", tables)]
    # DICOM has no word for the others, and a code for all.
    if protocol.projection in ("AP", "PA"):
        item.ViewPosition = protocol.projection
    else:
        item.PatientOrientation = _orientation(knees[0].side, protocol.projection)
    item.ViewCodeSequence = [code(protocol.projection, tables)]
    return item


def _orientation(side: str, projection: str) -> list[str]:
    """Where rows and columns go: to the back and the feet from the side, to the left and the back along the leg."""
    if projection == "axial":
        return ["L", "P"]
    return ["P" if side == "right" else "A", "F"]


def _technique(protocol: Protocol, detector: Detector, tables: DicomTables) -> Dataset:
    item = dataset({
        "ProtocolName": name_of(protocol),
        "FocalSpots": _ds(protocol.focal_spot_mm),
        "DetectorID": f"PSSF-{protocol.detector}".upper(),
        "DetectorDescription": f"{detector.formula}, {detector.thickness_mm:g} mm, packing {detector.packing:g}",
    })  # fmt: skip
    if protocol.mas > 0:
        item.ExposureInuAs = round(1000 * protocol.mas)
        if float(protocol.mas).is_integer():  # an integer in DICOM; a rounded one would contradict the line above
            item.Exposure = int(protocol.mas)
    if protocol.mono_kev is None:
        item.update(dataset(tables.tube))
        item.KVP = _ds(protocol.tube_kv)
        item.FilterThicknessMinimum = item.FilterThicknessMaximum = _ds(protocol.filtration_mm_al)
    return item


def _beam(protocol: Protocol) -> str:
    """What has no attribute of its own in the standard: the tilt of the beam, and its one energy."""
    angle, kev = protocol.beam_angle_deg, protocol.mono_kev
    tilt = f" Beam {abs(angle):g} deg {'caudad' if angle > 0 else 'cephalad'}." if angle else ""
    return tilt if kev is None else f"{tilt} Beam of one energy, {kev:g} keV."


def _geometry(protocol: Protocol) -> Dataset:
    """Distances along the central ray, so that their ratio is the magnification; spacings in both planes."""
    view = view_of(protocol)
    enlarged = magnification(view)
    field_mm = [round(n * protocol.pixel_mm) for n in (protocol.rows, protocol.cols)]  # whole numbers in DICOM
    item = dataset({
        "DistanceSourceToPatient": _ds(protocol.sod_mm),
        "DistanceSourceToDetector": _ds(enlarged * protocol.sod_mm),
        "EstimatedRadiographicMagnificationFactor": _ds(enlarged),
        "ImagerPixelSpacing": [_ds(protocol.pixel_mm)] * 2,
        "DetectorElementSpacing": [_ds(protocol.pixel_mm)] * 2,
        "DetectorElementPhysicalSize": [_ds(protocol.pixel_mm)] * 2,
        "PixelSpacing": [_ds(protocol.pixel_mm / enlarged)] * 2,
    })  # fmt: skip
    if min(field_mm) > 0:
        item.FieldOfViewDimensions = field_mm
    return item


def dataset(values: Mapping[str, Any]) -> Dataset:
    """A data set from keyword -> value."""
    item = Dataset()
    for keyword, value in values.items():
        setattr(item, keyword, value)
    return item


def name_of(protocol: Protocol) -> str:
    """A protocol's name in ASCII: a long string of DICOM is checked for 64 bytes. The JSON has it as it is."""
    return protocol.name.encode("ascii", "replace").decode()


def _ds(number: float) -> DSfloat:
    # A decimal string has 16 characters at most.
    return DSfloat(float(number), auto_format=True)


def _text(table: Mapping[str, Any]) -> str:
    return json.dumps(table, default=lambda number: number.item())


def uid(*parts: str) -> UID:
    """A UID under 2.25, the root of those that are UUIDs; the same parts give the same."""
    return UID(f"2.25.{uuid5(_UIDS, ' '.join(parts)).int}")
