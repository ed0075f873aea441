"""read_mesh: one mesh from a file of any program: STL, PLY, OBJ or GLB."""

import io
from pathlib import Path
from typing import Any

import trimesh

from ..core.checks import InputError, one_line, require_path
from ..data.userfiles import read_bytes
from .exported_scenes import materials_of
from .mesh_faults import require_whole
from .stl import read_stl

_READ = "STL, PLY, OBJ or GLB"
# glTF has metres.
_MM_PER_M = 1000.0


def read_mesh(path: str | Path) -> trimesh.Trimesh:
    """A mesh file: STL, PLY or OBJ in millimetres, or GLB in metres; equal corners are welded, as STL needs it.

    returns  the mesh in millimetres

    raises  InputError for a file that is missing, cut off or not a mesh, or that holds a scene
    warns   MeshNotice for an OBJ that may be cut off
    """
    path = require_path(path)
    content = read_bytes(path, allowed=f"a mesh file: {_READ}")
    require_whole(content, path)
    if path.suffix.lower() == ".stl":
        mesh: Any = read_stl(content, path)
    else:
        mesh = _by_trimesh(content, path)
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"file {path}: holds no faces; allowed: {_READ} with a closed mesh")
    if path.suffix.lower() in (".glb", ".gltf"):
        mesh.apply_scale(_MM_PER_M)
    return mesh


def _by_trimesh(content: bytes, path: Path) -> Any:
    kind = path.suffix.lower()
    if kind == ".3mf" or (kind == ".glb" and materials_of(content) > 1):
        raise InputError(f"file {path} must hold one mesh, got {kind[1:].upper()}, a scene: pssf.read_scene reads one")
    try:
        if kind in (".obj", ".ply") and not _is_unicode(content):
            # Names and remarks of older programs; numbers are the same.
            text = content.decode("latin-1").encode() if kind == ".obj" else _plain_header(content)
            return trimesh.load_mesh(io.BytesIO(text), file_type=kind[1:], process=True)
        return trimesh.load_mesh(path, process=True)
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable mesh file") from None
    except ImportError:  # of what reads other kinds of file
        raise InputError(f"file {path} must be {_READ}, got {kind or 'no suffix'}") from None
    except Exception as error:  # mesh readers fail in many ways on a damaged file
        reason = one_line(f"{type(error).__name__}: {error}")[:200]
        raise InputError(f"file {path}: not a whole {kind[1:].upper()} ({reason}); allowed: {_READ}, whole") from None


def _is_unicode(content: bytes) -> bool:
    header = content.partition(b"end_header")[0]  # whatever follows may be binary
    try:
        header.decode()
    except UnicodeDecodeError:
        return False
    return True


def _plain_header(content: bytes) -> bytes:
    header, end, body = content.partition(b"end_header")
    return header.decode("latin-1").encode("ascii", "replace") + end + body
