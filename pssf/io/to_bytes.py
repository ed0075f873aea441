"""Encoding of a radiograph, or of the meshes of a scene, as bytes in a file format."""

import io
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from ..geometry.scene import Scene
from ..model.radiograph import Radiograph
from .meshes.mesh_export import export_meshes
from .radiograph_files import save, save_parameters


def encode_radiograph(radiograph: Radiograph, kind: str) -> bytes:
    """Encode a radiograph as bytes in a file format.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph to encode.
    kind : str
        Suffix of the file: "tif", "dcm", "presentation.dcm" or "png" (see `save`), or "json" (see `save_parameters`).

    Returns
    -------
    bytes
        Content of the file.

    Raises
    ------
    InputError
        `save` or `save_parameters` raises an InputError.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"radiograph.{kind}"
        if kind == "json":
            save_parameters(radiograph, path)
        else:
            save(radiograph, path, intent="presentation" if kind == "presentation.dcm" else None)
        return path.read_bytes()


def encode_meshes(scene: Scene, kind: str, stem: str) -> tuple[str, bytes]:
    """Encode the meshes of a scene as bytes: one file, or a zip archive if the format requires several files.

    Parameters
    ----------
    scene : Scene
        Scene to encode.
    kind : str
        File format: "stl", "ply", "glb" or "3mf".
    stem : str
        File name without suffix.

    Returns
    -------
    name : str
        File name, including the suffix.
    content : bytes
        Content of the file.

    Raises
    ------
    InputError
        `export_meshes` raises an InputError.
    """
    with TemporaryDirectory() as folder:
        paths = export_meshes(scene, folder, formats=(kind,), stem=stem)
        if len(paths) == 1:
            return paths[0].name, paths[0].read_bytes()
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as package:
            for path in paths:
                package.write(path, path.name)
        return f"{stem}_{kind}.zip", buffer.getvalue()
