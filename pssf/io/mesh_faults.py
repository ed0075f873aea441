"""require_whole: refusals of mesh files that are cut off, by what their own headers announce."""

import re
import warnings
from pathlib import Path

from ..core.checks import InputError
from ..geometry.scene import MeshNotice

_AGAIN = "export or copy it again"


def require_whole(content: bytes, path: Path) -> None:
    """Refuse a PLY or GLB of which a part is missing; an OBJ, which announces nothing, gets a warning.

    Parameters
    ----------
    content
        Of the file.
    path
        Its suffix says what it is.

    Raises
    ------
    InputError
        The file is shorter than it says, or its header has no end.

    Warns
    -----
    MeshNotice
        The last vertices of an OBJ belong to no face.
    """
    kind = path.suffix.lower()
    if kind == ".ply":
        _require_whole_ply(content, path)
    elif kind == ".glb":
        _require_whole_glb(content, path)
    elif kind == ".obj":
        _warn_of_lost_faces(content, path)


def _require_whole_ply(content: bytes, path: Path) -> None:
    if not content.startswith(b"ply"):
        raise InputError(f"file {path} must begin with ply, got {content[:12]!r}: {_AGAIN}, or name what it is")
    header, end, body = content.partition(b"end_header")
    counts = [int(number) for number in re.findall(rb"^element\s+\S+\s+(\d{1,15})\s*$", header, re.MULTILINE)]
    if not end or not re.search(rb"^element\s+face\b", header, re.MULTILINE):
        raise InputError(f"file {path} must have a whole header with faces, got {len(header)} bytes of one: {_AGAIN}")
    if re.search(rb"^format\s+ascii\b", header, re.MULTILINE):
        # A line each; only the last may lack its end, and then may be cut.
        lines = [line for line in body.splitlines()[1:] if line.strip()]
        if len(lines) < sum(counts):
            raise InputError(f"file {path} must hold {sum(counts)} vertices and faces, got {len(lines)}: {_AGAIN}")


def _require_whole_glb(content: bytes, path: Path) -> None:
    # glTF 2.0, 4.4.2: magic, version, length of the whole in bytes.
    if content[:4] != b"glTF":
        raise InputError(f"file {path} must begin with glTF, got {content[:4]!r}: {_AGAIN}, or name what it is")
    length = int.from_bytes(content[8:12], "little")
    if len(content) < max(length, 20):
        raise InputError(f"file {path} must hold {length} bytes, as its header says, got {len(content)}: {_AGAIN}")


def _warn_of_lost_faces(content: bytes, path: Path) -> None:
    count = len(re.findall(rb"^\s*v\s", content, re.MULTILINE))
    faces = re.findall(rb"^\s*f\s([^\n]*)$", content, re.MULTILINE)
    used = [int(number) for face in faces for number in re.findall(rb"(?:^|\s)(-?\d{1,15})", face)]
    # Numbers below 0 count from the last vertex before, which is not known here.
    if faces and used and min(used) > 0 and max(used) < count:
        warnings.warn(
            f"file {path}: its vertices {max(used) + 1} to {count} belong to no face; it may be cut off; {_AGAIN}",
            MeshNotice,
            stacklevel=5,
        )
