"""From a manifest to regions and features: the first stage of a study."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ..core.checks import InputError, require_choice
from ..core.execution import Execution
from ..io import results
from ..radiomics.patches import Template
from ..radiomics.table import NOT_FEATURES, TEXT, How, Job, Load, Record, extract_all
from .learn.baselines import SOURCES
from .manifest_checks import require_files_once, require_manifest
from .predictions import joined
from .settings import StudySettings
from .statistics.provenance import require_one_of_each
from .statistics.reliability import REPEATS
from .tables import StudyTables

_COLUMNS = (
    *("radiograph", "subject", "knee", "side", "grade", "protocol", "file", "sha256"),
    *("pixel_mm", "sdd_mm", "sod_mm", "truth_medial_row_px", "truth_medial_col_px"),
)


@dataclass(frozen=True)
class Run:
    """What all stages need.

    load_masks  entry of the column `masks` of knees taken again -> name -> (rows, cols) bool; None where there are none
    """

    load_pixels: Load
    templates: Sequence[Template]
    settings: StudySettings
    out: Path
    execution: Execution
    tables: StudyTables
    load_masks: Callable[[str], Mapping[str, Any]] | None = None


def check_manifest(manifest: pd.DataFrame, settings: StudySettings) -> pd.DataFrame:
    """Refuse a manifest that lacks a column, has no reference protocol, names a radiograph twice, or knows it as two.

    returns  the manifest with its grades as integers
    raises   InputError; for a value out of its range as well, see `require_manifest`
    """
    if not isinstance(manifest, pd.DataFrame):
        require_manifest(manifest)
    missing = [name for name in _COLUMNS if name not in manifest.columns]
    if missing:
        raise InputError(f"manifest: columns {', '.join(missing)} are missing; required: {', '.join(_COLUMNS)}")
    manifest = require_manifest(manifest)
    require_choice("reference", settings.reference, sorted(set(manifest["protocol"].astype(str))))
    twice = manifest["radiograph"][manifest["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"manifest: radiograph {twice.iloc[0]} is listed twice; allowed: once")
    require_one_of_each(manifest)
    require_files_once(manifest)
    return manifest


def _with_retest(manifest: pd.DataFrame, retest: pd.DataFrame | None) -> pd.DataFrame:
    """The manifest, the columns that the study reads, and below it what was taken again; `kind` tells them apart.

    raises  InputError for repeats that lack a column, are no radiographs of their own, or of no knee of the manifest as
            that has it
    """
    columns = [*_COLUMNS, *(name for name in SOURCES if name in manifest)]
    first = manifest[columns].assign(kind="", turn="")
    if retest is None or retest.empty:
        return first
    missing = [name for name in (*columns, "kind", "turn") if name not in retest]
    if missing:
        raise InputError(f"manifest of repeats: columns {', '.join(missing)} are missing; required: as in the manifest")
    retest = require_manifest(retest, "manifest of repeats")
    for kind in retest["kind"].unique():
        require_choice("kind of repeat", kind, tuple(REPEATS))
    both = joined([first, retest[[*columns, "kind", "turn"]]])
    twice = both["radiograph"][both["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"manifest of repeats: radiograph {twice.iloc[0]} is listed twice; allowed: once")
    _require_repeats(manifest, retest)
    require_one_of_each(both, "manifest of repeats")
    return both


def _require_repeats(manifest: pd.DataFrame, retest: pd.DataFrame) -> None:
    """Refuse a file that is there already, which would agree with itself, and a knee that is not."""
    known = retest["sha256"].isin(manifest["sha256"]) | retest["sha256"].duplicated()
    if known.any():
        row = retest[known].iloc[0]
        raise InputError(
            f"manifest of repeats: radiograph {row['radiograph']} has sha256 = {row['sha256'][:12]}..., as another one "
            f"has ({int(known.sum())} such); allowed: a file of its own"
        )
    strange = ~retest["knee"].isin(manifest["knee"])
    if strange.any():
        row = retest[strange].iloc[0]
        raise InputError(
            f"manifest of repeats: radiograph {row['radiograph']} has knee = {row['knee']} "
            f"({int(strange.sum())} such); allowed: a knee of the manifest"
        )


def measured(
    run: Run, manifest: pd.DataFrame, retest: pd.DataFrame | None
) -> tuple[pd.DataFrame, list[str], dict[str, float]]:
    """The manifest with the region and features of each radiograph; names of the features; seconds of work by step.

    Kept in features.csv, from which a later run goes on.
    """
    manifest = check_manifest(manifest, run.settings)
    radiographs = _with_retest(manifest, retest)
    table, work = _records(run, radiographs, run.out / "features.csv", run.settings.region_px, "regions and features")
    names = [name for name in table.columns if name not in NOT_FEATURES]
    return radiographs.merge(table, on="radiograph", how="left", validate="one_to_one").copy(), names, work


def measured_by_design(run: Run, taken: pd.DataFrame, name: str, pixel_mm: float) -> pd.DataFrame:
    """`measured` of a manifest of `design.Designed`; a region has the same side in mm whatever the pixel.

    Kept in features_<name>_<side>.csv, a file a side in pixels.

    pixel_mm  of the reference
    """
    sides = (run.settings.region_px * pixel_mm / taken["pixel_mm"]).round().astype(int)
    parts = []
    for side, part in taken.groupby(sides, sort=True):
        path = run.out / f"features_{name}_{side}.csv"
        table, _ = _records(run, part, path, int(side), f"{name}, regions of {side} pixels")
        parts.append(part.merge(table, on="radiograph", how="left", validate="one_to_one"))
    return joined(parts)


def _records(
    run: Run, radiographs: pd.DataFrame, path: Path, region_px: int, stage: str
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Region and features of each radiograph, in their order, and seconds of work by step; kept in a table."""
    settings = run.settings
    earlier = results.load_table(path, TEXT)
    known: dict[str, Record] = {}
    if earlier is not None and "sha256" in earlier:
        known = {row["sha256"]: row for row in earlier.to_dict("records")}
    columns = ("radiograph", "file", "sha256", "side", "pixel_mm")
    jobs = [Job(**{name: row[name] for name in columns}) for row in radiographs[list(columns)].to_dict("records")]
    records, work = extract_all(
        jobs,
        load_pixels=run.load_pixels,
        templates=run.templates,
        tables=run.tables.radiomics,
        how=How(region_px=region_px, bins=settings.bins, families=settings.families, backend=settings.backend),
        execution=run.execution,
        known=known,
        save=lambda records: results.save_table(path, pd.DataFrame(records)),
        stage_name=stage,
    )
    return pd.DataFrame(records).drop(columns="sha256"), work
