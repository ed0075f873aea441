"""Folders of real bones: one NPZ of meshes in correspondence, or mesh files by bone."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError
from ..geometry.mesh import Mesh
from .image_kind import files_of
from .mesh_reader import read_mesh

KINDS = ("femur", "tibia", "patella")
_SUFFIXES = (".stl", ".ply", ".obj")
_ALLOWED = "one .npz with femur_mm (bones, vertices, 3), femur_faces; or folders femur, tibia, patella of STL, PLY, OBJ"


def read_bones(path: str | Path) -> dict[str, tuple[Mesh, ...]]:
    """Bone -> its meshes, mm, in the axes of a right knee (x medial, y posterior, z proximal).

    path    of an .npz, of a folder with one, or of a folder with folders femur, tibia, patella of mesh files; files are
            taken in the order of their names
    raises  InputError for no bone, a folder of a bone without meshes, arrays that are none, or an unreadable file
    """
    path = Path(path)
    archives = (
        [path] if path.suffix.lower() == ".npz" else [file for file in files_of(path) if file.suffix.lower() == ".npz"]
    )
    if len(archives) > 1:
        raise InputError(f"folder {path}: npz files = {len(archives)}; allowed: {_ALLOWED}")
    bones = _from_archive(archives[0]) if archives else _from_folders(path)
    if not bones:
        raise InputError(f"folder {path}: bones = none; allowed: {_ALLOWED}")
    return bones


def _from_archive(path: Path) -> dict[str, tuple[Mesh, ...]]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            held = {name: arrays[name] for name in arrays.files}
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable .npz") from None
    except Exception as error:  # a damaged file can fail anywhere in its readers
        raise InputError(f"file {path}: no arrays ({type(error).__name__}); allowed: {_ALLOWED}") from None
    bones = {}
    for kind in KINDS:
        if f"{kind}_mm" in held:
            if f"{kind}_faces" not in held:
                raise InputError(f"file {path}: {kind}_faces = none; allowed: {_ALLOWED}")
            bones[kind] = _meshes(held[f"{kind}_mm"], held[f"{kind}_faces"], f"file {path}: {kind}")
    return bones


def _meshes(points: NDArray[np.generic], faces: NDArray[np.generic], what: str) -> tuple[Mesh, ...]:
    if points.ndim != 3 or points.shape[2] != 3 or 0 in points.shape or points.dtype.kind != "f":
        raise InputError(f"{what}_mm: shape = {points.shape}, {points.dtype}; allowed: (bones, vertices, 3), floats")
    if faces.ndim != 2 or faces.shape[1] != 3 or 0 in faces.shape or faces.dtype.kind not in "iu":
        raise InputError(f"{what}_faces: shape = {faces.shape}, {faces.dtype}; allowed: (faces, 3), whole numbers")
    numbers = faces.astype(np.int64)
    if numbers.min() < 0 or numbers.max() >= points.shape[1]:
        most = points.shape[1] - 1
        raise InputError(f"{what}_faces: vertices = {numbers.min()} to {numbers.max()}; allowed: 0 to {most}")
    vertices = points.astype(np.float64)
    if not np.isfinite(vertices).all():
        raise InputError(f"{what}_mm: {(~np.isfinite(vertices)).sum()} values = not finite; allowed: finite, mm")
    return tuple(Mesh(one, numbers) for one in vertices)


def _from_folders(path: Path) -> dict[str, tuple[Mesh, ...]]:
    bones = {}
    for kind in KINDS:
        folder = path / kind
        files = [file for file in files_of(folder) if file.suffix.lower() in _SUFFIXES]
        if folder.is_dir() and not files:
            raise InputError(f"folder {path}: {kind}: meshes = none; allowed: {_ALLOWED}")
        if files:
            meshes = [read_mesh(file) for file in files]
            bones[kind] = tuple(Mesh(np.asarray(m.vertices), np.asarray(m.faces)) for m in meshes)
    return bones
