"""Validation: numerical error and run time on this machine, and comparison with reference values.

:func:`run_validation` measures the requested tables and writes one CSV file per table.

Ray casting
    - ``engines``: run time, memory and error by engine, number of triangles, number of pixels and float precision.
    - ``growth``: growth of run time with the number of pixels and of triangles, computed from ``engines``.
    - ``nested``: run time and memory for five nested spheroids.
    - ``agreement``: difference between the two engines for random knees and random beam directions.
    - ``tessellation``: error of the projected bone outlines by number of triangles.
    - ``gvxr``: path lengths and run time compared with gVirtualXray.
    - ``ctsimu``: primary signal behind step wedges compared with the CTSimU test suite.
    - ``ctsimu_scatter``: signal with scatter behind its aluminium wedges.
    - ``ctsimu_images``: flat field, noise, edge, focal spot and wire pairs, evaluated by the program of the suite.
    - ``calibration``: detectors with random properties, calibrated from simulated images.
Imaging
    - ``stages``: run time of each stage of ``simulate`` in the first run after installation and in later runs.
    - ``chain``: run time, fraction of the total and error of each stage of ``simulate``.
    - ``throughput``: CPU time, memory and disk space per radiograph with labels and masks, for sampled knees.
    - ``worker_scaling``: run time of one and of two workers for the same radiographs.
    - ``left_out``: change of the radiograph if a soft tissue is replaced by muscle.
    - ``spectrum``: error and run time of the attenuation by number of energies of the reduced spectrum.
    - ``focal_spot``: focal-spot blur compared with ray casting from many points of the focal spot.
    - ``physics``: spectrum, attenuation, primary and scattered signal compared with reference values.
    - ``monte_carlo``: Monte Carlo scatter code compared with independent Monte Carlo code.
    - ``scatter``: scatter kernel compared with the Monte Carlo simulation.
    - ``view_scatter``: scatter kernel compared with the Monte Carlo simulation in each view.
    - ``views``: effects of beam angle and leg rotation compared with published values.
    - ``criteria``: criteria of radiographic positioning guides, measured on simulated knees.
Knees
    - ``builds``: number of random knees that can be built, and error of their joint space width.
    - ``knees``: bone sizes compared with published sizes, and errors of the knee labels.
    - ``texture_steps``: error of the trabecular density integral by step length.
    - ``texture_trace``: fraction of the ray-casting time that the trabecular density integral takes.
    - ``texture``: trabecular texture of radiographs compared with published values of patients.
Study methods
    - ``localisation``: success rate of joint localisation on valid and on deliberately faulty radiographs.
    - ``localisation_limits``: localisation limits derived from the simulations of ``localisation``.
    - ``coverage``: coverage of the confidence intervals of the study.
    - ``refutation``: verdicts on the claims of the study for cohorts with random labels.
    - ``ablation``: run time of the study if one step is omitted, for each step.
    - ``backends``: features of MIRP compared with features of PyRadiomics.
Texture measures
    - ``fractal_truth``: fractal dimensions compared with the dimensions of known surfaces.
    - ``fractal_disturbances``: change of the dimensions with noise, blur, gradients and tone.
    - ``fractal_orientation``: orientation and aspect ratio of anisotropic surfaces.
    - ``fractal_times``: run time per region.
    - ``texture_conditions``: agreement of texture measures between acquisitions and display processing.
    - ``texture_ranking``: agreement of three fractal methods, compared with a published ranking.
    - ``texture_meaning``: correlation of texture measures with properties of sampled knees.
    - ``texture_structure``: Sobol indices of texture measures for the structure of the trabecular bone.

Notes
-----
``DEFAULT_TABLES`` are measured by default. ``OPTIONAL_TABLES`` are measured only on request.
``coverage``, ``refutation``, ``ablation``, ``backends`` and the figure of ``engines`` need the optional dependencies
``study``. ``backends`` and ``gvxr`` need the dependency group ``peers``.
"""

import os
import platform
from collections.abc import Callable, Collection
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..core.checks import require_choice
from ..io.atomic_write import make_folder, write_bytes
from ..io.cohort_records import write_csv, write_json
from ..simulation import collect_versions
from .imaging.calibration_recovery import measure_calibration_recovery
from .imaging.ctsimu_images import compare_images_with_ctsimu
from .imaging.ctsimu_scatter import compare_scatter_with_ctsimu
from .imaging.ctsimu_wedges import compare_with_ctsimu
from .imaging.focal_spot_error import measure_focal_spot_models
from .imaging.left_out_tissues import measure_left_out_tissues
from .imaging.monte_carlo_reference import compare_monte_carlo_with_reference
from .imaging.physics_reference import compare_physics_with_references
from .imaging.positioning_criteria import measure_positioning_criteria
from .imaging.scatter_phantoms import DETECTOR_CASES, OTHER_DETECTORS, compare_kernel_with_monte_carlo
from .imaging.stage_errors import measure_imaging_chain
from .imaging.stage_times import measure_cold_and_warm_runs, measure_spectrum_nodes
from .imaging.throughput import measure_throughput, measure_worker_scaling
from .imaging.view_effects import compare_views_with_literature
from .imaging.view_scatter import compare_scatter_by_view
from .knees.build_success import measure_knee_builds
from .knees.morphometry import compare_sizes_with_literature
from .knees.trabecular_error import compare_texture_with_patients, measure_integration_steps, measure_texture_cost
from .raycasting.engine_agreement import compare_engines
from .raycasting.gvxr_comparison import compare_with_gvxr
from .raycasting.raycast_engines import (
    Row,
    compute_growth_exponents,
    measure_engines,
    measure_nested_spheroids,
)
from .raycasting.tessellation_error import measure_tessellation_error
from .study_methods.fractal_errors import (
    measure_fractal_disturbances,
    measure_fractal_orientation,
    measure_fractal_times,
    measure_fractal_truth,
)
from .study_methods.localisation_rates import derive_localisation_limits, measure_localisation

# Tables that measure memory come first, because a new process inherits the peak memory of its parent process.
DEFAULT_TABLES = (
    "engines", "growth", "nested", "stages", "chain", "agreement", "spectrum", "focal_spot", "physics",
    "monte_carlo", "scatter", "tessellation", "texture_steps", "texture_trace", "texture", "builds", "knees", "views",
    "view_scatter", "criteria",
)  # fmt: skip
# These tables are measured only on request, because they take minutes or need another package.
OPTIONAL_TABLES = (
    "throughput", "worker_scaling", "left_out", "localisation", "localisation_limits", "coverage", "refutation",
    "ablation", "backends", "gvxr", "ctsimu", "ctsimu_scatter", "ctsimu_images", "calibration",
    "fractal_truth", "fractal_disturbances", "fractal_orientation", "fractal_times", "texture_conditions",
    "texture_ranking", "texture_meaning", "texture_structure",
)  # fmt: skip


def run_validation(
    out: Path,
    *,
    workers: int = 2,
    tables: Collection[str] = DEFAULT_TABLES,
    knees: int = 30,
    progress: Callable[[str], None] = lambda line: None,
) -> list[Path]:
    """Measure the requested tables and write a CSV file per table, a description of the machine, and a figure.

    Parameters
    ----------
    out : Path
        Output folder; it is created if it does not exist.
    workers : int, default 2
        Number of worker processes or threads.
    tables : collection of str, default DEFAULT_TABLES
        Names of tables from ``DEFAULT_TABLES`` or ``OPTIONAL_TABLES``.
    knees : int, default 30
        Number of knees sampled for each table that measures random knees.
    progress : callable
        Function called with a line of text before each measurement.

    Returns
    -------
    list of Path
        Paths of all written files.

    Raises
    ------
    InputError
        A table is unknown, or a file cannot be written.
    """
    for name in tables:
        require_choice("table", name, (*DEFAULT_TABLES, *OPTIONAL_TABLES))
    make_folder(out)
    engines: list[Row] = []
    if {"engines", "growth"} & set(tables):
        progress("ray casting")
        engines = measure_engines(workers)
    jobs, paths = _make_table_jobs(engines, knees, workers, progress), []
    for name in (name for name in (*DEFAULT_TABLES, *OPTIONAL_TABLES) if name in tables):
        progress(name)
        paths.append(out / f"{name}.csv")
        write_csv(paths[-1], jobs[name]())
    paths.append(out / "machine.json")
    write_json(paths[-1], _describe_machine())
    if engines and find_spec("matplotlib"):
        from .validation_figure import plot_error_against_time

        paths.append(out / "engines.png")
        write_bytes(paths[-1], plot_error_against_time(engines))
    return paths


def _make_table_jobs(
    engine_results: list[Row], knees: int, workers: int, progress: Callable[[str], None]
) -> dict[str, Callable[[], list[Row]]]:
    """Map each table name to the function that measures the rows of the table."""
    return {
        "engines": lambda: engine_results,
        "growth": lambda: compute_growth_exponents(engine_results),
        "nested": lambda: measure_nested_spheroids(workers),
        "stages": lambda: measure_cold_and_warm_runs(workers),
        "chain": lambda: measure_imaging_chain(workers),
        "agreement": lambda: compare_engines(knees, workers),
        "spectrum": measure_spectrum_nodes,
        "focal_spot": lambda: measure_focal_spot_models(workers),
        "physics": compare_physics_with_references,
        "monte_carlo": lambda: compare_monte_carlo_with_reference(workers),
        "scatter": lambda: [
            *compare_kernel_with_monte_carlo(workers=workers),
            *compare_kernel_with_monte_carlo(workers=workers, cases=DETECTOR_CASES, detectors=OTHER_DETECTORS),
        ],
        "tessellation": measure_tessellation_error,
        "texture_steps": measure_integration_steps,
        "texture_trace": measure_texture_cost,
        "texture": lambda: compare_texture_with_patients(knees, workers),
        "builds": lambda: measure_knee_builds(knees, workers, progress),
        "knees": lambda: compare_sizes_with_literature(knees, workers),
        "views": lambda: compare_views_with_literature(knees, workers),
        "view_scatter": lambda: compare_scatter_by_view(workers),
        "criteria": lambda: measure_positioning_criteria(knees, workers),
        "throughput": lambda: measure_throughput(knees),
        "worker_scaling": lambda: measure_worker_scaling(knees),
        "left_out": lambda: measure_left_out_tissues(knees),
        "localisation": lambda: measure_localisation(knees, workers),
        "localisation_limits": lambda: derive_localisation_limits(knees, workers),
        "coverage": lambda: _import_study_module("interval_coverage").measure_interval_coverage(workers),
        "refutation": lambda: _import_study_module("random_label_test").count_false_claims(workers),
        "ablation": lambda: _import_study_module("study_ablation").measure_ablations(workers),
        "backends": lambda: _import_study_module("backend_agreement").compare_backends(),
        "gvxr": lambda: compare_with_gvxr(workers),
        **_make_texture_jobs(knees, workers),
        "ctsimu": compare_with_ctsimu,
        "ctsimu_scatter": compare_scatter_with_ctsimu,
        "ctsimu_images": compare_images_with_ctsimu,
        "calibration": measure_calibration_recovery,
    }


def _make_texture_jobs(knees: int, workers: int) -> dict[str, Callable[[], list[Row]]]:
    """Map the name of each table of texture measures to the function that measures its rows."""
    return {
        "fractal_truth": lambda: measure_fractal_truth(workers),
        "fractal_disturbances": measure_fractal_disturbances,
        "fractal_orientation": measure_fractal_orientation,
        "fractal_times": measure_fractal_times,
        "texture_conditions": lambda: _import_study_module("texture_conditions").measure_texture_conditions(
            knees, workers
        ),
        "texture_ranking": lambda: _import_study_module("texture_ranking").measure_texture_ranking(knees, workers),
        "texture_meaning": lambda: _import_study_module("texture_conditions").measure_texture_meaning(knees, workers),
        "texture_structure": lambda: _import_study_module("texture_structure").measure_texture_structure(
            knees, workers
        ),
    }


def _describe_machine() -> dict[str, str | int | None]:
    """Return processor, number of cores and package versions of this machine."""
    return {"machine": platform.processor() or platform.machine(), "cores": os.cpu_count(), **collect_versions()}


def _import_study_module(name: str) -> Any:
    """Import a module of ``study_methods`` that needs the optional dependencies ``study``."""
    from ..study import require_extra

    require_extra()
    return import_module(f".study_methods.{name}", __package__)
