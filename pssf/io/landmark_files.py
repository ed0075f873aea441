"""Read and write landmarks of a radiograph in the format of landmark programs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..core.checks import InputError
from .atomic_write import write_bytes


def write_pts(path: Path, landmarks_px: Mapping[str, tuple[float, float]]) -> Path:
    """Write landmarks in the format ``.pts`` of BoneFinder and other landmark programs.

    Parameters
    ----------
    path : Path
        Output file.
    landmarks_px : mapping of str to (row, column) tuple
        Landmarks, in pixels.

    Returns
    -------
    Path
        The file, with one line of column and row per landmark.
    """
    lines = [f"{col:.3f} {row:.3f}" for row, col in landmarks_px.values()]
    write_bytes(path, "\n".join(["version: 1", f"n_points: {len(lines)}", "{", *lines, "}", ""]).encode())
    return path


def read_pts(path: Path, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Read landmarks in the format ``.pts``.

    Parameters
    ----------
    path : Path
        File with one line of column and row per landmark, in pixels.
    names : sequence of str
        Names of the landmarks, in the order of the lines.

    Returns
    -------
    dict of str to (row, column) tuple
        Landmarks, in pixels.

    Raises
    ------
    InputError
        The file cannot be read, or has another number of landmarks or a value that is no finite number.
    """
    try:
        _, _, block = path.read_text(encoding="utf-8").partition("{")
        places = np.array([line.split() for line in block.partition("}")[0].strip().splitlines()], float)
    except (OSError, ValueError) as error:
        raise InputError(f"file {path} must have lines of column and row, got {error}") from None
    if places.shape != (len(names), 2) or not np.isfinite(places).all():
        raise InputError(
            f"file {path} must have {len(names)} lines of column and row, got an array of shape {places.shape}"
        )
    return {name: (float(row), float(col)) for name, (col, row) in zip(names, places, strict=True)}
