"""Read bone meshes of patients from an NPZ with vertex correspondence, or from one folder of mesh files per bone."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...core.checks import InputError
from ...geometry.mesh import Mesh
from ..image_kind import list_files
from .mesh_reader import read_mesh

KINDS = ("femur", "tibia", "patella")
_SUFFIXES = (".stl", ".ply", ".obj")
_ALLOWED = "one .npz with femur_mm (bones, vertices, 3), femur_faces; or folders femur, tibia, patella of STL, PLY, OBJ"


def read_bones(path: str | Path) -> dict[str, tuple[Mesh, ...]]:
    """Read bone meshes from an NPZ or from folders of mesh files.

    Parameters
    ----------
    path : str or Path
        An .npz with arrays such as femur_mm (bones, vertices, 3) and femur_faces (faces, 3); a folder with one .npz; or
        a folder with subfolders femur, tibia and patella of STL, PLY or OBJ files. The files are read in alphabetical
        order.

    Returns
    -------
    dict of str to tuple of Mesh
        Meshes of every bone, keyed by "femur", "tibia" and "patella". Vertices are in mm in the axes of a right knee: x
        medial, y posterior, z proximal.

    Raises
    ------
    InputError
        The path contains no bones, or the folder of a bone contains no meshes. An array is invalid, or a file cannot be
        read.
    """
    path = Path(path)
    archives = (
        [path]
        if path.suffix.lower() == ".npz"
        else [file for file in list_files(path) if file.suffix.lower() == ".npz"]
    )
    if len(archives) > 1:
        raise InputError(f"folder {path} must contain {_ALLOWED}, got {len(archives)} npz files")
    bones = _read_archive(archives[0]) if archives else _read_mesh_folders(path)
    if not bones:
        raise InputError(f"folder {path} must contain {_ALLOWED}, got no bones")
    return bones


def _read_archive(path: Path) -> dict[str, tuple[Mesh, ...]]:
    """Read the bones of an NPZ file."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            held = {name: arrays[name] for name in arrays.files}
    except OSError as error:
        raise InputError(f"file {path} must be a readable .npz, got {error.strerror or error}") from None
    except Exception as error:  # numpy and zipfile raise many kinds of errors for a damaged file.
        raise InputError(f"file {path} must be {_ALLOWED}, got no arrays ({type(error).__name__})") from None
    bones = {}
    for kind in KINDS:
        if f"{kind}_mm" in held:
            if f"{kind}_faces" not in held:
                raise InputError(f"file {path} must contain {kind}_mm and {kind}_faces, got only {kind}_mm")
            bones[kind] = _build_meshes(held[f"{kind}_mm"], held[f"{kind}_faces"], f"file {path}: {kind}")
    return bones


def _build_meshes(points: NDArray[np.generic], faces: NDArray[np.generic], label: str) -> tuple[Mesh, ...]:
    """Check vertices (bones, vertices, 3), in mm, and faces (faces, 3), and build one mesh per bone."""
    if points.ndim != 3 or points.shape[2] != 3 or 0 in points.shape or points.dtype.kind != "f":
        raise InputError(f"{label}_mm must be (bones, vertices, 3) floats, got {points.shape}, {points.dtype}")
    if faces.ndim != 2 or faces.shape[1] != 3 or 0 in faces.shape or faces.dtype.kind not in "iu":
        raise InputError(f"{label}_faces must be (faces, 3) integers, got {faces.shape}, {faces.dtype}")
    numbers = faces.astype(np.int64)
    if numbers.min() < 0 or numbers.max() >= points.shape[1]:
        most = points.shape[1] - 1
        raise InputError(
            f"{label}_faces must be vertex indices from 0 to {most}, got {numbers.min()} to {numbers.max()}"
        )
    vertices = points.astype(np.float64)
    if not np.isfinite(vertices).all():
        raise InputError(f"{label}_mm must be finite, got {(~np.isfinite(vertices)).sum()} non-finite values")
    return tuple(Mesh(one, numbers) for one in vertices)


def _read_mesh_folders(path: Path) -> dict[str, tuple[Mesh, ...]]:
    """Read the mesh files in the subfolder of every bone."""
    bones = {}
    for kind in KINDS:
        folder = path / kind
        files = [file for file in list_files(folder) if file.suffix.lower() in _SUFFIXES]
        if folder.is_dir() and not files:
            raise InputError(f"folder {folder} contains no STL, PLY or OBJ files: add meshes or remove the folder")
        if files:
            meshes = [read_mesh(file) for file in files]
            bones[kind] = tuple(Mesh(np.asarray(m.vertices), np.asarray(m.faces)) for m in meshes)
    return bones
