"""Options that commands share, and what they become."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..model.knee import Knee
    from ..model.protocol import Protocol


def _cores() -> int:
    from ..core.parallel import cores

    return cores()


Out = Annotated[Path, typer.Option("--out", help="Folder for what is made; made if need be.")]
Seed = Annotated[int, typer.Option(help="Seed of all chance; the same seed gives the same bytes.")]
Grade = Annotated[int, typer.Option(help="KL grade of the drawn knee: 0 to 2 by the table paper, 0 to 4 by people.")]
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
    str, typer.Option(help="Cohort: quick (24 subjects), paper (180 subjects), or people (250, KL 0 to 4).")
]
Grades = Annotated[
    str,
    typer.Option(
        help="Table of grades that knees are drawn by: paper (grades 0 to 2 by joint space), people (KL 0 to 4 that "
        "overlap), or the path of a .toml file."
    ),
]


def knee_of(path: Path | None, grade: int, seed: int, table: str = "paper") -> "tuple[Knee, str]":
    """A knee from a file, or drawn by grade and seed; and a name for its files."""
    import numpy as np

    from ..core.checks import require_seed
    from ..data.tables import read_toml
    from ..model.draw import draw_knee
    from ..model.knee import knee_from

    require_seed(seed)
    if path is not None:
        return knee_from(read_toml(path), f"knee {path.name}"), path.stem
    return draw_knee(grade=grade, rng=np.random.default_rng(seed), table=table), f"knee_grade{grade}"


def subject_of(
    path: Path | None, grade: int, seed: int, table: str, protocol: "Protocol"
) -> "tuple[Knee | tuple[Knee, Knee], str]":
    """What a protocol takes: a knee, or both of a person, drawn by grade and seed; and a name for its files."""
    import numpy as np

    from ..core.checks import InputError, require_seed
    from ..model.draw import draw_pair

    if not protocol.apart_mm:
        return knee_of(path, grade, seed, table)
    if path is not None:
        raise InputError(
            f"knee = {path}, protocol = {protocol.name}, which takes both knees; allowed: a protocol of one"
        )
    require_seed(seed)
    return draw_pair(grade=grade, rng=np.random.default_rng(seed), table=table), f"knees_grade{grade}"
