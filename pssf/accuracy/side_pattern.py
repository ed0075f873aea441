"""side_pattern: by what a right knee is told from a left one, learnt anew from drawn knees: `python -m
pssf.accuracy.side_pattern pssf/data/side_pattern.toml`.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from ..core.blocks import block_mean
from ..core.checks import InputError
from ..core.parallel import ordered_map
from ..data.localisation import Localisation, localisation
from ..data.shapes import shape_table
from ..experiment import standard_templates
from ..io.results import save_text
from ..model.draw import draw_knee
from ..model.exposure import draw_exposure
from ..model.knee import Knee
from ..model.protocol import Protocol, load_protocol
from ..simulation import simulate
from .builds import wide_knee
from .localisation import OTHERS, STUDY, on_fewer_pixels

if TYPE_CHECKING:
    from ..radiomics.patches import Template

_KNEES = 800
# Inverse strength of the ridge, in units of edges; in trials 1e-4 to 1e-1 told 92 to 94 % of 200 real films right.
_RIDGE = 0.01
_HEAD = """\
# Weights of edges by which a right knee is told from a left one: logistic regression with a ridge on what differs from
# the mirror image, of {count} drawn knees: three fifths people's in fixed flexion and standing AP, exposures drawn, the
# rest a study's and all over the ranges of an adult, under other protocols. In such units that a right knee that was
# not learnt from shows 1 on average. Written by `python -m pssf.accuracy.side_pattern`.
"""


def learnt(
    count: int, modes: int, workers: int, table: Localisation
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights (2, rows, cols), and the evidence (count,) for the true side of each knee by weights of the others.

    modes  of the bones' shape, how many
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.model_selection import KFold

    shared = {"templates": standard_templates("scanline", workers=workers), "modes": modes, "table": table}
    made = ordered_map(_of_knee, list(range(count)), shared=shared, workers=workers)
    edges = np.array([one for one in made if one is not None])
    flat = edges.reshape(len(edges), -1)

    def fitted(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        model = LogisticRegression(C=_RIDGE, fit_intercept=False, max_iter=2000)
        model.fit(np.concatenate([rows, -rows]), np.repeat([1, 0], len(rows)))
        return np.asarray(model.coef_[0])

    evidence = np.empty(len(flat))
    for train, test in KFold(5).split(flat):
        evidence[test] = flat[test] @ fitted(flat[train])
    usual = evidence.mean()
    return (fitted(flat) / usual).reshape(edges.shape[1:]), evidence / usual


def _of_knee(
    number: int, *, templates: "tuple[Template, ...]", modes: int, table: Localisation
) -> NDArray[np.float64] | None:
    """Edges that are not the same in the mirror, as of a right knee; nothing where it cannot be built."""
    from ..radiomics.locate import searched
    from ..radiomics.patches import LINEAR_MM, density_of
    from ..radiomics.sides import mirror_difference

    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(3,)))
    knee, protocol = _drawn(number, rng, modes)
    try:
        radiograph = simulate(knee, protocol, rng=number, engine="scanline", workers=1)
    except InputError:
        return None
    step = max(1, int(LINEAR_MM / protocol.pixel_mm))
    density = density_of(block_mean(radiograph.pixels, step))
    search, of_sides = searched(density, templates, table, protocol.pixel_mm * step)
    difference = mirror_difference(search.image, of_sides, table)
    return difference if knee.side == "right" else -difference


def _drawn(number: int, rng: np.random.Generator, modes: int) -> tuple[Knee, Protocol]:
    turn, kind = divmod(number, 5)
    if kind < 3:
        knee = draw_knee(grade=turn % 5, rng=rng, grade_table="population")
        protocol = load_protocol("fixed_flexion" if kind < 2 else "ap_standing")
        return knee, on_fewer_pixels(draw_exposure(protocol, rng=rng, side=knee.side))
    if kind == 3:
        return draw_knee(grade=turn % 3, rng=rng, grade_table="paper"), on_fewer_pixels(
            load_protocol(STUDY[turn % len(STUDY)])
        )
    return wide_knee(rng, modes), on_fewer_pixels(load_protocol(OTHERS[turn % len(OTHERS)]))


def pattern_text(weights: NDArray[np.float64], count: int, block: int) -> str:
    """The table as TOML.

    weights  (2, rows, cols)  dimensionless
    count    knees that they were learnt from
    block    as in the table
    """
    lines = [_HEAD.format(count=count) + f"block = {block}"]
    for name, rows in zip(("down", "right"), weights, strict=True):
        lines += [f"{name} = [", *(f"  [{', '.join(f'{value:.4f}' for value in row)}]," for row in rows), "]"]
    return "\n".join(lines) + "\n"


def main(out: Annotated[Path, typer.Argument(help="The table that is written (TOML).")]) -> None:
    """Learn the pattern anew, which takes half an hour on two cores, and say what it tells."""
    table = localisation()
    weights, evidence = learnt(_KNEES, len(shape_table().modes), os.cpu_count() or 1, table)
    save_text(out, pattern_text(weights, len(evidence), table.sides.block))
    shares = np.quantile(evidence, [0.0, 0.01, 0.05, 0.5])
    print(f"evidence of {len(evidence)} knees for their side: least, 1 %, 5 %, median: {shares.round(2)}")


if __name__ == "__main__":
    typer.run(main)
