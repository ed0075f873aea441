"""Read TIFF radiographs that Pillow decodes incorrectly: 9 to 15 bits, big-endian white-is-zero, or rotated images."""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from ...core.checks import Array, InputError

# Values of the tag PhotometricInterpretation (TIFF 6.0, tag 262).
_WHITE_IS_ZERO = 0
_BLACK_IS_ZERO = 1
# Values of the tag Compression (TIFF 6.0, tag 259); Deflate has two values.
_NONE = 1
_DEFLATE = (8, 32946)
# Bit depths at which pixel values are packed: neighbouring pixels share bytes. At other depths, a value fills one or
# two bytes.
_PACKED = range(9, 16)
_WHOLE = (8, 16)
# Orientation values (TIFF 6.0, tag 274) that swap rows and columns.
_TRANSPOSED_ORIENTATIONS = range(5, 9)
# Function that rotates or mirrors an image upright, for each Orientation value (TIFF 6.0, tag 274).
_TURN_UPRIGHT: dict[int, Any] = {
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.T,
    6: lambda a: a.T[:, ::-1],
    7: lambda a: a[::-1, ::-1].T,
    8: lambda a: a.T[::-1],
}


def read_packed_tiff(path: Path) -> Array | None:
    """Read the grey values of a TIFF that Pillow decodes incorrectly.

    Parameters
    ----------
    path : Path
        TIFF file.

    Returns
    -------
    (rows, cols) array or None
        Upright grey values from 0 (black) to 1 (largest value of the bit depth). None if Pillow decodes the TIFF
        correctly or reports it as damaged.

    Raises
    ------
    InputError
        The image has several frames, or its orientation, tiling or compression is not supported.
    """
    try:
        tiff = tifffile.TiffFile(path)
    except tifffile.TiffFileError:
        return None  # Pillow reports the damaged file later.
    with tiff:
        page: Any = tiff.pages[0]
        bits, kind = page.bitspersample, int(page.photometric)
        orientation = page.tags.valueof(274) or 1
        # Pillow swaps rows and columns before it reads uncompressed pixels, which moves the pixels to wrong positions.
        sideways = orientation in _TRANSPOSED_ORIENTATIONS and page.compression == _NONE
        negative = kind == _WHITE_IS_ZERO and tiff.byteorder == ">" and bits == 16
        if page.samplesperpixel != 1 or kind not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO):
            if sideways:
                raise InputError(
                    f"file {path}: orientation of a colour image must be 1 to 4, got {orientation}: "
                    "save the image upright"
                )
            return None
        if (bits not in _PACKED and not (bits in _WHOLE and (negative or sideways))) or page.sampleformat != 1:
            return None
        if len(tiff.pages) > 1:
            raise InputError(f"file {path}: frames must be 1, got {len(tiff.pages)}")
        values = _unpack_strips(tiff, page, bits, path)
        turned = _TURN_UPRIGHT.get(orientation, lambda same: same)(values.astype(np.float64))
    share = turned / (2**bits - 1)
    return 1.0 - share if kind == _WHITE_IS_ZERO else share


def _unpack_strips(tiff: tifffile.TiffFile, page: Any, bits: int, path: Path) -> NDArray[np.integer[Any]]:
    """Decode the strips of a TIFF to dimensionless grey values (rows, cols).

    Each row begins at a byte boundary. The most significant bit of a pixel comes first.
    """
    rows, cols = page.imagelength, page.imagewidth
    known = page.compression == _NONE or page.compression in _DEFLATE
    if page.is_tiled or not known or page.predictor != 1:
        how = "tiles" if page.is_tiled else f"{page.compression.name}, predictor {int(page.predictor)}"
        raise InputError(
            f"file {path} must store its pixels in strips, uncompressed or with Deflate, got {bits} bits in {how}: "
            "save the image again"
        )
    content = bytearray()
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        tiff.filehandle.seek(offset)
        strip = tiff.filehandle.read(count)
        content += strip if page.compression == _NONE else zlib.decompress(strip)
    row_bytes = -(-cols * bits // 8)
    if len(content) < rows * row_bytes:
        raise InputError(
            f"file {path} must contain {rows * row_bytes} bytes of pixel data, got {len(content)}: copy the file again"
        )
    packed = np.frombuffer(content, np.uint8, rows * row_bytes).reshape(rows, row_bytes)
    if bits in _WHOLE:
        return packed.reshape(-1).view(f"{tiff.byteorder}u{bits // 8}").reshape(rows, cols)
    order: Any = "little" if page.fillorder == 2 else "big"
    each = np.unpackbits(packed, axis=1, count=cols * bits, bitorder=order).reshape(rows, cols, bits)
    return each @ (1 << np.arange(bits - 1, -1, -1, dtype=np.uint16))
