"""Read scenes from TOML files that list user meshes and their materials."""

from pathlib import Path

import msgspec

from ...core.checks import InputError, require_path
from ...data.data_files import read_toml
from ...data.table_records import Record
from ...geometry.scene import Scene, Surface
from .exported_scenes import SUFFIXES, read_exported_scene
from .mesh_reader import read_mesh


class _SurfaceEntry(Record, frozen=True):
    """Entry of one mesh in a scene file. The default name is the stem of the mesh file."""

    file: str
    inside: str
    outside: str
    name: str = ""


class _SceneFile(Record, frozen=True):
    """Content of a scene file."""

    surface: tuple[_SurfaceEntry, ...]
    ambient: str = "air"
    overlap: str = "warn"


def read_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file that lists meshes, or from a GLB or 3MF that `export_meshes` wrote.

    The TOML file has one table ``[[surface]]`` per mesh, with the entries file, inside, outside and, optionally, name.
    The optional entry ambient names the material around all surfaces; the default is air. The optional entry overlap is
    the rule for overlapping bodies, as in `Scene`.

    Parameters
    ----------
    path : str or Path
        File to read. Paths of mesh files are relative to the TOML file. Mesh coordinates are in mm; GLB coordinates are
        in metres.

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
        A material of the exported scene had a varying density, which a GLB or 3MF does not contain.

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
            f"file {path} must have tables [[surface]] with the entries file, inside, outside and name, got {error}"
        ) from None
    surfaces = [_read_surface(one, path.parent) for one in described.surface]
    return Scene(surfaces, described.ambient, overlap=described.overlap)


def _read_surface(entry: _SurfaceEntry, folder: Path) -> Surface:
    """Read the surface of an entry; the path of its mesh is relative to `folder`."""
    mesh, name = read_mesh(folder / entry.file), entry.name or Path(entry.file).stem
    return Surface(mesh, inside=entry.inside, outside=entry.outside, name=name)
