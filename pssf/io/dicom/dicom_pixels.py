"""Decode pixel data of DICOM objects; handle empty attributes, padding and compressed transfer syntaxes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import FileDataset
from pydicom.pixels import get_decoder

from ...core.checks import InputError

_DECODER_HINT = "install decoders of JPEG, JPEG-LS and JPEG 2000 with pip install 'pssf[compressed]'"


def remove_empty_attributes(item: FileDataset) -> FileDataset:
    """Remove attributes without a value, which DICOM allows and pydicom rejects.

    An empty VOI LUT function means LINEAR (PS3.3, C.11.2.1.3). A missing rescale slope is set to 1 if there is an
    intercept, and a missing intercept to 0 if there is a slope. A look-up table without descriptor or data is removed.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object, which is changed in place.

    Returns
    -------
    pydicom.dataset.FileDataset
        The object `item`, after the change.
    """
    for name in ("ModalityLUTSequence", "VOILUTSequence"):
        if name in item:
            whole = [
                one for one in item[name].value or () if one.get("LUTDescriptor") and one.get("LUTData") is not None
            ]
            setattr(item, name, whole)
            if not whole:
                delattr(item, name)
    for name in ("VOILUTFunction", "WindowCenter", "WindowWidth", "RescaleSlope", "RescaleIntercept"):
        if name in item and item[name].is_empty:
            delattr(item, name)
    if ("WindowCenter" in item) != ("WindowWidth" in item):
        delattr(item, "WindowCenter" if "WindowCenter" in item else "WindowWidth")
    if ("RescaleSlope" in item) != ("RescaleIntercept" in item):
        item.RescaleSlope, item.RescaleIntercept = item.get("RescaleSlope", 1), item.get("RescaleIntercept", 0)
    return item


def prepare_for_display(item: FileDataset, path: Path) -> FileDataset:
    """Remove empty attributes, and check the VOI window, before an object is displayed.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object, which is changed in place.
    path : Path
        Path shown in error messages.

    Returns
    -------
    pydicom.dataset.FileDataset
        The object `item`, after the change.

    Raises
    ------
    InputError
        The width of the window is too small.
    """
    item = remove_empty_attributes(item)
    if "WindowWidth" in item:
        width = float(np.ravel(item.WindowWidth)[0])
        least = 1.0 if item.get("VOILUTFunction", "LINEAR") == "LINEAR" else 0.0
        if not width >= least or width == 0.0:
            raise InputError(f"file {path}: WindowWidth must be at least 1, got {width:g}")
    return item


def find_padding(item: FileDataset, stored: NDArray[Any]) -> NDArray[np.bool_]:
    """Find the padding pixels of an object, which do not belong to the image.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object, with or without the attributes PixelPaddingValue and PixelPaddingRangeLimit.
    stored : (rows, cols) array, any unit
        Stored pixel values.

    Returns
    -------
    (rows, cols) bool array
        True for values from the padding value to the range limit. All False if the object has no padding value.
    """
    value, limit = (item.get(f"PixelPadding{end}") for end in ("Value", "RangeLimit"))
    if value is None:
        return np.zeros(stored.shape, np.bool_)
    ends = sorted((int(value), int(value if limit is None else limit)))
    return np.asarray((stored >= ends[0]) & (stored <= ends[1]))


def decode_pixels(item: FileDataset, path: Path) -> NDArray[Any]:
    """Decode the stored pixel values of an object; compressed values need an installed plugin of pydicom.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object with pixel data.
    path : Path
        Path shown in error messages.

    Returns
    -------
    (rows, cols) or (frames, rows, cols) array
        Stored values, without unit.

    Raises
    ------
    InputError
        No installed plugin of pydicom decodes the pixels.
    """
    require_decoder(item, path)
    return item.pixel_array


def require_decoder(item: FileDataset, path: Path) -> None:
    """Require that pydicom can decode the pixels of an object with an installed plugin.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object with pixel data.
    path : Path
        Path shown in error messages.

    Raises
    ------
    InputError
        The pixels cannot be decoded. The message names the transfer syntax, and the packages that decode it.
    """
    syntax = item.file_meta.get("TransferSyntaxUID")
    if syntax is None:
        return
    try:
        # pydicom raises ValueError for a transfer syntax that it does not know.
        if not syntax.is_compressed:
            return
        decoder = get_decoder(syntax)
    except (NotImplementedError, ValueError):
        raise InputError(
            f"file {path}: transfer syntax must be one that pydicom decodes to single images, got {syntax.name} "
            f"({syntax})"
        ) from None
    if not decoder.is_available:
        lacking = "; ".join(entry.strip() for entry in decoder.missing_dependencies)
        raise InputError(
            f"file {path}: transfer syntax must be one that an installed plugin decodes, got {syntax.name} ({syntax}): "
            f"{_DECODER_HINT} (pydicom's plugins for it: {lacking})"
        )
