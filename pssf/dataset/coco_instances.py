"""Instances of an image in the form of COCO (Lin et al. 2014): masks as run lengths, boxes and keypoints."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .label_map import find_mask_class
from .sample import Sample

# COCO visibility flags: a landmark inside and outside the image.
_VISIBLE, _NOT_LABELLED = 2, 0
# Category number of the knee; the kinds of the label map have lower numbers.
_KNEE_CATEGORY = 100


def list_instances(sample: Sample, kinds: Mapping[str, int]) -> list[dict[str, Any]]:
    """List the masks of an image as COCO annotations without numbers.

    Parameters
    ----------
    sample : Sample
        Image with its masks.
    kinds : mapping of str to int
        Category number of each kind of part.

    Returns
    -------
    list of dict
        Annotations; empty masks are omitted.
    """
    made = []
    for name, mask in sample.masks.items():
        if mask.any():
            category = kinds[find_mask_class(name, kinds)]
            made.append({"category_id": category, "name": name, **_describe_mask(mask), "num_keypoints": 0})
    if made:
        # The knee consists of all masks.
        whole = np.logical_or.reduce(list(sample.masks.values()))
        made.append({"category_id": _KNEE_CATEGORY, "name": "knee", **_describe_mask(whole)})
    return made


def encode_run_lengths(mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Encode a mask as uncompressed run lengths, which pycocotools reads with ``frPyObjects``.

    Parameters
    ----------
    mask : (rows, cols) bool array
        Mask.

    Returns
    -------
    dict of str to list of int
        ``size``, and ``counts``: lengths of alternating runs of 0 and 1, column by column, starting with 0.
    """
    flat = np.concatenate(([False], mask.ravel(order="F"), [False]))
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate(([0], edges, [mask.size]))).tolist()
    return {"size": list(mask.shape), "counts": counts if counts[-1] else counts[:-1]}


def decode_run_lengths(coded: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Decode uncompressed run lengths.

    Parameters
    ----------
    coded : mapping of str to list of int
        Result of `encode_run_lengths`.

    Returns
    -------
    (rows, cols) bool array
        Mask.
    """
    values = np.repeat(np.arange(len(coded["counts"])) % 2 == 1, coded["counts"])
    return values.reshape(coded["size"], order="F")


def make_categories(kinds: Mapping[str, int], keypoints: Sequence[str]) -> list[dict[str, Any]]:
    """Make the categories of a COCO file: the kinds of parts, and the knee with its keypoints.

    Parameters
    ----------
    kinds : mapping of str to int
        Category number of each kind of part; 0 (background) is omitted.
    keypoints : sequence of str
        Names of all landmarks in the data set.

    Returns
    -------
    list of dict
        Categories.
    """
    parts = [{"id": value, "name": kind, "supercategory": "knee"} for kind, value in kinds.items() if value]
    knee = {"id": _KNEE_CATEGORY, "name": "knee", "supercategory": "joint", "keypoints": list(keypoints)}
    return [*parts, knee | {"skeleton": []}]


def make_annotations(entry: Mapping[str, Any], keypoints: Sequence[str], image_id: int, first: int) -> Iterator[Any]:
    """Yield the COCO annotations of one image: its knee with keypoints, and its instances.

    Parameters
    ----------
    entry : mapping of str to object
        Labels of the image: ``rows``, ``cols``, ``landmarks_px``, ``kl`` and ``instances``.
    keypoints : sequence of str
        Names of all landmarks in the data set.
    image_id : int
        Number of the image.
    first : int
        Number of the first annotation.

    Yields
    ------
    dict
        Annotation. A landmark outside the image, or of another view, has coordinates (0, 0) and visibility 0.
    """
    flat = list[float]()
    for name in keypoints:
        place = entry["landmarks_px"].get(name)
        visible = place is not None and _is_imaged(entry, place)
        flat += [round(place[1], 4), round(place[0], 4), _VISIBLE] if visible else [0, 0, _NOT_LABELLED]
    count = sum(flag == _VISIBLE for flag in flat[2::3])
    for number, instance in enumerate(entry["instances"], start=first):
        of_knee = {"keypoints": flat, "num_keypoints": count, "attributes": {"kl": entry["kl"]}}
        extra = of_knee if instance["category_id"] == _KNEE_CATEGORY else {}
        yield {"id": number, "image_id": image_id, **instance, **extra}


def _describe_mask(mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Describe a mask with pixels by box, area and run lengths."""
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    box = [int(cols[0]), int(rows[0]), int(cols[-1] - cols[0] + 1), int(rows[-1] - rows[0] + 1)]
    return {"bbox": box, "area": int(mask.sum()), "iscrowd": 0, "segmentation": encode_run_lengths(mask)}


def _is_imaged(entry: Mapping[str, Any], place: Sequence[float]) -> bool:
    """Return whether a place is inside the image, and inside the whole image before the affine transform and the crop.

    Pixels outside the whole image repeat its edge, so a landmark there is not visible.
    """
    at, size = np.array(place), np.array([entry["rows"], entry["cols"]])
    inside = _is_within(at, size)
    if "affine" in entry:
        at = np.linalg.solve(np.array(entry["affine"]["matrix"]), at - np.array(entry["affine"]["offset_px"]))
    if "crop" in entry:
        at = at + np.array([entry["crop"]["top_px"], entry["crop"]["left_px"]])
        size = np.array([entry["crop"]["whole_rows"], entry["crop"]["whole_cols"]])
    return inside and _is_within(at, size)


def _is_within(at: NDArray[np.float64], size: NDArray[np.int64]) -> bool:
    """Return whether a place (row, column) is within an image of a size, in pixels."""
    return bool(((at >= -0.5) & (at <= size - 0.5)).all())
