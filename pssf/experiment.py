"""Whole experiments: make the cohort of a preset, then run the radiomics study on it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .cohort import (
    Plan,
    make_cohort,
    plan_cohort,
    plan_retest,
)
from .core.checks import require_choice
from .core.processes.execution import Execution
from .core.processes.parallel_map import map_in_parallel
from .io.atomic_write import delete_stale_temporary_files
from .io.cohort_records import read_manifest
from .io.mask_files import load_masks
from .io.patients import patient_radiographs as film_files
from .io.radiograph_files import load
from .model.knee import Knee, Osteophyte
from .model.protocol import load_protocol
from .simulation import simulate
from .study import (
    DesignedManifests,
    FilmSet,
    StudyResult,
    StudySettings,
    measure,
    require_extra,
    run,
)
from .study.design.response_curve_design import plan_response_curves

if TYPE_CHECKING:
    import pandas as pd

    from .radiomics.localisation.templates import Template

# Tables of a study that the READMEs show.
README_TABLES = ("scores", "reliability", "claims", "cost")
# Protocol -> knees of the templates, from a healthy medial joint space to one narrower than in any grade of the table
# `paper`. Both views are needed: the rims of the plateau overlap in one and are separate in the other.
_TEMPLATE_KNEES = {
    "reference": (Knee(jsw_medial_mm=5.0), Knee(jsw_medial_mm=3.5), Knee(jsw_medial_mm=2.0)),
    "fixed_flexion": (Knee(jsw_definition="read", jsw_medial_mm=4.5), Knee(jsw_definition="read", jsw_medial_mm=2.0)),
}
# Knee of a severe template, as patients of KL 4 have it: lost medial joint space, osteophytes at all margins, varus leg
# and sclerotic subchondral bone plate.
_SEVERE_KNEE = Knee(
    jsw_definition="read",
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
class PatientFilms:
    """Patient radiographs on disk, and how models are trained for them.

    Parameters
    ----------
    folder : Path
        Folder of images, or a CSV file that lists them (`io.patients.patient_radiographs.list_films`).
    protocol : str, optional
        Protocol of the cohort that the models are trained on. None: the reference protocol of the study.
    pixel_mm : float, optional
        Pixel pitch, in mm, to which patient radiographs and cohort are resampled. None: see `study.FilmSet`.
    region_mm : float, optional
        Side of the region, in mm. None: see `study.FilmSet`.
    """

    folder: Path
    protocol: str | None = None
    pixel_mm: float | None = None
    region_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class DesignSizes:
    """Sizes of the designed experiments beside a cohort; 0 leaves an experiment out.

    Parameters
    ----------
    curve_knees : int, default 0
        Knees of the response curves (`study.design.response_curve_design`).
    sobol_samples : int, default 0
        Samples of the Sobol design (`study.design.sensitivity_plan`), 64 or more.
    sensitivity_knees : int, default 0
        Knees of which one parameter at a time is changed.
    """

    curve_knees: int = 0
    sobol_samples: int = 0
    sensitivity_knees: int = 0


@dataclass(frozen=True)
class Experiment:
    """Finished cohort, and the settings of the study on it.

    Attributes
    ----------
    out : Path
        Folder of the experiment.
    engine : {"scanline", "embree"}
        Ray caster that made the radiographs.
    settings : StudySettings
        Settings of the study.
    manifest : DataFrame
        Manifest of the cohort, with files relative to `out`.
    retest : DataFrame or None
        Manifest of the repeated radiographs. Each row has the number of the knee that was repeated. None without them.
    films : FilmSet or None
        Patient radiographs used as a further test set.
    designed : DesignedManifests
        Manifests of the designed experiments.
    """

    out: Path
    engine: str
    settings: StudySettings
    manifest: "pd.DataFrame"
    retest: "pd.DataFrame | None"
    films: FilmSet | None = None
    designed: DesignedManifests = field(default_factory=DesignedManifests)


def make_experiment(
    out: Path,
    execution: Execution,
    *,
    preset: str,
    seed: int,
    engine: str,
    cohort: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    films: PatientFilms | None = None,
    design_sizes: DesignSizes | None = None,
) -> Experiment:
    """Make the cohort of an experiment, its repeated radiographs and its designed experiments.

    An interrupted run continues in the same folder.

    Parameters
    ----------
    out : Path
        Folder of the experiment. The cohort is written to ``out/cohort``, the repeated radiographs to ``out/repeats``.
    execution : Execution
        Workers, progress display and timer.
    preset : str
        Name of a cohort preset.
    seed : int
        Seed of the cohort and of the study.
    engine : {"scanline", "embree"}
        Ray caster.
    cohort : mapping of str to object, optional
        Entries that replace those of the preset, as for `cohort.plan_cohort`.
    settings : mapping of str to object, optional
        Fields of `StudySettings` that replace the defaults.
    films : PatientFilms, optional
        Patient radiographs to test the models on.
    design_sizes : DesignSizes, optional
        Sizes of the designed experiments. Their radiographs are written to ``out/response_curves``,
        ``out/sobol_samples`` and ``out/sensitivity_pairs``.

    Returns
    -------
    Experiment
        The cohort and the settings of its study.

    Raises
    ------
    InputError
        If the preset is unknown, a library is missing, the folder holds something else or cannot be written, or the
        scheduler cannot be used.
    WorkersLostError
        If workers are killed again and again.
    """
    require_extra(execution.scheduler)
    from .study.design.sensitivity_plan import compute_bounds  # Needs the extra `study`.

    plan = plan_cohort(preset, seed=seed, overrides=cohort)
    names = [exposure.protocol.name for exposure in plan.cases[0].exposures]
    known = {"repeats": plan.repeats, "seed": seed, "reference": "reference" if "reference" in names else names[0]}
    chosen = StudySettings(**{**known, **(settings or {})})
    film_set = None if films is None else _make_film_set(films, out, names, chosen)
    wanted = design_sizes or DesignSizes()
    # Planned before the cohort is made, so that wrong sizes raise an error before an hour of work.
    plans = _make_design_plans(plan, wanted, chosen.reference)
    manifest = _make_manifest(plan, out, "cohort", engine, execution)
    repeats, retest = plan_retest(plan, reference=chosen.reference), None
    if repeats is not None:
        retest = _make_manifest(repeats, out, "repeats", engine, execution)
        retest = retest.assign(knee=retest["of_knee"])
    made = {name: _make_manifest(one, out, name, engine, execution) for name, one in plans.items()}
    bounds = compute_bounds(plan, chosen.reference) if made.keys() & {"sobol_samples", "sensitivity_pairs"} else {}
    designed = DesignedManifests(**made, sobol_sample_count=wanted.sobol_samples, bounds=bounds)
    for folder in (out, out / "pictures", out / "models"):
        delete_stale_temporary_files(folder)
    return Experiment(out, engine, chosen, manifest, retest, film_set, designed)


def run_experiment(experiment: Experiment, execution: Execution) -> StudyResult:
    """Run the study of an experiment: regions, features, models and report, written into its folder.

    If an earlier run is complete, and cohort, settings, code and files have not changed since, its result is returned.

    Parameters
    ----------
    experiment : Experiment
        Result of `make_experiment`.
    execution : Execution
        Workers, progress display and timer.

    Returns
    -------
    StudyResult
        Result of the study.

    Raises
    ------
    InputError
        As raised by `study.run`.
    WorkersLostError
        If workers are killed again and again.
    """
    from .study import resume  # Needs the extra `study`.

    every = (experiment.manifest, experiment.retest, *experiment.designed.list_manifests())
    manifests = [table for table in every if table is not None]
    key = resume.compute_run_key(manifests, experiment.settings, experiment.engine, experiment.films)
    result = resume.load_finished_run(experiment.out, key)
    if result is None:
        result = run(
            *_prepare_study_inputs(experiment, execution),
            retest=experiment.retest,
            load_masks=partial(_load_masks, experiment.out.absolute()),
            films=experiment.films,
            designed=experiment.designed,
            execution=execution,
        )
        resume.save_finished_run(result, experiment.out, key)
    return result


def collect_readme_rows(result: StudyResult) -> dict[str, list[dict[str, Any]]]:
    """Collect the rows of the tables that the READMEs show.

    Parameters
    ----------
    result : StudyResult
        Result of a study.

    Returns
    -------
    dict of str to list of dict
        Name in `README_TABLES` and rows of the table.
    """
    from .io import study_results
    from .study.statistics.features.reliability import count_stable_features

    return {
        "scores": result.scores.to_dict("records"),
        "reliability": count_stable_features(result.reliability).to_dict("records"),
        "claims": study_results.load_typed_table(result.tables["claims"]).to_dict("records"),
        "cost": (study_results.load_json(result.report.parent / "study.json", dict[str, Any]) or {}).get("cost", []),
    }


def measure_experiment(experiment: Experiment, execution: Execution) -> Path:
    """Locate the regions and measure the features of an experiment, without training models.

    Parameters
    ----------
    experiment : Experiment
        Result of `make_experiment`.
    execution : Execution
        Workers, progress display and timer.

    Returns
    -------
    Path
        Path of features.csv.

    Raises
    ------
    InputError
        As raised by `study.measure`.
    WorkersLostError
        If workers are killed again and again.
    """
    return measure(*_prepare_study_inputs(experiment, execution), retest=experiment.retest, execution=execution)


def _prepare_study_inputs(experiment: Experiment, execution: Execution) -> tuple[Any, ...]:
    """Make the templates and collect the positional arguments of `study.run` and `study.measure`."""
    with execution.timer.stage("templates"):
        templates = make_standard_templates(experiment.engine, workers=execution.workers)
    load_pixels = partial(load_radiograph_pixels, experiment.out.absolute())
    return experiment.manifest, load_pixels, templates, experiment.settings, experiment.out


def make_standard_templates(engine: str = "embree", *, workers: int = 1) -> "tuple[Template, ...]":
    """Make the templates with which joints are located on radiographs.

    The first template shows a standard knee. Others show narrower medial joint spaces and another view, and the last
    one severe osteoarthritis. They have no noise, and all are scaled to the plateau width of the first one.

    Parameters
    ----------
    engine : {"embree", "scanline"}, default "embree"
        Ray caster.
    workers : int, default 1
        Processes. With one, two threads are used instead.

    Returns
    -------
    tuple of Template
        Templates, the standard knee first.
    """
    usual = [(knee, protocol, False) for protocol, of in _TEMPLATE_KNEES.items() for knee in of]
    seen = [*usual, (_SEVERE_KNEE, "fixed_flexion", True)]
    shared = {"engine": engine, "threads": 2 if workers == 1 else 1}
    first, *others = map_in_parallel(_make_template, seen, shared=shared, workers=workers)
    return (first, *(other.match_plateau_width(first) for other in others))


def _make_template(case: tuple[Knee, str, bool], engine: str, threads: int) -> "Template":
    """Simulate the template of one case: knee, name of its protocol, and whether it shows severe osteoarthritis."""
    from .radiomics.localisation.templates import Template

    knee, name, severe = case
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


def _make_manifest(plan: Plan, out: Path, name: str, engine: str, execution: Execution) -> "pd.DataFrame":
    """Make the missing radiographs of a plan in out/name, and return their manifest with files relative to `out`."""
    with execution.stage(name, "radiographs", sum(len(case.exposures) for case in plan.cases)) as stage:
        path = make_cohort(
            plan,
            out / name,
            workers=execution.workers,
            scheduler=execution.scheduler,
            engine=engine,
            progress=stage.advance,
            on_kept=stage.add_already_done,
        )
    return _prefix_files(name, read_manifest(path))


def _make_design_plans(plan: Plan, design_sizes: DesignSizes, reference: str) -> dict[str, Plan]:
    """Plan the designed experiments that are asked for, by the name of their folder."""
    from .study.design import sensitivity_plan  # Needs the extra `study`.

    plans: dict[str, Plan] = {}
    if design_sizes.curve_knees:
        plans["response_curves"] = plan_response_curves(plan, knees=design_sizes.curve_knees, reference=reference)
    if design_sizes.sobol_samples:
        plans["sobol_samples"] = sensitivity_plan.plan_sobol_samples(
            plan, samples=design_sizes.sobol_samples, reference=reference
        )
    if design_sizes.sensitivity_knees:
        plans["sensitivity_pairs"] = sensitivity_plan.plan_sensitivity_pairs(
            plan, knees=design_sizes.sensitivity_knees, reference=reference
        )
    return plans


def _prefix_files(folder: str, manifest: "pd.DataFrame") -> "pd.DataFrame":
    """Prefix the files of a manifest with the folder, so that they are relative to the folder above."""
    files = [name for name in ("file", "masks") if name in manifest]
    return manifest.assign(**{name: f"{folder}/" + manifest[name] for name in files})


def _make_film_set(patient_films: PatientFilms, out: Path, protocols: list[str], settings: StudySettings) -> FilmSet:
    """List the patient radiographs of a folder, with functions that load them and the cohort's radiographs alike."""
    protocol = settings.reference if patient_films.protocol is None else patient_films.protocol
    require_choice("films-protocol", protocol, protocols)
    folder = patient_films.folder.parent if patient_films.folder.suffix.lower() == ".csv" else patient_films.folder
    return FilmSet(
        films=film_files.list_films(patient_films.folder),
        load=partial(_read_film, folder.absolute()),
        load_cohort=partial(_read_film, out.absolute()),
        protocol=protocol,
        pixel_mm=patient_films.pixel_mm,
        region_mm=patient_films.region_mm,
    )


def _read_film(folder: Path, file: str) -> film_files.FilmImage:
    """Read one patient radiograph of a folder."""
    return film_files.read_film(folder / file)


def load_radiograph_pixels(folder: Path, file: str) -> NDArray[np.uint16]:
    """Load the pixels of a radiograph of a cohort.

    Parameters
    ----------
    folder : Path
        Folder that the files of the manifest are relative to.
    file : str
        Entry of the column ``file`` of the manifest.

    Returns
    -------
    (rows, cols) uint16 array
        Pixel values (DN), linear in the absorbed energy.
    """
    return load(folder / file).pixels


def _load_masks(folder: Path, file: str) -> dict[str, NDArray[np.bool_]]:
    """Load the masks of a radiograph by the entry of the column ``masks``; name -> (rows, cols) bool array."""
    return load_masks(folder / file)
