"""Scenes of meshes of the user, listed in a TOML file."""

from pathlib import Path

import msgspec

from ...core.checks import InputError, require_path
from ...data.data_files import read_toml
from ...data.table_records import Record
from ...geometry.scene import Scene, Surface
from .exported_scenes import SUFFIXES, read_exported_scene
from .mesh_reader import read_mesh


class _SurfaceEntry(Record, frozen=True):
    """One mesh file in a scene file. Without a name, the surface is named after the mesh file."""

    file: str
    inside: str
    outside: str
    name: str = ""


class _SceneFile(Record, frozen=True):
    """Content of a scene file."""

    surface: tuple[_SurfaceEntry, ...]
    ambient: str = "air"


def read_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file that lists meshes, or from a GLB or 3MF that `export_meshes` wrote.

    The TOML file has one table ``[[surface]]`` per mesh, with the entries file, inside, outside and, optionally, name.
    The optional entry ambient names the material around all surfaces, which is air by default.

    Parameters
    ----------
    path : str or Path
        File to read. Mesh files in a TOML file are relative to it, and in mm; a GLB is in metres.

    Returns
    -------
    Scene
        Scene with the names and materials of its surfaces.

    Raises
    ------
    InputError
        A file cannot be read, an entry is missing, unknown or of another type, or a surface or the scene is invalid.

    Warns
    -----
    MeshNotice
        Densities that varied within a surface are not in a GLB or 3MF.

    See Also
    --------
    export_meshes : Write the surfaces of a scene.
    read_mesh : Read a single mesh.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import pssf, trimesh
    >>> text = 'surface = [{file = "box.stl", inside = "water", outside = "air"}]'
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = trimesh.creation.box((10.0, 20.0, 30.0)).export(Path(folder) / "box.stl")
    ...     path = Path(folder) / "scene.toml"
    ...     _ = path.write_text(text)
    ...     scene = pssf.read_scene(path)
    >>> scene.surfaces[0].name, scene.surfaces[0].inside
    ('box', 'water')
    """
    path = require_path(path)
    if path.suffix.lower() in SUFFIXES:
        return read_exported_scene(path)
    try:
        described = msgspec.convert(read_toml(path), _SceneFile)
    except msgspec.ValidationError as error:
        raise InputError(
            f"file {path} must have tables [[surface]] with file, inside, outside, name, got {error}"
        ) from None
    return Scene([_read_surface(one, path.parent) for one in described.surface], described.ambient)


def _read_surface(entry: _SurfaceEntry, folder: Path) -> Surface:
    """Read the mesh of a surface from the folder of the scene file."""
    mesh, name = read_mesh(folder / entry.file), entry.name or Path(entry.file).stem
    return Surface(mesh, inside=entry.inside, outside=entry.outside, name=name)
