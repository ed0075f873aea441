"""Compare simulated with patient bones: distance between the mean bones, and spread about each mean bone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import trimesh

from ...anatomy.bones.small_bones import build_patella
from ...anatomy.meshing.solids import extract_mesh
from ...anatomy.template.bone_builder import map_template_femur, map_template_tibia, resolve_bone_parameters
from ...core.checks import Array, InputError, require_integer
from ...core.processes.parallel_map import map_in_parallel
from ...data.anatomy.anatomy_tables import AnatomyTables
from ...geometry.mesh import Mesh
from ...model.knee import Knee
from ...model.sampling.knee_sampling import KneeDistributions, sample_knees
from . import bone_distance_figure
from .bone_measures import compare_bone_measures, measure_bone
from .bone_registration import (
    BONES,
    BoneFit,
    compared_heights_mm,
    crop_near_joint,
    fit_bone,
    register_bone,
)
from .surface_distance import SampledSurface, measure_surface_distance, sample_surface

Row = dict[str, Any]
Bones = Mapping[str, Sequence[Mesh]]
# Number of alignment iterations in the computation of a mean bone.
_MEAN_ITERATIONS = 3
# Distance at both ends of the colour scale of the figure, in mm.
_COLOUR_LIMIT_MM = 6.0
# Length of the distal femur within which the epicondylar width is measured, in mm.
_FEMUR_END_MM = 45.0
_GIVEN = "patient bones to their mean"
_DRAWN = "sampled bones to built mean"
_COLUMNS = (
    "bone", "comparison", "bones", "rms_mm", "p99_mm", "mean_mm", "scale", "rms_min_mm", "rms_max_mm", "scale_sd",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _BoneGroup:
    """Bones of several knees, and the mean surface of every bone type, both keyed by bone name."""

    bones: Bones
    mean_surfaces: Mapping[str, SampledSurface]


class _BoneDeviation(NamedTuple):
    """RMS distance (mm), 99th percentile distance (mm) and scale relative to the mean bone, and shape measures."""

    rms_p99_scale: tuple[float, float, float]
    bone_measures: dict[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneComparison:
    """Result of :func:`compare_bones`.

    Attributes
    ----------
    rows : list of dict
        Table rows with surface distances in mm. Rows that compare mean bones contain ``mean_mm`` (positive if the bone
        of the default knee is outside the patient bone) and ``scale`` (patient size divided by the size of the default
        knee). Rows that report the spread of several bones contain the lowest and highest RMS distance, and
        ``scale_sd``.
    measure_rows : list of dict
        Shape measures from ``compare_bone_measures``, for bone types with at least two patient and two sampled bones.
    fits : dict of str to BoneFit
        Registration of every bone of the default knee to the mean patient bone, keyed by bone name.
    figure : bytes
        PNG image of the bones of the default knee, coloured by the distance from the mean patient bone.
    """

    rows: list[Row]
    measure_rows: list[Row]
    fits: dict[str, BoneFit]
    figure: bytes


def build_bones(knee: Knee, tables: AnatomyTables) -> dict[str, Mesh]:
    """Build the femur, tibia and patella of a right knee without osteophytes, each in its bone coordinate frame.

    Parameters
    ----------
    knee : Knee
        Knee to build.
    tables : AnatomyTables
        Anatomy tables from which bones are built.

    Returns
    -------
    dict of str to Mesh
        Meshes in mm, keyed by bone name.
    """
    build = resolve_bone_parameters(replace(knee, osteophytes=(), grade=None, grade_table=None), tables)
    femur, tibia = (extract_mesh(bone.outer) for bone in (build.template_femur, build.template_tibia))
    return {
        "femur": Mesh(map_template_femur(femur.vertices, build), femur.faces),
        "tibia": Mesh(map_template_tibia(tibia.vertices, build), tibia.faces),
        "patella": extract_mesh(build_patella(build).outer),
    }


def sample_bones(
    laws: KneeDistributions, tables: AnatomyTables, count: int, seed: int, workers: int = 1
) -> dict[str, list[Mesh]]:
    """Sample knees and build their bones without osteophytes; the parameters of knee k do not depend on `count`.

    Parameters
    ----------
    laws : KneeDistributions
        Distributions from which knees are sampled; the KL grades cycle through the grade table.
    tables : AnatomyTables
        Anatomy tables from which bones are built.
    count : int
        Number of knees, 2 or more.
    seed : int
        Seed of the random knees.
    workers : int, default 1
        Number of worker processes.

    Returns
    -------
    dict of str to list of Mesh
        Meshes in mm, keyed by bone name.

    Raises
    ------
    InputError
        `count` is below 2.
    """
    require_integer("knees", count, 2, 100_000, "")
    drawn = sample_knees(laws, count, seed, side="right")
    knees = map_in_parallel(build_bones, drawn, shared={"tables": tables}, workers=workers)
    return {name: [knee[name] for knee in knees] for name in BONES}


def compute_mean_bone(meshes: Sequence[Mesh], bone: str) -> Mesh:
    """Compute the mean shape of several bones at their mean size, in the coordinate frame of the first bone.

    Parameters
    ----------
    meshes : sequence of Mesh
        Bones, in mm.
    bone : {"femur", "tibia", "patella"}
        Bone type.

    Returns
    -------
    Mesh
        Mean bone with the faces of the first bone, in mm.

    Raises
    ------
    InputError
        `meshes` is empty.

    Notes
    -----
    If all meshes have the same faces, corresponding vertices are averaged after generalised Procrustes alignment (Gower
    1975). Otherwise each vertex of the first bone is moved to the mean of the nearest points on all bones.
    """
    if not meshes:
        raise InputError(f"number of {bone} meshes must be 1 or more, got 0")
    first = meshes[0]
    same = all(mesh.faces.shape == first.faces.shape and np.array_equal(mesh.faces, first.faces) for mesh in meshes)
    vertices = _procrustes_mean(meshes) if same else _nearest_point_mean(meshes, bone)
    return Mesh(vertices, first.faces)


def compare_bones(patient_bones: Bones, built: Mapping[str, Mesh], drawn: Bones, workers: int = 1) -> BoneComparison:
    """Compare the bones of the default knee and of sampled knees with patient bones.

    Parameters
    ----------
    patient_bones : mapping of str to sequence of Mesh
        Meshes of patient bones in mm, keyed by bone name.
    built : mapping of str to Mesh
        Bone meshes of the default knee in mm, keyed by bone name. The table calls them the built mean.
    drawn : mapping of str to sequence of Mesh
        Meshes of sampled knees in mm, keyed by bone name.
    workers : int, default 1
        Number of worker processes.

    Returns
    -------
    BoneComparison
        Surface distances, shape measures, registrations and figure.

    Raises
    ------
    InputError
        `patient_bones` contains no femur, tibia or patella.

    Notes
    -----
    Distances are measured between the surfaces in both directions after similarity registration, in mm at the mean size
    of the patient bones. The flat cut of a shaft is excluded. The spread is the distance of patient bones from the mean
    patient bone, and of sampled bones from the bone of the default knee. Shape measures are computed after registration
    to the bone of the default knee.
    """
    names = [name for name in BONES if patient_bones.get(name)]
    if not names:
        raise InputError(
            f"bones must include one or more of {', '.join(BONES)}, got {', '.join(patient_bones) or 'none'}"
        )
    means = {name: sample_surface(compute_mean_bone(patient_bones[name], name)) for name in names}
    fits = {name: fit_bone(built[name], means[name], name) for name in names}
    sized = {name: sample_surface(_scale_built_bone(built[name], fits[name], name)) for name in names}
    kinds = {
        _GIVEN: _BoneGroup(bones=patient_bones, mean_surfaces=means),
        _DRAWN: _BoneGroup(bones=drawn, mean_surfaces=sized),
    }
    tasks = [(what, name, bone) for what, kind in kinds.items() for name in names for bone in kind.bones[name]]
    centres = {(what, name): kind.mean_surfaces[name] for what, kind in kinds.items() for name in names}
    models = {name: sample_surface(crop_near_joint(built[name], name)) for name in names}
    each = map_in_parallel(_measure_deviation, tasks, shared={"centres": centres, "models": models}, workers=workers)
    rows, forms = list[Row](), list[Row]()
    for name in names:
        of = {what: [one for one, task in zip(each, tasks, strict=True) if task[:2] == (what, name)] for what in kinds}
        rows.append(_make_mean_row(name, len(patient_bones[name]), sized[name], means[name], fits[name]))
        several = {what: bones for what, bones in of.items() if len(bones) > 1}
        rows += [{"bone": name, "comparison": what} | _make_spread_row(bones) for what, bones in several.items()]
        if several.keys() == kinds.keys():
            forms += compare_bone_measures(
                name, [one.bone_measures for one in of[_GIVEN]], [one.bone_measures for one in of[_DRAWN]]
            )
    if {row["bone"] for row in forms} >= {"femur", "patella"} and len(patient_bones["femur"]) == len(
        patient_bones["patella"]
    ):
        forms += compare_bone_measures(
            "patella", *(_patella_to_femur_width_ratios(bones) for bones in (patient_bones, drawn))
        )
    figure = bone_distance_figure.plot_bone_distances(
        {name: (fit.placed_mesh, fit.off_mm) for name, fit in fits.items()}, _COLOUR_LIMIT_MM
    )
    return BoneComparison(
        rows=[dict.fromkeys(_COLUMNS, "") | row for row in rows], measure_rows=forms, fits=fits, figure=figure
    )


def _scale_built_bone(built: Mesh, fit: BoneFit, name: str) -> Mesh:
    """Crop a bone of the default knee near the joint, and register it to the mean patient bone."""
    near = crop_near_joint(built, name)
    return Mesh(fit.fit.apply(near.vertices), near.faces)


def _make_mean_row(name: str, count: int, built: SampledSurface, patient_mean: SampledSurface, fit: BoneFit) -> Row:
    """Make the table row for the distance between the bone of the default knee and the mean patient bone."""
    both = measure_surface_distance(built, patient_mean, heights_mm=fit.heights_mm)
    row = {"bone": name, "comparison": "built mean to patient mean", "bones": count, "rms_mm": both.rms_mm}
    return row | {"p99_mm": both.p99_mm, "mean_mm": both.mean_mm, "scale": fit.fit.scale}


def _make_spread_row(bones: Sequence[_BoneDeviation]) -> Row:
    """Make the table row for the spread of several bones about their mean bone."""
    rms, p99, scale = np.array([bone.rms_p99_scale for bone in bones]).T
    return {
        "bones": len(bones),
        "rms_mm": float(np.sqrt((rms**2).mean())),
        "p99_mm": float(np.sqrt((p99**2).mean())),
        "rms_min_mm": float(rms.min()),
        "rms_max_mm": float(rms.max()),
        "scale_sd": float(np.std(1 / scale, ddof=1) / np.mean(1 / scale)),
    }


def _patella_to_femur_width_ratios(bones: Bones) -> list[dict[str, float]]:
    """Compute the ratio of patellar to femoral width for every knee; both bone lists have the same knee order."""
    return [{"patella's width over the femur's": _width_mm(patella) / _width_mm(femur, _FEMUR_END_MM)}
            for femur, patella in zip(bones["femur"], bones["patella"], strict=True)]  # fmt: skip


def _width_mm(bone: Mesh, low_mm: float = np.inf) -> float:
    """Measure the mediolateral width of a bone within `low_mm` of the lowest point, in mm."""
    height = bone.vertices[:, 2] - bone.vertices[:, 2].min()
    return float(np.ptp(bone.vertices[height < low_mm, 0]))


def _measure_deviation(
    task: tuple[str, str, Mesh],
    centres: Mapping[tuple[str, str], SampledSurface],
    models: Mapping[str, SampledSurface],
) -> _BoneDeviation:
    """Measure the deviation of a bone from the mean bone, and its shape measures."""
    what, name, bone = task
    surface, centre = sample_surface(crop_near_joint(bone, name)), centres[what, name]
    fit = register_bone(surface, centre, name)
    distance = measure_surface_distance(surface, centre, fit, compared_heights_mm(centre.mesh, name))
    return _BoneDeviation((distance.rms_mm, distance.p99_mm, fit.scale), measure_bone(surface, models[name], name))


def _procrustes_mean(meshes: Sequence[Mesh]) -> Array:
    """Average corresponding vertices of all meshes; return (v, 3) vertices in mm."""
    mean = np.array(meshes[0].vertices, np.float64)
    for _ in range(_MEAN_ITERATIONS):
        moves = [trimesh.registration.procrustes(mesh.vertices, mean, reflection=False)[:2] for mesh in meshes]
        scales = [np.cbrt(np.linalg.det(matrix[:3, :3])) for matrix, _ in moves]
        average = np.mean([moved for _, moved in moves], axis=0)
        # The bone sizes are also averaged, because Procrustes alignment scales all bones to the size of the first bone.
        middle = average.mean(axis=0)
        mean = middle + (average - middle) / np.exp(np.mean(np.log(scales)))
    return mean


def _nearest_point_mean(meshes: Sequence[Mesh], bone: str) -> Array:
    """Move each vertex of the first bone to the mean of the nearest points on all bones; return (v, 3), in mm."""
    mean = np.array(meshes[0].vertices, np.float64)
    surfaces = [sample_surface(mesh) for mesh in meshes]
    for _ in range(_MEAN_ITERATIONS - 1):
        centre = sample_surface(Mesh(mean, meshes[0].faces))
        places, scales = [], []
        for surface in surfaces:
            fit = register_bone(surface, centre, bone)
            places.append(fit.apply(surface.find_nearest(fit.apply_inverse(mean))[0]))
            scales.append(fit.scale)
        average = np.mean(places, axis=0)
        middle = average.mean(axis=0)
        mean = middle + (average - middle) / np.exp(np.mean(np.log(scales)))
    return mean
