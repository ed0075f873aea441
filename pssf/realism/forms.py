"""Named measures of form of people's bones and of drawn ones, in one frame and at one size."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.parallel import ordered_map
from ..geometry.mesh import Mesh
from .bones import BONES, Bones, heights_mm, near_joint, start_of
from .shape_measures import measures
from .surfaces import MeasuredSurface, fit_similarity, measured

Row = dict[str, Any]
_Task = tuple[str, str, Mesh]


def compare_forms(given: Bones, built: Mapping[str, Mesh], drawn: Bones, workers: int = 1) -> list[Row]:
    """One row a measure: its mean and standard deviation of given bones and of drawn ones.

    Every bone is laid onto the built mean one by a similarity first, which takes size and pose out.

    off_sd        how far the drawn mean is off, over people's standard deviation
    spread_ratio  of the standard deviations, drawn over given
    """
    names = [name for name in BONES if len(given.get(name, ())) > 1]
    tasks = [
        (what, name, bone) for what, of in (("given", given), ("drawn", drawn)) for name in names for bone in of[name]
    ]
    onto = {name: measured(near_joint(built[name], name)) for name in names}
    measures = ordered_map(_measures_of, tasks, shared={"onto": onto}, workers=workers)
    rows = list[Row]()
    for name in names:
        people, ours = (
            [one for one, task in zip(measures, tasks, strict=True) if task[:2] == (what, name)]
            for what in ("given", "drawn")
        )
        rows += [
            _row(name, what, *(np.array([one[what] for one in of]) for of in (people, ours))) for what in people[0]
        ]
    return rows


def _row(bone: str, what: str, people: np.ndarray, ours: np.ndarray) -> Row:
    mean, sd, drawn_mean, drawn_sd = people.mean(), people.std(ddof=1), ours.mean(), ours.std(ddof=1)
    return {
        "bone": bone, "measure": what, "given": len(people), "mean": float(mean), "sd": float(sd), "drawn": len(ours),
        "drawn_mean": float(drawn_mean), "drawn_sd": float(drawn_sd), "off_sd": float((drawn_mean - mean) / sd),
        "spread_ratio": float(drawn_sd / sd),
    }  # fmt: skip


def _measures_of(task: _Task, onto: Mapping[str, MeasuredSurface]) -> dict[str, float]:
    _, name, bone = task
    near, surface = near_joint(bone, name), onto[name]
    fit = fit_similarity(measured(near), surface, start_of(near, surface.mesh, name), heights_mm(surface.mesh, name))
    return measures({name: Mesh(fit.apply(near.vertices), near.faces)})
