"""Command `study`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shared_options import (
    Bilateral,
    CohortGrades,
    Engine,
    KneeCounts,
    Matrix,
    Out,
    Preset,
    Processes,
    Readme,
    Scheduler,
    Seed,
    cohort_overrides,
    parse_numbers,
)

if TYPE_CHECKING:
    from ..experiment import PatientFilms


def study(
    *,
    out: Out,
    workers: Processes,
    preset: Preset = "quick",
    seed: Seed = 0,
    knees: KneeCounts = "",
    bilateral: Bilateral = -1,
    grade_table: CohortGrades = "",
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
    matrix: Matrix = 0,
    protocols: Annotated[
        str, typer.Option(help="Names or TOML files, separated by commas, instead of the preset's; one is enough.")
    ] = "",
    families: Annotated[str, typer.Option(help="Families of features, separated by commas; all by default.")] = "",
    selections: Annotated[str, typer.Option(help="Feature selections, separated by commas; all by default.")] = "",
    models: Annotated[str, typer.Option(help="Models, separated by commas; all by default.")] = "",
    backend: Annotated[
        str,
        typer.Option(
            help="Library that measures features: pyradiomics or mirp; by default the first that is installed."
        ),
    ] = "",
    films: Annotated[
        Path | None,
        typer.Option(help="Folder or CSV of patient radiographs by grade, on which models are tested too."),
    ] = None,
    films_protocol: Annotated[
        str,
        typer.Option(
            help="Protocol of the cohort closest to that of the patient radiographs; by default the reference protocol."
        ),
    ] = "",
    films_pixel_mm: Annotated[
        float,
        typer.Option(help="Pixel size of the comparison, mm; 0: that of the patient radiographs, if it is coarser."),
    ] = 0.0,
    films_region_mm: Annotated[
        float,
        typer.Option(
            help="Side of the region, mm; 0: as large as 90 % of patient radiographs allow, at most the study's."
        ),
    ] = 0.0,
    curve_knees: Annotated[
        int,
        typer.Option(
            help="Knees for response curves to dose, kV, focal spot, scatter, pixel size, distance, tilt and rotation; "
            "56 radiographs per knee. Half have grade 0, half grade 3 or 4 (2 if there are none). 0: none."
        ),
    ] = 0,
    sobol_samples: Annotated[
        int,
        typer.Option(
            help="Samples of the parameter space, 64 or more, for Sobol indices of the features; 11 radiographs per "
            "sample. 0: none."
        ),
    ] = 0,
    sensitivity_knees: Annotated[
        int,
        typer.Option(
            help="Knees for the effect of one parameter at a time on the features, with the same quantum noise; 14 "
            "radiographs per knee. 0: none."
        ),
    ] = 0,
    difference: Annotated[
        float, typer.Option(help="Difference of AUC for which power and the number of subjects are estimated.")
    ] = 0.05,
    strengths: Annotated[
        str,
        typer.Option(
            help="Strengths of the association of age, BMI and site with grade, for the analysis of confounders: 0 to "
            "0.95, separated by commas, 0 among them."
        ),
    ] = "0,0.3,0.6,0.9",
    until: Annotated[str, typer.Option(help="report, or features: stop when the features are measured.")] = "report",
    readme: Readme = None,
) -> None:
    """Run the whole study: cohort, regions, features, models and report; an interrupted run continues where it stopped.

    Protocols, families of features, selections and models that are left out cost no time.
    """
    from .. import experiment
    from ..core.checks import require_choice
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..io.readme_tables import open_checkout

    require_choice("until", until, ("features", "report"))
    checkout = open_checkout(readme, experiment.README_TABLES, preset=preset)
    execution = Execution(workers=workers, progress_bar=show_progress_bar, scheduler=scheduler)
    wanted = {"families": families, "selections": selections, "models": models}
    settings: dict[str, Any] = {name: tuple(listed.split(",")) for name, listed in wanted.items() if listed}
    settings |= {"backend": backend} if backend else {}
    settings |= {"difference": difference, "strengths": parse_numbers("strengths", strengths)}
    overrides = cohort_overrides(knees, bilateral, protocols, grade_table, matrix=matrix)
    # The region stays as wide as by default: 512 of the 2048 pixels of the protocols of the package.
    settings |= {"region_px": max(16, matrix // 4)} if matrix else {}
    own = _make_patient_films(films, films_protocol, films_pixel_mm, films_region_mm)
    sizes = {"curve_knees": curve_knees, "sobol_samples": sobol_samples, "sensitivity_knees": sensitivity_knees}
    made = experiment.make_experiment(
        out,
        execution,
        preset=preset,
        seed=seed,
        engine=engine,
        cohort=overrides,
        settings=settings,
        films=own,
        design_sizes=experiment.DesignSizes(**sizes),
    )
    if until == "features":
        print(f"features  {experiment.measure_experiment(made, execution)}")
        return
    result = experiment.run_experiment(made, execution)
    rows = experiment.collect_readme_rows(result) if readme else {}
    checkout.update_tables(rows, result.pictures.values(), measured_with=result.report)
    print(f"results   of {result.origin}")
    print(f"report    {result.report}")
    for what, paths in (("picture", result.pictures), ("model", result.models)):
        for path in paths.values():
            print(f"{what:<10}{path}")


def _make_patient_films(folder: Path | None, protocol: str, pixel_mm: float, region_mm: float) -> "PatientFilms | None":
    """Make the settings of patient radiographs; None if no folder is given."""
    from ..core.checks import InputError
    from ..experiment import PatientFilms

    if folder is not None:
        at = {"pixel_mm": pixel_mm or None, "region_mm": region_mm or None}
        return PatientFilms(folder=folder, protocol=protocol or None, **at)
    if pixel_mm or region_mm or protocol:
        raise InputError("films must be given with films-pixel-mm, films-region-mm or films-protocol, got films = none")
    return None
