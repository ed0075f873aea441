"""Detect incomplete mesh files from the sizes in their headers."""

import re
import warnings
from pathlib import Path

from ...core.checks import InputError
from ...geometry.scene import MeshNotice

_REMEDY = "export or copy the file again"


def require_complete_mesh_file(content: bytes, path: Path) -> None:
    """Require that a PLY or GLB is complete, and warn about an OBJ that may be incomplete.

    An OBJ has no header with a size, so unused vertices are the only sign of an incomplete OBJ.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : Path
        Path shown in error messages; the suffix determines the format.

    Raises
    ------
    InputError
        The file is shorter than its header specifies, or the header is incomplete.

    Warns
    -----
    MeshNotice
        No face uses the last vertices of an OBJ.
    """
    kind = path.suffix.lower()
    if kind == ".ply":
        _require_complete_ply(content, path)
    elif kind == ".glb":
        _require_complete_glb(content, path)
    elif kind == ".obj":
        _warn_of_lost_faces(content, path)


def _require_complete_ply(content: bytes, path: Path) -> None:
    """Require that a PLY has a complete header and, if it is an ASCII file, one line per vertex and face."""
    if not content.startswith(b"ply"):
        raise InputError(f"file {path} must begin with ply, got {content[:12]!r}: {_REMEDY}, or correct the suffix")
    header, end, body = content.partition(b"end_header")
    counts = [int(number) for number in re.findall(rb"^element\s+\S+\s+(\d{1,15})\s*$", header, re.MULTILINE)]
    if not end or not re.search(rb"^element\s+face\b", header, re.MULTILINE):
        raise InputError(
            f"file {path} must have a complete header with faces, got a header of {len(header)} bytes: {_REMEDY}"
        )
    if re.search(rb"^format\s+ascii\b", header, re.MULTILINE):
        # Every vertex and every face has one line. A last line without a line break may be incomplete.
        lines = [line for line in body.splitlines()[1:] if line.strip()]
        if len(lines) < sum(counts):
            raise InputError(f"file {path} must have {sum(counts)} vertices and faces, got {len(lines)}: {_REMEDY}")


def _require_complete_glb(content: bytes, path: Path) -> None:
    """Require that a GLB has the length that its header specifies."""
    # A GLB header contains the magic word, the version and the total length in bytes (glTF 2.0, 4.4.2).
    if content[:4] != b"glTF":
        raise InputError(f"file {path} must begin with glTF, got {content[:4]!r}: {_REMEDY}, or correct the suffix")
    length = int.from_bytes(content[8:12], "little")
    if len(content) < max(length, 20):
        raise InputError(
            f"file {path} must have {length} bytes, as its header specifies, got {len(content)}: {_REMEDY}"
        )


def _warn_of_lost_faces(content: bytes, path: Path) -> None:
    """Warn about an OBJ whose last vertices are not used by any face."""
    count = len(re.findall(rb"^\s*v\s", content, re.MULTILINE))
    faces = re.findall(rb"^\s*f\s([^\n]*)$", content, re.MULTILINE)
    used = [int(number) for face in faces for number in re.findall(rb"(?:^|\s)(-?\d{1,15})", face)]
    # Files with negative vertex indices are skipped, because negative indices are relative to the latest vertex.
    if faces and used and min(used) > 0 and max(used) < count:
        warnings.warn(
            f"file {path}: vertices {max(used) + 1} to {count} are not used by any face, so the file may be "
            f"incomplete; {_REMEDY}",
            MeshNotice,
            stacklevel=5,
        )
