"""Make a virtual trial: run it, and write its tables and report."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..data.analysis.trial_table import TrialDesign
from ..io.atomic_write import write_bytes
from ..io.study_results import save_table
from .trial_design import CAUSES
from .trial_power import check_power
from .trial_report import render_trial_page
from .trial_run import run_trial
from .trial_sites import recognise_sites, summarise_sites
from .trial_statistics import decompose_errors, summarise_alignment, summarise_measures
from .trial_what_if import change_design, estimate_what_if

REPORT_FILE = "trial.html"


def make_trial(
    design: TrialDesign,
    folder: str | Path,
    *,
    without: Sequence[str] = tuple(CAUSES),
    what_if: Mapping[str, float] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Path:
    """Run a trial, and write its tables and report.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    folder : str or Path
        Output folder. The records of an earlier run of the same design are reused.
    without : sequence of str
        Causes of measurement error that are left out in turn, from `trial_design.CAUSES`.
    what_if : mapping of str to float, optional
        Changes whose effect is estimated without a new simulation; see `trial_what_if.change_design`.
    workers : int, optional
        Number of local processes, 1 to 256. None starts one process per available core.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers must access `folder` under the same path.
    progress : callable
        Function that is called with 1 for each finished subject and cause.

    Returns
    -------
    Path
        Path of the report.

    Raises
    ------
    InputError
        If a view, cause or change is unknown, the folder contains another trial, a subject cannot be built, the disk is
        not writable, or the scheduler cannot be reached.
    WorkersLostError
        If workers are killed repeatedly.
    """
    changed = change_design(design, what_if) if what_if else None
    radiographs = run_trial(design, folder, without=without, workers=workers, scheduler=scheduler, progress=progress)
    measures = summarise_measures(radiographs, design)
    tables = {
        "measures": measures,
        "causes": decompose_errors(radiographs, design),
        "alignment": summarise_alignment(radiographs, design),
        "sites": summarise_sites(radiographs, design),
        "site_recognition": recognise_sites(radiographs, design),
        "planned_power": check_power(design, measures, workers=workers or 1),
    }
    if changed is not None:
        tables["what_if"] = estimate_what_if(radiographs, design, changed)
    for name, table in tables.items():
        save_table(Path(folder) / f"{name}.csv", table)
    path = Path(folder) / REPORT_FILE
    write_bytes(path, render_trial_page(design, tables).encode())
    return path
