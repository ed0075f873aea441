"""Command of virtual trials: trial."""

from pathlib import Path
from typing import Annotated

import typer

from .shared_options import Out, Processes, Scheduler


def trial(
    *,
    out: Out,
    workers: Processes,
    design: Annotated[
        Path | None,
        typer.Option(help="TOML file with entries that differ from the default design (data/trial.toml)."),
    ] = None,
    subjects: Annotated[int | None, typer.Option(help="Number of subjects.", show_default="200")] = None,
    visits: Annotated[
        str | None, typer.Option(help="Months of the visits, separated by commas.", show_default="0,12,24")
    ] = None,
    views: Annotated[
        str | None,
        typer.Option(
            help="Names or TOML files of frontal views, separated by commas.",
            show_default="fixed_flexion,lyon_schuss,ap_standing",
        ),
    ] = None,
    readers: Annotated[
        str | None,
        typer.Option(
            help="Readers, separated by commas: label (projected joint space), network (pssf.read), human (label with "
            "an assumed error).",
            show_default="label,network,human",
        ),
    ] = None,
    without: Annotated[
        str,
        typer.Option(
            help="Causes of measurement error that are left out in turn for some subjects, separated by commas: beam, "
            "rotation, flexion, magnification, noise, display. An existing trial needs only the new radiographs."
        ),
    ] = "beam,rotation,flexion,magnification,noise,display",
    seed: Annotated[
        int | None, typer.Option(help="Seed of all random numbers; the same seed gives byte-identical output.")
    ] = None,
    scheduler: Scheduler = None,
) -> None:
    """Simulate a trial: errors of the joint space, their causes, and the number of subjects for a question.

    The command writes radiographs.csv with one row per radiograph, tables, and the report trial.html. An interrupted
    run continues where it stopped.
    """
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..study import require_extra

    require_extra()
    from ..trial import count_subject_jobs, load_trial_design, make_trial

    settings = load_trial_design(
        design,
        subjects=subjects,
        visits_months=None if visits is None else _parse_numbers("visits", visits),
        views=None if views is None else _parse_names(views),
        readers=None if readers is None else _parse_names(readers),
        seed=seed,
    )
    causes = _parse_names(without)
    total = count_subject_jobs(settings, causes)
    with Execution(progress_bar=show_progress_bar).stage("subjects", "subjects", total) as stage:
        page = make_trial(settings, out, without=causes, workers=workers, scheduler=scheduler, progress=stage.advance)
    print(f"report    {page}")


def _parse_names(text: str) -> tuple[str, ...]:
    """Split names at commas; an empty text gives no names."""
    return tuple(part.strip() for part in text.split(",")) if text else ()


def _parse_numbers(label: str, text: str) -> tuple[float, ...]:
    """Split numbers at commas."""
    from ..core.checks import InputError

    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{label} must be numbers separated by commas, such as 0,12,24, got {text!r}") from None
