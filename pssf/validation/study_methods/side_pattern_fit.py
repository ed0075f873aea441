"""Fit of the side pattern, which distinguishes right from left knees, to sampled knees.

Run ``python -m pssf.validation.study_methods.side_pattern_fit pssf/data/side_pattern.toml``.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from ...core.checks import InputError
from ...core.processes.parallel_map import map_in_parallel
from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import LocalisationSettings, load_localisation_settings
from ...data.anatomy.shape_table import load_shape_model
from ...experiment import make_standard_templates
from ...io.study_results import save_text
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.sampling.acquisition import sample_acquisition
from ...model.sampling.knee_sampling import sample_knee
from ...simulation import simulate
from ..knees.build_success import sample_wide_range_knee
from .localisation_rates import OTHER_PROTOCOLS, STUDY_PROTOCOLS, make_coarse_protocol

if TYPE_CHECKING:
    from ...radiomics.localisation.templates import Template

# Number of training knees.
_KNEES = 800
# Inverse ridge penalty. In trials, 1e-4 to 1e-1 gave the correct side for 92 to 94 % of 200 patient radiographs.
_RIDGE = 0.01
_TOML_HEADER = """\
# Edge weights that distinguish right from left knees: ridge logistic regression on the difference between an image and
# its mirror image, trained on {count} simulated knees. Three fifths are population knees in fixed flexion and standing
# AP with sampled acquisitions; the others are study knees and knees from wide adult ranges, under other protocols.
# Scaled to mean evidence 1 for right knees outside the training set. Written by
# `python -m pssf.validation.study_methods.side_pattern_fit`.
"""


def train_side_pattern(
    count: int, modes: int, workers: int, table: LocalisationSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Train the weights that distinguish right from left knees.

    Parameters
    ----------
    count : int
        Number of knees.
    modes : int
        Number of shape modes of the bones.
    workers : int
        Number of worker processes.
    table : LocalisationSettings
        Localisation settings.

    Returns
    -------
    (2, rows, cols) array
        Weights of vertical and horizontal edges, dimensionless.
    (count,) array
        Cross-validated evidence for the true side of each knee, with mean 1; knees that cannot be built are left out.
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.model_selection import KFold

    shared = {"templates": make_standard_templates("scanline", workers=workers), "modes": modes, "table": table}
    made = map_in_parallel(_compute_knee_edges, list(range(count)), shared=shared, workers=workers)
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


def _compute_knee_edges(
    number: int, *, templates: "tuple[Template, ...]", modes: int, table: LocalisationSettings
) -> NDArray[np.float64] | None:
    """Compute the edges of one knee that differ from their mirror image, as for a right knee.

    Returns None if the knee cannot be built.
    """
    from ...radiomics.localisation.joint_localisation import find_candidates
    from ...radiomics.localisation.laterality import compute_mirror_difference
    from ...radiomics.localisation.templates import MAX_SEARCH_PIXEL_MM, compute_density

    rng = np.random.default_rng(np.random.SeedSequence(number, spawn_key=(3,)))
    knee, protocol = _sample_knee_and_protocol(number, rng, modes)
    try:
        radiograph = simulate(knee, protocol, rng=number, engine="scanline", workers=1)
    except InputError:
        return None
    step = max(1, int(MAX_SEARCH_PIXEL_MM / protocol.pixel_mm))
    density = compute_density(downsample_by_blocks(radiograph.pixels, step))
    search, of_sides = find_candidates(density, templates, table, protocol.pixel_mm * step)
    difference = compute_mirror_difference(search.image, of_sides, table)
    return difference if knee.side == "right" else -difference


def _sample_knee_and_protocol(number: int, rng: np.random.Generator, modes: int) -> tuple[Knee, Protocol]:
    """Sample a knee and a protocol.

    Three fifths of the knees are population knees, one fifth study knees, and one fifth knees from wide adult ranges.
    """
    turn, kind = divmod(number, 5)
    if kind < 3:
        knee = sample_knee(grade=turn % 5, rng=rng, grade_table="population")
        protocol = load_protocol("fixed_flexion" if kind < 2 else "ap_standing")
        return knee, make_coarse_protocol(sample_acquisition(protocol, rng=rng, side=knee.side))
    if kind == 3:
        return sample_knee(grade=turn % 3, rng=rng, grade_table="paper"), make_coarse_protocol(
            load_protocol(STUDY_PROTOCOLS[turn % len(STUDY_PROTOCOLS)])
        )
    return sample_wide_range_knee(rng, modes), make_coarse_protocol(
        load_protocol(OTHER_PROTOCOLS[turn % len(OTHER_PROTOCOLS)])
    )


def format_pattern_toml(weights: NDArray[np.float64], count: int, block: int) -> str:
    """Format the side pattern as TOML.

    Parameters
    ----------
    weights : (2, rows, cols) array, dimensionless
        Weights of vertical and horizontal edges.
    count : int
        Number of knees that the weights were trained on.
    block : int
        Pixels per side of a block, as in the localisation settings.

    Returns
    -------
    str
        TOML text with a header comment.
    """
    lines = [_TOML_HEADER.format(count=count) + f"block = {block}"]
    for name, rows in zip(("down", "right"), weights, strict=True):
        lines += [f"{name} = [", *(f"  [{', '.join(f'{value:.4f}' for value in row)}]," for row in rows), "]"]
    return "\n".join(lines) + "\n"


def main(out: Annotated[Path, typer.Argument(help="TOML file to write.")]) -> None:
    """Train the side pattern, write it, and print quantiles of its evidence (half an hour on two cores).

    \f

    Parameters
    ----------
    out : Path
        TOML file to write.
    """
    table = load_localisation_settings()
    weights, evidence = train_side_pattern(_KNEES, len(load_shape_model().modes), os.cpu_count() or 1, table)
    save_text(out, format_pattern_toml(weights, len(evidence), table.sides.block))
    shares = np.quantile(evidence, [0.0, 0.01, 0.05, 0.5])
    print(f"evidence for the true side of {len(evidence)} knees: minimum, 1 %, 5 %, median: {shares.round(2)}")


if __name__ == "__main__":
    typer.run(main)
