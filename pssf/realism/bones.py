"""Built bones beside people's: how far the mean is off, and how much drawn knees differ beside how much people do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh

from ..anatomy.bone_build import build_of, stand_femur, stand_tibia
from ..anatomy.small_bones import patella
from ..anatomy.solids import mesh_of
from ..core.checks import Array, InputError, require_whole
from ..core.parallel import ordered_map
from ..data.anatomy import AnatomyTables
from ..geometry.mesh import Mesh
from ..model.draw import DrawLaws, draw_knees
from ..model.knee import Knee
from . import bone_figure
from .surfaces import MeasuredSurface, Similarity, fit_similarity, measured, surface_distance, trimmed

Row = dict[str, Any]
Bones = Mapping[str, Sequence[Mesh]]
BONES = ("femur", "tibia", "patella")
# +1: the joint is at the bone's upper end; -1: at its lower one; 0: no end is cut.
_JOINT_END = {"femur": -1, "tibia": +1, "patella": 0}
# Of a shaft this much is compared, and nothing so near its cut, whose plane is no part of the bone.
_REACH_MM, _FROM_CUT_MM = 100.0, 5.0
# Of a joint's end, by which a fit begins; and of a shaft, what is kept at all, for bones of any size.
_END_MM, _KEPT_MM = 40.0, 140.0
_MEAN_ROUNDS = 3
# Where the colours of the picture end.
_MOST_MM = 6.0
_COLUMNS = (
    "bone", "what", "bones", "rms_mm", "p99_mm", "mean_mm", "scale", "rms_least_mm", "rms_most_mm", "scale_sd",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneFit:
    """The built mean bone where it lies closest to the mean of the given ones, at their size.

    placed      the built bone, without what is not compared
    off_mm      (n,)  distance of its vertices from the given mean; positive: the built bone stands out
    heights_mm  between which the given mean is compared
    """

    placed: Mesh
    off_mm: Array
    fit: Similarity
    heights_mm: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Spread:
    """Bones of several knees, and their means."""

    bones: Bones
    centres: Mapping[str, MeasuredSurface]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneComparison:
    """Built bones beside given ones.

    rows    bone, what, bones, rms_mm, p99_mm, and then of means: mean_mm (positive: the built one stands out), scale
            (given over built size); of spreads: least and most RMS of a bone, scale_sd (of sizes)
    fits    bone -> how the built mean lies on the given one
    figure  PNG: the built mean with its distance from the given one as colour
    """

    rows: list[Row]
    fits: dict[str, BoneFit]
    figure: bytes


def built_bones(knee: Knee, tables: AnatomyTables) -> dict[str, Mesh]:
    """Femur, tibia and patella of a right knee, each in its own frame (mm), osteophytes aside.

    tables  that bones are made from
    """
    build = build_of(replace(knee, osteophytes=()), tables)
    femur, tibia = (mesh_of(bone.outer) for bone in (build.mean_femur, build.mean_tibia))
    return {
        "femur": Mesh(stand_femur(femur.vertices, build), femur.faces),
        "tibia": Mesh(stand_tibia(tibia.vertices, build), tibia.faces),
        "patella": mesh_of(patella(build).outer),
    }


def drawn_bones(laws: DrawLaws, tables: AnatomyTables, count: int, seed: int) -> dict[str, list[Mesh]]:
    """Bones of drawn knees, osteophytes aside; knee k is the same in any number.

    laws    that knees are drawn by; their grades take turns
    tables  that bones are made from
    raises  InputError for a count below 2
    """
    require_whole("knees", count, 2, 100_000, "")
    knees = [built_bones(knee, tables) for knee in draw_knees(laws, count, seed, side="right")]
    return {name: [knee[name] for knee in knees] for name in BONES}


def mean_of(meshes: Sequence[Mesh], bone: str) -> Mesh:
    """The mean shape of bones at their mean size, in the frame of the first.

    Vertices in correspondence (the same faces in all) are averaged after generalised Procrustes alignment (Gower
    1975); otherwise those of the first, moved to the nearest places on each of the others.
    raises  InputError for no bone at all
    """
    if not meshes:
        raise InputError(f"{bone}: bones = 0; allowed: 1 or more")
    first = meshes[0]
    same = all(mesh.faces.shape == first.faces.shape and np.array_equal(mesh.faces, first.faces) for mesh in meshes)
    vertices = _procrustes_mean(meshes) if same else _nearest_mean(meshes, bone)
    return Mesh(vertices, first.faces)


def compare(given: Bones, built: Mapping[str, Mesh], drawn: Bones, workers: int = 1) -> BoneComparison:
    """Built mean and drawn bones beside given ones, bone by bone, for those that are given.

    Distances are surface to surface, both ways, after a similarity fit, in millimetres at the given bones' mean size;
    the flat cut of a shaft is left out. Spreads are of each bone about its mean by that one measure: people about the
    mean of people, drawn knees about the built mean.
    raises  InputError for no bone that is known
    """
    names = [name for name in BONES if given.get(name)]
    if not names:
        raise InputError(f"bones = {', '.join(given) or 'none'}; allowed: some of {', '.join(BONES)}")
    means = {name: measured(mean_of(given[name], name)) for name in names}
    fits = {name: fit_bone(built[name], means[name], name) for name in names}
    sized = {name: measured(_sized(built[name], fits[name], name)) for name in names}
    spreads = {
        "given about their mean": _Spread(bones=given, centres=means),
        "drawn about built mean": _Spread(bones=drawn, centres=sized),
    }
    tasks = [(what, name, bone) for what, of in spreads.items() for name in names for bone in of.bones[name]]
    centres = {(what, name): of.centres[name] for what, of in spreads.items() for name in names}
    distances = ordered_map(_about, tasks, shared={"centres": centres}, workers=workers)
    rows = list[Row]()
    for name in names:
        rows.append(_mean_row(name, len(given[name]), sized[name], means[name], fits[name]))
        for what in spreads:
            about = [one for one, task in zip(distances, tasks, strict=True) if task[:2] == (what, name)]
            rows += [{"bone": name, "what": what} | _spread_row(np.array(about))] if len(about) > 1 else []
    figure = bone_figure.draw({name: (fit.placed, fit.off_mm) for name, fit in fits.items()}, _MOST_MM)
    return BoneComparison(rows=[dict.fromkeys(_COLUMNS, "") | row for row in rows], fits=fits, figure=figure)


def fit_bone(bone: Mesh, onto: MeasuredSurface, name: str) -> BoneFit:
    """How one bone lies closest on another of its kind.

    name  femur | tibia | patella: which end is the joint
    """
    heights, near = heights_mm(onto.mesh, name), near_joint(bone, name)
    fit = fit_similarity(measured(near), onto, start_of(near, onto.mesh, name), heights)
    placed = trimmed(Mesh(fit.apply(near.vertices), near.faces), *heights)
    away, outward = onto.nearest(placed.vertices)
    off = np.linalg.norm(placed.vertices - away, axis=1)
    off *= np.where(((placed.vertices - away) * outward).sum(axis=1) < 0, -1.0, 1.0)
    return BoneFit(placed=placed, off_mm=off, fit=fit, heights_mm=heights)


def heights_mm(bone: Mesh, name: str) -> tuple[float, float]:
    """Between which heights (z) a bone is compared: within 100 mm of the joint, and 5 mm clear of a cut."""
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if _JOINT_END[name] < 0:
        return (-np.inf, float(min(high - _FROM_CUT_MM, low + _REACH_MM)))
    if _JOINT_END[name] > 0:
        return (float(max(low + _FROM_CUT_MM, high - _REACH_MM)), np.inf)
    return (-np.inf, np.inf)


def near_joint(bone: Mesh, name: str) -> Mesh:
    """A bone without what of its shaft is farther than 140 mm from the joint, for the sake of time."""
    low, high = bone.vertices[:, 2].min(), bone.vertices[:, 2].max()
    if not _JOINT_END[name] or high - low <= _KEPT_MM:
        return bone
    return trimmed(bone, -np.inf, low + _KEPT_MM) if _JOINT_END[name] < 0 else trimmed(bone, high - _KEPT_MM, np.inf)


def start_of(bone: Mesh, onto: Mesh, name: str) -> Similarity:
    """A first guess: as wide as the other near the joint, and there in the same place; turned as it is."""
    box, box_onto = _end_box(bone, name), _end_box(onto, name)
    scale = float(np.ptp(box_onto[:, 0]) / np.ptp(box[:, 0]))
    middle, middle_onto = box.mean(axis=0), box_onto.mean(axis=0)
    if _JOINT_END[name]:
        end = 0 if _JOINT_END[name] < 0 else 1
        middle[2], middle_onto[2] = box[end, 2], box_onto[end, 2]
    return Similarity(rotation=np.eye(3), scale=scale, shift_mm=middle_onto - scale * middle)


def _end_box(mesh: Mesh, name: str) -> Array:
    """(2, 3)  corners of the box around a joint's end"""
    points, end = mesh.vertices, _JOINT_END[name]
    if end:
        outward = points[:, 2] * end
        points = points[outward > outward.max() - _END_MM]
    return np.stack((points.min(axis=0), points.max(axis=0)))


def _sized(built: Mesh, fit: BoneFit, name: str) -> Mesh:
    near = near_joint(built, name)
    return Mesh(fit.fit.apply(near.vertices), near.faces)


def _mean_row(name: str, count: int, built: MeasuredSurface, given: MeasuredSurface, fit: BoneFit) -> Row:
    both = surface_distance(built, given, heights_mm=fit.heights_mm)
    row = {"bone": name, "what": "built mean from given mean", "bones": count, "rms_mm": both.rms_mm}
    return row | {"p99_mm": both.p99_mm, "mean_mm": both.mean_mm, "scale": fit.fit.scale}


def _spread_row(about: Array) -> Row:
    """Of RMS, 99th percentile and scale (n, 3) of bones about their mean."""
    rms, p99, scale = about.T
    return {
        "bones": len(about),
        "rms_mm": float(np.sqrt((rms**2).mean())),
        "p99_mm": float(np.sqrt((p99**2).mean())),
        "rms_least_mm": float(rms.min()),
        "rms_most_mm": float(rms.max()),
        "scale_sd": float(np.std(1 / scale, ddof=1) / np.mean(1 / scale)),
    }


def _about(
    task: tuple[str, str, Mesh], centres: Mapping[tuple[str, str], MeasuredSurface]
) -> tuple[float, float, float]:
    what, name, bone = task
    centre, near = centres[what, name], near_joint(bone, name)
    heights, surface = heights_mm(centre.mesh, name), measured(near)
    fit = fit_similarity(surface, centre, start_of(near, centre.mesh, name), heights)
    distance = surface_distance(surface, centre, fit, heights)
    return distance.rms_mm, distance.p99_mm, fit.scale


def _procrustes_mean(meshes: Sequence[Mesh]) -> Array:
    """(v, 3)  mean of vertices in correspondence"""
    mean = np.array(meshes[0].vertices, np.float64)
    for _ in range(_MEAN_ROUNDS):
        moves = [trimesh.registration.procrustes(mesh.vertices, mean, reflection=False)[:2] for mesh in meshes]
        scales = [np.cbrt(np.linalg.det(matrix[:3, :3])) for matrix, _ in moves]
        average = np.mean([moved for _, moved in moves], axis=0)
        # Sizes are averaged too; Procrustes alone would keep that of the first.
        middle = average.mean(axis=0)
        mean = middle + (average - middle) / np.exp(np.mean(np.log(scales)))
    return mean


def _nearest_mean(meshes: Sequence[Mesh], bone: str) -> Array:
    """(v, 3)  vertices of the first, each moved to the mean of the nearest places on all"""
    mean = np.array(meshes[0].vertices, np.float64)
    surfaces = [measured(mesh) for mesh in meshes]
    for _ in range(_MEAN_ROUNDS - 1):
        centre = measured(Mesh(mean, meshes[0].faces))
        heights = heights_mm(centre.mesh, bone)
        places, scales = [], []
        for surface in surfaces:
            fit = fit_similarity(surface, centre, start_of(surface.mesh, centre.mesh, bone), heights)
            places.append(fit.apply(surface.nearest(fit.undo(mean))[0]))
            scales.append(fit.scale)
        average = np.mean(places, axis=0)
        middle = average.mean(axis=0)
        mean = middle + (average - middle) / np.exp(np.mean(np.log(scales)))
    return mean
