"""Commands about the error of the joint space: trial, jsw-error."""

from pathlib import Path
from typing import Annotated

import typer

from .shared_options import KneeChoice, Out, Processes, Scheduler, Seed, make_knee, parse_numbers, split_names


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
    what_if: Annotated[
        str,
        typer.Option(
            help="Changes whose effect is estimated in what_if.csv without a new simulation, separated by commas: "
            "fraction=0.3 (of the treatment), human_sd_mm=0.1, human_bias_mm=0."
        ),
    ] = "",
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
        visits_months=None if visits is None else parse_numbers("visits", visits),
        views=None if views is None else split_names(views),
        readers=None if readers is None else split_names(readers),
        seed=seed,
    )
    causes, changes = split_names(without) if without else (), _parse_changes(what_if)
    total = count_subject_jobs(settings, causes)
    with Execution(progress_bar=show_progress_bar).stage("subjects", "subjects", total) as stage:
        page = make_trial(
            settings, out, without=causes, what_if=changes, workers=workers, scheduler=scheduler,
            progress=stage.advance,
        )  # fmt: skip
    print(f"report    {page}")


def jsw_error(
    knee: Annotated[
        Path | None, typer.Argument(help="TOML file with the parameters of a knee; without it, knees are sampled.")
    ] = None,
    *,
    out: Out,
    workers: Processes,
    knees: Annotated[int, typer.Option(help="Number of sampled knees, with the grades in turn.")] = 8,
    grades: Annotated[str, typer.Option(help="KL grades of sampled knees, separated by commas.")] = "2,3",
    seed: Seed = 0,
    view: Annotated[str, typer.Option(help="Name or TOML file of a frontal protocol.")] = "fixed_flexion",
    angles: Annotated[str, typer.Option(help="Beam angles in degrees, as first:last:step.")] = "0:20:2",
    rotation: Annotated[str, typer.Option(help="Rotations of the leg in degrees, as first:last:step.")] = "",
    flexion: Annotated[str, typer.Option(help="Flexions in degrees, as first:last:step.")] = "",
    distance: Annotated[str, typer.Option(help="Distances from source to joint in mm, as first:last:step.")] = "",
    centre_x: Annotated[str, typer.Option(help="Lateral shifts of the leg in mm, as first:last:step.")] = "",
    centre_z: Annotated[str, typer.Option(help="Vertical shifts of the leg in mm, as first:last:step.")] = "",
) -> None:
    """Map the error of the medial joint space against beam angle and positioning.

    The error is the difference from the joint space with the beam along the medial plateau. By default, the second axis
    is the rotation of the leg. The command writes jsw_errors.csv, jsw_error_summary.csv and the map jsw_errors.png.
    """
    from ..study import require_extra

    require_extra()
    from ..core.checks import InputError, require_integer
    from ..core.progress_display import show_status
    from ..io.atomic_write import make_folder, write_bytes
    from ..io.study_results import save_table
    from ..model.protocol import load_protocol
    from ..trial.jsw_error import ErrorGrid, measure_jsw_errors
    from ..trial.jsw_error_figure import draw_jsw_errors

    axes = {
        "rotation": rotation, "flexion": flexion, "distance": distance, "centre_x": centre_x, "centre_z": centre_z,
    }  # fmt: skip
    given = {name: text for name, text in axes.items() if text} or {"rotation": "-10:10:5"}
    if len(given) > 1:
        raise InputError(f"options must include one axis besides the angles, got {', '.join(given)}")
    ((axis, text),) = given.items()
    grid = ErrorGrid(angles_deg=_parse_range("angles", angles), axis=axis, values=_parse_range(axis, text))
    require_integer("knees", knees, 1, 10_000, "")
    listed = [int(grade) for grade in parse_numbers("grades", grades)]
    choices = (
        [KneeChoice(path=knee, grade=0, seed=0)]
        if knee is not None
        else [KneeChoice(path=None, grade=listed[turn % len(listed)], seed=seed + turn) for turn in range(knees)]
    )
    with show_status("measuring"):
        errors, summary = measure_jsw_errors(
            [make_knee(choice)[0] for choice in choices], load_protocol(view), grid, workers=workers
        )
    folder = make_folder(out)
    save_table(folder / "jsw_errors.csv", errors)
    save_table(folder / "jsw_error_summary.csv", summary)
    write_bytes(folder / "jsw_errors.png", draw_jsw_errors(errors, summary))
    for row in summary.to_dict("records"):
        print(
            f"knee {row['knee']:<4} best angle {row['best_angle_deg']:5.1f} degrees, error at the angle of the view "
            f"{row['nominal_error_mm']:+.2f} mm, within 2 degrees of the best angle {row['within_2_mm']:.2f} mm"
        )
    print(f"map       {folder / 'jsw_errors.png'}")


# Largest number of values of an axis.
_MOST_VALUES = 200


def _parse_range(label: str, text: str) -> tuple[float, ...]:
    """Parse a range of numbers, first:last:step, with the last number included."""
    from ..core.checks import InputError

    try:
        first, last, step = map(float, text.split(":"))
        count = int((last - first) / step + 1e-9) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(f"{label} must be first:last:step, such as -5:15:1, got {text!r}") from None
    if not 1 <= count <= _MOST_VALUES:
        raise InputError(f"{label} must be 1 to {_MOST_VALUES} values, first:last:step, got {text!r}")
    return tuple(round(first + step * turn, 6) for turn in range(count))


def _parse_changes(text: str) -> dict[str, float]:
    """Parse changes such as ``fraction=0.3,human_sd_mm=0.1``."""
    changes = {}
    for part in split_names(text) if text else ():
        name, _, value = part.partition("=")
        (changes[name],) = parse_numbers(f"what-if {name}", value)
    return changes
