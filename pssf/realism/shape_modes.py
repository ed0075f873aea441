"""Lattices fitted to every knee, and the principal directions in which the bones of a knee differ together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..anatomy.bone_build import Build
from ..core.checks import Array, InputError
from ..core.parallel import ordered_map
from ..data.anatomy import AnatomyTables
from ..geometry.freeform import Lattice, basis_matrix, with_displacements
from ..geometry.mesh import Mesh
from .bone_fit import BONES, heights_mm
from .bones import mean_of
from .freeform_fit import DeformableBone, deformable, fit_lattice, lattice_around
from .shape_frames import Frame, in_frame, mean_bones, mean_man, own_frames, pose_of
from .surfaces import MeasuredSurface, Similarity, measured

# Chosen by what is left: from 30 to 15 mm the mean femur comes from 1.02 to 0.31 mm RMS to the mean of people's
# (Clouthier et al. 2019); at 17 mm numbers are a third of those at 12.5 mm and folds are farther off.
PITCH_MM = {"femur": 17.0, "tibia": 17.0, "patella": 12.0}
SHAFT = {"femur": +1, "tibia": -1, "patella": 0}
# A knee's own change is smooth: it bends no more than the last of these lets it.
_OWN_STIFFNESS = (0.1, 0.03, 0.01, 0.01)


@dataclass(frozen=True, kw_only=True, eq=False)
class MeanFit:
    """The mean man's bones, the lattices that make them people's mean, and how people's come into their frames.

    people  the mean of people's bones, at its own place and size
    man     the mean man, in whom his bones stand
    """

    bones: Mapping[str, DeformableBone]
    lattices: Mapping[str, Lattice]
    frames: Mapping[str, Frame]
    people: Mapping[str, MeasuredSurface]
    man: Build


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """How the bones of one knee differ together.

    means       bone -> (controls, 3)         displacements of the mean, mm
    directions  bone -> (modes, controls, 3)  what one standard deviation of each mode adds, mm
    scores      (knees, modes)                of the knees they come from: mean 0, standard deviation 1
    share       (modes,)                      of the variance of distances between surfaces, each bone counting alike
    rms_mm      bone -> (modes,)              how far one standard deviation moves its surface
    """

    means: Mapping[str, Array]
    directions: Mapping[str, Array]
    scores: Array
    share: Array
    rms_mm: Mapping[str, Array]


def fit_mean(
    given: Mapping[str, Sequence[Mesh]],
    tables: AnatomyTables,
    workers: int = 1,
    kept: Mapping[str, Lattice] | None = None,
) -> MeanFit:
    """The mean man's bones laid onto the mean of given ones.

    tables  that the mean man is made from
    kept    bone -> the lattice that does it already
    raises  InputError where one of femur, tibia and patella is not given
    """
    if missing := [name for name in BONES if not given.get(name)]:
        raise InputError(f"bones: without = {', '.join(missing)}; allowed: femur, tibia and patella of every knee")
    man = mean_man(tables)
    built = mean_bones(man)
    people = {name: measured(mean_of(given[name], name)) for name in BONES}
    tasks = [(name, bone) for name in BONES for bone in given[name]]
    fits = ordered_map(_pose_one, tasks, shared={"people": people}, workers=workers)
    poses = {name: [one for one, task in zip(fits, tasks, strict=True) if task[0] == name] for name in BONES}
    frames = own_frames(built, people, poses, man)
    bones, lattices = dict[str, DeformableBone](), dict[str, Lattice]()
    for name in BONES:
        target = in_frame(people[name].mesh, frames[name])
        bones[name] = deformable(built[name], heights_mm(target.mesh, name))
        around = lattice_around(bones[name], PITCH_MM[name], SHAFT[name])
        lattices[name] = fit_lattice(bones[name], target, around) if kept is None else kept[name]
    return MeanFit(bones=bones, lattices=lattices, frames=frames, people=people, man=man)


def fit_knees(given: Mapping[str, Sequence[Mesh]], mean: MeanFit, workers: int = 1) -> dict[str, Array]:
    """Bone -> (knees, controls, 3)  displacements, mm, that lay the mean man's bone onto that of each knee

    Pose and size are taken out of every bone by a similarity fit onto the mean of people's.
    """
    tasks = [(name, bone) for name in BONES for bone in given[name]]
    displacements = ordered_map(_fit_one, tasks, shared={"mean": mean}, workers=workers)
    each = list(zip(displacements, tasks, strict=True))
    return {name: np.array([one for one, task in each if task[0] == name]) for name in BONES}


def modes_of(fitted: Mapping[str, Array], mean: MeanFit, least_share: float = 0.99) -> Modes:
    """Principal modes of knees, femur, tibia and patella together, as many as hold a share of the variance.

    fitted  bone -> (knees, controls, 3)  displacements, mm
    """
    means = {name: values.mean(axis=0) for name, values in fitted.items()}
    knees = len(next(iter(fitted.values())))
    off = {name: surface_change(fitted[name] - means[name], mean, name) for name in fitted}
    gram = np.sum([part @ part.T / (part**2).sum() for part in off.values()], axis=0)
    values, vectors = np.linalg.eigh(gram)
    order = np.argsort(values)[::-1][: knees - 1]
    share = values[order] / values[order].sum()
    count = int(np.searchsorted(np.cumsum(share), least_share) + 1)
    unit = vectors[:, order[:count]]
    scale = np.sqrt(knees - 1)
    return Modes(
        means=means,
        directions={name: np.einsum("nk,nci->kci", unit, fitted[name] - means[name]) / scale for name in fitted},
        scores=unit * scale,
        share=share[:count],
        rms_mm={name: np.sqrt(((unit.T @ part / scale) ** 2).mean(axis=1)) for name, part in off.items()},
    )


def scores_of(fitted: Mapping[str, Array], modes: Modes, mean: MeanFit) -> Array:
    """(knees, modes)  scores that come closest to knees, by distances between surfaces, each bone counting alike

    fitted  bone -> (knees, controls, 3)  displacements, mm
    """
    rows, wanted = [], []
    for name, directions in modes.directions.items():
        own = surface_change(directions, mean, name)
        weight = 1 / np.sqrt((own**2).sum())
        rows.append(own.T * weight)
        wanted.append(surface_change(fitted[name] - modes.means[name], mean, name).T * weight)
    return np.asarray(np.linalg.lstsq(np.vstack(rows), np.vstack(wanted), rcond=None)[0].T)


def displacements(modes: Modes, name: str, scores: Array) -> Array:
    """(controls, 3)  displacements of a bone with scores (modes,), mm"""
    return np.asarray(modes.means[name] + np.tensordot(scores, modes.directions[name], 1))


def surface_change(changes: Array, mean: MeanFit, name: str) -> Array:
    """(knees, points)  how far changes of displacement move the mean bone's surface outwards, mm

    changes  (knees, controls, 3)  mm
    """
    rows = _outward_rows(mean, name)
    return np.asarray((rows @ np.moveaxis(changes, 2, 1).reshape(len(changes), -1).T).T)


def _outward_rows(mean: MeanFit, name: str) -> sparse.csr_array:
    bone, lattice = mean.bones[name], mean.lattices[name]
    surface = bone.deformed(lattice)
    within = (surface.points_mm[:, 2] > bone.heights_mm[0]) & (surface.points_mm[:, 2] < bone.heights_mm[1])
    _, outward = surface.nearest(surface.points_mm[within])
    basis = basis_matrix(bone.points_mm[within], lattice)
    return sparse.csr_array(sparse.hstack([basis.multiply(outward[:, [axis]]) for axis in range(3)]))


def _pose_one(task: tuple[str, Mesh], people: Mapping[str, MeasuredSurface]) -> Similarity:
    name, bone = task
    return pose_of(bone, people[name], name)


def _fit_one(task: tuple[str, Mesh], mean: MeanFit) -> Array:
    name, bone = task
    laid = Mesh(pose_of(bone, mean.people[name], name).apply(bone.vertices), bone.faces)
    target = in_frame(laid, mean.frames[name])
    lattice = fit_lattice(mean.bones[name], target, mean.lattices[name], _OWN_STIFFNESS)
    return np.asarray(lattice.displacements_mm.reshape(-1, 3))


def lattice_of(mean: MeanFit, name: str, displacements_mm: Array) -> Lattice:
    """The lattice of a bone with other displacements.

    displacements_mm  (controls, 3)
    """
    return with_displacements(mean.lattices[name], displacements_mm)
