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
from .files.images import load
from .files.records import read_manifest
from .knee import Knee
from .protocol import load_protocol
from .simulate import simulate
from .study import StudyResult, StudySettings, require_extra, run

if TYPE_CHECKING:
    import pandas as pd

    from .radiomics.region import Template

# Shows a stage: its name and total give a context that yields a function to move it on.
Bar = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]


def run_experiment(out: Path, *, preset: str, seed: int, workers: int, engine: str, bar: Bar) -> StudyResult:
    """Cohort, repeats, regions, features, models, report; goes on where an earlier run in the same folder stopped.

    out      folder: the cohort goes into out/cohort, knees taken again into out/repeats, the rest beside them
    workers  processes; no result depends on them
    bar      shows the progress of a stage
    raises   InputError for an unknown preset, a missing library, a folder that holds something else or is unwritable
    """
    require_extra()
    plan = plan_cohort(preset, seed=seed)
    start = perf_counter()
    with bar("radiographs", sum(len(case.shots) for case in plan.cases)) as made:
        path = make_cohort(plan, out / "cohort", workers=workers, engine=engine, progress=made)
    seconds = {"cohort": perf_counter() - start}
    start = perf_counter()
    again = _taken_again(plan, out, workers, engine, bar)
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


def _taken_again(plan: Plan, out: Path, workers: int, engine: str, bar: Bar) -> "pd.DataFrame | None":
    """Make the repeats of a plan; their manifest with the knee that each is of, kind and turn."""
    repeats = plan_repeats(plan)
    if repeats is None:
        return None
    with bar("repeats", sum(len(case.shots) for case in repeats.cases)) as made:
        path = make_cohort(repeats, out / "repeats", workers=workers, engine=engine, progress=made)
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
    shown: dict[str, Any] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in shown:
            stack.close()
            shown[stage] = [stack.enter_context(bar(stage, total)), 0]
        shown[stage][0](done - shown[stage][1])
        shown[stage][1] = done

    return report
