"""The whole experiment: a preset's cohort is made, then studied."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .cohort import Plan, make_cohort, plan_cohort, plan_repeats
from .core.progress import Pace
from .io.atomic import sweep
from .io.images import load
from .io.records import read_manifest
from .model.knee import Knee
from .model.protocol import load_protocol
from .simulation import simulate
from .study import StudyResult, StudySettings, measure, require_extra, run
from .study.report.cost import Meter

if TYPE_CHECKING:
    import pandas as pd

    from .radiomics.region import Template

_TEMPLATES_JSW_MM = (5.0, 3.5, 2.0)  # from a healthy joint to one narrower than any of the grades'
# Shows a stage: its name and total give a context that yields what counts it.
Bar = Callable[[str, int], AbstractContextManager[Pace]]


@dataclass(frozen=True, kw_only=True)
class Crew:
    """Who does the work, and what shows it; no result depends on them.

    workers    processes
    bar        shows the progress of a stage
    scheduler  address of a Dask scheduler whose workers do it instead
    """

    workers: int
    bar: Bar
    scheduler: str | None = None
    meter: Meter = field(default_factory=Meter)


@dataclass(frozen=True)
class Experiment:
    """A cohort that stands, and how it is to be studied."""

    out: Path
    engine: str
    settings: StudySettings
    manifest: "pd.DataFrame"
    again: "pd.DataFrame | None"


def make_experiment(
    out: Path,
    crew: Crew,
    *,
    preset: str,
    seed: int,
    engine: str,
    cohort: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Experiment:
    """Cohort and repeats; goes on where an earlier run in the same folder stopped.

    out       folder: the cohort goes into out/cohort, knees taken again into out/repeats
    cohort    entries that replace the preset's, as for `plan_cohort`
    settings  fields of StudySettings that replace the defaults
    raises    InputError for an unknown preset, a missing library, a folder that holds something else or is unwritable,
              a scheduler that cannot be used; WorkersLostError when workers keep being killed
    """
    require_extra(crew.scheduler)
    plan = plan_cohort(preset, seed=seed, overrides=cohort)
    names = [shot.protocol.name for shot in plan.cases[0].shots]
    known = {"repeats": plan.repeats, "seed": seed, "reference": "reference" if "reference" in names else names[0]}
    chosen = StudySettings(**{**known, **(settings or {})})
    with crew.meter.stage("cohort", "radiographs") as made:
        manifest = _below("cohort", read_manifest(_made(plan, out / "cohort", "radiographs", engine, crew, made)))
    repeats, again = plan_repeats(plan, reference=chosen.reference), None
    if repeats is not None:
        with crew.meter.stage("repeats", "radiographs") as made:
            again = _again(read_manifest(_made(repeats, out / "repeats", "repeats", engine, crew, made)))
    for folder in (out, out / "pictures", out / "models"):
        sweep(folder)
    return Experiment(out, engine, chosen, manifest, again)


def run_experiment(experiment: Experiment, crew: Crew) -> StudyResult:
    """Regions, features, models, report, into the experiment's folder.

    Where an earlier run ended, and neither cohort, settings nor code have changed since, and no file, its result is
    given back.
    """
    from .study import finished  # needs the extra `study`

    manifests = [table for table in (experiment.manifest, experiment.again) if table is not None]
    key = finished.key_of(manifests, experiment.settings, experiment.engine)
    result = finished.earlier(experiment.out, key)
    if result is None:
        with ExitStack() as stack:
            result = run(*_given(experiment, crew), **_how(experiment, crew, stack))
        finished.mark(result, experiment.out, key)
    return result


def measure_experiment(experiment: Experiment, crew: Crew) -> Path:
    """Regions and features alone; returns the path of features.csv."""
    with ExitStack() as stack:
        return measure(*_given(experiment, crew), **_how(experiment, crew, stack))


def _given(experiment: Experiment, crew: Crew) -> tuple[Any, ...]:
    with crew.meter.stage("templates"):
        templates = standard_templates(experiment.engine)
    load_pixels = partial(_pixels, experiment.out.absolute())
    return experiment.manifest, load_pixels, templates, experiment.settings, experiment.out


def _how(experiment: Experiment, crew: Crew, stack: ExitStack) -> dict[str, Any]:
    who = {"meter": crew.meter, "workers": crew.workers, "scheduler": crew.scheduler}
    return {"again": experiment.again, "progress": _stages(stack, crew.bar), **who}


def standard_templates(engine: str = "embree") -> "tuple[Template, ...]":
    """The standard knee, and the same with narrower medial joint spaces, which regions are looked for with.

    Without noise, under the protocol `reference`.
    """
    from .radiomics.region import Template  # needs the extra `study`

    protocol = load_protocol("reference")

    def template(knee: Knee) -> Template:
        radiograph = simulate(knee, protocol, engine=engine, keep=("noise_free",))
        assert radiograph.truth is not None
        row, col = radiograph.truth.medial_joint_line_px
        return Template(pixels=radiograph.kept["noise_free"], row=row, col=col, pixel_mm=protocol.pixel_mm)

    return tuple(template(Knee(jsw_medial_mm=jsw)) for jsw in _TEMPLATES_JSW_MM)


def _made(plan: Plan, folder: Path, what: str, engine: str, crew: Crew, made: Callable[[int], None]) -> Path:
    """Make what is missing of a plan, with a bar of its own; returns the manifest."""
    with crew.bar(what, sum(len(case.shots) for case in plan.cases)) as pace:

        def progress(more: int) -> None:
            made(more)
            pace.made(more)

        return make_cohort(
            plan,
            folder,
            workers=crew.workers,
            scheduler=crew.scheduler,
            engine=engine,
            progress=progress,
            found=pace.found,
        )


def _again(manifest: "pd.DataFrame") -> "pd.DataFrame":
    """The manifest of repeats with the knee that each is of, kind and turn."""
    told = manifest["radiograph"].str.extract(r"_k(?P<knee>\d+)_(?P<kind>[a-z]+)(?P<turn>\d+)$")
    found = {"knee": told["knee"].astype(int), "kind": told["kind"], "turn": told["turn"]}
    return _below("repeats", manifest).assign(**found)


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
