"""read_stl: a binary or ASCII STL, every facet of it or a refusal.

Readers that split a text at its "endsolid" lose a body whose end is missing. Here facets are counted against what the
header announces, or against those that the text begins.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ..core.checks import Array, InputError

_HEADER, _FACET = 84, 50
_CORNERS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# A line that begins a body, a line that ends one; names may hold any word.
_BEGIN = re.compile(rb"^[ \t]*solid\b[^\n]*$", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*end[ \t]*solid\b[^\n]*$", re.MULTILINE | re.IGNORECASE)
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_AGAIN = "export or copy it again"


def read_stl(content: bytes, path: Path) -> trimesh.Trimesh:
    """Read an STL; equal corners of each body are welded, since the format repeats them in every facet.

    Parameters
    ----------
    content
        Of the file.
    path
        Is named in a refusal.

    Raises
    ------
    InputError
        The file is cut off, or has facets that are none.
    """
    count = int.from_bytes(content[80:_HEADER], "little")
    is_text = re.match(rb"(\xef\xbb\xbf)?\s*solid\b", content, re.IGNORECASE) and b"\0" not in content
    if is_text and len(content) != _HEADER + _FACET * count:
        return _of_text(content.removeprefix(b"\xef\xbb\xbf").replace(b"\r", b"\n"), path)
    return _of_records(content, count, path)


def _of_records(content: bytes, count: int, path: Path) -> trimesh.Trimesh:
    """Whatever follows the facets that are announced must be blank, as a line's end that a transfer has added."""
    if len(content) < _HEADER:
        raise InputError(f"file {path} must be an STL, got {len(content)} bytes without a header: {_AGAIN}")
    rest = content[_HEADER + _FACET * count :]
    if len(content) < _HEADER + _FACET * count or rest.strip(b"\0 \t\r\n"):
        held = (len(content) - _HEADER) / _FACET
        raise InputError(
            f"file {path} must hold the {count} facets that its header announces, got bytes for {held:.1f}: {_AGAIN}"
        )
    return _welded(np.frombuffer(content, _CORNERS, count, _HEADER)["corners"].astype(np.float64))


def _of_text(text: bytes, path: Path) -> trimesh.Trimesh:
    # What is before the first is no body.
    bodies = _BEGIN.split(text)[1:]
    if bodies and not _END.search(bodies[-1]):
        raise InputError(f"file {path} must end with endsolid, got {len(bodies)} bodies, the last without: {_AGAIN}")
    meshes = [_body(_END.sub(b"", body), f"file {path}: body {number}") for number, body in enumerate(bodies, start=1)]
    filled = [mesh for mesh in meshes if len(mesh.faces)]
    whole: Any = trimesh.util.concatenate(filled) if len(filled) > 1 else (*filled, trimesh.Trimesh())[0]
    return whole  # type: ignore[no-any-return]


def _body(text: bytes, what: str) -> trimesh.Trimesh:
    begun, ended = (len(re.findall(word, text, re.IGNORECASE)) for word in (rb"\bfacet\b", rb"\bendfacet\b"))
    corners = _VERTEX.findall(text)
    if begun != ended or 3 * begun != len(corners):
        raise InputError(
            f"{what} must hold whole facets of 3 corners, got {begun} begun and {ended} ended, {len(corners)} corners: "
            f"{_AGAIN}"
        )
    try:
        return _welded(np.array(corners, np.bytes_).astype(np.float64).reshape(-1, 3, 3))
    except ValueError as error:
        raise InputError(f"{what}: corners must be numbers, got {str(error).rpartition(':')[2].strip()}") from None


def _welded(corners_mm: Array) -> trimesh.Trimesh:
    """(facets, 3, 3) corners, mm, as a mesh."""
    faces = np.arange(3 * len(corners_mm)).reshape(-1, 3)
    return trimesh.Trimesh(corners_mm.reshape(-1, 3), faces, process=True)
