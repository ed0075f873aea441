"""Masks as a DICOM Segmentation, with one binary segment per mask on the pixel grid of the radiograph."""

import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.tag import Tag

from ...data.imaging.dicom_codes import load_dicom_tables
from ...model.knee import BONE_OF_SITE_PART
from ...model.radiograph import Radiograph
from ..metadata import hash_masks, require_hash, warn_unverified
from . import dicom_radiograph
from .dicom_pixels import decode_pixels

# highdicom is not used, because its times and UIDs differ between runs, and because dciodvfy reports a missing
# PatientOrientation.
Masks = Mapping[str, NDArray[np.bool_]]
# Function that creates a code sequence item from the name of a code in `data/dicom.toml`.
CodeMaker = Callable[[str], Dataset]
_BONES = ("femur", "tibia", "fibula", "patella")
_HASH_PREFIX = "sha256 of names, sizes and pixels: "
# Suffixes of mask names for osteophytes and cysts.
_OSTEOPHYTE = "_osteophyte"
_CYST = "_cyst"


def write_segmentation(radiograph: Radiograph, description: str, masks: Masks, path: Path) -> None:
    """Write masks as a DICOM Segmentation that refers to the For Processing object of the radiograph.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to which the masks belong.
    description : str
        JSON metadata of the radiograph, from which the UIDs are derived.
    masks : dict of str to (rows, cols) bool array
        Masks, keyed by mask name. Masks may overlap.
    path : Path
        File to write.
    """
    uids, tables = dicom_radiograph.make_uids(radiograph, description), load_dicom_tables()
    code = partial(dicom_radiograph.make_code_item, tables=tables)
    item = dicom_radiograph.make_common_attributes(radiograph, uids, ("segmentation",), tables)
    bits = _pack_bits(masks)
    content = _hash_content(masks, bits)
    item.SeriesInstanceUID, item.SOPInstanceUID = (
        uids["masks series"],
        dicom_radiograph.make_uid(uids["masks series"], content),
    )
    item.SeriesDescription = f"{dicom_radiograph.format_protocol_name(radiograph.protocol)[:40]}, masks"
    item.NumberOfFrames = len(masks)
    item.ImageComments = f"{_HASH_PREFIX}{hash_masks(masks)}"
    side = None if radiograph.knee is None else radiograph.knee.side
    item.SegmentSequence = [
        _make_segment_item(k, name, side, item.SoftwareVersions, code) for k, name in enumerate(masks, start=1)
    ]
    implants = {step["name"] for step in radiograph.surgery}
    for segment in item.SegmentSequence:
        if segment.SegmentLabel in implants:
            segment.SegmentedPropertyCategoryCodeSequence = [code("physical_object")]
            segment.SegmentedPropertyTypeCodeSequence = [code("implant")]
    series = {
        "SeriesInstanceUID": uids["processing series"],
        "ReferencedInstanceSequence": [dicom_radiograph.make_reference_item(uids, tables)],
    }
    item.ReferencedSeriesSequence = [dicom_radiograph.make_dataset(series)]
    item.update(_make_dimension_attributes(dicom_radiograph.make_uid("dimensions", item.SOPInstanceUID)))
    source = dicom_radiograph.make_reference_item(uids, tables, "source_of_segmentation")
    source.SpatialLocationsPreserved = "YES"
    item.SharedFunctionalGroupsSequence = [dicom_radiograph.make_dataset({})]
    item.PerFrameFunctionalGroupsSequence = [_make_frame_item(k, source, code) for k in range(1, len(masks) + 1)]
    dicom_radiograph.write_dataset(item, bits, path)


def read_segmentation(path: Path) -> dict[str, NDArray[np.bool_]]:
    """Read masks from a DICOM Segmentation that PSSF wrote.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    dict of str to (rows, cols) bool array
        Masks in the order in which they were written, keyed by mask name.

    Raises
    ------
    InputError
        The object was not written by PSSF or is not a Segmentation, or the masks do not match the recorded hash. A
        damaged file can raise any exception.

    Warns
    -----
    UnverifiedNotice
        An earlier version wrote the file without a hash, and an archive has replaced the UID that would verify the
        masks.
    """
    item = dicom_radiograph.read_own_dataset(path, "segmentation")
    shape = (int(item.NumberOfFrames), item.Rows, item.Columns)
    names = [segment.SegmentLabel for segment in item.SegmentSequence]
    masks = dict(zip(names, decode_pixels(item, path).reshape(shape).astype(np.bool_), strict=True))
    remark, uid = str(item.get("ImageComments", "")), str(item.SOPInstanceUID)
    if remark.startswith(_HASH_PREFIX):
        require_hash(path, hash_masks(masks), remark.removeprefix(_HASH_PREFIX), "masks")
    elif uid.startswith("2.25."):
        # Earlier versions derived the UID from the masks, so that the UID verifies the masks.
        require_hash(
            path,
            dicom_radiograph.make_uid(item.SeriesInstanceUID, _hash_content(masks, _pack_bits(masks))),
            uid,
            "masks",
        )
    else:
        warn_unverified(path, "masks")  # An archive has replaced the UID that would verify the masks.
    return masks


def _pack_bits(masks: Masks) -> NDArray[np.uint8]:
    """Pack masks (rows, cols) into bytes with one bit per pixel.

    There is no padding between frames. The first pixel is the least significant bit of the first byte (PS3.5, 8.1.1).
    """
    return np.packbits(np.concatenate([np.ravel(mask) for mask in masks.values()]).astype(np.bool_), bitorder="little")


def _hash_content(masks: Masks, bits: NDArray[np.uint8]) -> str:
    """Compute the SHA-256 hash of mask names and packed bits, from which earlier versions derived the UID."""
    return hashlib.sha256(" ".join(masks).encode() + bits.tobytes()).hexdigest()


def _make_segment_item(number: int, name: str, side: str | None, version: str, code: CodeMaker) -> Dataset:
    """Create the DICOM item of a segment, whose mask name determines codes such as bone, osteophyte or cyst.

    If a radiograph shows two knees, the mask names begin with the side.
    """
    label = name
    if side is None and name.split("_")[0] in ("right", "left"):
        side, name = name.split("_", 1)
    osteophyte, cyst = name.endswith(_OSTEOPHYTE), name.endswith(_CYST)
    of_bone = osteophyte or cyst
    category = "abnormal_structure" if of_bone else "anatomical_structure"
    what = (
        "osteophyte" if osteophyte else "abnormal_structure" if cyst else name if name in _BONES else "body_structure"
    )
    item = dicom_radiograph.make_dataset({
        "SegmentNumber": number,
        "SegmentLabel": label,
        "SegmentAlgorithmType": "AUTOMATIC",
        "SegmentAlgorithmName": version,
        "SegmentedPropertyCategoryCodeSequence": [code(category)],
        "SegmentedPropertyTypeCodeSequence": [code(what)],
    })  # fmt: skip
    bone = BONE_OF_SITE_PART[name.split("_")[-2]] if of_bone else "knee"
    if side is None:
        return item
    item.AnatomicRegionSequence = [code(bone)]
    item.AnatomicRegionSequence[0].AnatomicRegionModifierSequence = [code(side)]
    return item


def _make_frame_item(number: int, source: Dataset, code: CodeMaker) -> Dataset:
    """Create the functional groups of a frame, which contains the mask of one segment."""
    derived = {"DerivationCodeSequence": [code("segmentation")], "SourceImageSequence": [source]}
    # The source image is repeated in every frame, because highdicom reads the source image only from the frames.
    return dicom_radiograph.make_dataset({
        "DerivationImageSequence": [dicom_radiograph.make_dataset(derived)],
        "FrameContentSequence": [dicom_radiograph.make_dataset({"DimensionIndexValues": [number]})],
        "SegmentIdentificationSequence": [dicom_radiograph.make_dataset({"ReferencedSegmentNumber": number})],
    })  # fmt: skip


def _make_dimension_attributes(uid: str) -> Dataset:
    """Create the dimension attributes, with the segment number as the only dimension of the frames."""
    index = {
        "DimensionOrganizationUID": uid,
        "DimensionIndexPointer": Tag("ReferencedSegmentNumber"),
        "FunctionalGroupPointer": Tag("SegmentIdentificationSequence"),
        "DimensionDescriptionLabel": "Segment",
    }
    return dicom_radiograph.make_dataset({
        "DimensionOrganizationSequence": [dicom_radiograph.make_dataset({"DimensionOrganizationUID": uid})],
        "DimensionIndexSequence": [dicom_radiograph.make_dataset(index)],
    })  # fmt: skip
