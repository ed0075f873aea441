"""Make the radiographs of a cohort plan, knee by knee, in local processes or on a cluster."""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..anatomy import build
from ..core.checks import require_choice, require_workers
from ..core.processes.parallel_map import count_cores, map_in_parallel, require_scheduler
from ..data.code_hash import compute_code_hashes, list_pixel_data_files
from ..geometry.view import resolve_view
from ..io import atomic_write, cohort_records
from ..io.mask_files import save_masks
from ..io.radiograph_files import save
from ..model.knee import knee_to_dict
from ..model.protocol import Protocol, protocol_to_dict
from ..model.radiograph import Radiograph, Truth
from ..raycast import ENGINES, trace
from ..raycast.detector_clearance import move_clear_of_detector
from ..simulation import collect_versions, simulate
from .cohort_plan import Case, Exposure, Plan
from .run_environment import CODE_PATHS, RunEnvironment, require_same_environment

Row = dict[str, Any]
# Folders in which pssf writes cohort files, relative to the cohort folder; "" is the cohort folder itself.
SUBFOLDERS = ("", "images", "masks", "records")


def make_cohort(
    plan: Plan,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    engine: str = "scanline",
    progress: Callable[[int], None] = lambda made: None,
    on_kept: Callable[[int], None] = lambda stood: None,
) -> Path:
    """Make the missing radiographs of a cohort and write its manifest.

    The files are identical for any number of workers and on any machine. If the limb would intersect the
    detector, the joint is moved towards the source (`raycast.detector_clearance.move_clear_of_detector`). The column
    ``sod_mm`` of the manifest contains the resulting source-to-object distance.

    Parameters
    ----------
    plan : Plan
        Plan of knees and radiographs.
    folder : str or Path
        Cohort folder. Files from an earlier run are verified against their hashes and reused.
    workers : int, optional
        Number of local processes, 1 to 256. None starts one process per available core.
    scheduler : str, optional
        Address of a Dask scheduler. Its workers make the radiographs, and must be able to access `folder` under the
        same path.
    engine : {"scanline", "embree"}, default "scanline"
        Ray caster; "embree" gives the same path lengths but takes fifteen times as long.
    progress : callable
        Function that is called after each finished knee, with the number of its new radiographs.
    on_kept : callable
        Function that is called for each knee that an earlier run finished, with the number of its verified radiographs.

    Returns
    -------
    Path
        Path of the manifest, a CSV file with one row per radiograph.

    Raises
    ------
    InputError
        If the engine is unknown, or the folder contains a different cohort or a damaged file. If the disk is not
        writable, or the scheduler cannot be reached.
    WorkersLostError
        If workers are killed repeatedly.
    """
    workers = count_cores() if workers is None else workers
    require_workers(workers, "processes")
    require_choice("engine", engine, ENGINES)
    if scheduler is not None:
        require_scheduler(scheduler)
    folder = Path(folder)
    code = compute_code_hashes((*CODE_PATHS, *list_pixel_data_files()))
    asked = {**plan.build_request(), "engine": engine, "versions": collect_versions(), "code": code}
    claim = cohort_records.claim_folder(folder / "cohort.json", asked)
    _remove_temporary_files(folder)
    rows = _load_finished_rows(plan, folder, claim, workers, on_kept)
    missing = [case for case in plan.cases if case.index not in rows]

    def store_rows(index: int, made: list[Row]) -> None:
        """Store the manifest rows of a finished knee and report its number of radiographs."""
        rows[missing[index].index] = made
        progress(len(missing[index].exposures))

    # If there are more workers than unfinished knees, each knee uses several threads for ray casting.
    threads = 1 if scheduler else max(1, workers // max(1, len(missing)))
    site = RunEnvironment(
        folder=folder.absolute(),
        claim="cohort.json",
        claim_sha256=claim,
        versions=collect_versions(),
        code_hashes=code,
    )
    shared = {"site": site, "engine": engine, "threads": threads, "masks": plan.masks}
    map_in_parallel(make_case, missing, shared=shared, workers=workers, scheduler=scheduler, on_result=store_rows)
    _remove_temporary_files(folder)
    manifest = folder / "manifest.csv"
    cohort_records.write_csv(manifest, [row for case in plan.cases for row in rows[case.index]])
    return manifest


def make_case(case: Case, site: RunEnvironment, engine: str, threads: int, masks: str = "none") -> list[Row]:
    """Make and save all radiographs of one knee, then write the record of the knee.

    Parameters
    ----------
    case : Case
        Knee and planned radiographs.
    site : RunEnvironment
        Cohort folder, library versions and code hashes that the worker must match.
    engine : {"scanline", "embree"}
        Ray caster.
    threads : int
        Number of threads of the simulation.
    masks : {"none", "tif"}, default "none"
        File format of the segmentation masks of each radiograph; "none" saves no masks.

    Returns
    -------
    list of dict
        Rows of the manifest, one per radiograph.

    Raises
    ------
    InputError
        If the cohort folder, a library version or the code differs from that on the machine that started the run.
    """
    require_same_environment(site)
    built, paths, rows = build(case.knee, case.exposures[0].protocol), None, []
    for exposure in case.exposures:
        if built.assembly.posture != exposure.protocol.posture:
            built, paths = build(case.knee, exposure.protocol), None
        how: dict[str, Any] = {"rng": exposure.seed, "engine": engine, "workers": threads}
        how["keep"] = () if masks == "none" else ("masks",)
        protocol = move_clear_of_detector(built.scene, built.aim_beam(exposure.protocol))
        # Radiographs with the same geometry, such as a reference and a low-dose radiograph, share their path lengths.
        if paths is None or (paths.view, paths.texture) != (resolve_view(protocol), protocol.texture):
            paths = trace(built.scene, protocol, engine=engine, workers=threads)
        radiograph = simulate(built, protocol, paths=paths, **how)
        path = save(radiograph, site.folder / "images" / f"{exposure.name}.tif")
        row = _make_row(case, exposure, radiograph, path.relative_to(site.folder), cohort_records.hash_file(path))
        if masks != "none":
            path = save_masks(radiograph, site.folder / "masks" / f"{exposure.name}.{masks}")
            row |= {"masks": path.relative_to(site.folder).as_posix(), "masks_sha256": cohort_records.hash_file(path)}
        rows.append(row)
    cohort_records.write_knee_record(site.folder, case.index, rows, site.claim_sha256)
    return rows


def _remove_temporary_files(folder: Path) -> None:
    """Delete temporary files of interrupted runs."""
    for name in SUBFOLDERS:
        atomic_write.delete_stale_temporary_files(folder / name)


def _load_finished_rows(
    plan: Plan, folder: Path, claim: str, workers: int, on_kept: Callable[[int], None]
) -> dict[int, list[Row]]:
    """Load the manifest rows of every knee that an earlier run finished, keyed by knee index."""

    def load_rows(case: Case) -> list[Row] | None:
        """Read the manifest rows of a knee; return None if its record or a file is missing."""
        return cohort_records.read_verified_rows(
            folder, case.index, [exposure.name for exposure in case.exposures], claim
        )

    rows: dict[int, list[Row]] = {}
    # Threads are sufficient, because hashing releases the global interpreter lock.
    with ThreadPoolExecutor(workers) as pool:
        for case, known_rows in zip(plan.cases, pool.map(load_rows, plan.cases), strict=True):
            if known_rows is not None:
                rows[case.index] = known_rows
                on_kept(len(case.exposures))
    return rows


def _make_row(case: Case, exposure: Exposure, radiograph: Radiograph, relative_path: Path, digest: str) -> Row:
    """Build the manifest row of one radiograph."""
    truth = radiograph.truth
    assert truth is not None
    knee, protocol = knee_to_dict(case.knee), _flatten_protocol(radiograph.protocol)
    row: Row = {
        "radiograph": exposure.name,
        "subject": case.subject,
        "knee": case.index,
        "side": knee.pop("side"),
        "sex": knee.pop("sex"),
        "grade": truth.grade,
        "grade_table": case.grade_table,
        "protocol": protocol.pop("name"),
        "seed": exposure.seed,
        "engine": radiograph.engine,
        "file": relative_path.as_posix(),
        "sha256": digest,
    }
    if exposure.retest_kind:
        row |= {
            "kind": exposure.retest_kind,
            "repeat_index": exposure.repeat_index,
            "source_knee": exposure.source_knee,
        }
    # Posture columns get the prefix "posture_", because the knee also has fields for flexion and rotation.
    posture = {f"posture_{name}": protocol.pop(name) for name in asdict(exposure.protocol.posture)}
    # Columns without a prefix contain the joint spaces in the radiograph. The prefix "nominal" marks the joint spaces
    # in the specification of the knee.
    nominal = {f"nominal_{name}": knee.pop(name) for name in ("jsw_medial_mm", "jsw_lateral_mm")}
    row |= {"jsw_medial_mm": truth.jsw_medial_mm, "jsw_lateral_mm": truth.jsw_lateral_mm} | nominal
    for name in ("grade", "grade_table"):
        knee.pop(name)
    row |= {**knee, **{name: json.dumps(knee[name]) for name in ("shape", "osteophytes", "cysts")}} | protocol | posture
    row |= {f"truth_{name}": value for name, value in _make_truth_columns(truth).items()}
    return row | {f"audit_{name}": count for name, count in radiograph.audit.items()}


def _flatten_protocol(protocol: Protocol) -> Row:
    """Convert a protocol to manifest columns, with one number or text each; `cohort.json` has the entire detector."""
    columns = protocol_to_dict(protocol)
    detector, spectrum = columns["detector"], columns["spectrum"]
    return columns | {
        "filters": json.dumps(columns["filters"]),
        "spectrum": None if spectrum is None else json.dumps(spectrum),
        "detector": detector["name"] if isinstance(detector, dict) else detector,
    }


def _make_truth_columns(truth: Truth) -> Row:
    """Convert the labels of a radiograph to manifest columns, with one number per column."""
    columns: Row = {f"jsw_{round(1000 * at):03d}_mm": round(mm, 4) for at, mm in truth.jsw_at_mm.items()}
    for name, (row, col) in truth.landmarks_px.items():
        place = name.removesuffix("_joint_line")
        columns |= {f"{place}_row_px": round(row, 4), f"{place}_col_px": round(col, 4)}
    columns |= {f"attrition_{name}_mm": depth for name, depth in truth.attrition_mm.items()}
    columns |= {f"acquisition_{name}": value for name, value in truth.acquisition.items()}
    return columns | dict(truth.readings)
