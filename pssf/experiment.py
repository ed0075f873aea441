"""Experiments: simulate the cohort of a preset and run the radiomics study with this cohort."""

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
from .io.atomic_write import delete_stale_temporary_files
from .io.cohort_records import read_manifest
from .io.mask_files import load_masks
from .io.patients import patient_radiographs as film_files
from .io.radiograph_files import load
from .io.study_results import save_text
from .standard_templates import make_standard_templates
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


# Name of the settings file in the folder of an experiment.
SETTINGS_FILE = "study.toml"


@dataclass(frozen=True)
class Experiment:
    """Finished cohort and the settings of its study.

    Attributes
    ----------
    out : Path
        Folder of the experiment.
    engine : {"scanline", "embree"}
        Ray caster with which the radiographs are simulated.
    settings : StudySettings
        Settings of the study.
    manifest : DataFrame
        Manifest of the cohort, with file paths relative to `out`.
    retest : DataFrame or None
        Manifest of the repeated radiographs, with the knee numbers of the cohort; None if no radiograph is repeated.
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
    """Simulate the cohort, the repeated radiographs and the designed experiments of an experiment.

    After an interruption, another call with the same folder continues the simulation. The settings of the experiment
    are written to ``out/study.toml``.

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
        or the result of `merge_settings`. If None, the preset ``quick`` is used.

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
    # These imports require the `study` extra.
    from .radiomics.features.area_features import require_resolved_texture
    from .study.design.sensitivity_plan import compute_bounds

    given = settings if isinstance(settings, ExperimentSettings) else merge_settings(settings or {})
    plan = plan_cohort(given.preset, seed=given.seed, overrides=given.cohort)
    names = [exposure.protocol.name for exposure in plan.cases[0].exposures]
    known = {"repeats": plan.repeats, "reference": "reference" if "reference" in names else names[0]}
    chosen = StudySettings(**{**known, **given.study, "seed": given.seed})
    film_set = None if given.films is None else _make_film_set(given.films, out, names, chosen)
    largest_mm = max(exposure.protocol.pixel_mm for case in plan.cases for exposure in case.exposures)
    require_resolved_texture(largest_mm, chosen.families)
    # The designed experiments are planned before the cohort is simulated, so that invalid sizes raise an error early.
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
    # The settings are written after the cohort, so that the settings of another cohort are not overwritten.
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
    from .study import resume  # This import requires the `study` extra.

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
    """Make the localisation templates and return the positional arguments for `study.run` and `study.measure`."""
    with execution.timer.stage("templates"):
        templates = make_standard_templates(experiment.engine, workers=execution.workers)
    load_pixels = partial(load_radiograph_pixels, experiment.out.absolute())
    return experiment.manifest, load_pixels, templates, experiment.settings, experiment.out


def _make_manifest(plan: Plan, out: Path, name: str, engine: str, execution: Execution) -> "pd.DataFrame":
    """Simulate the missing radiographs of a plan in ``out/name`` and return the manifest.

    File paths in the manifest are relative to `out`.
    """
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
    from .study.design import sensitivity_plan  # This import requires the `study` extra.

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
    """Prefix the file names of a manifest with a folder name, so that paths are relative to the parent folder."""
    files = [name for name in ("file", "masks") if name in manifest]
    return manifest.assign(**{name: f"{folder}/" + manifest[name] for name in files})


def _make_film_set(patient_films: PatientFilms, out: Path, protocols: list[str], settings: StudySettings) -> FilmSet:
    """Return the patient radiographs of a folder as a test set, with functions that load the images."""
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
        Folder of the experiment, to which the file paths in the manifest are relative.
    file : str
        Entry of the column ``file`` of the manifest.

    Returns
    -------
    (rows, cols) uint16 array
        Pixel values (DN), linear in the absorbed energy.
    """
    return load(folder / file).pixels


def _load_masks(folder: Path, file: str) -> dict[str, NDArray[np.bool_]]:
    """Load the masks of a radiograph from the file listed in the manifest column ``masks``."""
    return load_masks(folder / file)
