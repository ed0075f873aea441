"""Write the readings of radiographs: JSON, landmark files and pictures."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .atomic_write import write_bytes


def write_landmark_json(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write a list of objects with one entry per knee.

    Parameters
    ----------
    path : Path
        JSON file.
    rows : sequence of mapping of str to object
        Entries.

    Returns
    -------
    Path
        The file.
    """
    write_bytes(path, msgspec.json.format(msgspec.json.encode(list(rows)), indent=1) + b"\n")
    return path


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


def write_overlay(path: Path, colours: NDArray[np.uint8]) -> Path:
    """Write a picture as PNG.

    Parameters
    ----------
    path : Path
        PNG file.
    colours : (rows, cols, 3) uint8 array
        Picture.

    Returns
    -------
    Path
        The file.
    """
    buffer = io.BytesIO()
    Image.fromarray(colours).save(buffer, "PNG")
    write_bytes(path, buffer.getvalue())
    return path
