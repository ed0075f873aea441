"""Write landmarks of a radiograph in the format of landmark programs."""

from collections.abc import Mapping
from pathlib import Path

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
