"""Makes the radiographs of a plan, knee by knee, in processes of this machine or on a cluster."""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from platform import node
from typing import Any

from ..anatomy import build
from ..core.checks import InputError, require_choice, require_workers
from ..core.parallel import cores, ordered_map, require_scheduler
from ..geometry.view import view_of
from ..io import atomic, records
from ..io.images import save
from ..model.knee import knee_table
from ..model.protocol import protocol_table
from ..model.radiograph import Radiograph
from ..raycast import ENGINES, trace
from ..simulation import simulate, versions
from .plan import Case, Plan, Shot

Row = dict[str, Any]
FOLDERS = ("", "images", "records")


@dataclass(frozen=True, kw_only=True)
class Site:
    """Where a cohort is made, as every worker must find it.

    claim     hash of its cohort.json
    versions  of all that its pixels depend on
    """

    folder: Path
    claim: str
    versions: dict[str, str]


def make_cohort(
    plan: Plan,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    engine: str = "scanline",
    progress: Callable[[int], None] = lambda made: None,
    found: Callable[[int], None] = lambda there: None,
) -> Path:
    """Make what is missing of a cohort and write its manifest; the bytes do not depend on who makes them.

    folder     of this cohort; what an earlier run left there is checked against its hashes and kept
    workers    processes of this machine; None: one for each core that this process may use
    scheduler  address of a Dask scheduler whose workers do the work instead, in the same folder under the same path
    engine     "scanline", or "embree", which gives the same path lengths in fifteen times the time
    progress   called with the number of radiographs that have been made, as they are
    found      called with the number of radiographs that an earlier run left, as they are checked, before any is made
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
    claim = records.claim(folder / "cohort.json", {**plan.table(), "engine": engine, "versions": versions()})
    _sweep(folder)
    rows = _found(plan, folder, workers, found)
    missing = [case for case in plan.cases if case.index not in rows]

    def stands(index: int, made: list[Row]) -> None:
        rows[missing[index].index] = made
        progress(len(missing[index].shots))

    # Cores that have no knee of their own work on the rays of one.
    threads = 1 if scheduler else max(1, workers // max(1, len(missing)))
    site = Site(folder=folder.absolute(), claim=claim, versions=versions())
    shared = {"site": site, "engine": engine, "threads": threads}
    ordered_map(make_case, missing, shared=shared, workers=workers, scheduler=scheduler, arrived=stands)
    _sweep(folder)
    manifest = folder / "manifest.csv"
    records.write_csv(manifest, [row for case in plan.cases for row in rows[case.index]])
    return manifest


def make_case(case: Case, site: Site, engine: str, threads: int) -> list[Row]:
    """Make and save every radiograph of one knee, then its record; returns its rows of the manifest.

    raises  InputError where the folder or a library is not what it is where the cohort was claimed
    """
    records.require_claimed(site.folder / "cohort.json", site.claim)
    for name, here in versions().items():
        if here != site.versions[name]:
            raise InputError(f"on {node()}: {name} = {here}; allowed: {site.versions[name]}, as where the run started")
    built, paths, rows = build(case.knee), None, []
    for shot in case.shots:
        how: dict[str, Any] = {"seed": shot.seed, "engine": engine, "workers": threads}
        # Radiographs of one geometry, such as reference and low dose, have the same paths.
        if paths is None or (paths.view, paths.texture) != (view_of(shot.protocol), shot.protocol.texture):
            paths = trace(built.scene, shot.protocol, engine=engine, workers=threads)
        radiograph = simulate(built, shot.protocol, paths=paths, **how)
        path = save(radiograph, site.folder / "images" / f"{shot.name}.tif")
        rows.append(_row(case, shot, radiograph, path.relative_to(site.folder), records.sha256(path)))
    records.write_rows(site.folder, case.index, rows)
    return rows


def _sweep(folder: Path) -> None:
    for name in FOLDERS:
        atomic.sweep(folder / name)


def _found(plan: Plan, folder: Path, workers: int, found: Callable[[int], None]) -> dict[int, list[Row]]:
    """The rows of every knee that an earlier run finished, by index."""

    def known(case: Case) -> list[Row] | None:
        return records.read_rows(folder, case.index, [shot.name for shot in case.shots])

    rows: dict[int, list[Row]] = {}
    # Threads, for hashing lets go of the lock.
    with ThreadPoolExecutor(workers) as pool:
        for case, of in zip(plan.cases, pool.map(known, plan.cases), strict=True):
            if of is not None:
                rows[case.index] = of
                found(len(case.shots))
    return rows


def _row(case: Case, shot: Shot, radiograph: Radiograph, file: Path, digest: str) -> Row:
    truth = radiograph.truth
    assert truth is not None
    knee, protocol = knee_table(case.knee), protocol_table(shot.protocol)
    row: Row = {
        "radiograph": shot.name,
        "subject": case.subject,
        "knee": case.index,
        "side": knee.pop("side"),
        "sex": knee.pop("sex"),
        "grade": knee.pop("grade"),
        "protocol": protocol.pop("name"),
        "seed": shot.seed,
        "engine": radiograph.engine,
        "file": file.as_posix(),
        "sha256": digest,
    }
    row |= {**knee, "osteophytes": json.dumps(knee["osteophytes"])} | protocol
    for name in ("medial", "lateral"):
        place = truth.landmarks_px[f"{name}_joint_line"]
        row |= {f"truth_{name}_row_px": round(place[0], 4), f"truth_{name}_col_px": round(place[1], 4)}
    return row | {f"audit_{name}": count for name, count in radiograph.audit.items()}
