"""Read binary and ASCII STL files, and check that no facet is missing.

Some readers split an ASCII file at "endsolid" and lose a body that has no "endsolid". This module compares the
number of facets with the header of a binary file, or with the number of "facet" keywords in an ASCII file.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ...core.checks import Array, InputError

_HEADER = 84  # bytes before the first facet of a binary STL
_FACET = 50  # bytes per facet of a binary STL
_FACET_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Patterns of the lines that begin and end a body; the name of the body may contain any word.
_BEGIN = re.compile(rb"^[ \t]*solid\b[^\n]*$", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*end[ \t]*solid\b[^\n]*$", re.MULTILINE | re.IGNORECASE)
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_REMEDY = "export or copy the file again"


def read_stl(content: bytes, path: Path) -> trimesh.Trimesh:
    """Read an STL, and merge equal vertices of each body.

    STL repeats a shared vertex in every facet.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : Path
        Path shown in error messages.

    Returns
    -------
    trimesh.Trimesh
        Mesh in the unit of the file.

    Raises
    ------
    InputError
        The file is incomplete, or a facet is invalid.
    """
    count = int.from_bytes(content[80:_HEADER], "little")
    is_text = re.match(rb"(\xef\xbb\xbf)?\s*solid\b", content, re.IGNORECASE) and b"\0" not in content
    if is_text and len(content) != _HEADER + _FACET * count:
        return _read_ascii_stl(content.removeprefix(b"\xef\xbb\xbf").replace(b"\r", b"\n"), path)
    return _read_binary_stl(content, count, path)


def _read_binary_stl(content: bytes, count: int, path: Path) -> trimesh.Trimesh:
    """Read a binary STL; only whitespace and zero bytes may follow the facets."""
    if len(content) < _HEADER:
        raise InputError(f"file {path} must be an STL, got {len(content)} bytes without a header: {_REMEDY}")
    rest = content[_HEADER + _FACET * count :]
    if len(content) < _HEADER + _FACET * count or rest.strip(b"\0 \t\r\n"):
        held = (len(content) - _HEADER) / _FACET
        raise InputError(
            f"file {path} must have the {count} facets that its header specifies, got {held:.1f}: {_REMEDY}"
        )
    return _weld_facets(np.frombuffer(content, _FACET_RECORD, count, _HEADER)["corners"].astype(np.float64))


def _read_ascii_stl(text: bytes, path: Path) -> trimesh.Trimesh:
    """Read an ASCII STL of one or several bodies."""
    # Text before the first body is ignored.
    bodies = _BEGIN.split(text)[1:]
    if bodies and not _END.search(bodies[-1]):
        raise InputError(
            f"file {path} must end with endsolid, got {len(bodies)} bodies, the last one without endsolid: {_REMEDY}"
        )
    meshes = [
        _read_body(_END.sub(b"", body), f"file {path}: body {number}") for number, body in enumerate(bodies, start=1)
    ]
    filled = [mesh for mesh in meshes if len(mesh.faces)]
    whole: Any = trimesh.util.concatenate(filled) if len(filled) > 1 else (*filled, trimesh.Trimesh())[0]
    return whole  # type: ignore[no-any-return]


def _read_body(text: bytes, label: str) -> trimesh.Trimesh:
    """Read one body of an ASCII STL; error messages begin with `label`."""
    begun, ended = (len(re.findall(word, text, re.IGNORECASE)) for word in (rb"\bfacet\b", rb"\bendfacet\b"))
    corners = _VERTEX.findall(text)
    if begun != ended or 3 * begun != len(corners):
        raise InputError(
            f"{label} must have complete facets of 3 vertices, got {begun} facet and {ended} endfacet keywords and "
            f"{len(corners)} vertices: {_REMEDY}"
        )
    try:
        return _weld_facets(np.array(corners, np.bytes_).astype(np.float64).reshape(-1, 3, 3))
    except ValueError as error:
        raise InputError(
            f"{label}: vertex coordinates must be numbers, got {str(error).rpartition(':')[2].strip()}"
        ) from None


def _weld_facets(corners_mm: Array) -> trimesh.Trimesh:
    """Make a mesh from facet corners (facets, 3, 3), in mm, and merge equal corners."""
    faces = np.arange(3 * len(corners_mm)).reshape(-1, 3)
    return trimesh.Trimesh(corners_mm.reshape(-1, 3), faces, process=True)
