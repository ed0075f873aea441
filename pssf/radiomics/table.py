"""One record a radiograph: where the region was found, and its features. Records that are there already are kept."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from inspect import getsource
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.parallel import ordered_map
from . import FAMILIES, bone, features, region
from .features import extract
from .region import Template, cut_region, find_joint

Record = dict[str, Any]
Load = Callable[[str], NDArray[np.uint16]]
TEXT = ("radiograph", "sha256", "settings", "checksum", "status")
NOT_FEATURES = (*TEXT, "row_px", "col_px", "score", "scale")


@dataclass(frozen=True, kw_only=True)
class Job:
    """One radiograph to measure; `file` is what the loader is asked for."""

    radiograph: str
    file: str
    sha256: str
    side: str
    pixel_mm: float


@dataclass(frozen=True, kw_only=True)
class How:
    """How a radiograph is measured: everything but its pixels that a record depends on."""

    region_px: int = 512
    bins: int = 64
    min_score: float = 0.5
    families: tuple[str, ...] = FAMILIES


def extract_all(
    jobs: Sequence[Job],
    *,
    load_pixels: Load,
    templates: Sequence[Template],
    how: How,
    workers: int = 1,
    scheduler: str | None = None,
    known: Mapping[str, Record] | None = None,
    save: Callable[[list[Record]], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Record], dict[str, float]]:
    """Records in the order of the jobs, the same on any number of workers, and the seconds of work in each step.

    load_pixels  file -> (rows, cols) integers; picklable if workers > 1
    scheduler    address of a Dask scheduler whose workers do it instead; None: processes of this machine
    known        sha256 -> record of an earlier run; used where its settings are the same and nothing in it has changed
    save         is given all records so far, now and then, so that a run that breaks off can go on from there
    progress     is told how many of how many are done
    """
    key = settings_key(templates, how)
    known = {sha: record for sha, record in (known or {}).items() if _stands(record, key)}
    records: dict[int, Record] = {}
    for index, job in enumerate(jobs):
        if job.sha256 in known:
            records[index] = {**known[job.sha256], "radiograph": job.radiograph}
    missing = [index for index in range(len(jobs)) if index not in records]
    seconds = {"localisation": 0.0, "features": 0.0}
    saved_at = perf_counter()

    def arrived(nth: int, result: tuple[Record, dict[str, float]]) -> None:
        nonlocal saved_at
        record = {**result[0], "settings": key}
        records[missing[nth]] = {**record, "checksum": _checksum(record)}
        for step, spent in result[1].items():
            seconds[step] += spent
        if progress is not None:
            progress(len(records), len(jobs))
        if save is not None and perf_counter() - saved_at > 10:
            save([records[index] for index in sorted(records)])
            saved_at = perf_counter()

    shared = {"load_pixels": load_pixels, "templates": templates, "how": how}
    todo = [jobs[index] for index in missing]
    ordered_map(measure, todo, shared=shared, workers=workers, scheduler=scheduler, arrived=arrived)
    in_order = [records[index] for index in range(len(jobs))]
    if save is not None:
        save(in_order)
    return in_order, seconds


def measure(job: Job, *, load_pixels: Load, templates: Sequence[Template], how: How) -> tuple[Record, dict[str, float]]:
    """The record of one radiograph, and the seconds each step took.

    A match that is refused has its place and score in the record, and no features.
    """
    began = perf_counter()
    pixels = load_pixels(job.file)
    joint = find_joint(
        pixels, templates, side=job.side, pixel_mm=job.pixel_mm, region_px=how.region_px, min_score=how.min_score
    )
    located = perf_counter()
    record: Record = {
        "radiograph": job.radiograph,
        "sha256": job.sha256,
        "status": joint.status,
        "row_px": joint.row,
        "col_px": joint.col,
        "score": joint.score,
        "scale": joint.scale,
    }
    if joint.status == "found":
        record |= extract(cut_region(pixels, joint.row, joint.col, how.region_px), job.pixel_mm, how.bins, how.families)
    return record, {"localisation": located - began, "features": perf_counter() - located}


def settings_key(templates: Sequence[Template], how: How) -> str:
    """Short text that changes with anything but the pixels that a record depends on, this code included."""
    at = [(template.row, template.col, template.pixel_mm) for template in templates]
    facts = [vars(how), at, _code(), version("pyradiomics"), version("scikit-image"), version("pssf")]
    digest = hashlib.sha256(json.dumps(facts).encode())
    for template in templates:
        digest.update(np.ascontiguousarray(template.pixels).tobytes())
    return digest.hexdigest()[:16]


def _stands(record: Mapping[str, Any], key: str) -> bool:
    return record.get("settings") == key and record.get("checksum") == _checksum(record)


def _checksum(record: Mapping[str, Any]) -> str:
    """Of all values but the radiograph's name; one that is not there is as good as one that is not a number."""
    told = {name: value if name in TEXT else repr(float(value)) for name, value in sorted(record.items())}
    kept = {name: value for name, value in told.items() if value != "nan" and name not in ("radiograph", "checksum")}
    return hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:16]


@cache
def _code() -> str:
    return hashlib.sha256("".join(map(getsource, (region, bone, features))).encode()).hexdigest()
