"""The command study."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import (
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
    numbers_of,
)

if TYPE_CHECKING:
    from ..experiment import OwnFilms


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
        str, typer.Option(help="Names or TOML files, with commas, instead of the preset's; the first may be alone.")
    ] = "",
    families: Annotated[str, typer.Option(help="Families of features, with commas; all if none is named.")] = "",
    selections: Annotated[str, typer.Option(help="Selections of features, with commas; all if none is named.")] = "",
    models: Annotated[str, typer.Option(help="Models, with commas; all if none is named.")] = "",
    backend: Annotated[
        str, typer.Option(help="What measures features: pyradiomics or mirp; the first that is installed if none.")
    ] = "",
    films: Annotated[
        Path | None,
        typer.Option(help="Folder or CSV of films of patients by grade, which models for films are tested on as well."),
    ] = None,
    films_protocol: Annotated[
        str, typer.Option(help="Protocol of the cohort near that of the films; the study's reference if none is named.")
    ] = "",
    films_pixel_mm: Annotated[
        float, typer.Option(help="Pitch that films and cohort are brought to, mm; 0: the films' own, if it is coarser.")
    ] = 0.0,
    films_region_mm: Annotated[
        float, typer.Option(help="Side of the region, mm; 0: what nine of ten films hold, at most the study's.")
    ] = 0.0,
    curves: Annotated[
        int,
        typer.Option(
            help="Knees, half of grade 0 and half of 3 and 4, or 2 where there are none, to take again along dose, kV, "
            "focal spot, scatter, pixel, distance, tilt and rotation, for response curves; 56 radiographs each. 0: none"
        ),
    ] = 0,
    shares: Annotated[
        int,
        typer.Option(
            help="Samples, 64 or more, of the space of all parameters, for shares of a feature's variance; 11 "
            "radiographs each; 0: none."
        ),
    ] = 0,
    pairs: Annotated[
        int,
        typer.Option(
            help="Knees to take again with one parameter after the other changed and the noise held, for what each "
            "does to a feature; 14 radiographs each; 0: none."
        ),
    ] = 0,
    difference: Annotated[
        float, typer.Option(help="Difference of AUC that the power to show it, and the subjects needed, are given for.")
    ] = 0.05,
    strengths: Annotated[
        str,
        typer.Option(
            help="How strongly age, BMI and site are tied to grade, for what confounders do: from 0 to 0.95, with "
            "commas, 0 among them."
        ),
    ] = "0,0.3,0.6,0.9",
    until: Annotated[str, typer.Option(help="report, or features: stop when they are measured.")] = "report",
    readme: Readme = None,
) -> None:
    """The whole study: cohort, regions, features, models, report; goes on where an earlier run stopped.

    What is left out costs nothing: protocols, families of features, selections, models.
    """
    from ..core.checks import require_choice
    from ..core.execution import Execution
    from ..core.progress import bar
    from ..experiment import SHOWN, ByDesign, make_experiment, measure_experiment, run_experiment, shown_rows
    from ..io.readme import open_checkout

    require_choice("until", until, ("features", "report"))
    checkout = open_checkout(readme, SHOWN, preset=preset)
    execution = Execution(workers=workers, bar=bar, scheduler=scheduler)
    wanted = {"families": families, "selections": selections, "models": models}
    settings: dict[str, Any] = {name: tuple(listed.split(",")) for name, listed in wanted.items() if listed}
    settings |= {"backend": backend} if backend else {}
    settings |= {"difference": difference, "strengths": numbers_of("strengths", strengths)}
    overrides = cohort_overrides(knees, bilateral, protocols, grade_table, matrix=matrix)
    # The region is as wide as by default: 512 of the 2048 pixels that the package's protocols have.
    settings |= {"region_px": max(16, matrix // 4)} if matrix else {}
    own = _own_films(films, films_protocol, films_pixel_mm, films_region_mm)
    made = make_experiment(
        out,
        execution,
        preset=preset,
        seed=seed,
        engine=engine,
        cohort=overrides,
        settings=settings,
        films=own,
        by_design=ByDesign(curves=curves, shares=shares, pairs=pairs),
    )
    if until == "features":
        print(f"features  {measure_experiment(made, execution)}")
        return
    result = run_experiment(made, execution)
    checkout.take(shown_rows(result) if readme else {}, result.pictures.values(), measured_with=result.report)
    print(f"results   of {result.origin}")
    print(f"report    {result.report}")
    for what, paths in (("picture", result.pictures), ("model", result.models)):
        for path in paths.values():
            print(f"{what:<10}{path}")


def _own_films(folder: Path | None, protocol: str, pixel_mm: float, region_mm: float) -> "OwnFilms | None":
    """Films and how they are taken, where there are any."""
    from ..core.checks import InputError
    from ..experiment import OwnFilms

    if folder is not None:
        at = {"pixel_mm": pixel_mm or None, "region_mm": region_mm or None}
        return OwnFilms(folder=folder, protocol=protocol or None, **at)
    if pixel_mm or region_mm or protocol:
        raise InputError(
            "films = none, with films-pixel-mm, films-region-mm or films-protocol; allowed: --films FOLDER"
        )
    return None
