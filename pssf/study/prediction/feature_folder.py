"""Feature measurement for all images in a folder; mask files are identified by their file names."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...core.checks import InputError
from ...core.processes.execution import Execution
from ...core.processes.parallel_map import map_in_parallel
from ...io.image_kind import SUFFIXES, is_image, list_files
from .own_images import features, read_image, read_masks

# Ending of a mask file name before the suffix: X_mask.png is the mask of X.png.
MASK_END = "_mask"
# Subfolder that contains the masks of a cohort: masks/X.png is the mask of X.png.
MASK_FOLDER = "masks"
# Entry of the column `mask` for an image without a mask.
WHOLE_IMAGE = "whole image"


@dataclass(frozen=True, kw_only=True)
class ImageJob:
    """An image to measure and its mask file.

    Parameters
    ----------
    image : Path
        Image file.
    masks : Path or None
        File with the masks of the image; None measures the whole image.
    """

    image: Path
    masks: Path | None


def list_images(folder: Path) -> list[ImageJob]:
    """List the images of a folder with their mask files.

    The mask of X.png is X_mask.png in the same folder, with the suffix of any image format. If that file is missing,
    the mask is the file X in a folder ``masks`` inside or next to `folder`, where `pssf cohort --masks` writes masks.
    If an image has no mask, the whole image is measured.

    Parameters
    ----------
    folder : Path
        Folder that contains the images.

    Returns
    -------
    list of ImageJob
        Images and their mask files, sorted by name.

    Raises
    ------
    InputError
        The folder has no image, a mask has no image, or an image has two masks.
    """
    images = [path for path in list_files(folder) if is_image(path)]
    masks = {path for path in images if path.stem.endswith(MASK_END)}
    below = {path for place in (folder, folder.parent) for path in list_files(place / MASK_FOLDER) if is_image(path)}
    jobs = []
    for image in (path for path in images if path not in masks):
        own = [path for path in sorted(masks) if path.stem == f"{image.stem}{MASK_END}"]
        own = own or [path for path in sorted(below) if path.stem == image.stem]
        if len(own) > 1:
            raise InputError(f"image {image} has several mask files, {', '.join(map(str, own))}: keep one")
        jobs.append(ImageJob(image=image, masks=own[0] if own else None))
    alone = masks - {job.masks for job in jobs}
    if alone:
        raise InputError(
            f"mask {min(alone)} has no image: add an image named {min(alone).stem.removesuffix(MASK_END)} or remove "
            "the mask"
        )
    if not jobs:
        raise InputError(f"folder {folder} contains no image: add files of the types {', '.join(SUFFIXES)}")
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
    """Measure the features of all images of a folder; see `list_images` and `features`.

    Parameters
    ----------
    folder : Path
        Folder that contains the images.
    execution : Execution, optional
        Workers, timer and progress bar.
    pixel_mm : float, optional
        Pixel pitch of all images, in mm; None uses the pitch stored in each file.
    bins : int, default 64
        Number of grey-level bins of the texture features.
    families : collection of str
        Feature families to measure.
    backend : str, optional
        Radiomics backend; None uses the first installed backend.

    Returns
    -------
    DataFrame
        One row per image and mask: file, mask (its name, or "whole image"), pixel_mm, status ("measured", or the error
        message) and the features.

    Raises
    ------
    InputError
        The folder has no image, or masks and images do not match; see `list_images`.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    jobs, execution = list_images(folder), execution or Execution()
    with execution.stage("image features", "images", len(jobs)) as stage:
        measured = map_in_parallel(
            measure_image,
            jobs,
            shared={"pixel_mm": pixel_mm, "bins": bins, "families": tuple(families), "backend": backend},
            workers=execution.workers,
            on_result=lambda *_: stage.advance(),
        )
    return pd.DataFrame([row for rows in measured for row in rows])


def measure_image(
    job: ImageJob, pixel_mm: float | None, bins: int, families: tuple[str, ...], backend: str | None
) -> list[dict[str, Any]]:
    """Measure the features of one image inside each of its masks.

    Parameters
    ----------
    job : ImageJob
        Image and mask file.
    pixel_mm : float or None
        Pixel pitch, in mm; None uses the pitch stored in the file.
    bins : int
        Number of grey-level bins of the texture features.
    families : tuple of str
        Feature families to measure.
    backend : str or None
        Radiomics backend; None uses the first installed backend.

    Returns
    -------
    list of dict
        One row per mask: file, mask, pixel_mm, status and features. If the image or a mask cannot be measured, the
        status is the error message.
    """
    row: dict[str, Any] = {"file": job.image.as_posix(), "mask": WHOLE_IMAGE, "pixel_mm": np.nan}
    try:
        pixels, known_mm = read_image(job.image)
        masks = {WHOLE_IMAGE: None} if job.masks is None else dict(read_masks(job.masks))
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
