"""Read one mesh from an STL, PLY, OBJ or GLB file."""

import io
from pathlib import Path
from typing import Any

import trimesh

from ...core.checks import InputError, format_one_line, require_path
from ...data.user_files import read_bytes
from .exported_scenes import count_described_meshes
from .mesh_faults import require_complete_mesh_file
from .stl_reader import read_stl

_FORMATS = "STL, PLY, OBJ or GLB"
# Millimetres per metre; the unit of a GLB is the metre.
_MM_PER_M = 1000.0


def read_mesh(path: str | Path) -> trimesh.Trimesh:
    """Read one mesh from an STL, PLY or OBJ in mm, or from a GLB in metres.

    Equal vertices are merged, because an STL repeats a shared vertex in every facet.

    Parameters
    ----------
    path : str or Path
        File to read.

    Returns
    -------
    trimesh.Trimesh
        Mesh in mm.

    Raises
    ------
    InputError
        The file is missing, incomplete, not a mesh, or a scene of several meshes.

    Warns
    -----
    MeshNotice
        An OBJ may be incomplete.

    See Also
    --------
    read_scene : Read a scene of several meshes with materials.
    export_meshes : Write the surfaces of a scene.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf, trimesh
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "box.stl"
    ...     _ = trimesh.creation.box((10.0, 20.0, 30.0)).export(path)
    ...     mesh = pssf.read_mesh(path)
    >>> mesh.is_watertight, float(mesh.volume)
    (True, 6000.0)
    """
    path = require_path(path)
    content = read_bytes(path, allowed=f"a mesh file, {_FORMATS}")
    require_complete_mesh_file(content, path)
    if path.suffix.lower() == ".stl":
        mesh: Any = read_stl(content, path)
    else:
        mesh = _load_with_trimesh(content, path)
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"file {path} must be {_FORMATS} with a closed mesh, got no faces")
    if path.suffix.lower() in (".glb", ".gltf"):
        mesh.apply_scale(_MM_PER_M)
    return mesh


def _load_with_trimesh(content: bytes, path: Path) -> Any:
    """Read a mesh with trimesh; convert its errors to an InputError."""
    kind = path.suffix.lower()
    if kind == ".3mf" or (kind == ".glb" and count_described_meshes(content) > 1):
        raise InputError(f"file {path} must have one mesh, got a {kind[1:].upper()} scene: use pssf.read_scene instead")
    try:
        if kind in (".obj", ".ply") and not _is_unicode(content):
            # Older programs write names and comments in encodings other than UTF-8, which do not affect numbers.
            text = content.decode("latin-1").encode() if kind == ".obj" else _convert_header_to_ascii(content)
            return trimesh.load_mesh(io.BytesIO(text), file_type=kind[1:], process=True)
        return trimesh.load_mesh(path, process=True)
    except OSError as error:
        raise InputError(f"file {path} must be a readable mesh file, got {error.strerror or error}") from None
    except ImportError:  # trimesh raises ImportError for formats that require additional libraries.
        raise InputError(f"file {path} must be {_FORMATS}, got {kind or 'no suffix'}") from None
    except Exception as error:  # Mesh readers raise many kinds of errors for a damaged file.
        reason = format_one_line(f"{type(error).__name__}: {error}")[:200]
        raise InputError(
            f"file {path} must be a complete {_FORMATS}, got a damaged {kind[1:].upper()} ({reason})"
        ) from None


def _is_unicode(content: bytes) -> bool:
    """Return whether the header of a mesh file is valid UTF-8; a file without "end_header" is checked completely."""
    header = content.partition(b"end_header")[0]  # The content after the header may be binary.
    try:
        header.decode()
    except UnicodeDecodeError:
        return False
    return True


def _convert_header_to_ascii(content: bytes) -> bytes:
    """Replace the characters in a PLY header that are not ASCII."""
    header, end, body = content.partition(b"end_header")
    return header.decode("latin-1").encode("ascii", "replace") + end + body
