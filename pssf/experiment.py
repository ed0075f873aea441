"""Experiments: make the cohort of a preset and run the radiomics study on it."""

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
from .io.study_results import save_text
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
from .study.design.experiment_settings import (
    DesignSizes,
    ExperimentSettings,
    PatientFilms,
    format_settings,
    merge_settings,
)
from .study.design.response_curve_design import plan_response_curves

if TYPE_CHECKING:
    import pandas as pd

    from .radiomics.localisation.templates import Template

# Name of the settings file in the folder of an experiment.
SETTINGS_FILE = "study.toml"
# Protocol -> knees of the localisation templates. Their medial joint spaces range from healthy to narrower than in any
# grade of the table `paper`. Both protocols are needed, because the anterior and posterior plateau rims overlap in only
# one of them.
_TEMPLATE_KNEES = {
    "reference": (Knee(jsw_medial_mm=5.0), Knee(jsw_medial_mm=3.5), Knee(jsw_medial_mm=2.0)),
    "fixed_flexion": (Knee(jsw_definition="read", jsw_medial_mm=4.5), Knee(jsw_definition="read", jsw_medial_mm=2.0)),
}
# Knee of the template for severe osteoarthritis (KL 4): no medial joint space, osteophytes at all margins, varus leg
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


@dataclass(frozen=True)
class Experiment:
    """Finished cohort and the settings of its study.

    Attributes
    ----------
    out : Path
        Folder of the experiment.
    engine : {"scanline", "embree"}
        Ray caster of the radiographs.
    settings : StudySettings
        Settings of the study.
    manifest : DataFrame
        Manifest of the cohort, with files relative to `out`.
    retest : DataFrame or None
        Manifest of the repeated radiographs, with the numbers of the repeated knees. None if no radiograph is repeated.
    films : FilmSet or None
        Patient radiographs used as an additional test set.
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
    out: Path, execution: Execution, settings: Mapping[str, Any] | ExperimentSettings | None = None
) -> Experiment:
    """Make the cohort of an experiment, its repeated radiographs and its designed experiments.

    If a run was interrupted, another call with the same folder continues it. The settings of the experiment are written
    to ``out/study.toml``.

    Parameters
    ----------
    out : Path
        Folder of the experiment. The cohort is written to ``out/cohort`` and the repeated radiographs to
        ``out/repeats``. Designed experiments are written to ``out/response_curves``, ``out/sobol_samples`` and
        ``out/sensitivity_pairs``.
    execution : Execution
        Workers, progress display and timer.
    settings : mapping of str to object or ExperimentSettings, optional
        Settings with the names of the settings file, such as ``{"preset": "quick", "knees": [4, 0, 4], "bins": 32}``,
        or the result of `merge_settings`. None: the settings of the preset ``quick``.

    Returns
    -------
    Experiment
        Cohort and settings of its study.

    Raises
    ------
    InputError
        If a setting or the preset is unknown, a library is missing, the folder contains other files or cannot be
        written, or the scheduler cannot be used.
    WorkersLostError
        If workers are killed repeatedly.
    """
    require_extra(execution.scheduler)
    from .study.design.sensitivity_plan import compute_bounds  # Needs the `study` extra.

    given = settings if isinstance(settings, ExperimentSettings) else merge_settings(settings or {})
    plan = plan_cohort(given.preset, seed=given.seed, overrides=given.cohort)
    names = [exposure.protocol.name for exposure in plan.cases[0].exposures]
    known = {"repeats": plan.repeats, "reference": "reference" if "reference" in names else names[0]}
    chosen = StudySettings(**{**known, **given.study, "seed": given.seed})
    film_set = None if given.films is None else _make_film_set(given.films, out, names, chosen)
    # The designed experiments are planned before the cohort is made, so that wrong sizes raise an error early.
    plans = _make_design_plans(plan, given.design_sizes, chosen.reference)
    manifest = _make_manifest(plan, out, "cohort", given.engine, execution)
    repeats, retest = plan_retest(plan, reference=chosen.reference), None
    if repeats is not None:
        retest = _make_manifest(repeats, out, "repeats", given.engine, execution)
        retest = retest.assign(knee=retest["source_knee"])
    made = {name: _make_manifest(one, out, name, given.engine, execution) for name, one in plans.items()}
    bounds = compute_bounds(plan, chosen.reference) if made.keys() & {"sobol_samples", "sensitivity_pairs"} else {}
    designed = DesignedManifests(**made, sobol_sample_count=given.design_sizes.sobol_samples, bounds=bounds)
    for folder in (out, out / "pictures", out / "models"):
        delete_stale_temporary_files(folder)
    assert plan.definition is not None
    # The settings are written after the cohort, so that a folder with another cohort keeps its own settings.
    resolved = format_settings(replace(given, preset=plan.preset), plan.definition, chosen)
    save_text(out / SETTINGS_FILE, resolved)
    return Experiment(out, given.engine, chosen, manifest, retest, film_set, designed)


def run_experiment(experiment: Experiment, execution: Execution) -> StudyResult:
    """Run the study of an experiment and write regions, features, models and report to its folder.

    The result of an earlier run is returned if that run is complete, and cohort, settings, code and files have not
    changed.

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
        Under the same conditions as in `study.run`.
    WorkersLostError
        If workers are killed repeatedly.
    """
    from .study import resume  # Needs the `study` extra.

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
        Under the same conditions as in `study.measure`.
    WorkersLostError
        If workers are killed repeatedly.
    """
    return measure(*_prepare_study_inputs(experiment, execution), retest=experiment.retest, execution=execution)


def _prepare_study_inputs(experiment: Experiment, execution: Execution) -> tuple[Any, ...]:
    """Make the localisation templates and collect the positional arguments of `study.run` and `study.measure`."""
    with execution.timer.stage("templates"):
        templates = make_standard_templates(experiment.engine, workers=execution.workers)
    load_pixels = partial(load_radiograph_pixels, experiment.out.absolute())
    return experiment.manifest, load_pixels, templates, experiment.settings, experiment.out


def make_standard_templates(engine: str = "embree", *, workers: int = 1) -> "tuple[Template, ...]":
    """Make the templates for the localisation of joints on radiographs.

    The first template shows a standard knee. Further templates show narrower medial joint spaces and another view, and
    the last template shows severe osteoarthritis. Templates have no noise, and all are scaled to the plateau width of
    the first template.

    Parameters
    ----------
    engine : {"embree", "scanline"}, default "embree"
        Ray caster.
    workers : int, default 1
        Number of processes. If it is 1, the process uses two threads.

    Returns
    -------
    tuple of Template
        Templates; the standard knee is first.
    """
    usual = [(knee, protocol, False) for protocol, of in _TEMPLATE_KNEES.items() for knee in of]
    seen = [*usual, (_SEVERE_KNEE, "fixed_flexion", True)]
    shared = {"engine": engine, "threads": 2 if workers == 1 else 1}
    first, *others = map_in_parallel(_make_template, seen, shared=shared, workers=workers)
    return (first, *(other.match_plateau_width(first) for other in others))


def _make_template(case: tuple[Knee, str, bool], engine: str, threads: int) -> "Template":
    """Simulate a template. `case` has the knee, the protocol name, and whether the knee has severe osteoarthritis."""
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
    """Make the missing radiographs of a plan in out/name and return the manifest with files relative to `out`."""
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
    """Plan the requested designed experiments, keyed by folder name."""
    from .study.design import sensitivity_plan  # Needs the `study` extra.

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
    """Prefix the file names of a manifest with a folder, so that they are relative to the parent folder."""
    files = [name for name in ("file", "masks") if name in manifest]
    return manifest.assign(**{name: f"{folder}/" + manifest[name] for name in files})


def _make_film_set(patient_films: PatientFilms, out: Path, protocols: list[str], settings: StudySettings) -> FilmSet:
    """List the patient radiographs of a folder, with functions that load patient and simulated radiographs."""
    protocol = settings.reference if patient_films.protocol is None else patient_films.protocol
    require_choice("films_protocol", protocol, protocols)
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
    """Read one patient radiograph from a folder."""
    return film_files.read_film(folder / file)


def load_radiograph_pixels(folder: Path, file: str) -> NDArray[np.uint16]:
    """Load the pixels of a radiograph in a cohort.

    Parameters
    ----------
    folder : Path
        Folder relative to which the manifest lists files.
    file : str
        Entry of the column ``file`` of the manifest.

    Returns
    -------
    (rows, cols) uint16 array
        Pixel values (DN), linear in the absorbed energy.
    """
    return load(folder / file).pixels


def _load_masks(folder: Path, file: str) -> dict[str, NDArray[np.bool_]]:
    """Load the masks of a radiograph, named in the column ``masks``, as a dict of name to (rows, cols) bool array."""
    return load_masks(folder / file)
