"""Features of the images of a folder, inside the masks that their names lead to."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..core.checks import InputError
from ..core.execution import Execution
from ..core.parallel import ordered_map
from ..io.image_kind import SUFFIXES, files_of, is_image
from .own_images import features, read_image, read_masks

# X_mask.png is the mask of X.png; so is masks/X.png, as a cohort has them.
MASK_END, MASK_FOLDER = "_mask", "masks"
WHOLE = "whole image"


@dataclass(frozen=True, kw_only=True)
class ImageJob:
    """An image to measure, and the file of its masks; None: the whole image."""

    image: Path
    masks: Path | None


def list_images(folder: Path) -> list[ImageJob]:
    """List the images of a folder with their masks.

    The mask of X.png is X_mask.png (of any suffix of an image) beside it, else a file X in the folder `masks` of the
    folder, or beside the folder, as `pssf cohort --masks` lays them. An image without one is measured whole.

    Raises
    ------
    InputError
        No image in the folder, a mask without an image, or two masks of one image.
    """
    images = [path for path in files_of(folder) if is_image(path)]
    masks = {path for path in images if path.stem.endswith(MASK_END)}
    below = {path for place in (folder, folder.parent) for path in files_of(place / MASK_FOLDER) if is_image(path)}
    jobs = []
    for image in (path for path in images if path not in masks):
        own = [path for path in sorted(masks) if path.stem == f"{image.stem}{MASK_END}"]
        own = own or [path for path in sorted(below) if path.stem == image.stem]
        if len(own) > 1:
            raise InputError(f"image {image} must have one mask, got {', '.join(map(str, own))}")
        jobs.append(ImageJob(image=image, masks=own[0] if own else None))
    alone = masks - {job.masks for job in jobs}
    if alone:
        raise InputError(f"mask {min(alone)} must have an image {min(alone).stem.removesuffix(MASK_END)}, got none")
    if not jobs:
        raise InputError(f"folder {folder} must hold images ({', '.join(SUFFIXES)}), got none")
    return jobs


def measure_folder(
    folder: Path,
    execution: Execution | None = None,
    *,
    pixel_mm: float | None = None,
    bins: int = 64,
    families: Collection[str],
    backend: str | None = None,
) -> pd.DataFrame:
    """Measure the images of a folder; see `list_images` and `features`.

    Returns
    -------
    DataFrame
        One row per image and mask: file, mask (its name, or "whole image"), pixel_mm, status ("measured", or why not)
        and the features.
    """
    jobs, execution = list_images(folder), execution or Execution()
    with execution.stage("features of images", "images", len(jobs)) as stage:
        measured = ordered_map(
            measure_image,
            jobs,
            shared={"pixel_mm": pixel_mm, "bins": bins, "families": tuple(families), "backend": backend},
            workers=execution.workers,
            arrived=lambda *_: stage.advance(),
        )
    return pd.DataFrame([row for rows in measured for row in rows])


def measure_image(
    job: ImageJob, pixel_mm: float | None, bins: int, families: tuple[str, ...], backend: str | None
) -> list[dict[str, Any]]:
    """Measure one image inside each of its masks; what is refused has its reason as status."""
    row: dict[str, Any] = {"file": job.image.as_posix(), "mask": WHOLE, "pixel_mm": np.nan}
    try:
        pixels, known_mm = read_image(job.image)
        masks = {WHOLE: None} if job.masks is None else dict(read_masks(job.masks))
    except InputError as error:
        return [row | {"status": str(error)}]
    pitch_mm = known_mm if pixel_mm is None else pixel_mm
    rows = []
    for name, mask in masks.items():
        row |= {"mask": name, "pixel_mm": np.nan if pitch_mm is None else pitch_mm}
        try:
            values = features(pixels, mask, pitch_mm, bins=bins, families=families, backend=backend)
            rows.append(row | {"status": "measured", **values})
        except InputError as error:
            rows.append(row | {"status": str(error)})
    return rows
