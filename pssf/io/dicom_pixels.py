"""Pixels of DICOM objects: attributes without a value taken as absent, compressions named with what decodes them."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import FileDataset
from pydicom.pixels import get_decoder

from ..core.checks import InputError

_EXTRA = "pip install 'pssf[compressed]' brings decoders of JPEG, JPEG-LS and JPEG 2000"


def without_empty(item: FileDataset) -> FileDataset:
    """Take out what has no value where DICOM lets it be empty or be absent, which pydicom takes for a fault.

    An empty VOI LUT function is LINEAR (PS3.3, C.11.2.1.3), of slope and intercept the one that is missing is 1 or 0,
    and a look-up table without its descriptor or data is none.
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


def tidied(item: FileDataset, path: Path) -> FileDataset:
    """Take out what `without_empty` does, of an object that is to be displayed.

    Raises
    ------
    InputError
        The window has no width.
    """
    item = without_empty(item)
    if "WindowWidth" in item:
        width = float(np.ravel(item.WindowWidth)[0])
        least = 1.0 if item.get("VOILUTFunction", "LINEAR") == "LINEAR" else 0.0
        if not width >= least or width == 0.0:
            raise InputError(f"file {path}: WindowWidth must be at least 1, got {width:g}")
    return item


def padding_of(item: FileDataset, stored: NDArray[Any]) -> NDArray[np.bool_]:
    """Find the pixels that are no part of the image: those of the padding value, or from it to its limit.

    Parameters
    ----------
    stored : (rows, cols) array
        Values as stored, without unit.

    Returns
    -------
    (rows, cols) array of bool
    """
    value, limit = (item.get(f"PixelPadding{end}") for end in ("Value", "RangeLimit"))
    if value is None:
        return np.zeros(stored.shape, np.bool_)
    ends = sorted((int(value), int(value if limit is None else limit)))
    return np.asarray((stored >= ends[0]) & (stored <= ends[1]))


def pixels_of(item: FileDataset, path: Path) -> NDArray[Any]:
    """Give the stored values of an object, decompressed where an installed plugin can.

    Raises
    ------
    InputError
        The pixels are compressed, and no installed plugin of pydicom decodes them.
    """
    require_decoder(item, path)
    return item.pixel_array


def require_decoder(item: FileDataset, path: Path) -> None:
    """Refuse pixels that no installed plugin of pydicom decodes.

    Raises
    ------
    InputError
        The message names the transfer syntax, and the packages that decode it.
    """
    syntax = item.file_meta.get("TransferSyntaxUID")
    if syntax is None:
        return
    try:
        # A ValueError for what is no transfer syntax that pydicom knows.
        if not syntax.is_compressed:
            return
        decoder = get_decoder(syntax)
    except (NotImplementedError, ValueError):
        raise InputError(
            f"file {path}: transfer syntax must be of single pictures, got {syntax.name} ({syntax}), which pydicom "
            "decodes with no plugin"
        ) from None
    if not decoder.is_available:
        lacking = "; ".join(entry.strip() for entry in decoder.missing_dependencies)
        raise InputError(
            f"file {path}: transfer syntax must be one that an installed plugin decodes, got {syntax.name} ({syntax}): "
            f"{_EXTRA} (pydicom's plugins for it: {lacking})"
        )
