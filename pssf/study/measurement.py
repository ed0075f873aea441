"""First stage of a study: locate the joint region of each radiograph and measure its features."""

from dataclasses import replace
from pathlib import Path

import pandas as pd

from ..core.checks import InputError, require_choice
from ..io import study_results
from ..radiomics.features.area_features import require_resolved_texture
from ..radiomics.features.feature_families import SQUARE
from ..radiomics.features.feature_table import (
    LANDMARK_COLUMNS,
    NON_FEATURE_COLUMNS,
    TEXT_COLUMNS,
    ExtractionSettings,
    MeasurementJob,
    Record,
    make_measurement_jobs,
    measure_radiographs,
    read_landmark_columns,
)
from .design.manifest_checks import require_manifest, require_unique_files
from .design.study_settings import StudySettings
from .learn.models.trivial_baselines import BASELINE_MANIFEST_COLUMNS
from .predictions import concatenate_tables
from .statistics.analyses.leakage_checks import require_consistent_identifiers
from .statistics.features.reliability import REPEAT_LABELS
from .study_data import StudyContext

_COLUMNS = (
    *("radiograph", "subject", "knee", "side", "grade", "protocol", "file", "sha256"),
    *("pixel_mm", "sdd_mm", "sod_mm", "truth_medial_row_px", "truth_medial_col_px"),
)
# Columns of the true tibial landmarks, by which regions of the tibia are placed.
_TRUE_LANDMARKS = tuple(f"truth_{name}" for name in LANDMARK_COLUMNS)


def check_manifest(manifest: pd.DataFrame, settings: StudySettings) -> pd.DataFrame:
    """Check the columns, values, identifiers and files of a manifest.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph.
    settings : StudySettings
        Study settings; the reference protocol must be in the manifest.

    Returns
    -------
    DataFrame
        Manifest with integer grades.

    Raises
    ------
    InputError
        A column or the reference protocol is missing, or a radiograph or file is listed twice. The error is also raised
        if identifiers are inconsistent, or a value is out of range; see `require_manifest`.
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


def _append_retest(manifest: pd.DataFrame, retest: pd.DataFrame | None, settings: StudySettings) -> pd.DataFrame:
    """Append the repeat radiographs to the manifest, reduced to the columns that the study reads.

    The column ``kind`` is empty for radiographs of the manifest. Raise InputError if `retest` lacks a column, reuses a
    radiograph or a file, or is inconsistent with the manifest.
    """
    landmarks = _TRUE_LANDMARKS if _uses_true_landmarks(settings) else ()
    columns = [*_COLUMNS, *(name for name in (*BASELINE_MANIFEST_COLUMNS, *landmarks) if name in manifest)]
    first = manifest[columns].assign(kind="", repeat_index="")
    if retest is None or retest.empty:
        return first
    missing = [name for name in (*columns, "kind", "repeat_index") if name not in retest]
    if missing:
        raise InputError(
            "retest manifest must have the manifest columns, kind and repeat_index, got none named "
            f"{', '.join(missing)}"
        )
    retest = require_manifest(retest, "retest manifest")
    for kind in retest["kind"].unique():
        require_choice("kind of repeat", kind, tuple(REPEAT_LABELS))
    both = concatenate_tables([first, retest[[*columns, "kind", "repeat_index"]]])
    twice = both["radiograph"][both["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"retest manifest must list each radiograph once, got {twice.iloc[0]} listed twice")
    _require_valid_repeats(manifest, retest)
    require_consistent_identifiers(both, "retest manifest")
    return both


def _require_valid_repeats(manifest: pd.DataFrame, retest: pd.DataFrame) -> None:
    """Raise InputError if a repeat radiograph reuses a file or its knee is not in the manifest.

    A reused file would agree perfectly with itself and bias the reliability.
    """
    known = retest["sha256"].isin(manifest["sha256"]) | retest["sha256"].duplicated()
    if known.any():
        row = retest[known].iloc[0]
        raise InputError(
            f"retest manifest: radiograph {row['radiograph']} must have its own file, "
            f"got sha256 = {row['sha256'][:12]}... of another radiograph ({int(known.sum())} rows affected)"
        )
    strange = ~retest["knee"].isin(manifest["knee"])
    if strange.any():
        row = retest[strange].iloc[0]
        raise InputError(
            f"retest manifest: radiograph {row['radiograph']} must show a knee in the manifest, "
            f"got knee = {row['knee']} ({int(strange.sum())} rows affected)"
        )


def measure_features(
    run: StudyContext, manifest: pd.DataFrame, retest: pd.DataFrame | None
) -> tuple[pd.DataFrame, list[str], dict[str, float]]:
    """Locate the joint region in each radiograph of a cohort and measure its features.

    The records are written to ``features.csv``; a later run reads the file and resumes.

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
        Manifest and repeat radiographs, with the region and the features of each radiograph.
    names : list of str
        Feature names.
    work : dict of str to float
        Run time of each step in s, summed over the processes.

    Raises
    ------
    InputError
        The manifest or the table of repeat radiographs is not valid.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    manifest = check_manifest(manifest, run.settings)
    radiographs = _append_retest(manifest, retest, run.settings)
    table, work = _measure_records(
        run, radiographs, run.out / "features.csv", run.settings.region_px, "regions and features"
    )
    names = [name for name in table.columns if name not in NON_FEATURE_COLUMNS]
    return radiographs.merge(table, on="radiograph", how="left", validate="one_to_one").copy(), names, work


def measure_designed_features(run: StudyContext, radiographs: pd.DataFrame, name: str, pixel_mm: float) -> pd.DataFrame:
    """Locate the joint region in each designed radiograph and measure its features.

    The side length of the region in mm is the same for every pixel pitch. One file ``features_<name>_<side>.csv`` is
    written for each side length in px.

    Parameters
    ----------
    run : StudyContext
        Inputs, settings and execution.
    radiographs : DataFrame
        Manifest of designed radiographs, from `DesignedManifests`.
    name : str
        Name of the design, used in the file name.
    pixel_mm : float
        Pixel pitch of the reference protocol, in mm.

    Returns
    -------
    DataFrame
        Manifest with added columns for region and features of each radiograph.

    Raises
    ------
    InputError
        A worker process has a different code version.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    sides = (run.settings.region_px * pixel_mm / radiographs["pixel_mm"]).round().astype(int)
    parts = []
    for side, part in radiographs.groupby(sides, sort=True):
        path = run.out / f"features_{name}_{side}.csv"
        table, _ = _measure_records(run, part, path, int(side), f"{name}, region side {side} px")
        parts.append(part.merge(table, on="radiograph", how="left", validate="one_to_one"))
    return concatenate_tables(parts)


def _measure_records(
    run: StudyContext, radiographs: pd.DataFrame, path: Path, region_px: int, stage: str
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Measure radiographs, reuse the records of an earlier run in a CSV file, and save all records in the file.

    Return the records and the run time of each step in s.
    """
    settings = run.settings
    earlier = study_results.load_table(path, TEXT_COLUMNS)
    known: dict[str, Record] = {}
    if earlier is not None and "sha256" in earlier:
        known = {row["sha256"]: row for row in earlier.to_dict("records")}
    require_resolved_texture(float(radiographs["pixel_mm"].max()), settings.families)
    jobs = _make_jobs(radiographs, settings)
    records, work = measure_radiographs(
        jobs,
        load_pixels=run.load_pixels,
        templates=run.templates,
        tables=run.tables.radiomics,
        settings=ExtractionSettings(
            region_px=region_px,
            bins=settings.bins,
            families=settings.families,
            backend=settings.backend,
            regions=settings.regions,
            areas=settings.areas,
        ),
        execution=run.execution,
        known_records=known,
        save=lambda records: study_results.save_table(path, pd.DataFrame(records)),
        stage_name=stage,
    )
    return pd.DataFrame(records).drop(columns="sha256"), work


def _uses_true_landmarks(settings: StudySettings) -> bool:
    """Report whether true landmarks place regions of the tibia."""
    return settings.regions == "truth" and set(settings.areas) != {SQUARE}


def _make_jobs(radiographs: pd.DataFrame, settings: StudySettings) -> list[MeasurementJob]:
    """Make one measurement job per radiograph, with the true medial joint line and landmarks if they are used."""
    rows = radiographs.to_dict("records")
    jobs = make_measurement_jobs(rows)
    if settings.regions != "truth":
        return jobs
    with_landmarks = _uses_true_landmarks(settings)
    missing = [column for column in _TRUE_LANDMARKS if column not in radiographs]
    if with_landmarks and missing:
        raise InputError(f"radiographs must have true tibial landmarks for areas, got no column {missing[0]}")
    return [
        replace(
            job,
            place_px=(float(row["truth_medial_row_px"]), float(row["truth_medial_col_px"])),
            landmarks_px=read_landmark_columns(row, "truth_") if with_landmarks else None,
        )
        for job, row in zip(jobs, rows, strict=True)
    ]
