"""Scenes of one's own meshes from a TOML file that names them."""

from pathlib import Path

import msgspec

from ..core.checks import InputError, require_path
from ..data.records import Record
from ..data.tables import read_toml
from ..geometry.scene import Scene, Surface
from .exported_scenes import SUFFIXES, read_exported
from .mesh_reader import read_mesh


class _SurfaceEntry(Record, frozen=True):
    """One mesh file; its name is the file's where none is given."""

    file: str
    inside: str
    outside: str
    name: str = ""


class _SceneFile(Record, frozen=True):
    """What a scene file holds."""

    surface: tuple[_SurfaceEntry, ...]
    ambient: str = "air"


def read_scene(path: str | Path) -> Scene:
    """A scene of mesh files: a TOML file with a table [[surface]] each, of file, inside, outside and, if need be, name.

    Files are called from where the TOML file lies, and are in millimetres; `ambient` names what is around all: air, if
    it is not given. A GLB or 3MF that `export_meshes` wrote is read with the names and materials of its surfaces.
    raises  InputError for a file that cannot be read, an entry that is missing, unknown or of another type, a surface
            or scene that cannot be
    warns   MeshNotice where densities that varied within a surface are not in a GLB or 3MF
    """
    path = require_path(path)
    if path.suffix.lower() in SUFFIXES:
        return read_exported(path)
    try:
        described = msgspec.convert(read_toml(path), _SceneFile)
    except msgspec.ValidationError as error:
        raise InputError(f"file {path}: {error}; allowed: [[surface]] with file, inside, outside, name") from None
    return Scene([_surface(one, path.parent) for one in described.surface], described.ambient)


def _surface(entry: _SurfaceEntry, folder: Path) -> Surface:
    mesh, name = read_mesh(folder / entry.file), entry.name or Path(entry.file).stem
    return Surface(mesh, inside=entry.inside, outside=entry.outside, name=name)
