"""Decoding of DICOM pixel data, with support for empty attributes, padding and compressed transfer syntaxes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import FileDataset
from pydicom.pixels import get_decoder

from ...core.checks import InputError

_DECODER_HINT = "install decoders for JPEG, JPEG-LS and JPEG 2000 with pip install 'pssf[compressed]'"


def remove_empty_attributes(item: FileDataset) -> FileDataset:
    """Remove attributes without a value, which are valid in DICOM but cause errors in pydicom.

    An empty VOI LUT function means LINEAR (PS3.3, C.11.2.1.3). A missing rescale slope is set to 1 if an intercept is
    present, and a missing intercept is set to 0 if a slope is present. A look-up table without descriptor or data is
    removed.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object, which is modified in place.

    Returns
    -------
    pydicom.dataset.FileDataset
        The modified object `item`.
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
    """Prepare a DICOM object for display: remove empty attributes and check the VOI window.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object, which is modified in place.
    path : Path
        Path shown in error messages.

    Returns
    -------
    pydicom.dataset.FileDataset
        The modified object `item`.

    Raises
    ------
    InputError
        The window width is too small.
    """
    item = remove_empty_attributes(item)
    if "WindowWidth" in item:
        width = float(np.ravel(item.WindowWidth)[0])
        least = 1.0 if item.get("VOILUTFunction", "LINEAR") == "LINEAR" else 0.0
        if not width >= least or width == 0.0:
            raise InputError(f"file {path}: WindowWidth must be at least 1, got {width:g}")
    return item


def find_padding(item: FileDataset, stored: NDArray[Any]) -> NDArray[np.bool_]:
    """Find the padding pixels of a DICOM object, which do not belong to the image.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object, with or without the attributes PixelPaddingValue and PixelPaddingRangeLimit.
    stored : (rows, cols) array, any unit
        Stored pixel values.

    Returns
    -------
    (rows, cols) bool array
        True for pixels with values from PixelPaddingValue to PixelPaddingRangeLimit. All pixels are False if the object
        has no padding value.
    """
    value, limit = (item.get(f"PixelPadding{end}") for end in ("Value", "RangeLimit"))
    if value is None:
        return np.zeros(stored.shape, np.bool_)
    ends = sorted((int(value), int(value if limit is None else limit)))
    return np.asarray((stored >= ends[0]) & (stored <= ends[1]))


def decode_pixels(item: FileDataset, path: Path) -> NDArray[Any]:
    """Decode the stored pixel values of a DICOM object. Compressed pixels require an installed pydicom plugin.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object with pixel data.
    path : Path
        Path shown in error messages.

    Returns
    -------
    (rows, cols) or (frames, rows, cols) array
        Stored pixel values, dimensionless.

    Raises
    ------
    InputError
        No installed pydicom plugin can decode the pixels.
    """
    require_decoder(item, path)
    return item.pixel_array


def require_decoder(item: FileDataset, path: Path) -> None:
    """Require that an installed pydicom plugin can decode the pixels of a DICOM object.

    Parameters
    ----------
    item : pydicom.dataset.FileDataset
        DICOM object with pixel data.
    path : Path
        Path shown in error messages.

    Raises
    ------
    InputError
        The pixels cannot be decoded. The message contains the transfer syntax and the packages that can decode it.
    """
    syntax = item.file_meta.get("TransferSyntaxUID")
    if syntax is None:
        return
    try:
        # pydicom raises ValueError for an unknown transfer syntax.
        if not syntax.is_compressed:
            return
        decoder = get_decoder(syntax)
    except (NotImplementedError, ValueError):
        raise InputError(
            f"file {path}: transfer syntax must be one that pydicom can decode to single images, got {syntax.name} "
            f"({syntax})"
        ) from None
    if not decoder.is_available:
        lacking = "; ".join(entry.strip() for entry in decoder.missing_dependencies)
        raise InputError(
            f"file {path}: transfer syntax must be one that an installed pydicom plugin can decode, got {syntax.name} "
            f"({syntax}): {_DECODER_HINT} (suitable plugins: {lacking})"
        )
