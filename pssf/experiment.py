"""The whole experiment: a preset's cohort is made, then studied."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .cohort import Plan, make_cohort, plan_cohort, plan_retest
from .core.checks import require_choice
from .core.execution import Execution
from .core.parallel import ordered_map
from .io import films as film_files
from .io.atomic import sweep
from .io.images import load
from .io.masks import load_masks
from .io.records import read_manifest
from .model.knee import Knee, Osteophyte
from .model.protocol import load_protocol
from .simulation import simulate
from .study import Designed, FilmSet, StudyResult, StudySettings, measure, require_extra, run
from .study.design import plan_curves

if TYPE_CHECKING:
    import pandas as pd

    from .radiomics.patches import Template

# What the READMEs show of a study.
SHOWN = ("scores", "reliability", "claims", "cost")
# Medial joint space, from a healthy joint to one narrower than the paper's grades have, as the two views show it:
# the plateau's rims lie under each other in one and apart in the other.
_SPACES = {
    "reference": (Knee(jsw_medial_mm=5.0), Knee(jsw_medial_mm=3.5), Knee(jsw_medial_mm=2.0)),
    "fixed_flexion": (Knee(jsw_as="read", jsw_medial_mm=4.5), Knee(jsw_as="read", jsw_medial_mm=2.0)),
}
# One whose medial joint space is gone, with lips all round, a bowed leg and a hard plate, as people of KL 4 have it.
_SEVERE = Knee(
    jsw_as="read",
    jsw_medial_mm=0.3,
    jsw_lateral_mm=5.5,
    flexion_deg=15.0,
    varus_deg=5.0,
    subchondral_plate=1.6,
    osteophytes=(
        Osteophyte(site="medial_tibia", size_mm=4.0),
        Osteophyte(site="medial_femur", size_mm=4.0),
        Osteophyte(site="lateral_tibia", size_mm=2.5),
        Osteophyte(site="lateral_femur", size_mm=2.5),
    ),
)


@dataclass(frozen=True, kw_only=True)
class OwnFilms:
    """Films of patients on disk.

    folder    as `io.films.list_films` takes it
    protocol  of the cohort that models for them learn from; None: the study's reference
    pixel_mm  pitch that films and cohort are brought to, and region_mm side of the region; None: see `study.FilmSet`
    """

    folder: Path
    protocol: str | None = None
    pixel_mm: float | None = None
    region_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class ByDesign:
    """Radiographs to take beside a cohort's; 0: none.

    curves  knees along the axes of `study.design`
    shares  samples of the space of `study.space`, 64 or more
    pairs   knees, of each of which one parameter after the other is changed
    """

    curves: int = 0
    shares: int = 0
    pairs: int = 0


@dataclass(frozen=True)
class Experiment:
    """A cohort that stands, and how it is to be studied.

    manifest  of the cohort, files as they are called from `out`
    retest    of the knees taken again, each under the number of the knee that it is of; None where there are none
    films     of patients, to test on as well; None where there are none
    designed  radiographs taken by design
    """

    out: Path
    engine: str
    settings: StudySettings
    manifest: "pd.DataFrame"
    retest: "pd.DataFrame | None"
    films: FilmSet | None = None
    designed: Designed = field(default_factory=Designed)


def make_experiment(
    out: Path,
    execution: Execution,
    *,
    preset: str,
    seed: int,
    engine: str,
    cohort: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    films: OwnFilms | None = None,
    by_design: ByDesign | None = None,
) -> Experiment:
    """Cohort and repeats; goes on where an earlier run in the same folder stopped.

    out       folder: the cohort goes into out/cohort, knees taken again into out/repeats
    cohort    entries that replace the preset's, as for `plan_cohort`
    settings  fields of StudySettings that replace the defaults
    films     of patients, to test the models on
    by_design what is taken beside, into out/curves, out/shares, out/pairs
    raises    InputError for an unknown preset, a missing library, a folder that holds something else or is unwritable,
              a scheduler that cannot be used; WorkersLostError when workers keep being killed
    """
    require_extra(execution.scheduler)
    from .study.space import bounds_of  # needs the extra `study`

    plan = plan_cohort(preset, seed=seed, overrides=cohort)
    names = [exposure.protocol.name for exposure in plan.cases[0].exposures]
    known = {"repeats": plan.repeats, "seed": seed, "reference": "reference" if "reference" in names else names[0]}
    chosen = StudySettings(**{**known, **(settings or {})})
    film_set = None if films is None else _film_set(films, out, names, chosen)
    wanted = by_design or ByDesign()
    # Refused before an hour of work, not after it.
    plans = _plans_by_design(plan, wanted, chosen.reference)
    manifest = _made(plan, out, "cohort", engine, execution)
    repeats, retest = plan_retest(plan, reference=chosen.reference), None
    if repeats is not None:
        retest = _made(repeats, out, "repeats", engine, execution)
        retest = retest.assign(knee=retest["of_knee"])
    made = {name: _made(one, out, name, engine, execution) for name, one in plans.items()}
    bounds = bounds_of(plan, chosen.reference) if made.keys() & {"shares", "pairs"} else {}
    designed = Designed(**made, samples=wanted.shares, bounds=bounds)
    for folder in (out, out / "pictures", out / "models"):
        sweep(folder)
    return Experiment(out, engine, chosen, manifest, retest, film_set, designed)


def run_experiment(experiment: Experiment, execution: Execution) -> StudyResult:
    """Regions, features, models, report, into the experiment's folder.

    Where an earlier run ended, and neither cohort, settings nor code have changed since, and no file, its result is
    given back.

    raises  InputError and WorkersLostError as `study.run` does
    """
    from .study import finished  # needs the extra `study`

    every = (experiment.manifest, experiment.retest, *experiment.designed.manifests())
    manifests = [table for table in every if table is not None]
    key = finished.key_of(manifests, experiment.settings, experiment.engine, experiment.films)
    result = finished.earlier(experiment.out, key)
    if result is None:
        result = run(
            *_given(experiment, execution),
            retest=experiment.retest,
            load_masks=partial(_masks, experiment.out.absolute()),
            films=experiment.films,
            designed=experiment.designed,
            execution=execution,
        )
        finished.mark(result, experiment.out, key)
    return result


def shown_rows(result: StudyResult) -> dict[str, list[dict[str, Any]]]:
    """Rows of each of SHOWN."""
    from .io import results
    from .study.statistics.reliability import count_stable

    return {
        "scores": result.scores.to_dict("records"),
        "reliability": count_stable(result.reliability).to_dict("records"),
        "claims": results.load_typed_table(result.tables["claims"]).to_dict("records"),
        "cost": (results.load_json(result.report.parent / "study.json", dict[str, Any]) or {}).get("cost", []),
    }


def measure_experiment(experiment: Experiment, execution: Execution) -> Path:
    """Regions and features alone; returns the path of features.csv.

    raises  InputError and WorkersLostError as `study.measure` does
    """
    return measure(*_given(experiment, execution), retest=experiment.retest, execution=execution)


def _given(experiment: Experiment, execution: Execution) -> tuple[Any, ...]:
    with execution.timer.stage("templates"):
        templates = standard_templates(experiment.engine, workers=execution.workers)
    load_pixels = partial(radiograph_pixels, experiment.out.absolute())
    return experiment.manifest, load_pixels, templates, experiment.settings, experiment.out


def standard_templates(engine: str = "embree", *, workers: int = 1) -> "tuple[Template, ...]":
    """The standard knee, the same with narrower medial joint spaces and in another view, and a severe one: what joints
    are looked for with.

    Without noise; all as wide at the detector as the first.
    workers  processes; with one, its two threads
    """
    usual = [(knee, protocol, False) for protocol, of in _SPACES.items() for knee in of]
    seen = [*usual, (_SEVERE, "fixed_flexion", True)]
    shared = {"engine": engine, "threads": 2 if workers == 1 else 1}
    first, *others = ordered_map(_template, seen, shared=shared, workers=workers)
    return (first, *(other.as_wide_as(first) for other in others))


def _template(seen: tuple[Knee, str, bool], engine: str, threads: int) -> "Template":
    """Of a knee under a protocol, and whether it is severe."""
    from .radiomics.patches import Template

    knee, name, severe = seen
    protocol = replace(load_protocol(name), noise="none")
    radiograph = simulate(knee, protocol, engine=engine, workers=threads)
    assert radiograph.truth is not None
    row, col = radiograph.truth.medial_joint_line_px
    edges = [radiograph.truth.landmarks_px[f"{side}_plateau_edge"][1] for side in ("medial", "lateral")]
    return Template(
        pixels=radiograph.pixels,
        row=row,
        col=col,
        pixel_mm=protocol.pixel_mm,
        plateau_mm=abs(edges[0] - edges[1]) * protocol.pixel_mm,
        severe=severe,
    )


def _made(plan: Plan, out: Path, name: str, engine: str, execution: Execution) -> "pd.DataFrame":
    """The manifest of a plan's radiographs in out/name, of which those that are missing are made in a stage."""
    with execution.stage(name, "radiographs", sum(len(case.exposures) for case in plan.cases)) as stage:
        path = make_cohort(
            plan,
            out / name,
            workers=execution.workers,
            scheduler=execution.scheduler,
            engine=engine,
            progress=stage.advance,
            kept=stage.keep,
        )
    return _below(name, read_manifest(path))


def _plans_by_design(plan: Plan, wanted: ByDesign, reference: str) -> dict[str, Plan]:
    """What is wanted, by the folder it goes into."""
    from .study import space  # needs the extra `study`

    plans: dict[str, Plan] = {}
    if wanted.curves:
        plans["curves"] = plan_curves(plan, knees=wanted.curves, reference=reference)
    if wanted.shares:
        plans["shares"] = space.plan_shares(plan, samples=wanted.shares, reference=reference)
    if wanted.pairs:
        plans["pairs"] = space.plan_pairs(plan, knees=wanted.pairs, reference=reference)
    return plans


def _below(folder: str, manifest: "pd.DataFrame") -> "pd.DataFrame":
    """The manifest with files as they are called from the folder above."""
    files = [name for name in ("file", "masks") if name in manifest]
    return manifest.assign(**{name: f"{folder}/" + manifest[name] for name in files})


def _film_set(own: OwnFilms, out: Path, protocols: list[str], settings: StudySettings) -> FilmSet:
    """The films of a folder, with what reads them and the cohort's radiographs alike."""
    protocol = settings.reference if own.protocol is None else own.protocol
    require_choice("films-protocol", protocol, protocols)
    folder = own.folder.parent if own.folder.suffix.lower() == ".csv" else own.folder
    return FilmSet(
        films=film_files.list_films(own.folder),
        load=partial(_film, folder.absolute()),
        load_cohort=partial(_film, out.absolute()),
        protocol=protocol,
        pixel_mm=own.pixel_mm,
        region_mm=own.region_mm,
    )


def _film(folder: Path, file: str) -> film_files.FilmImage:
    return film_files.read_film(folder / file)


def radiograph_pixels(folder: Path, file: str) -> NDArray[np.uint16]:
    """(rows, cols) DN of a radiograph of a cohort, by the entry of its manifest's column `file`."""
    return load(folder / file).pixels


def _masks(folder: Path, file: str) -> dict[str, NDArray[np.bool_]]:
    return load_masks(folder / file)
