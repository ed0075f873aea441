"""The whole experiment: a preset's cohort is made, then studied."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .cohort import make_cohort, plan_cohort
from .files.atomic import sweep
from .files.images import load
from .files.records import read_manifest
from .knee import Knee
from .progress import Pace
from .protocol import load_protocol
from .simulate import simulate
from .study import StudyResult, StudySettings, require_extra, run

if TYPE_CHECKING:
    from .radiomics.region import Template

# Shows a stage: its name and total give a context that yields what counts it.
Bar = Callable[[str, int], AbstractContextManager[Pace]]


def run_experiment(
    out: Path, *, preset: str, seed: int, workers: int, engine: str, bar: Bar, scheduler: str | None = None
) -> StudyResult:
    """Cohort, regions, features, models, report; goes on where an earlier run in the same folder stopped.

    out        folder: the cohort goes into out/cohort, report, tables and pictures beside it
    workers    processes; no result depends on them
    bar        shows the progress of a stage
    scheduler  address of a Dask scheduler whose workers make the radiographs; what follows is done here all the same
    raises     InputError for an unknown preset, a missing library, a folder that holds something else or is unwritable,
               a scheduler that cannot be used; WorkersLostError when workers keep being killed
    """
    require_extra()
    plan = plan_cohort(preset, seed=seed)
    start = perf_counter()
    with bar("radiographs", sum(len(case.shots) for case in plan.cases)) as pace:
        path = make_cohort(
            plan,
            out / "cohort",
            workers=workers,
            scheduler=scheduler,
            engine=engine,
            progress=pace.made,
            found=pace.found,
        )
    for folder in (out, out / "pictures"):
        sweep(folder)
    seconds = {"cohort": perf_counter() - start}
    start = perf_counter()
    template = standard_template(engine)
    seconds["template"] = perf_counter() - start
    with ExitStack() as stack:
        return run(
            read_manifest(path),
            partial(_pixels, out / "cohort"),
            template,
            StudySettings(repeats=plan.repeats, seed=seed),
            out,
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
