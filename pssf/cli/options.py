"""Options that commands share, and what they become."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..geometry.scene import Scene
    from ..model.knee import Knee
    from ..model.protocol import Protocol


def _cores() -> int:
    from ..core.parallel import cores

    return cores()


Out = Annotated[Path, typer.Option("--out", help="Folder for what is made; made if need be.")]
Seed = Annotated[int, typer.Option(help="Seed of all chance; the same seed gives the same bytes.")]
Grade = Annotated[
    int, typer.Option(help="KL grade of the sampled knee: 0 to 4 in the grade table population, 0 to 2 in paper.")
]
KneeFile = Annotated[
    Path | None, typer.Option("--knee", help="TOML file with the parameters of a knee, instead of a draw.")
]
ProtocolName = Annotated[str, typer.Option("--protocol", help="Protocol by name, or the path of a TOML file.")]
Workers = Annotated[int, typer.Option(help="Processes or threads; they do not change the result.")]
Processes = Annotated[
    int,
    typer.Option(
        "--workers",
        default_factory=_cores,
        show_default="all cores that this process may use",
        help="Processes of this machine, one thread each; they do not change the result.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:PORT",
        help="Dask scheduler whose workers make the radiographs, instead of processes of this machine; all must see "
        "--out under the same path and have the same pssf (extra: cluster).",
    ),
]
Engine = Annotated[str, typer.Option(help="Ray caster: embree or scanline; they agree, and scanline is faster.")]
Readme = Annotated[
    Path | None,
    typer.Option("--readme", help="Source checkout; its READMEs get what was measured, between the markers there."),
]
Preset = Annotated[
    str,
    typer.Option(
        help="Cohort: quick (24 subjects, 0.7 GB on disk), paper (180 subjects, 7 GB), population (250, KL 0 to 4), or "
        "benchmark-1 (1,000 people; see pssf benchmark)."
    ),
]
GradeTable = Annotated[
    str,
    typer.Option(
        "--grade-table",
        help="Table of grades that knees are sampled from: population (KL 0 to 4, which overlap as in patients), paper "
        "(grades 0 to 2 by joint space), or the path of a .toml file.",
    ),
]


Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help="Another value for a field of the knee or the protocol, such as mas=2 or jsw_medial_mm=3; may be given "
        "several times. `pssf knees` and `pssf protocols` list the fields.",
    ),
]
Matrix = Annotated[
    int,
    typer.Option(
        help="Pixels along the detector's longer side; the field stays, and the pixel size follows. 0: the protocol's."
    ),
]
KneeCounts = Annotated[
    str, typer.Option("--knees", help="Knees of each grade from 0 on, with commas, instead of the preset's: 10,10,10.")
]
Bilateral = Annotated[
    int, typer.Option(help="Subjects who give both knees; -1: as the preset has it, or none with --knees.")
]
CohortGrades = Annotated[
    str, typer.Option("--grade-table", help="Table of grades, as for simulate, instead of the preset's.")
]


def cohort_overrides(
    knees: str,
    bilateral: int,
    protocols: str,
    grade_table: str,
    exposures: str = "",
    *,
    matrix: int = 0,
    settings: "list[str] | None" = None,
) -> "dict[str, Any]":
    """Entries that replace a preset's, as `plan_cohort` takes them; those that are not given are left out.

    raises  InputError for counts that are none
    """
    from ..core.checks import InputError

    given: dict[str, Any] = {}
    if knees:
        counts = [count.strip() for count in knees.split(",")]
        if not all(count.isascii() and count.isdigit() and len(count) < 7 for count in counts):
            raise InputError(f"knees = {knees!r}; allowed: whole numbers with commas, one a grade from 0 on")
        given = {"knees": tuple(map(int, counts)), "bilateral": 0}
    if bilateral != -1:
        given["bilateral"] = bilateral
    if protocols:
        given["protocols"] = tuple(name.strip() for name in protocols.split(","))
    if grade_table:
        given["grade_table"] = grade_table
    if exposures:
        given["exposures"] = exposures
    if matrix:
        given["matrix"] = matrix
    if settings:
        given["settings"] = tuple(settings)
    return given


def tell_cropped(of_protocol: "dict[str, Any]") -> None:
    """Tell on standard error that fewer pixels of the same size are a smaller field, where a user sets those alone."""
    sides = [name for name in ("rows", "cols") if name in of_protocol]
    if sides and "pixel_mm" not in of_protocol:
        print(
            f"pssf: noted: {' and '.join(sides)} without pixel_mm change the field, since pixels keep their size; "
            "--matrix changes the number of pixels and keeps the field",
            file=sys.stderr,
        )


def numbers_of(name: str, listed: str) -> tuple[float, ...]:
    """The numbers of an option that lists them with commas.

    raises  InputError for what is none
    """
    from ..core.checks import InputError

    try:
        return tuple(float(number) for number in listed.split(","))
    except ValueError:
        raise InputError(f"{name} = {listed!r}; allowed: numbers with commas") from None


@dataclass(frozen=True)
class KneeChoice:
    """Which knee is wanted: of a file, or drawn by grade and seed; with other values in some fields; or a scene."""

    path: Path | None
    grade: int
    seed: int
    grade_table: str = "population"
    changed: "dict[str, Any]" = field(default_factory=dict)
    scene: Path | None = None


def knee_of(choice: KneeChoice) -> "tuple[Knee, str]":
    """A knee, and a name for its files."""

    from ..core.checks import require_seed
    from ..data.tables import read_toml
    from ..model.draw import draw_knee
    from ..model.knee import knee_from
    from ..model.listing import with_changes

    require_seed(choice.seed)
    if choice.path is not None:
        _require_not_drawn(choice, f"knee = {choice.path}")
        read = knee_from(read_toml(choice.path), f"knee {choice.path.name}")
        return with_changes(read, choice.changed), choice.path.stem
    drawn = draw_knee(grade=choice.grade, rng=choice.seed, grade_table=choice.grade_table)
    return with_changes(drawn, choice.changed), f"knee_grade{choice.grade}"


def _require_not_drawn(choice: KneeChoice, given: str) -> None:
    """Refuse what a knee would be drawn by, where it is given."""
    from ..core.checks import InputError

    for name, value, default in (
        ("grade", choice.grade, 0),
        ("grade_table", choice.grade_table, KneeChoice.grade_table),
    ):
        if value != default:
            raise InputError(f"{given}, with {name} = {value}; allowed: one of both")


def subject_of(choice: KneeChoice, protocol: "Protocol") -> "tuple[Knee | tuple[Knee, Knee] | Scene, str]":
    """What a protocol takes, and a name for its files: a knee, or both of a person; or a scene of one's own."""

    from ..core.checks import InputError, require_seed
    from ..model.draw import draw_pair
    from ..model.listing import with_changes

    if choice.scene is not None:
        from ..io.scenes import read_scene

        if choice.path is not None or choice.changed:
            given = choice.path or ", ".join(choice.changed)
            raise InputError(f"scene = {choice.scene}, with knee = {given}; allowed: one of both")
        _require_not_drawn(choice, f"scene = {choice.scene}")
        return read_scene(choice.scene), choice.scene.stem
    if not protocol.apart_mm:
        return knee_of(choice)
    if choice.path is not None:
        raise InputError(
            f"knee = {choice.path}, protocol = {protocol.name}, which takes both knees; allowed: a protocol of one"
        )
    require_seed(choice.seed)
    drawn = draw_pair(grade=choice.grade, rng=choice.seed, grade_table=choice.grade_table)
    right, left = (with_changes(one, choice.changed) for one in drawn)
    return (right, left), f"knees_grade{choice.grade}"


def taken_as(exposure: str, meant: "Protocol", subject: "Knee | tuple[Knee, Knee] | Scene", seed: int) -> "Protocol":
    """A protocol as it is meant ("fixed"), or as it is carried out ("drawn"), by a stream of the seed's own.

    raises  InputError for another exposure
    """
    import numpy as np

    from ..core.checks import require_choice
    from ..model.exposure import draw_exposure
    from ..model.knee import Knee

    require_choice("exposure", exposure, ("fixed", "drawn"))
    if exposure == "fixed":
        return meant
    side = subject.side if isinstance(subject, Knee) else None
    return draw_exposure(meant, rng=np.random.default_rng([seed, 1]), side=side)
