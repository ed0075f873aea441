"""Images of a data set, prepared for the training of the reader."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..core.label_names import CONTOUR_LANDMARKS
from ..core.processes.parallel_map import map_in_parallel
from ..dataset.coco_instances import decode_run_lengths
from ..io.dataset_files import read_pixels, read_sample_labels
from ..io.dataset_index_files import read_index_table
from ..reader.knee_frame import PLATEAU_EDGES, fit_frame, make_whole_frame

# Masks that the reader finds. Osteophytes belong to the mask of their bone.
BONES = ("femur", "tibia", "fibula", "patella")
# Side of a stored crop in pixels, its side in plateau widths, and the width of its plateau in pixels.
STORED_PX = 448
STORED_SPAN = 2.3
STORED_PLATEAU_PX = STORED_PX / STORED_SPAN
# Longer side of a stored whole image, in pixels.
WHOLE_PX = 384


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingImages:
    """Images with landmarks and masks; left knees are mirrored.

    Attributes
    ----------
    crops : (n, STORED_PX, STORED_PX) uint8 array
        Grey values in the frame of the knee.
    coded_masks : (n, STORED_PX, STORED_PX) uint8 array
        Bit k is the mask of ``BONES[k]``; bit 7 is set inside the image.
    landmarks_px : (n, 16, 2) float32 array
        Row and column of each landmark in the crop, in pixels.
    plateau_mm : (n,) float32 array
        Width of the plateau on the detector, in mm.
    whole : (n, WHOLE_PX, WHOLE_PX) uint8 array
        Whole images, padded with 0.
    whole_edges_px : (n, 2, 2) float32 array
        Row and column of the lateral and medial plateau edge in the whole image, in pixels.
    """

    crops: NDArray[np.uint8]
    coded_masks: NDArray[np.uint8]
    landmarks_px: NDArray[np.float32]
    plateau_mm: NDArray[np.float32]
    whole: NDArray[np.uint8]
    whole_edges_px: NDArray[np.float32]


def read_training_images(folder: Path, split: str, workers: int = 1) -> TrainingImages:
    """Read one subset of a data set and cut a crop in the frame of each knee.

    Parameters
    ----------
    folder : Path
        Folder of a complete data set with images for display.
    split : {"train", "validation", "test"}
        Subset.
    workers : int, default 1
        Number of processes.

    Returns
    -------
    TrainingImages
        Images, landmarks and masks.

    Raises
    ------
    InputError
        The folder contains no complete data set, or the subset is empty.
    """
    names = _list_names(folder, split)
    return collect_training_images(
        map_in_parallel(_read_prepared, names, shared={"folder": folder, "split": split}, workers=workers)
    )


def read_displays(folder: Path, split: str) -> Iterator[NDArray[np.uint8]]:
    """Read the images for display of one subset of a data set.

    Parameters
    ----------
    folder : Path
        Folder of a complete data set with images for display.
    split : {"train", "validation", "test"}
        Subset.

    Yields
    ------
    (rows, cols) uint8 array
        Image.

    Raises
    ------
    InputError
        The folder contains no complete data set, or the subset is empty.
    """
    for name in _list_names(folder, split):
        yield read_pixels(folder, split, "display", name)


def _list_names(folder: Path, split: str) -> list[str]:
    """List the names of the images of one subset."""
    _, rows = read_index_table(folder / "index.csv", split, ("name",))
    if not rows:
        raise InputError(f"split must be a subset with images, got {split!r} of {folder} without images")
    return [name for (name,) in rows]


def collect_training_images(prepared: list[dict[str, Any]]) -> TrainingImages:
    """Join prepared images to arrays.

    Parameters
    ----------
    prepared : list of dict
        Results of `prepare_image`.

    Returns
    -------
    TrainingImages
        Images of all entries.
    """
    return TrainingImages(**{name: np.array([entry[name] for entry in prepared]) for name in prepared[0]})


def _read_prepared(name: str, folder: Path, split: str) -> dict[str, Any]:
    """Read and prepare one image."""
    pixels, labels = read_pixels(folder, split, "display", name), read_sample_labels(folder, split, name)
    landmarks = np.array([labels["landmarks_px"][name] for name in CONTOUR_LANDMARKS])
    return prepare_image(pixels, landmarks, _code_masks(labels, pixels.shape), labels["side"], labels["pixel_mm"])


def prepare_image(
    pixels: NDArray[np.uint8], landmarks_px: Array, masks: NDArray[np.uint8], side: str, pixel_mm: float
) -> dict[str, Any]:
    """Cut the crop of one image and reduce the whole image.

    Parameters
    ----------
    pixels : (rows, cols) uint8 array
        Grey values.
    landmarks_px : (16, 2) array
        Row and column of each landmark, in pixels.
    masks : (rows, cols) uint8 array
        Bit k is the mask of ``BONES[k]``.
    side : {"right", "left"}
        Side of the knee.
    pixel_mm : float
        Pixel size, in mm.

    Returns
    -------
    dict of str to array
        Attributes of `TrainingImages` for this image.
    """
    edges = landmarks_px[PLATEAU_EDGES]
    frame = fit_frame(edges, side)
    grey, inside = frame.cut_crop(pixels.astype(np.float32), STORED_PLATEAU_PX, STORED_PX)
    points = np.moveaxis(np.indices((STORED_PX, STORED_PX), float), 0, -1)
    nearest = frame.map_to_image(points, STORED_PLATEAU_PX, STORED_PX)
    rows, cols = np.moveaxis(np.rint(nearest).astype(int), -1, 0)
    coded = np.where(inside, masks[rows.clip(0, len(masks) - 1), cols.clip(0, masks.shape[1] - 1)] | (1 << 7), 0)
    whole, whole_edges = _reduce(pixels, edges, side)
    return {
        "crops": np.clip(np.rint(grey), 0, 255).astype(np.uint8),
        "coded_masks": coded.astype(np.uint8),
        "landmarks_px": frame.map_to_crop(landmarks_px, STORED_PLATEAU_PX, STORED_PX).astype(np.float32),
        "plateau_mm": np.float32(frame.width_px * pixel_mm),
        "whole": whole,
        "whole_edges_px": whole_edges.astype(np.float32),
    }


def _code_masks(labels: dict[str, Any], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the masks of all bones, with their osteophytes, as bits."""
    coded = np.zeros(shape, np.uint8)
    for instance in labels["instances"]:
        parts = instance["name"].split("_")
        bone = parts[1] if parts[-1] == "osteophyte" else instance["name"]
        if bone in BONES:
            mask = np.asarray(decode_run_lengths(instance["segmentation"]), bool)
            coded |= mask.astype(np.uint8) << BONES.index(bone)
    return coded


def _reduce(pixels: NDArray[np.uint8], edges: Array, side: str) -> tuple[NDArray[np.uint8], Array]:
    """Reduce a whole image and mirror a left knee; return it with its plateau edges."""
    frame = make_whole_frame(pixels.shape, WHOLE_PX, side)
    grey, _ = frame.cut_crop(pixels.astype(np.float32), 1.0, WHOLE_PX)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), frame.map_to_crop(edges, 1.0, WHOLE_PX)
