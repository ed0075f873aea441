"""Command `study`."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from .shared_options import (
    CohortGrades,
    Families,
    KneeCounts,
    Matrix,
    Out,
    Preset,
    Processes,
    Scheduler,
    Seed,
    parse_knee_counts,
    parse_numbers,
    split_names,
)

# Options that affect how a study runs but not its results.
_OF_EXECUTION = ("out", "workers", "scheduler", "config", "until")
# Types of deprecated options. The settings file now contains these settings; the options remain valid for one version.
_FormerText = Annotated[str, typer.Option(hidden=True)]
_FormerCount = Annotated[int, typer.Option(hidden=True)]
_FormerNumber = Annotated[float, typer.Option(hidden=True)]
_FORMER = (
    *("bilateral", "engine", "selections", "models", "backend", "difference", "strengths"),
    *("films_protocol", "films_pixel_mm", "films_region_mm", "curve_knees", "sobol_samples", "sensitivity_knees"),
)
# Functions that convert the text of an option to the value of the setting with the same name.
_CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "knees": parse_knee_counts,
    "films": str,
    "strengths": partial(parse_numbers, "strengths"),
    **dict.fromkeys(("protocols", "families", "areas", "selections", "models"), split_names),
}
# Default values of deprecated options. A default value means that the user did not specify the option.
_NOT_GIVEN = {"bilateral": -1, "films_pixel_mm": 0.0, "films_region_mm": 0.0}


def study(
    context: typer.Context,
    *,
    out: Out,
    workers: Processes,
    config: Annotated[
        Path | None,
        typer.Option(
            help="Settings file (TOML), such as study.toml of an earlier study; other options override its settings."
        ),
    ] = None,
    preset: Preset = "quick",
    seed: Seed = 0,
    knees: KneeCounts = "",
    grade_table: CohortGrades = "",
    protocols: Annotated[
        str,
        typer.Option(
            help="Names or TOML files of protocols, separated by commas; they replace the protocols of the preset."
        ),
    ] = "",
    matrix: Matrix = 0,
    regions: Annotated[
        str,
        typer.Option(
            help="Source of the position of the regions: template (search), reader (landmarks of pssf.read) or truth "
            "(labels; patient radiographs then use the reader)."
        ),
    ] = "template",
    families: Families = "",
    areas: Annotated[
        str,
        typer.Option(
            help="Measured areas, separated by commas: square (default), and regions of the tibia such as "
            "medial_subchondral, which need --regions reader or truth."
        ),
    ] = "",
    films: Annotated[
        Path | None,
        typer.Option(
            help="Folder or CSV file of patient radiographs by grade; the models are also tested on these radiographs."
        ),
    ] = None,
    scheduler: Scheduler = None,
    until: Annotated[str, typer.Option(help="Last step of the run: features or report.")] = "report",
    bilateral: _FormerCount = -1,
    engine: _FormerText = "",
    selections: _FormerText = "",
    models: _FormerText = "",
    backend: _FormerText = "",
    difference: _FormerNumber = 0.05,
    strengths: _FormerText = "",
    films_protocol: _FormerText = "",
    films_pixel_mm: _FormerNumber = 0.0,
    films_region_mm: _FormerNumber = 0.0,
    curve_knees: _FormerCount = 0,
    sobol_samples: _FormerCount = 0,
    sensitivity_knees: _FormerCount = 0,
) -> None:
    """Run the entire study: cohort, regions, features, models and report.

    An interrupted run continues where it stopped. The settings file specifies features, models, statistics and designed
    experiments. Every study writes its settings to study.toml in the output folder. A disabled analysis costs no time.
    """
    from .. import experiment
    from ..core.checks import require_choice
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..io.run_record import start_run_record
    from ..study.design.experiment_settings import merge_settings, read_settings

    require_choice("until", until, ("features", "report"))
    record = start_run_record()
    execution = Execution(workers=workers, progress_bar=show_progress_bar, scheduler=scheduler)
    from_file = {} if config is None else read_settings(config)
    made = experiment.make_experiment(out, execution, merge_settings(from_file, _collect_given_settings(context)))
    if until == "features":
        print(f"features  {experiment.measure_experiment(made, execution)}")
        return
    result = experiment.run_experiment(made, execution)
    if result.origin == "this run":
        record.save(out)
    print(f"results   of {result.origin}")
    print(f"report    {result.report}")
    for what, paths in (("picture", result.pictures), ("model", result.models)):
        for path in paths.values():
            print(f"{what:<10}{path}")


def _collect_given_settings(context: typer.Context) -> dict[str, Any]:
    """Collect the settings on the command line, and warn about options that have become settings of the file."""
    given = {}
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if name in _OF_EXECUTION or source is None or source.name != "COMMANDLINE":
            continue
        if name in _FORMER:
            option = f"--{name.replace('_', '-')}"
            print(
                f"pssf: {option} is now a setting of the settings file, and the option will be removed; set {name} in "
                "a file and pass the file with --config",
                file=sys.stderr,
            )
        if value not in ("", _NOT_GIVEN.get(name)):
            given[name] = _CONVERSIONS.get(name, lambda same: same)(value)
    return given
