"""read_packed: TIFF films that Pillow reads wrongly or not at all: 9 to 15 bits, big-endian negatives, turned."""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from ..core.checks import Array, InputError

_WHITE_IS_ZERO, _BLACK_IS_ZERO = 0, 1
_NONE, _DEFLATE = 1, (8, 32946)
_PACKED, _WHOLE = range(9, 16), (8, 16)
_SIDEWAYS = range(5, 9)
# How a picture is turned upright by its orientation (TIFF 6.0, tag 274).
_UPRIGHT: dict[int, Any] = {
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.T,
    6: lambda a: a.T[:, ::-1],
    7: lambda a: a[::-1, ::-1].T,
    8: lambda a: a.T[::-1],
}


def read_packed(path: Path) -> Array | None:
    """Read the grey values of a film that Pillow would not read right.

    Returns
    -------
    (rows, cols) array of 0 to 1 over the range of its bits, upright, black is 0; None for any other TIFF.

    Raises
    ------
    InputError
        The film has several frames, or is compressed or tiled in a way that is not read.
    """
    try:
        tiff = tifffile.TiffFile(path)
    except tifffile.TiffFileError:
        return None  # Pillow says what is wrong
    with tiff:
        page: Any = tiff.pages[0]
        bits, kind = page.bitspersample, int(page.photometric)
        orientation = page.tags.valueof(274) or 1
        # Pillow turns rows and columns before it reads what is not compressed, and mixes all pixels up.
        sideways = orientation in _SIDEWAYS and page.compression == _NONE
        negative = kind == _WHITE_IS_ZERO and tiff.byteorder == ">" and bits == 16
        if page.samplesperpixel != 1 or kind not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO):
            if sideways:
                raise InputError(
                    f"file {path}: orientation of colour must be 1 to 4, got {orientation}: save it upright"
                )
            return None
        if (bits not in _PACKED and not (bits in _WHOLE and (negative or sideways))) or page.sampleformat != 1:
            return None
        if len(tiff.pages) > 1:
            raise InputError(f"file {path}: frames = {len(tiff.pages)}; allowed: 1")
        values = _unpacked(tiff, page, bits, path)
        turned = _UPRIGHT.get(orientation, lambda same: same)(values.astype(np.float64))
    share = turned / (2**bits - 1)
    return 1.0 - share if kind == _WHITE_IS_ZERO else share


def _unpacked(tiff: tifffile.TiffFile, page: Any, bits: int, path: Path) -> NDArray[np.integer[Any]]:
    """(rows, cols) of strips whose rows begin at whole bytes, the highest bit first."""
    rows, cols = page.imagelength, page.imagewidth
    known = page.compression == _NONE or page.compression in _DEFLATE
    if page.is_tiled or not known or page.predictor != 1:
        how = "tiles" if page.is_tiled else f"{page.compression.name}, predictor {int(page.predictor)}"
        raise InputError(
            f"file {path} must be in strips, without compression or with Deflate, got {bits} bits in {how}: save it so"
        )
    content = bytearray()
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        tiff.filehandle.seek(offset)
        strip = tiff.filehandle.read(count)
        content += strip if page.compression == _NONE else zlib.decompress(strip)
    row_bytes = -(-cols * bits // 8)
    if len(content) < rows * row_bytes:
        raise InputError(f"file {path} must hold {rows * row_bytes} bytes of pixels, got {len(content)}: copy it again")
    packed = np.frombuffer(content, np.uint8, rows * row_bytes).reshape(rows, row_bytes)
    if bits in _WHOLE:
        return packed.reshape(-1).view(f"{tiff.byteorder}u{bits // 8}").reshape(rows, cols)
    order: Any = "little" if page.fillorder == 2 else "big"
    each = np.unpackbits(packed, axis=1, count=cols * bits, bitorder=order).reshape(rows, cols, bits)
    return each @ (1 << np.arange(bits - 1, -1, -1, dtype=np.uint16))
