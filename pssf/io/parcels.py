"""Files as bytes, for who cannot take a path: a radiograph, the meshes of a scene."""

import io
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from ..geometry.scene import Scene
from ..model.radiograph import Radiograph
from .images import save, save_parameters
from .meshes import export_meshes


def radiograph_bytes(radiograph: Radiograph, kind: str) -> bytes:
    """What `save` writes as tif, dcm, presentation.dcm or png, or `save_parameters` as json.

    raises  InputError as `save`
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"radiograph.{kind}"
        if kind == "json":
            save_parameters(radiograph, path)
        else:
            save(radiograph, path, intent="presentation" if kind == "presentation.dcm" else None)
        return path.read_bytes()


def mesh_bytes(scene: Scene, kind: str, stem: str) -> tuple[str, bytes]:
    """What `export_meshes` writes of one format: the name and bytes of its file, or of a zip of its files.

    raises  InputError as `export_meshes`
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
