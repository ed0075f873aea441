"""Masks as a DICOM Segmentation: one binary segment a mask, which may overlap, on the radiograph's own pixels."""

import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.tag import Tag

from ..data.dicom import dicom_tables
from ..model.knee import BONE_OF
from ..model.radiograph import Radiograph
from . import dicom
from .description import digest_of, require_hash, warn_unverified
from .dicom_pixels import pixels_of

Masks = Mapping[str, NDArray[np.bool_]]
# A code by its name in the table.
Code = Callable[[str], Dataset]
_BONES = ("femur", "tibia", "fibula", "patella")
_HASH = "sha256 of names, sizes and pixels: "
_OSTEOPHYTE, _CYST = "_osteophyte", "_cyst"


def write(radiograph: Radiograph, description: str, masks: Masks, path: Path) -> None:
    """Write masks as a Segmentation that refers to the For Processing object of their radiograph.

    description  JSON of all the radiograph was made from, which its UIDs are made of
    masks        name -> (rows, cols) bool
    """
    uids, tables = dicom.uids_of(radiograph, description), dicom_tables()
    code = partial(dicom.code, tables=tables)
    item = dicom.start(radiograph, uids, ("segmentation",), tables)
    bits = _bits(masks)
    content = _content_hash(masks, bits)
    item.SeriesInstanceUID, item.SOPInstanceUID = uids["masks series"], dicom.uid(uids["masks series"], content)
    item.SeriesDescription = f"{dicom.name_of(radiograph.protocol)[:40]}, masks"
    item.NumberOfFrames = len(masks)
    item.ImageComments = f"{_HASH}{digest_of(masks)}"
    side = None if radiograph.knee is None else radiograph.knee.side
    item.SegmentSequence = [
        _segment(k, name, side, item.SoftwareVersions, code) for k, name in enumerate(masks, start=1)
    ]
    implants = {step["name"] for step in radiograph.surgery}
    for segment in item.SegmentSequence:
        if segment.SegmentLabel in implants:
            segment.SegmentedPropertyCategoryCodeSequence = [code("physical_object")]
            segment.SegmentedPropertyTypeCodeSequence = [code("implant")]
    series = {
        "SeriesInstanceUID": uids["processing series"],
        "ReferencedInstanceSequence": [dicom.reference(uids, tables)],
    }
    item.ReferencedSeriesSequence = [dicom.dataset(series)]
    item.update(_dimensions(dicom.uid("dimensions", item.SOPInstanceUID)))
    source = dicom.reference(uids, tables, "source_of_segmentation")
    source.SpatialLocationsPreserved = "YES"
    item.SharedFunctionalGroupsSequence = [dicom.dataset({})]
    item.PerFrameFunctionalGroupsSequence = [_frame(k, source, code) for k in range(1, len(masks) + 1)]
    dicom.finish(item, bits, path)


def read(path: Path) -> dict[str, NDArray[np.bool_]]:
    """Name -> mask (rows, cols) of a Segmentation by this package.

    raises  InputError for another's DICOM, or one that is no Segmentation; whatever its reader has for damage
    """
    item = dicom.ours(path, "segmentation")
    shape = (int(item.NumberOfFrames), item.Rows, item.Columns)
    names = [segment.SegmentLabel for segment in item.SegmentSequence]
    masks = dict(zip(names, pixels_of(item, path).reshape(shape).astype(np.bool_), strict=True))
    remark, uid = str(item.get("ImageComments", "")), str(item.SOPInstanceUID)
    if remark.startswith(_HASH):
        require_hash(path, digest_of(masks), remark.removeprefix(_HASH), "masks")
    elif uid.startswith("2.25."):
        # Of an earlier version: its UID was made of its content.
        require_hash(path, dicom.uid(item.SeriesInstanceUID, _content_hash(masks, _bits(masks))), uid, "masks")
    else:
        warn_unverified(path, "masks")  # an archive has given it UIDs of its own
    return masks


def _bits(masks: Masks) -> NDArray[np.uint8]:
    """Bits run on from frame to frame, the first in the lowest bit of its byte (PS3.5, 8.1.1)."""
    return np.packbits(np.concatenate([np.ravel(mask) for mask in masks.values()]).astype(np.bool_), bitorder="little")


def _content_hash(masks: Masks, bits: NDArray[np.uint8]) -> str:
    return hashlib.sha256(" ".join(masks).encode() + bits.tobytes()).hexdigest()


def _segment(number: int, name: str, side: str | None, version: str, code: Code) -> Dataset:
    """What a mask is, by its name: a bone, or an osteophyte or the cysts of a bone; of two knees after its side."""
    label = name
    if side is None and name.split("_")[0] in ("right", "left"):
        side, name = name.split("_", 1)
    osteophyte, cyst = name.endswith(_OSTEOPHYTE), name.endswith(_CYST)
    of_bone = osteophyte or cyst
    category = "abnormal_structure" if of_bone else "anatomical_structure"
    what = (
        "osteophyte" if osteophyte else "abnormal_structure" if cyst else name if name in _BONES else "body_structure"
    )
    item = dicom.dataset({
        "SegmentNumber": number,
        "SegmentLabel": label,
        "SegmentAlgorithmType": "AUTOMATIC",
        "SegmentAlgorithmName": version,
        "SegmentedPropertyCategoryCodeSequence": [code(category)],
        "SegmentedPropertyTypeCodeSequence": [code(what)],
    })  # fmt: skip
    bone = BONE_OF[name.split("_")[-2]] if of_bone else "knee"
    if side is None:
        return item
    item.AnatomicRegionSequence = [code(bone)]
    item.AnatomicRegionSequence[0].AnatomicRegionModifierSequence = [code(side)]
    return item


def _frame(number: int, source: Dataset, code: Code) -> Dataset:
    derived = {"DerivationCodeSequence": [code("segmentation")], "SourceImageSequence": [source]}
    # Once a frame though the same for all: readers look for it here (highdicom).
    return dicom.dataset({
        "DerivationImageSequence": [dicom.dataset(derived)],
        "FrameContentSequence": [dicom.dataset({"DimensionIndexValues": [number]})],
        "SegmentIdentificationSequence": [dicom.dataset({"ReferencedSegmentNumber": number})],
    })  # fmt: skip


def _dimensions(uid: str) -> Dataset:
    """Frames are description apart by their segment alone."""
    index = {
        "DimensionOrganizationUID": uid,
        "DimensionIndexPointer": Tag("ReferencedSegmentNumber"),
        "FunctionalGroupPointer": Tag("SegmentIdentificationSequence"),
        "DimensionDescriptionLabel": "Segment",
    }
    return dicom.dataset({
        "DimensionOrganizationSequence": [dicom.dataset({"DimensionOrganizationUID": uid})],
        "DimensionIndexSequence": [dicom.dataset(index)],
    })  # fmt: skip
