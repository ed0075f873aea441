"""Agreement of the segmented bone with the true bone masks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.processes.parallel_map import map_in_parallel
from ..data.code_hash import compute_code_hashes, require_same_code
from ..radiomics.features.bone_mask import segment_bone
from ..radiomics.features.mask_overlap import compute_mask_overlap
from ..radiomics.localisation.region_of_interest import cut_region
from .learn.each_split import CODE_PACKAGES
from .study_data import StudyContext

LoadMasks = Callable[[str], Mapping[str, NDArray[np.bool_]]]
COLUMNS = ["grade", "radiographs", "dice", "dice_p5", "mean_mm", "p95_mm", "area"]


@dataclass(frozen=True, kw_only=True)
class SegmentationJob:
    """Radiograph and true masks for measuring the overlap of segmented and true bone.

    Parameters
    ----------
    file : str
        Path of the radiograph, passed to the pixel loader.
    masks : str
        Path of the masks, passed to the mask loader.
    row : float
        Row of the centre of the region, in px.
    col : float
        Column of the centre of the region, in px.
    pixel_mm : float
        Pixel pitch at the detector, in mm.
    joint_plane_pixel_mm : float
        Pixel pitch at the joint plane, in mm.
    """

    file: str
    masks: str
    row: float
    col: float
    pixel_mm: float
    joint_plane_pixel_mm: float


def evaluate_segmentation(repeated: pd.DataFrame, retest: pd.DataFrame | None, run: StudyContext) -> pd.DataFrame:
    """Compare the segmented bone with the projected bone masks, per grade and for all radiographs.

    Parameters
    ----------
    repeated : DataFrame
        Repeat radiographs with a located region: radiograph, grade, row_px, col_px, pixel_mm, sdd_mm, sod_mm.
    retest : DataFrame or None
        Manifest of the repeat radiographs, with the paths of mask files in the column ``masks``.
    run : StudyContext
        Loaders, settings and execution.

    Returns
    -------
    DataFrame
        Columns `COLUMNS`: grade, radiographs, means of the overlap measures, and the 5th percentile of Dice. Without
        mask files, the table is empty.

    Raises
    ------
    InputError
        A worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    if run.load_masks is None or retest is None or "masks" not in retest or repeated.empty:
        return pd.DataFrame(columns=COLUMNS)
    rows = repeated.merge(retest[["radiograph", "masks"]], on="radiograph", how="inner").to_dict("records")
    jobs = [
        SegmentationJob(
            file=row["file"],
            masks=row["masks"],
            row=row["row_px"],
            col=row["col_px"],
            pixel_mm=row["pixel_mm"],
            joint_plane_pixel_mm=row["pixel_mm"] * row["sod_mm"] / row["sdd_mm"],
        )
        for row in rows
    ]
    shared = {"load_pixels": run.load_pixels, "load_masks": run.load_masks, "size": run.settings.region_px}
    with run.execution.stage("segmentation accuracy", "radiographs", len(jobs)) as stage:
        measured = map_in_parallel(
            measure_overlap,
            jobs,
            shared=shared | {"code": compute_code_hashes(CODE_PACKAGES)},
            workers=run.execution.workers,
            scheduler=run.execution.scheduler,
            on_result=lambda *_: stage.advance(),
        )
    table = pd.DataFrame(measured).assign(grade=[str(row["grade"]) for row in rows])
    parts = [*table.groupby("grade"), ("all", table)]
    return pd.DataFrame([{"grade": grade, **_summarise_overlap(part)} for grade, part in parts], columns=COLUMNS)


def measure_overlap(
    job: SegmentationJob,
    *,
    load_pixels: Callable[[str], Any],
    load_masks: LoadMasks,
    size: int,
    code: Mapping[str, str],
) -> dict[str, float]:
    """Measure the overlap of segmented and true bone in the region of one radiograph.

    Parameters
    ----------
    job : SegmentationJob
        Radiograph, masks and position of the region.
    load_pixels : callable
        Function that returns (rows, cols) pixels for `job.file`.
    load_masks : callable
        Function that returns bone masks by name for `job.masks`; the true bone is the union of the masks.
    size : int
        Side length of the region, in px.
    code : mapping of str to str
        Code hashes of the process that started the run, keyed by subpackage.

    Returns
    -------
    dict of str to float
        Measures from `compute_mask_overlap`: dice, mean_mm, p95_mm, area.

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    bone = reduce(np.logical_or, load_masks(job.masks).values())
    region, true = (cut_region(of, job.row, job.col, size) for of in (load_pixels(job.file), bone))
    return compute_mask_overlap(segment_bone(region, job.pixel_mm), true.astype(np.bool_), job.joint_plane_pixel_mm)


def _summarise_overlap(part: pd.DataFrame) -> dict[str, float]:
    """Compute the mean overlap measures over radiographs and the 5th percentile of Dice."""
    means = {name: part[name].mean() for name in ("mean_mm", "p95_mm", "area")}
    return {"radiographs": len(part), "dice": part["dice"].mean(), "dice_p5": part["dice"].quantile(0.05), **means}
