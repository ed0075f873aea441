"""One record a radiograph: where the region was found, and its features. Records that are there already are kept."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.execution import Execution
from ..core.parallel import ordered_map
from ..core.timer import seldom
from ..data.code import code_digest, require_code
from .backends import BACKENDS, default_backend
from .families import FAMILIES
from .features import extract
from .locate import find_joint
from .patches import Template
from .region import cut_region
from .tables import RadiomicsTables

Record = dict[str, Any]
Load = Callable[[str], NDArray[np.uint16]]
Measured = tuple[Record, dict[str, float]]
# Of a radiograph as displayed: what was found of it, beside its place.
FOUND = ("film_side", "film_polarity", "film_pixel_from", "film_knees")
TEXT = ("radiograph", "sha256", "settings", "checksum", "status", *FOUND)
SCORES = ("score", "narrow", "side_margin", "way_margin", "scale")
NOT_FEATURES = (*TEXT, "row_px", "col_px", "film_pixel_mm", *SCORES)
# What a record depends on beside the file, templates and `How`: code and tables of the package, what reads files too.
_CODE = ("core", "data", "detector", "io", "radiomics")
_LIBRARIES = ("numpy", "scikit-image", "scipy")
SAVE_SECONDS = 10


@dataclass(frozen=True, kw_only=True)
class Job:
    """One radiograph to measure; `file` is what the loader is asked for.

    side      right | left; None only of a film, where it is not known; pixel_mm likewise
    """

    radiograph: str
    file: str
    sha256: str
    side: str | None
    pixel_mm: float | None


@dataclass(frozen=True, kw_only=True)
class How:
    """How a radiograph is measured: everything but its pixels that a record depends on."""

    region_px: int = 512
    bins: int = 64
    families: tuple[str, ...] = FAMILIES
    backend: str = field(default_factory=default_backend)


def extract_all(
    jobs: Sequence[Job],
    *,
    load_pixels: Callable[[str], Any],
    templates: Sequence[Template],
    how: Any,
    tables: RadiomicsTables,
    execution: Execution | None = None,
    known: Mapping[str, Record] | None = None,
    save: Callable[[list[Record]], None] = lambda records: None,
    by: Callable[..., Measured] | None = None,
    stage_name: str = "regions and features",
) -> tuple[list[Record], dict[str, float]]:
    """Records in the order of the jobs, whoever does the work, and the seconds of work in each step.

    load_pixels  file -> (rows, cols) integers, or what else `by` takes; picklable for more than one worker
    how          a `How`, or what else `by` takes
    tables       by which joints are found and features known
    by           what measures one radiograph; None: `measure`
    known        sha256 -> record of an earlier run; used where its settings are the same and nothing in it has changed
    save         is given all records so far, now and then, so that a run that breaks off can go on from there
    raises       InputError for a worker with other code; WorkersLostError when workers keep being killed
    """
    execution, key = execution or Execution(), settings_key(templates, how)
    known = {sha: record for sha, record in (known or {}).items() if _stands(record, key)}
    records: dict[int, Record] = {}
    for index, job in enumerate(jobs):
        if job.sha256 in known:
            records[index] = {**known[job.sha256], "radiograph": job.radiograph}
    missing = [index for index in range(len(jobs)) if index not in records]
    seconds = {"localisation": 0.0, "features": 0.0}
    due = seldom(SAVE_SECONDS)

    def arrived(nth: int, result: tuple[Record, dict[str, float]]) -> None:
        record = {**result[0], "settings": key}
        records[missing[nth]] = {**record, "checksum": _checksum(record)}
        for step, spent in result[1].items():
            seconds[step] += spent
        stage.advance()
        if due():
            save([records[index] for index in sorted(records)])

    with execution.stage(stage_name, "radiographs", len(jobs)) as stage:
        stage.keep(len(records))
        shared = {"load_pixels": load_pixels, "templates": templates, "how": how, "tables": tables}
        ordered_map(
            by or measure,
            [jobs[index] for index in missing],
            shared=shared | {"code": code_digest(_CODE)},
            workers=execution.workers,
            scheduler=execution.scheduler,
            arrived=arrived,
        )
        in_order = [records[index] for index in range(len(jobs))]
        save(in_order)
    return in_order, seconds


def measure(
    job: Job,
    *,
    load_pixels: Load,
    templates: Sequence[Template],
    how: How,
    tables: RadiomicsTables,
    code: Mapping[str, str],
) -> Measured:
    """The record of one radiograph, and the seconds each step took.

    A match that is refused has its place and score in the record, and no features.

    tables  by which the joint is found and features known
    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    assert job.side is not None
    assert job.pixel_mm is not None
    began = perf_counter()
    pixels = load_pixels(job.file)
    joint = find_joint(
        pixels, templates, tables.localisation, side=job.side, pixel_mm=job.pixel_mm, region_px=how.region_px
    )
    located = perf_counter()
    record: Record = {
        "radiograph": job.radiograph,
        "sha256": job.sha256,
        "status": joint.status,
        "row_px": joint.row,
        "col_px": joint.col,
        **{name: getattr(joint, name) for name in SCORES},
    }
    if joint.status == "found":
        region = cut_region(pixels, joint.row, joint.col, how.region_px)
        record |= extract(region, job.pixel_mm, tables.tags, how.bins, how.families, how.backend)
    return record, {"localisation": located - began, "features": perf_counter() - located}


def settings_key(templates: Sequence[Template], how: Any) -> str:
    """Short text that changes with anything but the pixels that a record depends on, code and libraries included."""
    libraries = (*_LIBRARIES, *BACKENDS[how.backend].libraries)
    at = [template.facts for template in templates]
    facts = [vars(how), at, code_digest(_CODE), {name: version(name) for name in libraries}]
    digest = hashlib.sha256(json.dumps(facts).encode())
    for template in templates:
        digest.update(template.content)
    return digest.hexdigest()[:16]


def _stands(record: Mapping[str, Any], key: str) -> bool:
    return record.get("settings") == key and record.get("checksum") == _checksum(record)


def _checksum(record: Mapping[str, Any]) -> str:
    """Of all values but the radiograph's name; one that is not there is as good as one that is not a number."""
    texts = {name: value if name in TEXT else repr(float(value)) for name, value in sorted(record.items())}
    kept = {name: value for name, value in texts.items() if value != "nan" and name not in ("radiograph", "checksum")}
    return hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:16]
