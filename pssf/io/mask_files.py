"""Mask files: TIFF with one page per mask, or DICOM Segmentation with one segment per mask."""

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
from .atomic_write import replace_file
from .metadata import (
    encode_metadata,
    hash_masks,
    require_hash,
    warn_unverified,
)
from .radiograph_files import convert_read_errors, require_radiograph, require_suffix

SUFFIXES = (".tif", ".tiff", ".dcm")
_PAGE_NAME_TAG = 285  # number of the TIFF tag PageName, which contains the mask name (TIFF 6.0)


def save_masks(radiograph: Radiograph, path: str | Path) -> Path:
    """Write the masks of a radiograph as TIFF or DICOM Segmentation, depending on the file suffix.

    Both formats are lossless, and masks may overlap. A TIFF has one compressed page per mask, with the mask name and
    the values 0 and 255. A Segmentation has one bit per pixel, and refers to the DICOM For Processing image that `save`
    writes for the same radiograph.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph simulated from one or two knees with ``keep=("masks",)``. For two knees, the mask names begin with
        the side, such as right_femur and left_femur.
    path : str or Path
        File to write, with suffix .tif, .tiff or .dcm.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        The suffix is not supported, the radiograph has no masks, or the size of a mask differs from the radiograph. A
        mask name is not allowed, the disk is full, or the file cannot be written.

    See Also
    --------
    load_masks : Read the masks from the file.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf
    >>> knee = pssf.sample_knee(grade=0, rng=0)
    >>> protocol = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(knee, protocol, rng=0, keep=("masks",))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pssf.save_masks(radiograph, Path(folder) / "masks.tif")
    ...     masks = pssf.load_masks(path)
    >>> list(masks)[:4], masks["femur"].shape
    (['femur', 'tibia', 'fibula', 'patella'], (64, 64))
    """
    path = require_path(path)
    suffix = require_suffix(path, SUFFIXES)
    require_radiograph(radiograph)
    masks = _collect_masks(radiograph)
    if not masks:
        raise InputError("radiograph must have masks, got masks = none: simulate the knee with keep=('masks',)")
    for name, mask in masks.items():
        if not re.fullmatch(r"[\w-]{1,64}", name, re.ASCII):
            raise InputError(f"mask name must be 1 to 64 letters, digits, _ and -, got {name!r}")
        if np.shape(mask) != radiograph.pixels.shape:
            raise InputError(f"mask {name}: shape must be {radiograph.pixels.shape}, got {np.shape(mask)}")
    with replace_file(path) as temporary:
        if suffix == ".dcm":
            from .dicom import dicom_segmentation  # pydicom is imported only for DICOM files.

            dicom_segmentation.write_segmentation(radiograph, encode_metadata(radiograph), masks, temporary)
        else:
            _write_tiff(radiograph, masks, temporary)
    return path


def load_masks(path: str | Path) -> dict[str, NDArray[np.bool_]]:
    """Read masks from a file that `save_masks` wrote.

    Parameters
    ----------
    path : str or Path
        File to read, with suffix .tif, .tiff or .dcm.

    Returns
    -------
    dict of str to (rows, cols) bool array
        Masks in the order in which they were written, keyed by mask name.

    Raises
    ------
    InputError
        The suffix is not supported, or the file is missing, damaged, altered, or not written by PSSF.

    Warns
    -----
    UnverifiedNotice
        An earlier version wrote the TIFF without a hash, or an archive has replaced the UIDs that would verify a DICOM
        file.

    See Also
    --------
    save_masks : Write the masks of a radiograph.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf
    >>> knee = pssf.sample_knee(grade=0, rng=0)
    >>> protocol = pssf.load_protocol("reference").resample(64)
    >>> radiograph = pssf.simulate(knee, protocol, rng=0, keep=("masks",))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pssf.save_masks(radiograph, Path(folder) / "masks.dcm")
    ...     masks = pssf.load_masks(path)
    >>> bool((masks["tibia"] == radiograph.truth.masks["tibia"]).all())
    True
    """
    path = require_path(path)
    suffix = require_suffix(path, SUFFIXES)
    with convert_read_errors(path, "a mask file written by pssf"):
        if suffix == ".dcm":
            from .dicom import dicom_segmentation

            return dicom_segmentation.read_segmentation(path)
        with tifffile.TiffFile(path) as tiff:
            header = json.loads(tiff.pages[0].description)  # type: ignore[union-attr]
            pages = [page.asarray().astype(np.bool_) for page in tiff.pages]
        masks = dict(zip(header["masks"], pages, strict=True))
        if "sha256" in header:
            require_hash(path, hash_masks(masks), header["sha256"], "masks")
        else:
            warn_unverified(path, "masks")
        return masks


def _collect_masks(radiograph: Radiograph) -> dict[str, NDArray[np.bool_]]:
    """Return the masks (rows, cols) of all knees. For two knees, the mask names begin with the side."""
    if radiograph.truth is not None:
        return dict(radiograph.truth.masks)
    return {
        f"{knee.side}_{name}": mask
        for knee, truth in zip(radiograph.knees, radiograph.truths, strict=True)
        for name, mask in truth.masks.items()
    }


def _write_tiff(radiograph: Radiograph, masks: Mapping[str, NDArray[np.bool_]], path: Path) -> None:
    """Write masks (rows, cols) as pages of a TIFF, with JSON metadata in the description of the first page."""
    header = {"masks": list(masks), "sha256": hash_masks(masks), "radiograph": json.loads(encode_metadata(radiograph))}
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
                extratags=[(_PAGE_NAME_TAG, "s", 0, name, True)],
                metadata=None,
            )
