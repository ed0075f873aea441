"""Run a virtual trial: simulate the missing subjects, and write the table of all radiographs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from ..cohort.run_environment import CODE_PATHS, RunEnvironment, find_file_library_versions, require_same_environment
from ..core.checks import InputError, require_choice, require_workers
from ..core.processes.parallel_map import count_cores, map_in_parallel, require_scheduler
from ..data.analysis.trial_table import TrialDesign
from ..data.code_hash import compute_code_hashes, list_pixel_data_files
from ..data.imaging.display_table import load_display_processing
from ..data.knees.oarsi_table import load_oarsi_thresholds
from ..data.user_files import read_json
from ..io.atomic_write import delete_stale_temporary_files, make_folder
from ..io.cohort_records import claim_folder, write_json
from ..io.study_results import save_table
from ..model.protocol import Protocol, load_protocol, protocol_to_dict
from ..model.sampling.knee_sampling import load_knee_distributions
from ..simulation import collect_versions
from .trial_design import CAUSES, IMAGE_CAUSES, describe_design
from .trial_measurement import Row, measure_subject, resolve_displays

DESIGN_FILE = "trial.json"
RADIOGRAPHS_FILE = "radiographs.csv"
_RECORDS = "subjects"
# Further code that affects the measurements. Statistics and report are made anew by every run.
_OWN_CODE_PATHS = (
    *("trial/trial_design.py", "trial/trial_plan.py", "trial/trial_measurement.py"),
    *("reader", "texture", "data/progress.toml", "data/knees/progression_table.py", "data/reader"),
)


def run_trial(
    design: TrialDesign,
    folder: str | Path,
    *,
    without: Sequence[str] = tuple(CAUSES),
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> pd.DataFrame:
    """Simulate and measure the missing subjects of a trial.

    The same design, code and library versions give byte-identical files for any number of workers. Every subject has
    one file for the trial itself, and one for each cause of error that is left out, so that another cause needs only
    its own radiographs.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    folder : str or Path
        Output folder. The records of an earlier run of the same design are reused.
    without : sequence of str
        Causes of measurement error that are left out in turn, from `CAUSES`.
    workers : int, optional
        Number of local processes, 1 to 256. None starts one process per available core.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers must access `folder` under the same path.
    progress : callable
        Function that is called with 1 for each finished subject and cause.

    Returns
    -------
    DataFrame
        One row per radiograph; see ``radiographs.csv`` in the reference of files.

    Raises
    ------
    InputError
        If a view or cause is unknown, the folder contains another trial, a subject cannot be built, the disk is not
        writable, or the scheduler cannot be reached.
    WorkersLostError
        If workers are killed repeatedly.
    """
    workers = count_cores() if workers is None else workers
    require_workers(workers, "processes")
    if scheduler is not None:
        require_scheduler(scheduler)
    folder, views = Path(folder), load_views(design)
    versions = {**collect_versions(), **find_file_library_versions()}
    code = compute_code_hashes((*CODE_PATHS, *_OWN_CODE_PATHS, *list_pixel_data_files()))
    specified = {
        "design": describe_design(design),
        "views": {name: protocol_to_dict(view) for name, view in views.items()},
        "versions": versions,
        "code": code,
    }
    jobs, claim = _list_jobs(design, without), claim_folder(folder / DESIGN_FILE, specified)
    delete_stale_temporary_files(make_folder(folder / _RECORDS))
    site = RunEnvironment(
        folder=folder.absolute(), claim=DESIGN_FILE, claim_sha256=claim, versions=versions, code_hashes=code
    )
    records = {job: _read_record(folder, job, claim) for job in jobs}
    missing = [job for job, rows in records.items() if rows is None]
    for _ in range(len(jobs) - len(missing)):
        progress(1)
    shared = {
        "design": design,
        "views": views,
        "distributions": load_knee_distributions(design.population.grade_table),
        "displays": resolve_displays(design, load_display_processing()),
        "cuts": load_oarsi_thresholds(),
        "site": site,
    }
    map_in_parallel(
        measure_and_save, missing, shared=shared, workers=workers, scheduler=scheduler,
        on_result=lambda index, done: progress(1),
    )  # fmt: skip
    records |= {job: _read_record(folder, job, claim) for job in missing}
    table = pd.DataFrame([row for rows in records.values() for row in rows or ()])
    save_table(folder / RADIOGRAPHS_FILE, table)
    return table


def load_views(design: TrialDesign) -> dict[str, Protocol]:
    """Load the protocols of the views, with the pixel size of the design.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    dict of str to Protocol
        Nominal protocol of each view.

    Raises
    ------
    InputError
        If a view is unknown or not frontal.
    """
    views = {}
    for name in design.views:
        view = load_protocol(name)
        if not view.posture.is_frontal or view.knee_distance_mm:
            raise InputError(f"views must be frontal views of one knee, got {name}")
        if design.pixel_mm:
            factor = view.pixel_mm / design.pixel_mm
            view = replace(
                view,
                pixel_mm=design.pixel_mm,
                rows=round(view.rows * factor),
                cols=round(view.cols * factor),
            )
        views[name] = view
    return views


# Number of a subject, and the cause of error that is left out; empty for the trial itself.
_Job = tuple[int, str]


def _list_jobs(design: TrialDesign, without: Sequence[str]) -> list[_Job]:
    """List the subjects of the trial, and those that are simulated again without each cause.

    An unknown cause raises InputError.
    """
    for cause in without:
        require_choice("without", cause, tuple(CAUSES))
    causes = [cause for cause in without if cause not in IMAGE_CAUSES or "network" in design.readers]
    again = range(min(design.cause_subjects, design.subjects))
    return [(number, "") for number in range(design.subjects)] + [
        (number, cause) for number in again for cause in causes
    ]


def count_subject_jobs(design: TrialDesign, without: Sequence[str] = tuple(CAUSES)) -> int:
    """Count the subjects to simulate, including those that are simulated again without a cause.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    without : sequence of str
        Causes of measurement error that are left out in turn.

    Returns
    -------
    int
        Number of subjects and causes.
    """
    return len(_list_jobs(design, without))


def measure_and_save(job: _Job, *, site: RunEnvironment, design: TrialDesign, **shared: Any) -> int:
    """Measure the radiographs of a subject, and write their record.

    Parameters
    ----------
    job : tuple
        Number of the subject, and the cause of error that is left out.
    site : RunEnvironment
        Folder, library versions and code hashes that the worker must match.
    design : TrialDesign
        Design of the trial.
    **shared
        Further arguments of `measure_subject`.

    Returns
    -------
    int
        Number of radiographs.

    Raises
    ------
    InputError
        If the folder, a library version or the code differs, or the subject cannot be built.
    """
    require_same_environment(site)
    rows = measure_subject(job[0], design=design, without=job[1], **shared)
    write_json(_record_path(site.folder, job), {"design_sha256": site.claim_sha256, "radiographs": rows})
    return len(rows)


def _record_path(folder: Path, job: _Job) -> Path:
    """Return the path of the record of a subject."""
    number, cause = job
    return folder / _RECORDS / (f"{number:06d}_without_{cause}.json" if cause else f"{number:06d}.json")


def _read_record(folder: Path, job: _Job, claim: str) -> list[Row] | None:
    """Read the rows of a subject; None if there is no record of this trial."""
    path = _record_path(folder, job)
    if not path.exists():
        return None
    record: dict[str, Any] = read_json(path, dict[str, Any])
    return record["radiographs"] if record.get("design_sha256") == claim else None
