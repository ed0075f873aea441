"""Makes the radiographs of a plan, knee by knee, in processes of this machine."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import anatomy
from ..checks import require_whole
from ..files import records
from ..files.images import save
from ..knee import knee_table
from ..parallel import ordered_map
from ..protocol import protocol_table
from ..radiograph import Radiograph
from ..simulate import simulate, versions
from .plan import Case, Plan, Shot

Row = dict[str, Any]


def make_cohort(
    plan: Plan,
    folder: str | Path,
    *,
    workers: int = 2,
    engine: str = "scanline",
    progress: Callable[[int], None] = lambda made: None,
) -> Path:
    """Make what is missing of a cohort and write its manifest; the bytes do not depend on the number of workers.

    folder    of this cohort; what an earlier run left there is checked against its hashes and kept
    engine    "scanline", or "embree", which gives the same path lengths in fifteen times the time
    progress  called with the number of radiographs that have come to stand, as they do
    returns   the path of the manifest (CSV, one row a radiograph)
    raises    InputError for a folder that holds another cohort, a damaged file in it, a disk that cannot be written
    """
    require_whole("workers", workers, 1, 256, "processes")
    folder = Path(folder)
    records.claim(folder / "cohort.json", {**plan.table(), "engine": engine, "versions": versions()})
    rows: dict[int, list[Row]] = {}
    missing = []
    for case in plan.cases:
        known = records.read_rows(folder, case.index, [shot.name for shot in case.shots])
        if known is None:
            missing.append(case)
        else:
            rows[case.index] = known
            progress(len(case.shots))

    def stands(index: int, made: list[Row]) -> None:
        rows[missing[index].index] = made
        progress(len(missing[index].shots))

    # Cores that have no knee of their own work on the rays of one.
    threads = max(1, workers // max(1, len(missing)))
    shared = {"folder": folder, "engine": engine, "threads": threads}
    ordered_map(make_case, missing, shared=shared, workers=workers, arrived=stands)
    manifest = folder / "manifest.csv"
    records.write_csv(manifest, [row for case in plan.cases for row in rows[case.index]])
    return manifest


def make_case(case: Case, folder: Path, engine: str, threads: int) -> list[Row]:
    """Make and save every radiograph of one knee, then its record; returns its rows of the manifest."""
    scene = anatomy.build(case.knee)
    rows = []
    for shot in case.shots:
        radiograph = simulate(case.knee, shot.protocol, seed=shot.seed, engine=engine, workers=threads, scene=scene)
        path = save(radiograph, folder / "images" / f"{shot.name}.tif")
        rows.append(_row(case, shot, radiograph, path.relative_to(folder), records.sha256(path)))
    records.write_rows(folder, case.index, rows)
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
