"""Built bones beside people's: how far the mean is off, and how much drawn knees differ beside how much people do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh

from ..anatomy.bones import build_of, patella, stand_femur, stand_tibia
from ..anatomy.femur import mean_femur
from ..anatomy.solids import mesh_of
from ..anatomy.tibia import mean_tibia
from ..core.checks import InputError, require_whole
from ..core.parallel import ordered_map
from ..data.bones import mean_shape
from ..geometry.mesh import Mesh
from ..model.knee import GRADES, Knee, draw_knee
from .surfaces import MeasuredSurface, Similarity, fit_similarity, measured, surface_distance, trimmed

Row = dict[str, Any]
Bones = Mapping[str, Sequence[Mesh]]
BONES = ("femur", "tibia", "patella")
# +1: the joint is at the bone's upper end; -1: at its lower one; 0: no end is cut.
_JOINT_END = {"femur": -1, "tibia": +1, "patella": 0}
# Of a shaft this much is compared, and nothing so near its cut, whose plane is no part of the bone.
_REACH_MM, _FROM_CUT_MM = 100.0, 5.0
# Of a joint's end, by which a fit begins.
_END_MM = 40.0
_MEAN_ROUNDS = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneFit:
    """The built mean bone where it lies closest to the mean of the given ones, at their size.

    placed      the built bone, without what is not compared
    off_mm      (n,)  distance of its vertices from the given mean; positive: the built bone stands out
    heights_mm  between which the given mean is compared
    """

    placed: Mesh
    off_mm: np.ndarray
    fit: Similarity
    heights_mm: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneComparison:
    """Built bones beside given ones.

    rows  bone, what, bones, rms_mm, p99_mm, mean_mm (positive: the first stands out), scale; a row a figure
    fits  bone -> how the built mean lies on the given one
    """

    rows: list[Row]
    fits: dict[str, BoneFit]


def built_bones(knee: Knee) -> dict[str, Mesh]:
    """Femur, tibia and patella of a right knee, each in its own frame (mm), osteophytes aside."""
    build = build_of(replace(knee, osteophytes=()), mean_shape())
    femur, tibia = (mesh_of(bone.outer) for bone in (mean_femur(build.shape.femur), mean_tibia(build.shape.tibia)))
    return {
        "femur": Mesh(stand_femur(femur.vertices, build), femur.faces),
        "tibia": Mesh(stand_tibia(tibia.vertices, build), tibia.faces),
        "patella": mesh_of(patella(build).outer),
    }


def drawn_bones(count: int, seed: int, grades: Sequence[int] = GRADES) -> dict[str, list[Mesh]]:
    """Bones of drawn knees, the grades in turn, osteophytes aside; knee k is the same in any number.

    raises  InputError for a count below 2
    """
    require_whole("knees", count, 2, 100_000, "")
    knees = []
    for index in range(count):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        knees.append(built_bones(draw_knee(grade=grades[index % len(grades)], rng=rng, side="right")))
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
    rows = []
    for name in names:
        both = surface_distance(measured(built[name]), means[name], fits[name].fit, fits[name].heights_mm)
        row = {"bone": name, "what": "built mean from given mean", "bones": len(given[name]), "rms_mm": both.rms_mm}
        rows.append(row | {"p99_mm": both.p99_mm, "mean_mm": both.mean_mm, "scale": fits[name].fit.scale})
        centres = (("given about their mean", given[name], means[name]),)
        centres += (("drawn about built mean", drawn[name], measured(_at_given_size(built[name], fits[name]))),)
        for what, bones, centre in centres:
            if len(bones) > 1:
                rows.append({"bone": name, "what": what, "bones": len(bones)} | _spread(bones, centre, name, workers))
    return BoneComparison(rows=rows, fits=fits)


def fit_bone(bone: Mesh, onto: MeasuredSurface, name: str) -> BoneFit:
    """How one bone lies closest on another of its kind.

    name  femur | tibia | patella: which end is the joint
    """
    heights = heights_mm(onto.mesh, name)
    fit = fit_similarity(measured(bone), onto, start_of(bone, onto.mesh, name), heights)
    placed = trimmed(Mesh(fit.apply(bone.vertices), bone.faces), *heights)
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


def start_of(bone: Mesh, onto: Mesh, name: str) -> Similarity:
    """A first guess: as wide as the other near the joint, and there in the same place; turned as it is."""
    boxes = [_end_box(mesh, name) for mesh in (bone, onto)]
    (low, high), (low_onto, high_onto) = boxes
    scale = float((high_onto[0] - low_onto[0]) / (high[0] - low[0]))
    middle, middle_onto = (low + high) / 2, (low_onto + high_onto) / 2
    if _JOINT_END[name]:
        end = 0 if _JOINT_END[name] < 0 else 1
        middle[2], middle_onto[2] = boxes[0][end][2], boxes[1][end][2]
    return Similarity(rotation=np.eye(3), scale=scale, shift_mm=middle_onto - scale * middle)


def _end_box(mesh: Mesh, name: str) -> tuple[np.ndarray, np.ndarray]:
    points, end = mesh.vertices, _JOINT_END[name]
    if end:
        depth = end * ((points[:, 2] * end).max() * end - points[:, 2])
        points = points[depth < _END_MM]
    return points.min(axis=0), points.max(axis=0)


def _at_given_size(built: Mesh, fit: BoneFit) -> Mesh:
    return Mesh(fit.fit.apply(built.vertices), built.faces)


def _spread(bones: Sequence[Mesh], centre: MeasuredSurface, name: str, workers: int) -> Row:
    shared = {"centre": centre, "name": name, "heights": heights_mm(centre.mesh, name)}
    found = np.array(ordered_map(_about, bones, shared=shared, workers=workers))
    rms, p99, scale = found.T
    return {
        "rms_mm": float(np.sqrt((rms**2).mean())),
        "p99_mm": float(np.median(p99)),
        "rms_least_mm": float(rms.min()),
        "rms_most_mm": float(rms.max()),
        "scale_sd": float(np.std(1 / scale, ddof=1)),
    }


def _about(bone: Mesh, centre: MeasuredSurface, name: str, heights: tuple[float, float]) -> tuple[float, float, float]:
    surface = measured(bone)
    fit = fit_similarity(surface, centre, start_of(bone, centre.mesh, name), heights)
    distance = surface_distance(surface, centre, fit, heights)
    return distance.rms_mm, distance.p99_mm, fit.scale


def _procrustes_mean(meshes: Sequence[Mesh]) -> np.ndarray:
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


def _nearest_mean(meshes: Sequence[Mesh], bone: str) -> np.ndarray:
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
