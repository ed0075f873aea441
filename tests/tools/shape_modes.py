"""Shape modes: lattices fitted to every knee, and principal components of all bones of a knee combined."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from tools.bone_frames import (
    FrameTransform,
    build_template_anatomy,
    build_template_bones,
    fit_bone_pose,
    make_frame_transforms,
    transform_bone,
)
from tools.lattice_fit import (
    DeformableBone,
    fit_lattice,
    make_deformable_bone,
    make_lattice_around,
)

from pssf.anatomy.template.bone_builder import BoneParameters
from pssf.core.checks import Array, InputError
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.data.anatomy.anatomy_tables import AnatomyTables
from pssf.geometry.freeform_deformation import Lattice, basis_matrix, replace_displacements
from pssf.geometry.mesh import Mesh
from pssf.patient_comparison.bones.bone_comparison import compute_mean_bone
from pssf.patient_comparison.bones.bone_registration import BONES, compared_heights_mm
from pssf.patient_comparison.bones.surface_distance import SampledSurface, SimilarityTransform, sample_surface

# Distance between control points, in mm. If it is reduced from 30 to 15 mm, the distance between fitted and mean
# patient femur (Clouthier et al. 2019) decreases from 1.02 to 0.31 mm RMS. A lattice with 17 mm has a third of the
# control points of a lattice with 12.5 mm, and deformations are farther from self-intersection.
LATTICE_PITCH_MM = {"femur": 17.0, "tibia": 17.0, "patella": 12.0}
# Direction of the shaft: +1 proximal, -1 distal, 0 for a bone without a shaft.
SHAFT_SIGN = {"femur": +1, "tibia": -1, "patella": 0}
# Weight of the bending penalty in each fit step of a single knee; the last weight keeps the deviation from the mean
# smooth.
_KNEE_STIFFNESS = (0.1, 0.03, 0.01, 0.01)


@dataclass(frozen=True, kw_only=True, eq=False)
class MeanFit:
    """Template bones, lattices that deform them to the mean patient bones, and transforms to template frames.

    Attributes
    ----------
    bones : mapping of str to DeformableBone
        Template bones in their bone frames.
    lattices : mapping of str to Lattice
        Lattice that deforms each template bone to the mean patient bone.
    frames : mapping of str to callable
        Function per bone that moves points of the mean patient bone to the frame of the template bone.
    patient_means : mapping of str to SampledSurface
        Mean patient bones, at their original positions and sizes.
    template : BoneParameters
        Template anatomy.
    """

    bones: Mapping[str, DeformableBone]
    lattices: Mapping[str, Lattice]
    frames: Mapping[str, FrameTransform]
    patient_means: Mapping[str, SampledSurface]
    template: BoneParameters


@dataclass(frozen=True, kw_only=True, eq=False)
class ShapeModes:
    """Principal components of the combined displacements of femur, tibia and patella of a knee.

    Attributes
    ----------
    means : mapping of str to (controls, 3) array
        Mean control-point displacements of each bone, in mm.
    directions : mapping of str to (modes, controls, 3) array
        Control-point displacements per standard deviation of each mode, in mm.
    scores : (knees, modes) array
        Scores of the knees, with mean 0 and standard deviation 1.
    variance_fraction : (modes,) array
        Fraction of the variance of surface displacements that each mode explains; all bones have equal weight.
    rms_mm : mapping of str to (modes,) array
        RMS surface displacement per standard deviation of each mode, in mm.
    """

    means: Mapping[str, Array]
    directions: Mapping[str, Array]
    scores: Array
    variance_fraction: Array
    rms_mm: Mapping[str, Array]


def fit_mean(
    patient_bones: Mapping[str, Sequence[Mesh]],
    tables: AnatomyTables,
    workers: int = 1,
    known_lattices: Mapping[str, Lattice] | None = None,
) -> MeanFit:
    """Fit lattices that deform the template bones to the mean patient bones.

    Parameters
    ----------
    patient_bones : mapping of str to sequence of Mesh
        Patient bones by name; bone k of each type belongs to knee k.
    tables : AnatomyTables
        Anatomy tables of the template anatomy.
    workers : int, default 1
        Number of worker processes.
    known_lattices : mapping of str to Lattice or None, default None
        Known lattices of the mean patient bones; None fits the lattices.

    Returns
    -------
    MeanFit
        Template bones, mean lattices and frame transforms.

    Raises
    ------
    InputError
        Femur, tibia or patella is missing.
    """
    if missing := [name for name in BONES if not patient_bones.get(name)]:
        raise InputError(f"bones must include femur, tibia and patella of every knee, got no {', '.join(missing)}")
    man = build_template_anatomy(tables)
    built = build_template_bones(man)
    people = {name: sample_surface(compute_mean_bone(patient_bones[name], name)) for name in BONES}
    tasks = [(name, bone) for name in BONES for bone in patient_bones[name]]
    fits = map_in_parallel(_pose_one, tasks, shared={"people": people}, workers=workers)
    poses = {name: [one for one, task in zip(fits, tasks, strict=True) if task[0] == name] for name in BONES}
    frames = make_frame_transforms(built, people, poses, man)
    bones, lattices = dict[str, DeformableBone](), dict[str, Lattice]()
    for name in BONES:
        target = transform_bone(people[name].mesh, frames[name])
        bones[name] = make_deformable_bone(built[name], compared_heights_mm(target.mesh, name))
        around = make_lattice_around(bones[name], LATTICE_PITCH_MM[name], SHAFT_SIGN[name])
        lattices[name] = fit_lattice(bones[name], target, around) if known_lattices is None else known_lattices[name]
    return MeanFit(bones=bones, lattices=lattices, frames=frames, patient_means=people, template=man)


def fit_knees(patient_bones: Mapping[str, Sequence[Mesh]], mean: MeanFit, workers: int = 1) -> dict[str, Array]:
    """Fit the lattices that deform the template bones to the bones of each knee.

    Registration to the mean patient bone removes the pose and size of every bone.

    Parameters
    ----------
    patient_bones : mapping of str to sequence of Mesh
        Patient bones by name, one per knee.
    mean : MeanFit
        Template bones and mean lattices.
    workers : int, default 1
        Number of worker processes.

    Returns
    -------
    dict of str to (knees, controls, 3) array
        Control-point displacements of each bone, in mm.
    """
    tasks = [(name, bone) for name in BONES for bone in patient_bones[name]]
    displacements = map_in_parallel(_fit_one, tasks, shared={"mean": mean}, workers=workers)
    each = list(zip(displacements, tasks, strict=True))
    return {name: np.array([one for one, task in each if task[0] == name]) for name in BONES}


def compute_modes(
    knee_displacements: Mapping[str, Array], mean: MeanFit, min_variance_fraction: float = 0.99
) -> ShapeModes:
    """Compute the principal components of the combined displacements of femur, tibia and patella.

    Parameters
    ----------
    knee_displacements : mapping of str to (knees, controls, 3) array, mm
        Control-point displacements of each bone and knee.
    mean : MeanFit
        Template bones and mean lattices.
    min_variance_fraction : float, default 0.99
        Minimum fraction of the variance that the modes explain.

    Returns
    -------
    ShapeModes
        Shape modes.
    """
    means = {name: values.mean(axis=0) for name, values in knee_displacements.items()}
    knees = len(next(iter(knee_displacements.values())))
    off = {name: surface_change_mm(knee_displacements[name] - means[name], mean, name) for name in knee_displacements}
    gram = np.sum([part @ part.T / (part**2).sum() for part in off.values()], axis=0)
    values, vectors = np.linalg.eigh(gram)
    order = np.argsort(values)[::-1][: knees - 1]
    share = values[order] / values[order].sum()
    count = int(np.searchsorted(np.cumsum(share), min_variance_fraction) + 1)
    unit = vectors[:, order[:count]]
    scale = np.sqrt(knees - 1)
    return ShapeModes(
        means=means,
        directions={
            name: np.einsum("nk,nci->kci", unit, knee_displacements[name] - means[name]) / scale
            for name in knee_displacements
        },
        scores=unit * scale,
        variance_fraction=share[:count],
        rms_mm={name: np.sqrt(((unit.T @ part / scale) ** 2).mean(axis=1)) for name, part in off.items()},
    )


def fit_scores(knee_displacements: Mapping[str, Array], modes: ShapeModes, mean: MeanFit) -> Array:
    """Fit the scores that best reproduce the surfaces of knees; all bones have equal weight.

    Parameters
    ----------
    knee_displacements : mapping of str to (knees, controls, 3) array, mm
        Control-point displacements of each bone and knee.
    modes : ShapeModes
        Shape modes.
    mean : MeanFit
        Template bones and mean lattices.

    Returns
    -------
    (knees, modes) array
        Scores in standard deviations.
    """
    rows, wanted = [], []
    for name, directions in modes.directions.items():
        own = surface_change_mm(directions, mean, name)
        weight = 1 / np.sqrt((own**2).sum())
        rows.append(own.T * weight)
        wanted.append(surface_change_mm(knee_displacements[name] - modes.means[name], mean, name).T * weight)
    return np.asarray(np.linalg.lstsq(np.vstack(rows), np.vstack(wanted), rcond=None)[0].T)


def compute_displacements(modes: ShapeModes, name: str, scores: Array) -> Array:
    """Compute the control-point displacements of a bone from scores.

    Parameters
    ----------
    modes : ShapeModes
        Shape modes.
    name : {"femur", "tibia", "patella"}
        Bone type.
    scores : (modes,) array, SD
        Scores in standard deviations.

    Returns
    -------
    (controls, 3) array
        Control-point displacements in mm.
    """
    return np.asarray(modes.means[name] + np.tensordot(scores, modes.directions[name], 1))


def surface_change_mm(changes: Array, mean: MeanFit, name: str) -> Array:
    """Compute the outward displacement of the mean surface caused by changes of control points.

    Parameters
    ----------
    changes : (knees, controls, 3) array, mm
        Changes of the control-point displacements.
    mean : MeanFit
        Template bones and mean lattices.
    name : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    (knees, points) array
        Outward displacement of each surface point, in mm.
    """
    rows = _outward_basis(mean, name)
    return np.asarray((rows @ np.moveaxis(changes, 2, 1).reshape(len(changes), -1).T).T)


def _outward_basis(mean: MeanFit, name: str) -> sparse.csr_array:
    """Make the sparse matrix that converts control-point displacements to outward displacements of surface points."""
    bone, lattice = mean.bones[name], mean.lattices[name]
    surface = bone.apply_lattice(lattice)
    within = (surface.points_mm[:, 2] > bone.heights_mm[0]) & (surface.points_mm[:, 2] < bone.heights_mm[1])
    _, outward = surface.find_nearest(surface.points_mm[within])
    basis = basis_matrix(bone.points_mm[within], lattice)
    return sparse.csr_array(sparse.hstack([basis.multiply(outward[:, [axis]]) for axis in range(3)]))


def _pose_one(task: tuple[str, Mesh], people: Mapping[str, SampledSurface]) -> SimilarityTransform:
    """Register one bone to the mean patient bone."""
    name, bone = task
    return fit_bone_pose(bone, people[name], name)


def _fit_one(task: tuple[str, Mesh], mean: MeanFit) -> Array:
    """Fit the lattice of one bone; return the control-point displacements (controls, 3) in mm."""
    name, bone = task
    laid = Mesh(fit_bone_pose(bone, mean.patient_means[name], name).apply(bone.vertices), bone.faces)
    target = transform_bone(laid, mean.frames[name])
    lattice = fit_lattice(mean.bones[name], target, mean.lattices[name], _KNEE_STIFFNESS)
    return np.asarray(lattice.displacements_mm.reshape(-1, 3))


def make_lattice(mean: MeanFit, name: str, displacements_mm: Array) -> Lattice:
    """Make the lattice of a bone with given displacements.

    Parameters
    ----------
    mean : MeanFit
        Template bones and mean lattices.
    name : {"femur", "tibia", "patella"}
        Bone type.
    displacements_mm : (controls, 3) array
        Control-point displacements in mm.

    Returns
    -------
    Lattice
        Lattice of the bone with the given displacements.
    """
    return replace_displacements(mean.lattices[name], displacements_mm)
