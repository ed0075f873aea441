"""Registration of patient bones to the frames of template bones; registration removes size and pose."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from pssf.anatomy.bones.small_bones import build_patella
from pssf.anatomy.meshing.solids import extract_mesh
from pssf.anatomy.template.bone_builder import (
    BoneDeformation,
    BoneParameters,
    compute_plateau_fall_per_mm,
    map_template_femur,
    map_template_tibia,
    resolve_bone_parameters,
)
from pssf.core.checks import Array
from pssf.data.anatomy.anatomy_tables import AnatomyTables
from pssf.geometry.freeform_deformation import Lattice, replace_displacements
from pssf.geometry.mesh import Mesh
from pssf.model.knee import Knee
from pssf.patient_comparison.bones.bone_registration import fit_bone
from pssf.patient_comparison.bones.surface_distance import SampledSurface, SimilarityTransform, sample_surface

FrameTransform = Callable[[Array], Array]
# Depth of the proximal tibia that contains the widest part of the plateau, in mm.
_PLATEAU_DEPTH_MM = 25.0
# Number of fixed-point iterations for the inverse of the standing pose.
_ITERATIONS = 15


def build_template_bones(template: BoneParameters) -> dict[str, Mesh]:
    """Build femur, tibia and patella of the template anatomy in their bone frames, before posture is applied.

    Parameters
    ----------
    template : BoneParameters
        Template anatomy, from :func:`build_template_anatomy`.

    Returns
    -------
    dict of str to Mesh
        Bones by name, in mm. The patella is in the frame of the femur, in which its lattice is defined.
    """
    small = extract_mesh(build_patella(template).outer)
    return {
        "femur": extract_mesh(template.template_femur.outer),
        "tibia": extract_mesh(template.template_tibia.outer),
        # The lattice of the patella is defined in the frame of the femur, so the patella is moved to this frame.
        "patella": Mesh(small.vertices + template.shape.patella.centre_mm, small.faces),
    }


def build_template_anatomy(tables: AnatomyTables) -> BoneParameters:
    """Build the parameters of the template anatomy, with lattices that do not deform the bones.

    Parameters
    ----------
    tables : AnatomyTables
        Anatomy tables.

    Returns
    -------
    BoneParameters
        Parameters of the template anatomy.
    """
    build = resolve_bone_parameters(Knee(), tables)
    none = {
        name: replace_displacements(lattice, 0 * lattice.displacements_mm)
        for name, lattice in _bone_lattices(build).items()
    }
    tibia = BoneDeformation(lattice=none["tibia"], shaft_sign=-1)
    return replace(
        build,
        femur=BoneDeformation(lattice=none["femur"], shaft_sign=+1),
        tibia=tibia,
        plateau_fall_per_mm=compute_plateau_fall_per_mm(tibia, build.shape.tibia),
        patella=none["patella"],
        femur_valgus_deg=build.shape.femur.valgus_deg,
        tibia_varus_deg=0.0,
    )


def _bone_lattices(build: BoneParameters) -> dict[str, Lattice]:
    """Return the lattice of each bone."""
    return {"femur": build.femur.lattice, "tibia": build.tibia.lattice, "patella": build.patella}


def apply_standing_pose(points_mm: Array, name: str, template: BoneParameters) -> Array:
    """Move points of an undeformed template bone to their position in the standing knee.

    Parameters
    ----------
    points_mm : (n, 3) array
        Points in the frame of the bone, in mm.
    name : {"femur", "tibia", "patella"}
        Bone type.
    template : BoneParameters
        Template anatomy, from :func:`build_template_anatomy`.

    Returns
    -------
    (n, 3) array
        Points in the knee frame, in mm.
    """
    how = {"femur": map_template_femur, "tibia": map_template_tibia}.get(name)
    return how(points_mm, template) if how else points_mm


def undo_standing_pose(places_mm: Array, name: str, template: BoneParameters) -> Array:
    """Move points of the standing knee to the frame of the bone; inverse of :func:`apply_standing_pose`.

    Parameters
    ----------
    places_mm : (n, 3) array
        Points in the knee frame, in mm.
    name : {"femur", "tibia", "patella"}
        Bone type.
    template : BoneParameters
        Template anatomy, from :func:`build_template_anatomy`.

    Returns
    -------
    (n, 3) array
        Points in the frame of the bone, in mm.
    """
    points = np.array(places_mm, np.float64)
    for _ in range(_ITERATIONS):
        points += places_mm - apply_standing_pose(points, name, template)
    return points


def make_frame_transforms(
    built: Mapping[str, Mesh],
    patient_means: Mapping[str, SampledSurface],
    poses: Mapping[str, Sequence[SimilarityTransform]],
    template: BoneParameters,
) -> dict[str, FrameTransform]:
    """Make a function per bone that moves points of the mean patient bone to the frame of the template bone.

    Parameters
    ----------
    built : mapping of str to Mesh
        Template bones before posture is applied, in mm.
    patient_means : mapping of str to SampledSurface
        Mean patient bone of each type.
    poses : mapping of str to sequence of SimilarityTransform
        Transforms that register the bone of each knee to the mean patient bone.
    template : BoneParameters
        Template anatomy, from :func:`build_template_anatomy`.

    Returns
    -------
    dict of str to callable
        Function per bone that transforms an (n, 3) array of points in mm.

    Notes
    -----
    The mean patient bone is rotated to the average orientation of the patient bones. It is not fitted to the template
    bone, because a fit would change plateau slope and shaft direction. All three bones have the same scale, which gives
    the plateau the width of the template plateau. Femur and tibia have the same horizontal shift, so they remain
    congruent. The distal end of the femur is at height 0, and the plateau at the height of the template plateau.
    """
    standing = {
        name: Mesh(apply_standing_pose(bone.vertices, name, template), bone.faces) for name, bone in built.items()
    }
    rest = {name: _compute_mean_pose(poses[name], patient_means[name].mesh) for name in built}
    placed = {
        name: Mesh(rest[name].apply(patient_means[name].mesh.vertices), patient_means[name].mesh.faces)
        for name in built
    }
    plateau, given = _plateau_box(standing["tibia"]), _plateau_box(placed["tibia"])
    scale = float(np.ptp(plateau[:, 0]) / np.ptp(given[:, 0]))
    across = plateau.mean(axis=0) - scale * given.mean(axis=0)
    heights = {
        "femur": -scale * placed["femur"].vertices[:, 2].min(),
        "tibia": _plateau_height_mm(standing["tibia"]) - scale * _plateau_height_mm(placed["tibia"]),
    }
    frames = dict[str, FrameTransform]()
    for name in built:
        shift = _bounding_box(standing[name].vertices).mean(axis=0) - scale * _bounding_box(placed[name].vertices).mean(
            axis=0
        )
        if name in heights:
            shift = np.array([across[0], across[1], heights[name]])
        whole = SimilarityTransform(
            rotation=rest[name].rotation,
            scale=scale * rest[name].scale,
            translation_mm=scale * rest[name].translation_mm + shift,
        )
        frames[name] = partial(_transform_points, fit=whole, name=name, template=template)
    return frames


def transform_bone(bone: Mesh, frame: FrameTransform) -> SampledSurface:
    """Move a patient bone, registered to the mean patient bone, to the frame of the template bone.

    Parameters
    ----------
    bone : Mesh
        Registered patient bone, in mm.
    frame : callable
        Function from :func:`make_frame_transforms`.

    Returns
    -------
    SampledSurface
        Bone in the frame of the template bone.
    """
    return sample_surface(Mesh(frame(np.asarray(bone.vertices, np.float64)), bone.faces))


def fit_bone_pose(bone: Mesh, fixed: SampledSurface, name: str) -> SimilarityTransform:
    """Fit the similarity transform that registers a bone to the mean patient bone.

    Parameters
    ----------
    bone : Mesh
        Bone, in mm.
    fixed : SampledSurface
        Mean patient bone of the same type.
    name : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    SimilarityTransform
        Similarity transform from the bone to the mean patient bone.
    """
    return fit_bone(bone, fixed, name).fit


def _transform_points(places_mm: Array, fit: SimilarityTransform, name: str, template: BoneParameters) -> Array:
    """Apply a similarity transform and undo the standing pose."""
    return undo_standing_pose(fit.apply(places_mm), name, template)


def _compute_mean_pose(poses: Sequence[SimilarityTransform], mean: Mesh) -> SimilarityTransform:
    """Compute the average pose and size of bones from their registrations to the mean patient bone."""
    back = Rotation.from_matrix([pose.rotation.T for pose in poses]).mean().as_matrix()
    middle = _bounding_box(mean.vertices).mean(axis=0)
    scale = float(np.exp(-np.mean([np.log(pose.scale) for pose in poses])))
    there = np.mean([pose.apply_inverse(middle[None])[0] for pose in poses], axis=0)
    return SimilarityTransform(rotation=back, scale=scale, translation_mm=there - scale * back @ middle)


def _bounding_box(points: Array) -> Array:
    """Return the lower and upper corner, (2, 3), of the bounding box of points."""
    return np.stack((points.min(axis=0), points.max(axis=0)))


def _plateau_box(tibia: Mesh) -> Array:
    """Return the lower and upper corner, (2, 3), of the bounding box of the plateau, in mm."""
    return _bounding_box(tibia.vertices[tibia.vertices[:, 2] > tibia.vertices[:, 2].max() - _PLATEAU_DEPTH_MM])


def _plateau_height_mm(tibia: Mesh) -> float:
    """Measure the mean height of the centres of medial and lateral plateau, in mm."""
    (low, _, _), (high, _, top) = _plateau_box(tibia)
    share = (tibia.vertices[:, 0] - low) / (high - low)
    level = (tibia.as_trimesh().vertex_normals[:, 2] > 0.8) & (tibia.vertices[:, 2] > top - _PLATEAU_DEPTH_MM)
    sides = [level & (share > start) & (share < start + 0.2) for start in (0.12, 0.68)]
    return float(np.mean([np.median(tibia.vertices[side, 2]) for side in sides]))
