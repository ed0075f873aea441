"""The bone that is found in a region, beside the bone that the knee was built with."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..core.parallel import ordered_map
from ..data.code import code_digest, require_code
from ..radiomics.bone import bone_mask
from ..radiomics.overlap import overlap
from ..radiomics.region import cut_region
from .learn.each_split import CODE
from .measuring import Run

LoadMasks = Callable[[str], Mapping[str, NDArray[np.bool_]]]
COLUMNS = ["grade", "radiographs", "dice", "dice_p5", "mean_mm", "p95_mm", "area"]


@dataclass(frozen=True, kw_only=True)
class Job:
    """A radiograph whose true masks are known.

    file, masks   what the loaders are asked for
    row, col      middle of its region, px
    pixel_mm      side of a pixel at the detector
    unit_mm       the same at the joint plane
    """

    file: str
    masks: str
    row: float
    col: float
    pixel_mm: float
    unit_mm: float


def segmentation(repeated: pd.DataFrame, retest: pd.DataFrame | None, run: Run) -> pd.DataFrame:
    """One row a grade, and one for all: how `radiomics.bone_mask` agrees with the projection of the bones.

    repeated  radiographs taken again with a region found: radiograph, grade, row_px, col_px, pixel_mm, sdd_mm, sod_mm
    retest    their manifest, whose column `masks` names the files of their masks
    returns   grade, radiographs, and of `overlap` the means, with the 5th percentile of Dice: COLUMNS. Without rows
              where no masks are known
    """
    if run.load_masks is None or retest is None or "masks" not in retest or repeated.empty:
        return pd.DataFrame(columns=COLUMNS)
    rows = repeated.merge(retest[["radiograph", "masks"]], on="radiograph", how="inner").to_dict("records")
    jobs = [
        Job(
            file=row["file"],
            masks=row["masks"],
            row=row["row_px"],
            col=row["col_px"],
            pixel_mm=row["pixel_mm"],
            unit_mm=row["pixel_mm"] * row["sod_mm"] / row["sdd_mm"],
        )
        for row in rows
    ]
    shared = {"load_pixels": run.load_pixels, "load_masks": run.load_masks, "size": run.settings.region_px}
    with run.execution.stage("bone beside the true one", "radiographs", len(jobs)) as stage:
        measured = ordered_map(
            compare,
            jobs,
            shared=shared | {"code": code_digest(CODE)},
            workers=run.execution.workers,
            scheduler=run.execution.scheduler,
            arrived=lambda *_: stage.advance(),
        )
    table = pd.DataFrame(measured).assign(grade=[str(row["grade"]) for row in rows])
    parts = [*table.groupby("grade"), ("all", table)]
    return pd.DataFrame([{"grade": grade, **_row(part)} for grade, part in parts], columns=COLUMNS)


def compare(
    job: Job, *, load_pixels: Callable[[str], Any], load_masks: LoadMasks, size: int, code: Mapping[str, str]
) -> dict[str, float]:
    """`overlap` in the region of one radiograph, of side `size` pixels, of the bone found with all bone there is.

    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    bone = reduce(np.logical_or, load_masks(job.masks).values())
    region, true = (cut_region(of, job.row, job.col, size) for of in (load_pixels(job.file), bone))
    return overlap(bone_mask(region, job.pixel_mm), true.astype(np.bool_), job.unit_mm)


def _row(part: pd.DataFrame) -> dict[str, float]:
    means = {name: part[name].mean() for name in ("mean_mm", "p95_mm", "area")}
    return {"radiographs": len(part), "dice": part["dice"].mean(), "dice_p5": part["dice"].quantile(0.05), **means}
