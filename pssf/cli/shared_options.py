"""Options common to several commands, and their conversion to knees, protocols and scenes."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..geometry.scene import Scene
    from ..model.knee import Knee
    from ..model.protocol import Protocol


def _count_cores() -> int:
    """Return the number of cores that this process may use."""
    from ..core.processes.parallel_map import count_cores

    return count_cores()


Out = Annotated[Path, typer.Option("--out", help="Output folder; created if it does not exist.")]
Seed = Annotated[int, typer.Option(help="Seed of all random numbers; the same seed gives byte-identical output.")]
Grade = Annotated[
    int,
    typer.Option(help="KL grade of the sampled knee: 0 to 4 for grade table population, 0 to 2 for grade table paper."),
]
KneeFile = Annotated[
    Path | None,
    typer.Option("--knee", help="TOML file with the parameters of a knee, which replaces the sampled knee."),
]
ProtocolName = Annotated[str, typer.Option("--protocol", help="Name or TOML file of a protocol.")]
Workers = Annotated[int, typer.Option(help="Number of processes or threads; it does not affect the result.")]
Processes = Annotated[
    int,
    typer.Option(
        "--workers",
        default_factory=_count_cores,
        show_default="all cores that this process may use",
        help="Number of processes on this machine, with one thread each; it does not affect the result.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:PORT",
        help="Dask scheduler; its workers make the radiographs instead of processes on this machine. All workers "
        "need access to --out under the same path and the same version of pssf. Requires the extra cluster.",
    ),
]
Engine = Annotated[
    str, typer.Option(help="Ray caster: embree or scanline. Both give the same path lengths; scanline is faster.")
]
Preset = Annotated[
    str,
    typer.Option(
        help="Cohort: quick (24 subjects, 0.7 GB), paper (180 subjects, 7 GB), population (250 subjects, KL 0 to 4) or "
        "benchmark-1 (1,000 subjects; see pssf benchmark)."
    ),
]
GradeTable = Annotated[
    str,
    typer.Option(
        "--grade-table",
        help="Grade table from which knees are sampled: population (KL 0 to 4, with overlap as in patients), paper "
        "(grades 0 to 2, separated by JSW), or the path of a .toml file.",
    ),
]


Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help="New value for a field of the knee or the protocol, such as mas=2 or jsw_medial_mm=3. Repeat the option "
        "for several fields. `pssf knees` and `pssf protocols` list the fields.",
    ),
]
Matrix = Annotated[
    int,
    typer.Option(
        help="Number of pixels along the longer detector edge, for the same field of view; 0: as in the protocol."
    ),
]
Families = Annotated[
    str,
    typer.Option(
        help="Feature families, separated by commas: firstorder, shape2D, glcm, glrlm, glszm, ngtdm, gldm "
        "(default), and the texture measures fsa, vot, hot, lbp and spectrum."
    ),
]
KneeCounts = Annotated[
    str,
    typer.Option(
        "--knees",
        help="Number of knees of each grade, starting with grade 0, such as 10,10,10; default: as in the preset.",
    ),
]
Bilateral = Annotated[
    int, typer.Option(help="Number of subjects with both knees; -1: as in the preset, or 0 if --knees is used.")
]
CohortGrades = Annotated[
    str,
    typer.Option(
        "--grade-table",
        help="Grade table that replaces that of the preset: population, paper or the path of a .toml file.",
    ),
]


def cohort_overrides(
    knees: str,
    bilateral: int,
    protocols: str,
    grade_table: str,
    acquisition: str = "",
    *,
    matrix: int = 0,
    settings: "list[str] | None" = None,
) -> "dict[str, Any]":
    """Collect the preset entries that options replace, for `plan_cohort`.

    Options that the user does not specify are omitted.

    Parameters
    ----------
    knees : str
        Number of knees of each grade, starting with grade 0, separated by commas; an empty string keeps the preset.
    bilateral : int
        Number of subjects with both knees; -1 keeps the preset.
    protocols : str
        Names or TOML files of protocols, separated by commas; an empty string keeps the preset.
    grade_table : str
        Grade table; an empty string keeps the preset.
    acquisition : str
        "fixed" or "sampled"; an empty string keeps the preset.
    matrix : int
        Number of pixels along the longer detector edge; 0 keeps the protocol.
    settings : list of str or None
        Entries FIELD=VALUE that change the knee or the protocol.

    Returns
    -------
    dict of str to object
        New values of preset entries, keyed by entry name.

    Raises
    ------
    InputError
        If a number of knees is not an integer.
    """
    given: dict[str, Any] = {}
    if knees:
        given = {"knees": parse_knee_counts(knees), "bilateral": 0}
    if bilateral != -1:
        given["bilateral"] = bilateral
    if protocols:
        given["protocols"] = split_names(protocols)
    if grade_table:
        given["grade_table"] = grade_table
    if acquisition:
        given["acquisition"] = acquisition
    if matrix:
        given["matrix"] = matrix
    if settings:
        given["settings"] = tuple(settings)
    return given


def warn_of_cropped_field(protocol_changes: "dict[str, Any]") -> None:
    """Print a warning if rows or columns change without the pixel size, which changes the field of view.

    Parameters
    ----------
    protocol_changes : dict of str to object
        New values of protocol fields, keyed by field name.
    """
    sides = [name for name in ("rows", "cols") if name in protocol_changes]
    if sides and "pixel_mm" not in protocol_changes:
        print(
            f"pssf: warning: setting {' and '.join(sides)} without pixel_mm changes the field of view; to keep the "
            "field of view, change the number of pixels with --matrix",
            file=sys.stderr,
        )


def split_names(text: str) -> tuple[str, ...]:
    """Split the value of an option that lists names separated by commas.

    Parameters
    ----------
    text : str
        Value of the option.

    Returns
    -------
    tuple of str
        Names in the order of `text`, without surrounding spaces.
    """
    return tuple(name.strip() for name in text.split(","))


def parse_knee_counts(text: str) -> tuple[int, ...]:
    """Parse an option that lists the number of knees of each grade.

    Parameters
    ----------
    text : str
        Integers separated by commas, one per grade, starting with grade 0.

    Returns
    -------
    tuple of int
        Number of knees of each grade.

    Raises
    ------
    InputError
        If an entry is not an integer.
    """
    from ..core.checks import InputError

    counts = split_names(text)
    if not all(count.isascii() and count.isdigit() and len(count) < 7 for count in counts):
        raise InputError(
            f"knees must be integers separated by commas, one per grade starting with grade 0, got {text!r}"
        )
    return tuple(map(int, counts))


def parse_numbers(name: str, text: str) -> tuple[float, ...]:
    """Parse an option that lists numbers separated by commas.

    Parameters
    ----------
    name : str
        Name of the option in error messages.
    text : str
        Value of the option.

    Returns
    -------
    tuple of float
        Numbers in the order of `text`.

    Raises
    ------
    InputError
        If an entry is not a number.
    """
    from ..core.checks import InputError

    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise InputError(f"{name} must be numbers separated by commas, got {text!r}") from None


@dataclass(frozen=True)
class KneeChoice:
    """Knee or scene that the user requests: a knee from a file, a sampled knee or a scene from a file.

    Attributes
    ----------
    path : Path or None
        TOML file of the knee; None for a sampled knee.
    grade : int
        KL grade of a sampled knee.
    seed : int
        Seed of a sampled knee.
    grade_table : str
        Grade table from which a knee is sampled.
    overrides : dict of str to object
        New values of knee fields, keyed by field name.
    scene : Path or None
        File of a scene; None for a knee.
    """

    path: Path | None
    grade: int
    seed: int
    grade_table: str = "population"
    overrides: "dict[str, Any]" = field(default_factory=dict)
    scene: Path | None = None


def make_knee(choice: KneeChoice) -> "tuple[Knee, str]":
    """Make the knee that the user requests.

    Parameters
    ----------
    choice : KneeChoice
        Requested knee.

    Returns
    -------
    knee : Knee
        Requested knee.
    name : str
        Beginning of the output file names.

    Raises
    ------
    InputError
        If the options contradict each other, or a value is not allowed.
    """

    from ..core.checks import require_seed
    from ..data.data_files import read_toml
    from ..model.field_listing import apply_settings
    from ..model.knee import knee_from_dict
    from ..model.sampling.knee_sampling import sample_knee

    require_seed(choice.seed)
    if choice.path is not None:
        _require_no_sampling_options(choice, f"knee {choice.path}")
        read = knee_from_dict(read_toml(choice.path), f"knee {choice.path.name}")
        return apply_settings(read, choice.overrides), choice.path.stem
    drawn = sample_knee(grade=choice.grade, rng=choice.seed, grade_table=choice.grade_table)
    return apply_settings(drawn, choice.overrides), f"knee_grade{choice.grade}"


def _require_no_sampling_options(choice: KneeChoice, given: str) -> None:
    """Raise an error if options of a sampled knee are combined with a knee file or scene.

    `given` names the file or scene in the message.
    """
    from ..core.checks import InputError

    for name, value, default in (
        ("grade", choice.grade, 0),
        ("grade_table", choice.grade_table, KneeChoice.grade_table),
    ):
        if value != default:
            raise InputError(f"{name} must not be combined with {given}, got {value}")


def make_subject(choice: KneeChoice, protocol: "Protocol") -> "tuple[Knee | tuple[Knee, Knee] | Scene, str]":
    """Make the subject of a radiograph: one knee, both knees of a person, or a scene.

    Parameters
    ----------
    choice : KneeChoice
        Requested knee or scene.
    protocol : Protocol
        Acquisition protocol. If its knee distance is not 0, both knees are made.

    Returns
    -------
    subject : Knee, (Knee, Knee) tuple or Scene
        Subject to simulate. A pair of knees is ordered right, left.
    name : str
        Beginning of the output file names.

    Raises
    ------
    InputError
        If the options contradict each other, or a value is not allowed.
    """

    from ..core.checks import InputError, require_seed
    from ..model.field_listing import apply_settings
    from ..model.sampling.knee_sampling import sample_knee_pair

    if choice.scene is not None:
        from ..io.meshes.scene_file import read_scene

        if choice.path is not None or choice.overrides:
            given = choice.path or ", ".join(choice.overrides)
            raise InputError(f"scene {choice.scene} must not be combined with a knee, got {given}")
        _require_no_sampling_options(choice, f"scene {choice.scene}")
        return read_scene(choice.scene), choice.scene.stem
    if not protocol.knee_distance_mm:
        return make_knee(choice)
    if choice.path is not None:
        raise InputError(
            f"knee {choice.path} must be used with a protocol for one knee, got {protocol.name}, which images both "
            "knees"
        )
    require_seed(choice.seed)
    drawn = sample_knee_pair(grade=choice.grade, rng=choice.seed, grade_table=choice.grade_table)
    right, left = (apply_settings(one, choice.overrides) for one in drawn)
    return (right, left), f"knees_grade{choice.grade}"


def resolve_acquisition(
    acquisition: str, nominal: "Protocol", subject: "Knee | tuple[Knee, Knee] | Scene", seed: int
) -> "Protocol":
    """Return the nominal protocol, or sample an acquisition of it.

    Acquisition variability is sampled from a separate random stream.

    Parameters
    ----------
    acquisition : {"fixed", "sampled"}
        "fixed" returns the nominal protocol; "sampled" varies it.
    nominal : Protocol
        Protocol without acquisition variability.
    subject : Knee, (Knee, Knee) tuple or Scene
        Subject to simulate. The side of a single knee determines the location of the side marker.
    seed : int
        Seed that the user passes to the command.

    Returns
    -------
    Protocol
        Protocol of the sampled or nominal acquisition.

    Raises
    ------
    InputError
        If `acquisition` is neither "fixed" nor "sampled".
    """
    import numpy as np

    from ..core.checks import require_choice
    from ..model.knee import Knee
    from ..model.sampling.acquisition import sample_acquisition

    require_choice("acquisition", acquisition, ("fixed", "sampled"))
    if acquisition == "fixed":
        return nominal
    side = subject.side if isinstance(subject, Knee) else None
    return sample_acquisition(nominal, rng=np.random.default_rng([seed, 1]), side=side)
