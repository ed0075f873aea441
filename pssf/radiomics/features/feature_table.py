"""Feature table: parallel measurement of many radiographs, and reuse of records from an earlier run."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.label_names import TIBIAL_LANDMARKS
from ...core.processes.execution import Execution
from ...core.processes.parallel_map import map_in_parallel
from ...core.stage_timer import make_interval_check
from ...data.code_hash import compute_code_hashes, require_same_code
from ..localisation.joint_localisation import JointLocation, Landmarks
from ..localisation.region_of_interest import cut_region
from ..localisation.region_placement import hash_reader, locate_region
from ..localisation.templates import Template
from ..radiomics_tables import RadiomicsTables
from .area_features import measure_areas
from .feature_backends import BACKENDS, default_backend
from .feature_families import FAMILIES, SQUARE

Record = dict[str, Any]
LoadPixels = Callable[[str], NDArray[np.uint16]]
Measurement = tuple[Record, dict[str, float]]
# Additional columns in the record of a displayed radiograph: side, polarity, source of the pixel size, number of knees.
FILM_COLUMNS = ("film_side", "film_polarity", "film_pixel_from", "film_knees")
TEXT_COLUMNS = ("radiograph", "sha256", "settings", "checksum", "status", *FILM_COLUMNS)
SCORE_COLUMNS = ("score", "compartment_score", "side_margin", "orientation_margin", "scale")
# Columns of the landmarks by which areas were placed; only in records with areas other than the square.
LANDMARK_COLUMNS = tuple(f"{name}_{axis}_px" for name in TIBIAL_LANDMARKS for axis in ("row", "col"))
# Minimum joint space of each compartment as a fraction of the plateau width, measured by the reader.
JSW_COLUMNS = ("jsw_medial_share", "jsw_lateral_share")
NON_FEATURE_COLUMNS = (
    *(*TEXT_COLUMNS, "row_px", "col_px", "film_pixel_mm"),
    *(*SCORE_COLUMNS, *LANDMARK_COLUMNS, *JSW_COLUMNS),
)
# Subpackages whose code and tables affect feature records. Their hashes are included in the settings hash.
_CODE_PACKAGES = ("core", "data", "detector", "io", "radiomics", "reader", "texture")
_LIBRARIES = ("numpy", "scikit-image", "scipy")
# Columns of a table of radiographs that a measurement uses.
_JOB_COLUMNS = ("radiograph", "file", "sha256", "side", "pixel_mm")
# Minimum time between two calls of `save` by `measure_radiographs`, in seconds.
SAVE_INTERVAL_S = 10


@dataclass(frozen=True, kw_only=True)
class MeasurementJob:
    """One radiograph to measure.

    Attributes
    ----------
    radiograph : str
        Name of the radiograph.
    file : str
        File name, passed to the function that loads pixels.
    sha256 : str
        SHA-256 hash of the file.
    side : {"right", "left"} or None
        Left or right knee; None only for a patient radiograph of unknown side.
    pixel_mm : float or None
        Pixel size, in mm; None only for a patient radiograph of unknown pixel size.
    place_px : (row, column) tuple or None, default None
        True position of the medial joint line, in pixels; None if unknown or not used.
    landmarks_px : dict of str to (row, column) tuple, or None, default None
        True landmarks of the tibia, in pixels; None if unknown or not used.
    """

    radiograph: str
    file: str
    sha256: str
    side: str | None
    pixel_mm: float | None
    place_px: tuple[float, float] | None = None
    landmarks_px: Landmarks | None = None


@dataclass(frozen=True, kw_only=True)
class ExtractionSettings:
    """Settings for the measurement of radiographs with linear pixels.

    Parameters
    ----------
    region_px : int
        Edge length of the region, in pixels.
    bins : int
        Number of grey-level bins.
    families : tuple of str
        Feature families to measure.
    backend : str
        Feature library, "pyradiomics" or "mirp". The default is pyradiomics if it is installed, else MIRP.
    regions : {"template", "reader", "truth"}
        Source of the position of the region.
    areas : tuple of str
        Areas to measure, from `feature_families.AREAS`. Areas other than "square" need landmarks.
    """

    region_px: int = 512
    bins: int = 64
    families: tuple[str, ...] = FAMILIES
    backend: str = field(default_factory=default_backend)
    regions: str = "template"
    areas: tuple[str, ...] = (SQUARE,)


def measure_radiographs(
    jobs: Sequence[MeasurementJob],
    *,
    load_pixels: Callable[[str], Any],
    templates: Sequence[Template],
    settings: Any,
    tables: RadiomicsTables,
    execution: Execution | None = None,
    known_records: Mapping[str, Record] | None = None,
    save: Callable[[list[Record]], None] = lambda records: None,
    measure_job: Callable[..., Measurement] | None = None,
    stage_name: str = "regions and features",
) -> tuple[list[Record], dict[str, float]]:
    """Measure radiographs in parallel, and reuse records from an earlier run.

    Parameters
    ----------
    jobs : sequence of MeasurementJob
        Radiographs to measure.
    load_pixels : callable
        Function that returns the pixels (rows, cols), or another input of `measure_job`, for a file name. It must be
        picklable if several workers are used.
    templates : sequence of Template
        Template radiographs.
    settings : ExtractionSettings or other settings of `measure_job`
        Measurement settings.
    tables : RadiomicsTables
        Localisation settings and IBSI tags.
    execution : Execution or None
        Number of workers and progress display. If None, one process without progress display is used.
    known_records : dict of str to dict, or None
        Records from an earlier run, keyed by SHA-256 of the file. A record is reused if its settings are the same and
        its checksum is correct.
    save : callable
        Function that is called at intervals with a list of all finished records, so that an interrupted run can resume.
    measure_job : callable or None
        Function that measures one radiograph; None means `measure_radiograph`.
    stage_name : str
        Label of the progress display.

    Returns
    -------
    records : list of dict
        Records in the order of the jobs.
    seconds : dict of str to float
        Total run time of the steps "localisation" and "features".

    Raises
    ------
    InputError
        The code version of a worker process differs from the code version of the main process.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    execution, key = execution or Execution(), hash_settings(templates, settings)
    known_records = {sha: record for sha, record in (known_records or {}).items() if _is_current(record, key)}
    records: dict[int, Record] = {}
    for index, job in enumerate(jobs):
        if job.sha256 in known_records:
            records[index] = {**known_records[job.sha256], "radiograph": job.radiograph}
    missing = [index for index in range(len(jobs)) if index not in records]
    seconds = {"localisation": 0.0, "features": 0.0}
    due = make_interval_check(SAVE_INTERVAL_S)

    def arrived(nth: int, result: tuple[Record, dict[str, float]]) -> None:
        record = {**result[0], "settings": key}
        records[missing[nth]] = {**record, "checksum": _checksum(record)}
        for step, spent in result[1].items():
            seconds[step] += spent
        stage.advance()
        if due():
            save([records[index] for index in sorted(records)])

    with execution.stage(stage_name, "radiographs", len(jobs)) as stage:
        stage.add_already_done(len(records))
        shared = {"load_pixels": load_pixels, "templates": templates, "settings": settings, "tables": tables}
        map_in_parallel(
            measure_job or measure_radiograph,
            [jobs[index] for index in missing],
            shared=shared | {"code": compute_code_hashes(_CODE_PACKAGES)},
            workers=execution.workers,
            scheduler=execution.scheduler,
            on_result=arrived,
        )
        in_order = [records[index] for index in range(len(jobs))]
        save(in_order)
    return in_order, seconds


def measure_radiograph(
    job: MeasurementJob,
    *,
    load_pixels: LoadPixels,
    templates: Sequence[Template],
    settings: ExtractionSettings,
    tables: RadiomicsTables,
    code: Mapping[str, str],
) -> Measurement:
    """Measure one radiograph with linear pixels.

    If the best match is rejected, an area extends beyond the image or its texture cannot be measured, the record
    contains the reason, the position and scores of the match, but no features.

    Parameters
    ----------
    job : MeasurementJob
        Radiograph to measure, with known side and pixel size.
    load_pixels : callable
        Function that returns linear pixels (rows, cols) in DN, given the file name.
    templates : sequence of Template
        Template radiographs.
    settings : ExtractionSettings
        Measurement settings.
    tables : RadiomicsTables
        Localisation settings and IBSI tags.
    code : dict of str to str
        Code hashes of the process that started the run, from `compute_code_hashes`.

    Returns
    -------
    record : dict of str to object
        Location, scores and features by column name.
    seconds : dict of str to float
        Run time of the steps "localisation" and "features".

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    assert job.side is not None
    assert job.pixel_mm is not None
    began = perf_counter()
    pixels = load_pixels(job.file)
    joint = locate_region(
        pixels,
        templates,
        tables.localisation,
        regions=settings.regions,
        side=job.side,
        pixel_mm=job.pixel_mm,
        region_px=settings.region_px if SQUARE in settings.areas else 1,
        place_px=job.place_px,
        landmarks_px=job.landmarks_px,
    )
    located = perf_counter()
    record: Record = {
        "radiograph": job.radiograph,
        "sha256": job.sha256,
        "status": joint.status,
        "row_px": joint.row,
        "col_px": joint.col,
        **{name: getattr(joint, name) for name in SCORE_COLUMNS},
    }
    if joint.status == "found":
        # The square may extend beyond the image if it is not measured.
        has_square = SQUARE in settings.areas
        measured = measure_areas(
            pixels,
            cut_region(pixels, joint.row, joint.col, settings.region_px) if has_square else None,
            joint,
            job.pixel_mm,
            tables.tags,
            settings=settings,
            bones=_cut_bones(joint, settings.region_px) if has_square else None,
        )
        record |= measured | make_landmark_columns(joint, settings.areas)
    return record, {"localisation": located - began, "features": perf_counter() - located}


def make_landmark_columns(joint: JointLocation, areas: tuple[str, ...]) -> Record:
    """Make the columns of the landmarks by which areas were placed.

    Parameters
    ----------
    joint : JointLocation
        Location of the joint.
    areas : tuple of str
        Measured areas.

    Returns
    -------
    dict of str to float
        Row and column of each tibial landmark, in pixels of the radiograph; empty if only the square is measured.
    """
    if joint.landmarks_px is None or set(areas) == {SQUARE}:
        return {}
    places = [place for name in TIBIAL_LANDMARKS for place in joint.landmarks_px[name]]
    return dict(zip(LANDMARK_COLUMNS, map(float, places), strict=True))


def read_landmark_columns(row: Mapping[str, Any], prefix: str = "") -> dict[str, tuple[float, float]]:
    """Read the landmarks of the tibia from the columns of a record or manifest.

    Parameters
    ----------
    row : dict of str to object
        Row with the columns LANDMARK_COLUMNS.
    prefix : str, default ""
        Text before the name of each column, such as "truth_" in a manifest.

    Returns
    -------
    dict of str to (row, column) tuple
        Landmarks, in pixels.
    """
    return {
        name: (float(row[f"{prefix}{name}_row_px"]), float(row[f"{prefix}{name}_col_px"])) for name in TIBIAL_LANDMARKS
    }


def make_measurement_jobs(rows: Iterable[Mapping[str, Any]]) -> list[MeasurementJob]:
    """Make one measurement job per row of a table of radiographs.

    Parameters
    ----------
    rows : iterable of dict
        Rows with the columns ``radiograph``, ``file``, ``sha256``, ``side`` and ``pixel_mm``; others are ignored.

    Returns
    -------
    list of MeasurementJob
        Jobs without a true position of the joint.
    """
    return [MeasurementJob(**{name: row[name] for name in _JOB_COLUMNS}) for row in rows]


def _cut_bones(joint: JointLocation, region_px: int) -> NDArray[np.bool_] | None:
    """Cut the masks of the bones, if there are any, to the region that is measured."""
    if joint.bones is None:
        return None
    return np.asarray(cut_region(joint.bones, joint.row, joint.col, region_px), dtype=np.bool_)


def hash_settings(templates: Sequence[Template], settings: Any) -> str:
    """Compute a hash of all inputs of a feature record except pixels: settings, templates, code and library versions.

    Parameters
    ----------
    templates : sequence of Template
        Template radiographs.
    settings : ExtractionSettings or DisplayExtractionSettings
        Measurement settings that the hash includes.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    libraries = (*_LIBRARIES, *BACKENDS[settings.backend].libraries)
    at: list[Any] = [template.scalar_values for template in templates]
    if settings.regions == "reader":
        at += hash_reader()
    facts = [vars(settings), at, compute_code_hashes(_CODE_PACKAGES), {name: version(name) for name in libraries}]
    digest = hashlib.sha256(json.dumps(facts).encode())
    for template in templates:
        digest.update(template.pixel_bytes)
    return digest.hexdigest()[:16]


def _is_current(record: Mapping[str, Any], key: str) -> bool:
    """Report whether a feature record has the current settings hash and a correct checksum."""
    return record.get("settings") == key and record.get("checksum") == _checksum(record)


def _checksum(record: Mapping[str, Any]) -> str:
    """Compute the checksum of a feature record, excluding the radiograph name and NaN values."""
    texts = {name: value if name in TEXT_COLUMNS else repr(float(value)) for name, value in sorted(record.items())}
    kept = {name: value for name, value in texts.items() if value != "nan" and name not in ("radiograph", "checksum")}
    return hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:16]
