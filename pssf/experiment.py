"""The whole experiment: a preset's cohort is made, then studied."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .cohort import Plan, make_cohort, plan_cohort, plan_repeats
from .files.atomic import sweep
from .files.images import load
from .files.records import read_manifest
from .knee import Knee
from .progress import Pace
from .protocol import load_protocol
from .simulate import simulate
from .study import StudyResult, StudySettings, require_extra, run

if TYPE_CHECKING:
    import pandas as pd

    from .radiomics.region import Template

# Shows a stage: its name and total give a context that yields what counts it.
Bar = Callable[[str, int], AbstractContextManager[Pace]]


def run_experiment(
    out: Path, *, preset: str, seed: int, workers: int, engine: str, bar: Bar, scheduler: str | None = None
) -> StudyResult:
    """Cohort, repeats, regions, features, models, report; goes on where an earlier run in the same folder stopped.

    out        folder: the cohort goes into out/cohort, knees taken again into out/repeats, the rest beside them
    workers    processes; no result depends on them
    bar        shows the progress of a stage
    scheduler  address of a Dask scheduler whose workers make the radiographs; what follows is done here all the same
    raises     InputError for an unknown preset, a missing library, a folder that holds something else or is unwritable,
               a scheduler that cannot be used; WorkersLostError when workers keep being killed
    """
    require_extra()
    plan = plan_cohort(preset, seed=seed)
    how = {"workers": workers, "scheduler": scheduler, "engine": engine}
    start = perf_counter()
    path = _made(plan, out / "cohort", "radiographs", bar, how)
    for folder in (out, out / "pictures", out / "models"):
        sweep(folder)
    seconds = {"cohort": perf_counter() - start}
    start = perf_counter()
    again = _taken_again(plan, out, bar, how)
    if again is not None:
        seconds["repeats"] = perf_counter() - start
    start = perf_counter()
    template = standard_template(engine)
    seconds["template"] = perf_counter() - start
    with ExitStack() as stack:
        return run(
            _below("cohort", read_manifest(path)),
            partial(_pixels, out),
            template,
            StudySettings(repeats=plan.repeats, seed=seed),
            out,
            again=again,
            seconds=seconds,
            workers=workers,
            progress=_stages(stack, bar),
        )


def standard_template(engine: str = "embree") -> "Template":
    """The standard knee without noise under the protocol `reference`, which regions are looked for with."""
    from .radiomics.region import Template  # needs the extra `study`

    protocol = load_protocol("reference")
    radiograph = simulate(Knee(), protocol, engine=engine, keep=("noise_free",))
    assert radiograph.truth is not None
    row, col = radiograph.truth.medial_joint_line_px
    return Template(pixels=radiograph.kept["noise_free"], row=row, col=col, pixel_mm=protocol.pixel_mm)


def _made(plan: Plan, folder: Path, what: str, bar: Bar, how: dict[str, Any]) -> Path:
    """Make what is missing of a plan, with a bar of its own; returns the manifest."""
    with bar(what, sum(len(case.shots) for case in plan.cases)) as pace:
        return make_cohort(plan, folder, progress=pace.made, found=pace.found, **how)


def _taken_again(plan: Plan, out: Path, bar: Bar, how: dict[str, Any]) -> "pd.DataFrame | None":
    """Make the repeats of a plan; their manifest with the knee that each is of, kind and turn."""
    repeats = plan_repeats(plan)
    if repeats is None:
        return None
    path = _made(repeats, out / "repeats", "repeats", bar, how)
    table = _below("repeats", read_manifest(path))
    told = table["radiograph"].str.extract(r"_k(?P<knee>\d+)_(?P<kind>[a-z]+)(?P<turn>\d+)$")
    return table.assign(knee=told["knee"].astype(int), kind=told["kind"], turn=told["turn"])


def _below(folder: str, manifest: "pd.DataFrame") -> "pd.DataFrame":
    """The manifest with files as they are called from the folder above."""
    return manifest.assign(file=f"{folder}/" + manifest["file"])


def _pixels(folder: Path, file: str) -> NDArray[np.uint16]:
    return load(folder / file).pixels


def _stages(stack: ExitStack, bar: Bar) -> Callable[[str, int, int], None]:
    """One bar a stage, from a report of stage, done and total."""
    shown: dict[str, Pace] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage in shown:
            shown[stage].made(done - shown[stage].done)
            return
        stack.close()
        shown[stage] = stack.enter_context(bar(stage, total))
        shown[stage].found(done)  # an earlier run's too, which cannot be told apart here

    return report
