"""Landmarks in standard formats: writing of .pts files and COCO keypoints, and reading of .pts files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from .atomic_write import write_bytes
from .cohort_records import write_json

Landmarks = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class LabelledImage:
    """Image file with landmarks and additional labels.

    Attributes
    ----------
    file : str
        Path of the image file, relative to the image folder.
    rows : int
        Height of the image, in pixels.
    cols : int
        Width of the image, in pixels.
    landmarks_px : dict of str to (row, column) tuple
        Landmark positions in pixels, keyed by landmark name.
    attributes : dict of str to float or None
        Additional labels, such as the KL grade, keyed by name. Labels with the value None are not written.
    """

    file: str
    rows: int
    cols: int
    landmarks_px: Landmarks
    attributes: Mapping[str, float | None]


def write_pts(path: Path, landmarks_px: Landmarks) -> Path:
    """Write landmarks to a .pts file, which is the format of the ISBI and BoneFinder annotations.

    Each line contains the coordinates x and y of one landmark in pixels. Row 0 is at the top of the image.

    Parameters
    ----------
    path : Path
        File to write.
    landmarks_px : dict of str to (row, column) tuple
        Landmark positions in pixels, keyed by landmark name. The landmarks are written in the order of the dict.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    lines = [f"{col:.4f} {row:.4f}" for row, col in landmarks_px.values()]
    text = "\n".join(["version: 1", f"n_points: {len(lines)}", "{", *lines, "}"]) + "\n"
    write_bytes(path, text.encode())
    return path


def read_pts(path: Path, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Read landmarks from a .pts file.

    Parameters
    ----------
    path : Path
        File to read.
    names : sequence of str
        Landmark names, in the order of the landmarks in the file.

    Returns
    -------
    dict of str to (row, column) tuple
        Landmark positions in pixels, keyed by landmark name.

    Raises
    ------
    InputError
        The file cannot be read or is not a .pts file, or the number of landmarks differs from the number of names.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("{", 1)[1].split("}", 1)[0].split("\n")
        places = [tuple(map(float, line.split())) for line in lines if line.strip()]
    except (OSError, UnicodeDecodeError, IndexError, ValueError) as error:
        raise InputError(f"file {path} must be a .pts file of landmarks, got other content ({error})") from None
    if len(places) != len(names) or any(len(place) != 2 for place in places):
        raise InputError(f"file {path}: number of landmarks must be {len(names)}, each with x and y, got {len(places)}")
    return {name: (row, col) for name, (col, row) in zip(names, places, strict=True)}


def write_coco(path: Path, images: Sequence[LabelledImage]) -> Path:
    """Write the landmarks of several images as COCO keypoints (Lin et al. 2014).

    Each image has one annotation, in which all landmarks are marked as visible.

    Parameters
    ----------
    path : Path
        JSON file to write.
    images : sequence of LabelledImage
        Images whose landmarks have the same names in the same order.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        The landmark names of an image differ from those of the first image, the disk is full, or the file cannot be
        written.
    """
    names = list(images[0].landmarks_px) if images else []
    annotations = []
    for number, image in enumerate(images, start=1):
        if list(image.landmarks_px) != names:
            raise InputError(
                f"image {image.file}: landmarks must be {', '.join(names)}, got {', '.join(image.landmarks_px)}"
            )
        points = [(col, row) for row, col in image.landmarks_px.values()]
        left, top = (min(point[axis] for point in points) for axis in (0, 1))
        right, bottom = (max(point[axis] for point in points) for axis in (0, 1))
        annotations.append(_make_annotation(number, points, (left, top, right - left, bottom - top), image.attributes))
    write_json(path, {
        "info": {"description": "Knee radiographs simulated by pssf; landmarks are true by construction."},
        "images": [
            {"id": number, "file_name": image.file, "width": image.cols, "height": image.rows}
            for number, image in enumerate(images, start=1)
        ],
        "annotations": annotations,
        "categories": [
            {"id": 1, "name": "knee", "supercategory": "joint", "keypoints": names, "skeleton": _make_skeleton(names)}
        ],
    })  # fmt: skip
    return path


def _make_annotation(
    number: int,
    points: list[tuple[float, float]],
    box: tuple[float, float, float, float],
    attributes: Mapping[str, float | None],
) -> dict[str, Any]:
    """Create the COCO annotation of one image.

    `points` are the landmark positions (x, y) in pixels. `box` contains left, top, width and height in pixels. The COCO
    visibility flag 2 marks a landmark as labelled and visible.
    """
    flat = [value for x, y in points for value in (round(x, 4), round(y, 4), 2)]
    annotation: dict[str, Any] = {"id": number, "image_id": number, "category_id": 1, "iscrowd": 0}
    annotation |= {"keypoints": flat, "num_keypoints": len(points)}
    annotation |= {"bbox": [round(value, 4) for value in box], "area": round(box[2] * box[3], 4)}
    known = {name: round(value, 4) for name, value in attributes.items() if value is not None}
    return annotation | ({"attributes": known} if known else {})


def _make_skeleton(names: Sequence[str]) -> list[list[int]]:
    """List the pairs of adjacent landmarks along each bone contour, with COCO landmark numbers, which start at 1."""
    return [[k, k + 1] for k in range(1, len(names)) if _is_femoral(names[k - 1]) == _is_femoral(names[k])]


def _is_femoral(name: str) -> bool:
    """Report whether a landmark is on the femur."""
    return "femur" in name or "notch" in name
