"""How well lattices reach people's bones, in and out of the fit, and what is drawn from their distribution.

`python -m pssf.realism.shape_report BONES OUT` writes tables (CSV) and a picture of each mode.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from ..core.checks import Array
from ..core.parallel import ordered_map
from ..data.anatomy import AnatomyTables, anatomy_tables
from ..geometry.freeform import least_jacobian
from ..geometry.mesh import Mesh
from ..io.bones import read_bones
from ..io.results import save_bytes, save_table
from . import bones
from .bone_fit import BONES, heights_mm, laid_onto, near_joint
from .shape_figure import draw_modes
from .shape_frames import stand
from .shape_modes import (
    MeanFit,
    Modes,
    displacements,
    fit_knees,
    fit_mean,
    lattice_of,
    modes_of,
    scores_of,
)  # fmt: skip
from .shape_names import ModeName, formed, measured_knees, name_modes
from .surfaces import measured, surface_distance

Row = dict[str, Any]
Fitted = Mapping[str, Array]
Given = Mapping[str, Sequence[Mesh]]


def standing(mean: MeanFit, displacements_mm: Fitted) -> dict[str, Mesh]:
    """Bones as displacements form them, standing in the knee of default parameters.

    displacements_mm  bone -> (controls, 3)
    """
    own = formed(mean, displacements_mm)
    return {name: Mesh(stand(bone.vertices, name, mean.man), bone.faces) for name, bone in own.items()}


def reached(mean: MeanFit, displacements_mm: Sequence[Fitted], given: Given, workers: int = 1) -> dict[str, Array]:
    """Bone -> (knees, 2)  RMS and 99th percentile of the distances of formed bones from given ones, by the meter, mm

    displacements_mm  of each knee, bone -> (controls, 3)
    """
    tasks = [
        (name, standing(mean, {name: own[name]})[name], given[name][k])
        for name in BONES
        for k, own in enumerate(displacements_mm)
    ]
    distances = ordered_map(_distance, tasks, shared={}, workers=workers)
    each = list(zip(distances, tasks, strict=True))
    return {name: np.array([one for one, task in each if task[0] == name]) for name in BONES}


def _distance(task: tuple[str, Mesh, Mesh]) -> tuple[float, float]:
    name, formed_bone, given = task
    own, onto = measured(formed_bone), measured(near_joint(given, name))
    both = surface_distance(own, onto, laid_onto(own, onto, name), heights_mm(onto.mesh, name))
    return both.rms_mm, both.p99_mm


def reach_rows(what: str, distances_mm: Mapping[str, Array]) -> list[Row]:
    """One row a bone: median, largest and quantiles of RMS.

    distances_mm  bone -> (knees, 2)  RMS and 99th percentile, mm
    """
    rows = []
    for name, values in distances_mm.items():
        rms, p99 = values.T
        low, middle, high = np.percentile(rms, (10, 50, 90))
        rows.append({"bone": name, "what": what, "knees": len(rms), "rms_median_mm": middle, "rms_p10_mm": low})
        rows[-1] |= {"rms_p90_mm": high, "rms_most_mm": rms.max(), "p99_median_mm": np.median(p99)}
    return rows


def knees_of(fitted: Fitted) -> list[dict[str, Array]]:
    """Each knee's own displacements, bone -> (controls, 3).

    fitted  bone -> (knees, controls, 3)  mm
    """
    count = len(next(iter(fitted.values())))
    return [{name: values[k] for name, values in fitted.items()} for k in range(count)]


def by_modes(modes: Modes, scores: Array) -> list[dict[str, Array]]:
    """Displacements of knees with scores, bone -> (controls, 3) each.

    scores  (knees, modes)  SD
    """
    return [{name: displacements(modes, name, one) for name in BONES} for one in scores]


def held_out_rows(given: Given, out: Sequence[int], tables: AnatomyTables, workers: int = 1) -> list[Row]:
    """As `reach_rows`, of knees that had no part in the mean and the modes.

    out     their numbers
    tables  that the mean man is made from
    """
    knees = range(len(given[BONES[0]]))
    kept = {name: [given[name][k] for k in knees if k not in out] for name in BONES}
    left = {name: [given[name][k] for k in out] for name in BONES}
    mean = fit_mean(kept, tables, workers)
    modes = modes_of(fit_knees(kept, mean, workers), mean)
    fitted = fit_knees(left, mean, workers)
    rows = reach_rows("left out, own lattice", reached(mean, knees_of(fitted), left, workers))
    scores = scores_of(fitted, modes, mean)
    what = f"left out, scores of {len(modes.share)} modes of {len(knees) - len(out)} knees"
    return rows + reach_rows(what, reached(mean, by_modes(modes, scores), left, workers))


def jacobian_rows(mean: MeanFit, modes: Modes, draws: int, seed: int) -> list[Row]:
    """Least Jacobians: of the mean, of each mode alone at 3 SD, of drawn knees, normal scores held within 3 SD."""
    count = len(modes.share)
    scores = np.clip(np.random.default_rng(seed).standard_normal((draws, count)), -3, 3)
    alone = np.vstack((3 * np.eye(count), -3 * np.eye(count)))
    sets = {"mean": np.zeros((1, count)), "one mode at 3 SD": alone, f"{draws} drawn, within 3 SD": scores}
    rows = []
    for what, asked in sets.items():
        for name in BONES:
            least = [least_jacobian(lattice_of(mean, name, displacements(modes, name, one))) for one in asked]
            rows.append({"bone": name, "what": what, "least_jacobian": min(least)})
            rows[-1] |= {"p01": np.percentile(least, 1), "folds": int(np.sum(np.array(least) <= 0))}
    return rows


def mode_picture(mean: MeanFit, modes: Modes, names: Sequence[ModeName]) -> bytes:
    """PNG: each mode at -2, 0 and +2 SD, coloured by how far it moves the surface outwards."""
    rows = []
    for k, called in enumerate(names):
        columns = []
        for score in (-2.0, 0.0, 2.0):
            scores = np.zeros(len(names))
            scores[k] = score
            own = by_modes(modes, scores[None])[0]
            bones = formed(mean, own)
            columns.append((bones, {name: _outward(mean, modes, bones[name], name) for name in BONES}))
        title = f"{k + 1}: {called.name} ({called.correlation:.2f}; {called.also}), {modes.share[k]:.1%}"
        rows.append((title, columns))
    return draw_modes(rows)


def _outward(mean: MeanFit, modes: Modes, bone: Mesh, name: str) -> Array:
    """(n,)  how far vertices stand out beyond those of the mean, mm"""
    middle = mean.bones[name].deformed(lattice_of(mean, name, modes.means[name]))
    away = bone.vertices - middle.mesh.vertices
    normals = middle.mesh.as_trimesh().vertex_normals
    return np.asarray((away * normals).sum(axis=1))


def main(
    folder: Annotated[Path, typer.Argument(help="Real bones: an .npz, or folders of meshes in mm.")],
    out: Annotated[Path, typer.Argument(help="Folder for tables and the picture.")],
    seed: Annotated[int, typer.Option(help="Of the knees that are drawn, and of those that are left out.")] = 0,
    workers: Annotated[int, typer.Option(help="Processes.")] = 1,
) -> None:
    """Measure the lattices: reach, reach of knees left out, spread of drawn knees, folds; and draw the modes."""
    given = read_bones(folder)
    rng, tables = np.random.default_rng(seed), anatomy_tables()
    knees = len(given["femur"])
    mean = fit_mean(given, tables, workers)
    fitted = fit_knees(given, mean, workers)
    modes, names = name_modes(modes_of(fitted, mean), *measured_knees(mean, fitted))
    save_bytes(out / "modes.png", mode_picture(mean, modes, names))
    _table(out / "jacobians.csv", jacobian_rows(mean, modes, 2000, seed))
    drawn = [standing(mean, own) for own in by_modes(modes, rng.standard_normal((50, len(names))))]
    centre = standing(mean, modes.means)
    beside = bones.compare(given, centre, {name: [one[name] for one in drawn] for name in BONES}, workers)
    save_bytes(out / "mean.png", beside.figure)
    _table(out / "spread.csv", beside.rows)
    rows = reach_rows("own lattice", reached(mean, knees_of(fitted), given, workers))
    scores = scores_of(fitted, modes, mean)
    rows += reach_rows(f"scores of {len(names)} modes", reached(mean, by_modes(modes, scores), given, workers))
    out_of = sorted(rng.choice(knees, max(1, knees // 5), replace=False).tolist())
    rows += held_out_rows(given, out_of, tables, workers)
    _table(out / "reach.csv", rows)


def _table(path: Path, rows: Sequence[Row]) -> None:
    table = pd.DataFrame(list(rows))
    save_table(path, table)
    print(table.to_string(index=False, float_format="{:.3f}".format), flush=True)


if __name__ == "__main__":
    typer.run(main)
