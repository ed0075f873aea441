"""Masks on disk: a TIFF of one page a mask, or a DICOM Segmentation of one segment a mask."""

import json
import re
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from ..core.checks import InputError, require_path
from ..model.radiograph import Radiograph
from .atomic import writing
from .description import as_json, digest_of, require_hash, warn_unverified
from .images import reading, require_radiograph, suffix_of

SUFFIXES = (".tif", ".tiff", ".dcm")
_PAGE_NAME = 285


def save_masks(radiograph: Radiograph, path: str | Path) -> Path:
    """Write the masks of a radiograph, by suffix: .tif (a page each, 0 or 255, named) or .dcm (Segmentation, binary).

    Those of two knees are named after their side: right_femur, left_femur.
    Masks may overlap. Both files are lossless; the TIFF is compressed, the Segmentation has one bit a pixel. A
    Segmentation refers to the For Processing DICOM that `save` writes of the same radiograph, by its UIDs.
    raises  InputError for another suffix, a radiograph without masks, a name or size that does not fit,
            a disk that is full or cannot be written
    """
    path = require_path(path)
    suffix = suffix_of(path, SUFFIXES)
    require_radiograph(radiograph)
    masks = _masks(radiograph)
    if not masks:
        raise InputError("masks = none; allowed: those of a Knee simulated with keep=('masks',)")
    for name, mask in masks.items():
        if not re.fullmatch(r"[\w-]{1,64}", name, re.ASCII):
            raise InputError(f"mask name = {name!r}; allowed: 1 to 64 letters, digits, _ and -")
        if np.shape(mask) != radiograph.pixels.shape:
            raise InputError(f"mask {name}: shape = {np.shape(mask)}; allowed: {radiograph.pixels.shape}")
    with writing(path) as temporary:
        if suffix == ".dcm":
            from . import segmentation  # pydicom is not imported before a DICOM is wanted

            segmentation.write(radiograph, as_json(radiograph), masks, temporary)
        else:
            _write_tiff(radiograph, masks, temporary)
    return path


def load_masks(path: str | Path) -> dict[str, NDArray[np.bool_]]:
    """Name -> mask (rows, cols) bool of a file that `save_masks` wrote, in the order in which they were.

    raises  InputError for another suffix, or a file that is missing, damaged, altered, or not written by this package
    warns   UnverifiedNotice for a TIFF of an earlier version, which has no hash
    """
    path = require_path(path)
    suffix = suffix_of(path, SUFFIXES)
    with reading(path, "masks by pssf"):
        if suffix == ".dcm":
            from . import segmentation

            return segmentation.read(path)
        with tifffile.TiffFile(path) as tiff:
            header = json.loads(tiff.pages[0].description)  # type: ignore[union-attr]
            pages = [page.asarray().astype(np.bool_) for page in tiff.pages]
        masks = dict(zip(header["masks"], pages, strict=True))
        if "sha256" in header:
            require_hash(path, digest_of(masks), header["sha256"], "masks")
        else:
            warn_unverified(path, "masks")
        return masks


def _masks(radiograph: Radiograph) -> dict[str, NDArray[np.bool_]]:
    if radiograph.truth is not None:
        return dict(radiograph.truth.masks)
    return {
        f"{knee.side}_{name}": mask
        for knee, truth in zip(radiograph.knees, radiograph.truths, strict=True)
        for name, mask in truth.masks.items()
    }


def _write_tiff(radiograph: Radiograph, masks: Mapping[str, NDArray[np.bool_]], path: Path) -> None:
    header = {"masks": list(masks), "sha256": digest_of(masks), "radiograph": json.loads(as_json(radiograph))}
    per_cm = float(10.0 / radiograph.protocol.pixel_mm)
    with tifffile.TiffWriter(path) as tiff:
        for k, (name, mask) in enumerate(masks.items()):
            tiff.write(
                np.where(mask, np.uint8(255), np.uint8(0)),
                photometric="minisblack",
                compression="zlib",
                resolution=(per_cm, per_cm),
                resolutionunit="CENTIMETER",
                software=f"pssf {version('pssf')}",
                description=json.dumps(header) if k == 0 else None,
                extratags=[(_PAGE_NAME, "s", 0, name, True)],
                metadata=None,
            )
