"""Named measures of form of people's bones and of drawn ones, in one frame and at one size."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..core.checks import Array
from ..geometry.mesh import Mesh
from .bone_fit import laid_onto
from .front_measures import front_measures
from .shape_measures import measures
from .surfaces import MeasuredSurface

Row = dict[str, Any]


def forms_of(surface: MeasuredSurface, model: MeasuredSurface, bone: str) -> dict[str, float]:
    """Measures of a bone's form, laid onto a model by a similarity first, which takes size and pose out.

    surface, model  near their joint, see `bone_fit.near_joint`
    """
    fit, near = laid_onto(surface, model, bone), surface.mesh
    laid = Mesh(fit.apply(near.vertices), near.faces)
    return measures({bone: laid}) | front_measures(bone, laid)


def form_rows(bone: str, given: Sequence[Mapping[str, float]], drawn: Sequence[Mapping[str, float]]) -> list[Row]:
    """One row a measure: given bones beside drawn ones, two or more of each; see `beside`."""
    return [
        {"bone": bone, "measure": what} | beside(*(np.array([one[what] for one in of]) for of in (given, drawn)))
        for what in given[0]
    ]


def beside(people: Array, ours: Array) -> Row:
    """Mean and standard deviation of one measure of people and of what was drawn, two or more of each.

    people, ours  (n,), (m,)  shares, degrees
    off_sd        how far the drawn mean is off, over people's standard deviation
    spread_ratio  of the standard deviations, drawn over given
    """
    mean, sd, drawn_mean, drawn_sd = people.mean(), people.std(ddof=1), ours.mean(), ours.std(ddof=1)
    return {
        "given": len(people), "mean": float(mean), "sd": float(sd), "drawn": len(ours),
        "drawn_mean": float(drawn_mean), "drawn_sd": float(drawn_sd), "off_sd": float((drawn_mean - mean) / sd),
        "spread_ratio": float(drawn_sd / sd),
    }  # fmt: skip
