"""Fit of the side pattern, the edge weights that distinguish right from left knees, to simulated knees.

Run ``python -m tools.side_pattern_fit ../pssf/data/side_pattern.toml`` in the folder ``tests``.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from pssf.core.checks import InputError
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.core.resample import downsample_by_blocks
from pssf.data.analysis.localisation_table import LocalisationSettings, load_localisation_settings
from pssf.data.anatomy.shape_table import load_shape_model
from pssf.io.study_results import save_text
from pssf.model.knee import Knee
from pssf.model.protocol import Protocol, load_protocol
from pssf.model.sampling.acquisition import sample_acquisition
from pssf.model.sampling.knee_sampling import sample_knee
from pssf.simulation import simulate
from pssf.standard_templates import make_standard_templates
from pssf.validation.knees.build_success import sample_wide_range_knee
from pssf.validation.study_methods.localisation_rates import OTHER_PROTOCOLS, STUDY_PROTOCOLS, make_coarse_protocol

if TYPE_CHECKING:
    from pssf.radiomics.localisation.templates import Template

# Number of training knees.
_KNEES = 800
# Inverse strength of the ridge penalty, dimensionless. In trials, values from 1e-4 to 1e-1 gave the correct side for 92
# to 94 % of 200 patient radiographs.
_RIDGE = 0.01
_TOML_HEADER = """\
# Edge weights that distinguish right from left knees.
# The weights are from ridge logistic regression on the difference between an image and its mirror image.
# The training set has {count} simulated knees.
# Three fifths are population knees in fixed flexion and standing AP, with sampled acquisitions.
# The other knees are study knees and knees with wide ranges of adult parameters, with other protocols.
# Weights are scaled to a mean evidence of 1 for right knees outside the training set.
# `tests/tools/side_pattern_fit.py` writes this file.
"""


def train_side_pattern(
    count: int, modes: int, workers: int, table: LocalisationSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Train the edge weights that distinguish right from left knees.

    Parameters
    ----------
    count : int
        Number of training knees.
    modes : int
        Number of shape modes of sampled bones.
    workers : int
        Number of worker processes.
    table : LocalisationSettings
        Localisation settings.

    Returns
    -------
    (2, rows, cols) array
        Weights of vertical and horizontal edges, dimensionless.
    (count,) array
        Cross-validated evidence for the true side of each knee, with mean 1; knees that cannot be built are omitted.
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
    """Compute the difference between the edges of a knee and their mirror image, with the sign of a right knee.

    Return None if the knee cannot be built.
    """
    from pssf.radiomics.localisation.joint_localisation import find_candidates
    from pssf.radiomics.localisation.laterality import compute_mirror_difference
    from pssf.radiomics.localisation.templates import MAX_SEARCH_PIXEL_MM, compute_density

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

    Three fifths of the knees are sampled from the grade table ``population``, one fifth from ``paper``, and one fifth
    from wide ranges of adults.
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
        Number of training knees.
    block : int
        Edge length of a block in pixels, as in the localisation settings.

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
    """Train the side pattern, write it to a file, and print quantiles of the side evidence (half an hour on two cores).

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
