"""Labels of radiographs in the field's formats: landmarks as .pts and COCO keypoints, folders by grade."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.checks import InputError
from .atomic import write_bytes
from .records import write_json

Places = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class LabelledImage:
    """One picture and its landmarks.

    file       name within the folder of pictures
    rows, cols of pixels
    places     landmark -> (row, column)
    attributes name -> what else is known of it, such as its KL grade; None is left out
    """

    file: str
    rows: int
    cols: int
    places: Places
    attributes: Mapping[str, float | None]


def write_pts(path: Path, places: Places) -> Path:
    """Landmarks as a .pts file (the format of ISBI and BoneFinder annotations): x and y in pixels, row 0 at the top.

    raises  InputError for a disk that is full or cannot be written
    """
    lines = [f"{col:.4f} {row:.4f}" for row, col in places.values()]
    text = "\n".join(["version: 1", f"n_points: {len(lines)}", "{", *lines, "}"]) + "\n"
    write_bytes(path, text.encode())
    return path


def read_pts(path: Path, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Landmark -> (row, column) of a .pts file.

    names   of its landmarks, in order
    raises  InputError for a file that is none, or of another number of landmarks
    """
    try:
        lines = path.read_text(encoding="utf-8").split("{", 1)[1].split("}", 1)[0].split("\n")
        places = [tuple(map(float, line.split())) for line in lines if line.strip()]
    except (OSError, UnicodeDecodeError, IndexError, ValueError) as error:
        raise InputError(f"file {path}: no .pts file ({error}); allowed: landmarks as write_pts has them") from None
    if len(places) != len(names) or any(len(place) != 2 for place in places):
        raise InputError(f"file {path}: {len(places)} landmarks; allowed: {len(names)}, each with x and y")
    return {name: (row, col) for name, (col, row) in zip(names, places, strict=True)}


def write_coco(path: Path, images: Sequence[LabelledImage]) -> Path:
    """Landmarks of all pictures as COCO keypoints (Lin et al. 2014): one annotation a picture, all landmarks visible.

    raises  InputError for pictures of other landmarks, or a disk that is full or cannot be written
    """
    names = list(images[0].places) if images else []
    annotations = []
    for number, image in enumerate(images, start=1):
        if list(image.places) != names:
            raise InputError(f"image {image.file}: landmarks = {', '.join(image.places)}; allowed: {', '.join(names)}")
        points = [(col, row) for row, col in image.places.values()]
        left, top = (min(point[axis] for point in points) for axis in (0, 1))
        right, bottom = (max(point[axis] for point in points) for axis in (0, 1))
        annotations.append(_annotation(number, points, (left, top, right - left, bottom - top), image.attributes))
    write_json(path, {
        "info": {"description": "Knee radiographs simulated by pssf; landmarks are true by construction."},
        "images": [
            {"id": number, "file_name": image.file, "width": image.cols, "height": image.rows}
            for number, image in enumerate(images, start=1)
        ],
        "annotations": annotations,
        "categories": [
            {"id": 1, "name": "knee", "supercategory": "joint", "keypoints": names, "skeleton": _skeleton(names)}
        ],
    })  # fmt: skip
    return path


def _annotation(
    number: int,
    points: list[tuple[float, float]],
    box: tuple[float, float, float, float],
    attributes: Mapping[str, float | None],
) -> dict[str, Any]:
    """2 is COCO's word for a landmark that is labelled and visible."""
    flat = [value for x, y in points for value in (round(x, 4), round(y, 4), 2)]
    annotation: dict[str, Any] = {"id": number, "image_id": number, "category_id": 1, "iscrowd": 0}
    annotation |= {"keypoints": flat, "num_keypoints": len(points)}
    annotation |= {"bbox": [round(value, 4) for value in box], "area": round(box[2] * box[3], 4)}
    known = {name: round(value, 4) for name, value in attributes.items() if value is not None}
    return annotation | ({"attributes": known} if known else {})


def _skeleton(names: Sequence[str]) -> list[list[int]]:
    """Neighbours along each bone's contour, counted from 1."""
    return [[k, k + 1] for k in range(1, len(names)) if _femoral(names[k - 1]) == _femoral(names[k])]


def _femoral(name: str) -> bool:
    return "femur" in name or "notch" in name
