"""First stage of a study: locate the regions of a manifest and measure their features."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ..core.checks import InputError, require_choice
from ..core.processes.execution import Execution
from ..io import study_results
from ..radiomics.features.feature_table import (
    NON_FEATURE_COLUMNS,
    TEXT_COLUMNS,
    ExtractionSettings,
    LoadPixels,
    MeasurementJob,
    Record,
    measure_radiographs,
)
from ..radiomics.localisation.templates import Template
from .design.manifest_checks import require_manifest, require_unique_files
from .design.study_settings import StudySettings
from .design.study_tables import StudyTables
from .learn.models.trivial_baselines import BASELINE_MANIFEST_COLUMNS
from .predictions import concatenate_tables
from .statistics.analyses.leakage_checks import require_consistent_identifiers
from .statistics.features.reliability import REPEAT_LABELS

_COLUMNS = (
    *("radiograph", "subject", "knee", "side", "grade", "protocol", "file", "sha256"),
    *("pixel_mm", "sdd_mm", "sod_mm", "truth_medial_row_px", "truth_medial_col_px"),
)


@dataclass(frozen=True)
class StudyContext:
    """Hold the inputs, settings and execution that all stages share.

    Parameters
    ----------
    load_pixels : callable
        Function from an entry of the column ``file`` to (rows, cols) uint16 pixels, linear in the signal.
    templates : sequence of Template
        Radiographs of standard knees, the widest joint space first.
    settings : StudySettings
        Settings of the study.
    out : Path
        Folder that the files are written to.
    execution : Execution
        Workers, scheduler, timer and progress bar.
    tables : StudyTables
        Data tables of the package that the study reads.
    load_masks : callable, optional
        Function from an entry of the column ``masks`` of the repeats to bone masks by name, each (rows, cols) bool;
        None if no masks are known.
    """

    load_pixels: LoadPixels
    templates: Sequence[Template]
    settings: StudySettings
    out: Path
    execution: Execution
    tables: StudyTables
    load_masks: Callable[[str], Mapping[str, Any]] | None = None


def check_manifest(manifest: pd.DataFrame, settings: StudySettings) -> pd.DataFrame:
    """Check the columns, values, identifiers and files of a manifest.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph.
    settings : StudySettings
        Settings; the manifest must have their reference protocol.

    Returns
    -------
    DataFrame
        The manifest with integer grades.

    Raises
    ------
    InputError
        A column is missing, the reference protocol does not occur, a radiograph or file is listed twice, identifiers
        contradict each other, or a value is out of range; see `require_manifest`.
    """
    if not isinstance(manifest, pd.DataFrame):
        require_manifest(manifest)
    missing = [name for name in _COLUMNS if name not in manifest.columns]
    if missing:
        raise InputError(f"manifest must have the columns {', '.join(_COLUMNS)}, got none named {', '.join(missing)}")
    manifest = require_manifest(manifest)
    require_choice("reference", settings.reference, sorted(set(manifest["protocol"].astype(str))))
    twice = manifest["radiograph"][manifest["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"manifest must list each radiograph once, got {twice.iloc[0]} listed twice")
    require_consistent_identifiers(manifest)
    require_unique_files(manifest)
    return manifest


def _append_retest(manifest: pd.DataFrame, retest: pd.DataFrame | None) -> pd.DataFrame:
    """Append the repeat radiographs to the columns of the manifest that the study reads.

    The column ``kind`` is empty for the first radiograph of a knee. Raise InputError for repeats that lack a column,
    reuse a radiograph or a file, or contradict the manifest.
    """
    columns = [*_COLUMNS, *(name for name in BASELINE_MANIFEST_COLUMNS if name in manifest)]
    first = manifest[columns].assign(kind="", turn="")
    if retest is None or retest.empty:
        return first
    missing = [name for name in (*columns, "kind", "turn") if name not in retest]
    if missing:
        raise InputError(
            "manifest of repeats must have the columns of the manifest, kind and turn, got none named "
            f"{', '.join(missing)}"
        )
    retest = require_manifest(retest, "manifest of repeats")
    for kind in retest["kind"].unique():
        require_choice("kind of repeat", kind, tuple(REPEAT_LABELS))
    both = concatenate_tables([first, retest[[*columns, "kind", "turn"]]])
    twice = both["radiograph"][both["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"manifest of repeats must list each radiograph once, got {twice.iloc[0]} listed twice")
    _require_valid_repeats(manifest, retest)
    require_consistent_identifiers(both, "manifest of repeats")
    return both


def _require_valid_repeats(manifest: pd.DataFrame, retest: pd.DataFrame) -> None:
    """Raise InputError for a repeat that reuses a file, or whose knee is not in the manifest.

    A reused file would agree with itself.
    """
    known = retest["sha256"].isin(manifest["sha256"]) | retest["sha256"].duplicated()
    if known.any():
        row = retest[known].iloc[0]
        raise InputError(
            f"manifest of repeats: radiograph {row['radiograph']} must have a file of its own, "
            f"got sha256 = {row['sha256'][:12]}... of another radiograph ({int(known.sum())} such rows)"
        )
    strange = ~retest["knee"].isin(manifest["knee"])
    if strange.any():
        row = retest[strange].iloc[0]
        raise InputError(
            f"manifest of repeats: radiograph {row['radiograph']} must have a knee of the manifest, "
            f"got knee = {row['knee']} ({int(strange.sum())} such rows)"
        )


def measure_features(
    run: StudyContext, manifest: pd.DataFrame, retest: pd.DataFrame | None
) -> tuple[pd.DataFrame, list[str], dict[str, float]]:
    """Locate the regions of a cohort and measure their features.

    The records are kept in ``features.csv``, so that a later run can continue from them.

    Parameters
    ----------
    run : StudyContext
        Inputs, settings and execution.
    manifest : DataFrame
        One row per radiograph.
    retest : DataFrame or None
        Repeat radiographs of some knees.

    Returns
    -------
    table : DataFrame
        Manifest and repeats with region and features of each radiograph.
    names : list of str
        Names of the features.
    work : dict of str to float
        Seconds of work in each step, summed over the processes.

    Raises
    ------
    InputError
        The manifest or the repeats cannot be used.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    manifest = check_manifest(manifest, run.settings)
    radiographs = _append_retest(manifest, retest)
    table, work = _measure_records(
        run, radiographs, run.out / "features.csv", run.settings.region_px, "regions and features"
    )
    names = [name for name in table.columns if name not in NON_FEATURE_COLUMNS]
    return radiographs.merge(table, on="radiograph", how="left", validate="one_to_one").copy(), names, work


def measure_designed_features(run: StudyContext, radiographs: pd.DataFrame, name: str, pixel_mm: float) -> pd.DataFrame:
    """Locate the regions of designed radiographs and measure their features.

    A region has the same side in mm at every pixel pitch. The records of each region size in px are kept in
    ``features_<name>_<side>.csv``.

    Parameters
    ----------
    run : StudyContext
        Inputs, settings and execution.
    radiographs : DataFrame
        One manifest of `DesignedManifests`.
    name : str
        Name of the design, used in the file name.
    pixel_mm : float
        Pixel pitch of the reference protocol, in mm.

    Returns
    -------
    DataFrame
        The manifest with region and features of each radiograph.

    Raises
    ------
    InputError
        A worker runs other code.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    sides = (run.settings.region_px * pixel_mm / radiographs["pixel_mm"]).round().astype(int)
    parts = []
    for side, part in radiographs.groupby(sides, sort=True):
        path = run.out / f"features_{name}_{side}.csv"
        table, _ = _measure_records(run, part, path, int(side), f"{name}, regions of {side} pixels")
        parts.append(part.merge(table, on="radiograph", how="left", validate="one_to_one"))
    return concatenate_tables(parts)


def _measure_records(
    run: StudyContext, radiographs: pd.DataFrame, path: Path, region_px: int, stage: str
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Measure the radiographs in order and keep the records in a table.

    Return the records and the seconds of work in each step.
    """
    settings = run.settings
    earlier = study_results.load_table(path, TEXT_COLUMNS)
    known: dict[str, Record] = {}
    if earlier is not None and "sha256" in earlier:
        known = {row["sha256"]: row for row in earlier.to_dict("records")}
    columns = ("radiograph", "file", "sha256", "side", "pixel_mm")
    jobs = [
        MeasurementJob(**{name: row[name] for name in columns}) for row in radiographs[list(columns)].to_dict("records")
    ]
    records, work = measure_radiographs(
        jobs,
        load_pixels=run.load_pixels,
        templates=run.templates,
        tables=run.tables.radiomics,
        settings=ExtractionSettings(
            region_px=region_px, bins=settings.bins, families=settings.families, backend=settings.backend
        ),
        execution=run.execution,
        known_records=known,
        save=lambda records: study_results.save_table(path, pd.DataFrame(records)),
        stage_name=stage,
    )
    return pd.DataFrame(records).drop(columns="sha256"), work
