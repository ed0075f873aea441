"""Makes the radiographs of a plan, knee by knee, in processes of this machine or on a cluster."""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from platform import node
from typing import Any

from ..anatomy import build
from ..core.checks import InputError, require_choice, require_workers
from ..core.parallel import cores, ordered_map, require_scheduler
from ..data.code import code_digest, data_of_pixels, require_code
from ..geometry.view import view_of
from ..io import atomic, records
from ..io.images import save
from ..io.masks import save_masks
from ..model.knee import knee_table
from ..model.protocol import protocol_table
from ..model.radiograph import Radiograph, Truth
from ..raycast import ENGINES, trace
from ..raycast.room import with_room
from ..simulation import simulate, versions
from .plan import Case, Exposure, Plan

Row = dict[str, Any]
FOLDERS = ("", "images", "masks", "records")
# What of this package pixels, files and manifest depend on.
_CODE = (
    *("anatomy", "cohort", "core", "detector", "geometry", "io", "model", "raycast", "scatter"),
    *("image_faults.py", "precompile.py", "simulation.py", "stages.py", "xray"),
)


@dataclass(frozen=True, kw_only=True)
class Site:
    """Where a cohort is made, as every worker must find it.

    claim     hash of its cohort.json
    versions  of all that its pixels depend on
    code      of this package that they depend on, see `code_digest`
    """

    folder: Path
    claim: str
    versions: dict[str, str]
    code: dict[str, str]


def make_cohort(
    plan: Plan,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    engine: str = "scanline",
    progress: Callable[[int], None] = lambda made: None,
    kept: Callable[[int], None] = lambda stood: None,
) -> Path:
    """Make what is missing of a cohort and write its manifest; the bytes do not depend on who makes them.

    A leg that would reach behind the detector stands farther off it (`raycast.room.with_room`): the manifest's sod_mm.

    folder     of this cohort; what an earlier run left there is checked against its hashes and kept
    workers    processes of this machine; None: one for each core that this process may use
    scheduler  address of a Dask scheduler whose workers do the work instead, in the same folder under the same path
    engine     "scanline", or "embree", which gives the same path lengths in fifteen times the time
    progress   called with the number of radiographs that have been made, as they are
    kept       called with the number of radiographs that an earlier run left, as they are checked, before any is made
    returns    the path of the manifest (CSV, one row a radiograph)
    raises     InputError for an unknown engine, a folder that holds another cohort, a damaged file in it, a disk that
               cannot be written, a scheduler that cannot be used; WorkersLostError when workers keep being killed
    """
    workers = cores() if workers is None else workers
    require_workers(workers, "processes")
    require_choice("engine", engine, ENGINES)
    if scheduler is not None:
        require_scheduler(scheduler)
    folder = Path(folder)
    code = code_digest((*_CODE, *data_of_pixels()))
    asked = {**plan.table(), "engine": engine, "versions": versions(), "code": code}
    claim = records.claim(folder / "cohort.json", asked)
    _sweep(folder)
    rows = _standing(plan, folder, claim, workers, kept)
    missing = [case for case in plan.cases if case.index not in rows]

    def stands(index: int, made: list[Row]) -> None:
        rows[missing[index].index] = made
        progress(len(missing[index].exposures))

    # Cores that have no knee of their own work on the rays of one.
    threads = 1 if scheduler else max(1, workers // max(1, len(missing)))
    site = Site(folder=folder.absolute(), claim=claim, versions=versions(), code=code)
    shared = {"site": site, "engine": engine, "threads": threads, "masks": plan.masks}
    ordered_map(make_case, missing, shared=shared, workers=workers, scheduler=scheduler, arrived=stands)
    _sweep(folder)
    manifest = folder / "manifest.csv"
    records.write_csv(manifest, [row for case in plan.cases for row in rows[case.index]])
    return manifest


def make_case(case: Case, site: Site, engine: str, threads: int, masks: str = "none") -> list[Row]:
    """Make and save every radiograph of one knee, then its record; returns its rows of the manifest.

    raises  InputError where the folder or a library is not what it is where the cohort was claimed
    """
    records.require_claimed(site.folder / "cohort.json", site.claim)
    for name, here in versions().items():
        if here != site.versions[name]:
            raise InputError(f"on {node()}: {name} = {here}; allowed: {site.versions[name]}, as where the run started")
    require_code(site.code)
    built, paths, rows = build(case.knee, case.exposures[0].protocol), None, []
    for exposure in case.exposures:
        if built.assembly.posture != exposure.protocol.posture:
            built, paths = build(case.knee, exposure.protocol), None
        how: dict[str, Any] = {"rng": exposure.seed, "engine": engine, "workers": threads}
        how["keep"] = () if masks == "none" else ("masks",)
        protocol = with_room(built.scene, built.aimed(exposure.protocol))
        # Radiographs of one geometry, such as reference and low dose, have the same paths.
        if paths is None or (paths.view, paths.texture) != (view_of(protocol), protocol.texture):
            paths = trace(built.scene, protocol, engine=engine, workers=threads)
        radiograph = simulate(built, protocol, paths=paths, **how)
        path = save(radiograph, site.folder / "images" / f"{exposure.name}.tif")
        row = _row(case, exposure, radiograph, path.relative_to(site.folder), records.sha256(path))
        if masks != "none":
            path = save_masks(radiograph, site.folder / "masks" / f"{exposure.name}.{masks}")
            row |= {"masks": path.relative_to(site.folder).as_posix(), "masks_sha256": records.sha256(path)}
        rows.append(row)
    records.write_rows(site.folder, case.index, rows, site.claim)
    return rows


def _sweep(folder: Path) -> None:
    for name in FOLDERS:
        atomic.sweep(folder / name)


def _standing(plan: Plan, folder: Path, claim: str, workers: int, kept: Callable[[int], None]) -> dict[int, list[Row]]:
    """The rows of every knee that an earlier run finished, by index."""

    def known(case: Case) -> list[Row] | None:
        return records.read_rows(folder, case.index, [exposure.name for exposure in case.exposures], claim)

    rows: dict[int, list[Row]] = {}
    # Threads, for hashing lets go of the lock.
    with ThreadPoolExecutor(workers) as pool:
        for case, known_rows in zip(plan.cases, pool.map(known, plan.cases), strict=True):
            if known_rows is not None:
                rows[case.index] = known_rows
                kept(len(case.exposures))
    return rows


def _row(case: Case, exposure: Exposure, radiograph: Radiograph, file: Path, digest: str) -> Row:
    truth = radiograph.truth
    assert truth is not None
    knee, protocol = knee_table(case.knee), protocol_table(radiograph.protocol)
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
        "file": file.as_posix(),
        "sha256": digest,
    }
    if exposure.kind:
        row |= {"kind": exposure.kind, "turn": exposure.turn, "of_knee": exposure.of_knee}
    # A knee has a flexion and a rotation of its own, which a posture adds to.
    stands = {f"posture_{name}": protocol.pop(name) for name in asdict(exposure.protocol.posture)}
    # The plain name is of this radiograph; what the knee was specified with says so.
    nominal = {f"nominal_{name}": knee.pop(name) for name in ("jsw_medial_mm", "jsw_lateral_mm")}
    row |= {"jsw_medial_mm": truth.jsw_medial_mm, "jsw_lateral_mm": truth.jsw_lateral_mm} | nominal
    for name in ("grade", "grade_table"):
        knee.pop(name)
    row |= {**knee, **{name: json.dumps(knee[name]) for name in ("shape", "osteophytes", "cysts")}} | protocol | stands
    row |= {f"truth_{name}": value for name, value in _truth_columns(truth).items()}
    return row | {f"audit_{name}": count for name, count in radiograph.audit.items()}


def _truth_columns(truth: Truth) -> Row:
    """What is known about a radiograph, one number a column; landmarks that its view does not show are left out."""
    columns: Row = {f"jsw_{round(1000 * at):03d}_mm": round(mm, 4) for at, mm in truth.jsw_at_mm.items()}
    for name, (row, col) in truth.landmarks_px.items():
        place = name.removesuffix("_joint_line")
        columns |= {f"{place}_row_px": round(row, 4), f"{place}_col_px": round(col, 4)}
    columns |= {f"attrition_{name}_mm": depth for name, depth in truth.attrition_mm.items()}
    columns |= {f"taking_{name}": value for name, value in truth.taking.items()}
    return columns | dict(truth.readings)
