"""Report on the shape model: distances from fitted and held-out patient bones, spread, and self-intersection.

Run ``python -m tools.shape_report BONES OUT`` in the folder ``tests``; the command writes tables (CSV) and figures.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from tools.bone_frames import apply_standing_pose
from tools.mode_figure import plot_modes
from tools.mode_names import (
    ModeName,
    deform_bones,
    measure_knees,
    name_modes,
)
from tools.shape_modes import (
    MeanFit,
    ShapeModes,
    compute_displacements,
    compute_modes,
    fit_knees,
    fit_mean,
    fit_scores,
    make_lattice,
)  # fmt: skip

from pssf.core.checks import Array
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.data.anatomy.anatomy_tables import AnatomyTables, load_anatomy_tables
from pssf.geometry.freeform_deformation import min_jacobian_determinant
from pssf.geometry.mesh import Mesh
from pssf.io.meshes.bone_folder import read_bones
from pssf.io.study_results import save_bytes, save_table
from pssf.patient_comparison.bones import bone_comparison
from pssf.patient_comparison.bones.bone_registration import (
    BONES,
    compared_heights_mm,
    crop_near_joint,
    register_bone,
)
from pssf.patient_comparison.bones.surface_distance import measure_surface_distance, sample_surface

Row = dict[str, Any]
BoneDisplacements = Mapping[str, Array]
PatientBones = Mapping[str, Sequence[Mesh]]


def build_standing_bones(mean: MeanFit, displacements_mm: BoneDisplacements) -> dict[str, Mesh]:
    """Deform template bones and move them to their positions in the standing knee with default parameters.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    displacements_mm : mapping of str to (controls, 3) array
        Control-point displacements of each bone, in mm.

    Returns
    -------
    dict of str to Mesh
        Bones in the knee frame, in mm.
    """
    own = deform_bones(mean, displacements_mm)
    return {
        name: Mesh(apply_standing_pose(bone.vertices, name, mean.template), bone.faces) for name, bone in own.items()
    }


def measure_fit_distances(
    mean: MeanFit, displacements_mm: Sequence[BoneDisplacements], patient_bones: PatientBones, workers: int = 1
) -> dict[str, Array]:
    """Measure the distances between deformed template bones and patient bones.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    displacements_mm : sequence of mapping of str to (controls, 3) array
        Control-point displacements of each knee and bone, in mm.
    patient_bones : mapping of str to sequence of Mesh
        Patient bones by name, one per knee, in mm.
    workers : int, default 1
        Number of worker processes.

    Returns
    -------
    dict of str to (knees, 2) array
        RMS and 99th percentile of the distances of each bone, in mm.
    """
    tasks = [
        (name, build_standing_bones(mean, {name: own[name]})[name], patient_bones[name][k])
        for name in BONES
        for k, own in enumerate(displacements_mm)
    ]
    distances = map_in_parallel(_measure_distance, tasks, shared={}, workers=workers)
    each = list(zip(distances, tasks, strict=True))
    return {name: np.array([one for one, task in each if task[0] == name]) for name in BONES}


def _measure_distance(task: tuple[str, Mesh, Mesh]) -> tuple[float, float]:
    """Measure RMS and 99th percentile of the distances of one bone after registration, in mm."""
    name, formed_bone, given = task
    own, onto = sample_surface(formed_bone), sample_surface(crop_near_joint(given, name))
    both = measure_surface_distance(own, onto, register_bone(own, onto, name), compared_heights_mm(onto.mesh, name))
    return both.rms_mm, both.p99_mm


def summarise_distances(what: str, distances_mm: Mapping[str, Array]) -> list[Row]:
    """Summarise surface distances over knees, for each bone.

    Parameters
    ----------
    what : str
        Description of the deformed bones.
    distances_mm : mapping of str to (knees, 2) array
        RMS and 99th percentile of the distances of each bone, in mm.

    Returns
    -------
    list of dict
        One row per bone: median, 10th and 90th percentile and maximum of the RMS, and median of the 99th percentile.
    """
    rows = []
    for name, values in distances_mm.items():
        rms, p99 = values.T
        low, middle, high = np.percentile(rms, (10, 50, 90))
        rows.append({"bone": name, "what": what, "knees": len(rms), "rms_median_mm": middle, "rms_p10_mm": low})
        rows[-1] |= {"rms_p90_mm": high, "rms_most_mm": rms.max(), "p99_median_mm": np.median(p99)}
    return rows


def split_by_knee(knee_displacements: BoneDisplacements) -> list[dict[str, Array]]:
    """Split control-point displacements by knee.

    Parameters
    ----------
    knee_displacements : mapping of str to (knees, controls, 3) array, mm
        Control-point displacements of each bone and knee.

    Returns
    -------
    list of dict of str to (controls, 3) array
        Control-point displacements of each knee, in mm.
    """
    count = len(next(iter(knee_displacements.values())))
    return [{name: values[k] for name, values in knee_displacements.items()} for k in range(count)]


def compute_knee_displacements(modes: ShapeModes, scores: Array) -> list[dict[str, Array]]:
    """Compute the control-point displacements of knees from scores.

    Parameters
    ----------
    modes : ShapeModes
        Shape modes.
    scores : (knees, modes) array, SD
        Scores of each knee, in standard deviations.

    Returns
    -------
    list of dict of str to (controls, 3) array
        Control-point displacements of each knee, in mm.
    """
    return [{name: compute_displacements(modes, name, one) for name in BONES} for one in scores]


def measure_held_out_knees(
    patient_bones: PatientBones, held_out: Sequence[int], tables: AnatomyTables, workers: int = 1
) -> list[Row]:
    """Measure surface distances for held-out knees, which are not used to compute mean and modes.

    Parameters
    ----------
    patient_bones : mapping of str to sequence of Mesh
        Patient bones by name, one per knee, in mm.
    held_out : sequence of int
        Numbers of the held-out knees.
    tables : AnatomyTables
        Anatomy tables of the template anatomy.
    workers : int, default 1
        Number of worker processes.

    Returns
    -------
    list of dict
        Rows of :func:`summarise_distances`, for lattices fitted to each knee and for scores of the modes.
    """
    knees = range(len(patient_bones[BONES[0]]))
    kept = {name: [patient_bones[name][k] for k in knees if k not in held_out] for name in BONES}
    left = {name: [patient_bones[name][k] for k in held_out] for name in BONES}
    mean = fit_mean(kept, tables, workers)
    modes = compute_modes(fit_knees(kept, mean, workers), mean)
    fitted = fit_knees(left, mean, workers)
    rows = summarise_distances(
        "held out, own lattice", measure_fit_distances(mean, split_by_knee(fitted), left, workers)
    )
    scores = fit_scores(fitted, modes, mean)
    what = f"held out, scores of {len(modes.variance_fraction)} modes of {len(knees) - len(held_out)} knees"
    return rows + summarise_distances(
        what, measure_fit_distances(mean, compute_knee_displacements(modes, scores), left, workers)
    )


def measure_jacobians(mean: MeanFit, modes: ShapeModes, draws: int, seed: int) -> list[Row]:
    """Measure the minimum Jacobian determinant of lattices; 0 or less means that the deformed bone intersects itself.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    modes : ShapeModes
        Shape modes.
    draws : int
        Number of sampled knees.
    seed : int
        Seed of the sampling.

    Returns
    -------
    list of dict
        One row per bone and group of knees. The groups are the mean knee, knees with one mode at -3 or +3 standard
        deviations, and sampled knees with normal scores clipped to 3 standard deviations.
    """
    count = len(modes.variance_fraction)
    scores = np.clip(np.random.default_rng(seed).standard_normal((draws, count)), -3, 3)
    alone = np.vstack((3 * np.eye(count), -3 * np.eye(count)))
    sets = {"mean": np.zeros((1, count)), "one mode at 3 SD": alone, f"{draws} sampled, within 3 SD": scores}
    rows = []
    for what, asked in sets.items():
        for name in BONES:
            least = [
                min_jacobian_determinant(make_lattice(mean, name, compute_displacements(modes, name, one)))
                for one in asked
            ]
            rows.append({"bone": name, "what": what, "least_jacobian": min(least)})
            rows[-1] |= {"p01": np.percentile(least, 1), "folds": int(np.sum(np.array(least) <= 0))}
    return rows


def make_mode_picture(mean: MeanFit, modes: ShapeModes, names: Sequence[ModeName]) -> bytes:
    """Make a figure of each mode at -2, 0 and +2 standard deviations, coloured by outward displacement.

    Parameters
    ----------
    mean : MeanFit
        Template bones and lattices.
    modes : ShapeModes
        Shape modes.
    names : sequence of ModeName
        Name of each mode.

    Returns
    -------
    bytes
        PNG image.
    """
    rows = []
    for k, called in enumerate(names):
        columns = []
        for score in (-2.0, 0.0, 2.0):
            scores = np.zeros(len(names))
            scores[k] = score
            own = compute_knee_displacements(modes, scores[None])[0]
            bones = deform_bones(mean, own)
            columns.append((bones, {name: _outward_distances_mm(mean, modes, bones[name], name) for name in BONES}))
        title = (
            f"{k + 1}: {called.name} ({called.correlation:.2f}; {called.other_measures}), "
            f"{modes.variance_fraction[k]:.1%}"
        )
        rows.append((title, columns))
    return plot_modes(rows)


def _outward_distances_mm(mean: MeanFit, modes: ShapeModes, bone: Mesh, name: str) -> Array:
    """Measure the outward displacements (n,) of vertices relative to the mean bone, in mm."""
    middle = mean.bones[name].apply_lattice(make_lattice(mean, name, modes.means[name]))
    away = bone.vertices - middle.mesh.vertices
    normals = middle.mesh.as_trimesh().vertex_normals
    return np.asarray((away * normals).sum(axis=1))


def main(
    folder: Annotated[Path, typer.Argument(help="Patient bones: an .npz file, or folders of meshes in mm.")],
    out: Annotated[Path, typer.Argument(help="Output folder for tables and figures.")],
    seed: Annotated[int, typer.Option(help="Seed of the sampled knees and of the selection of held-out knees.")] = 0,
    workers: Annotated[int, typer.Option(help="Number of worker processes.")] = 1,
) -> None:
    """Measure distances from fitted and held-out patient bones, spread and self-intersection, and plot the modes.

    \f

    Parameters
    ----------
    folder : Path
        File or folder of patient bones.
    out : Path
        Output folder.
    seed : int, default 0
        Seed of the sampled knees and of the selection of held-out knees.
    workers : int, default 1
        Number of worker processes.
    """
    given = read_bones(folder)
    rng, tables = np.random.default_rng(seed), load_anatomy_tables()
    knees = len(given["femur"])
    mean = fit_mean(given, tables, workers)
    fitted = fit_knees(given, mean, workers)
    modes, names = name_modes(compute_modes(fitted, mean), *measure_knees(mean, fitted))
    save_bytes(out / "modes.png", make_mode_picture(mean, modes, names))
    _save_and_print_table(out / "jacobians.csv", measure_jacobians(mean, modes, 2000, seed))
    drawn = [
        build_standing_bones(mean, own)
        for own in compute_knee_displacements(modes, rng.standard_normal((50, len(names))))
    ]
    centre = build_standing_bones(mean, modes.means)
    beside = bone_comparison.compare_bones(
        given, centre, {name: [one[name] for one in drawn] for name in BONES}, workers
    )
    save_bytes(out / "mean.png", beside.figure)
    _save_and_print_table(out / "spread.csv", beside.rows)
    rows = summarise_distances("own lattice", measure_fit_distances(mean, split_by_knee(fitted), given, workers))
    scores = fit_scores(fitted, modes, mean)
    rows += summarise_distances(
        f"scores of {len(names)} modes",
        measure_fit_distances(mean, compute_knee_displacements(modes, scores), given, workers),
    )
    out_of = sorted(rng.choice(knees, max(1, knees // 5), replace=False).tolist())
    rows += measure_held_out_knees(given, out_of, tables, workers)
    _save_and_print_table(out / "reach.csv", rows)


def _save_and_print_table(path: Path, rows: Sequence[Row]) -> None:
    """Save rows as a CSV file and print the table."""
    table = pd.DataFrame(list(rows))
    save_table(path, table)
    print(table.to_string(index=False, float_format="{:.3f}".format), flush=True)


if __name__ == "__main__":
    typer.run(main)
