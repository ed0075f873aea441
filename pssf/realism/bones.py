"""Built bones beside people's: how far the mean is off, and how much drawn knees differ beside how much people do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

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
from .bone_fit import BONES, BoneFit, fit_bone, heights_mm, laid_onto, near_joint
from .forms import form_rows, forms_of
from .surfaces import MeasuredSurface, measured, surface_distance

Row = dict[str, Any]
Bones = Mapping[str, Sequence[Mesh]]
_MEAN_ROUNDS = 3
# Where the colours of the picture end.
_MOST_MM = 6.0
# Of a femur, whose epicondyles are its widest place.
_FEMUR_END_MM = 45.0
_GIVEN, _DRAWN = "given about their mean", "drawn about built mean"
_COLUMNS = (
    "bone", "what", "bones", "rms_mm", "p99_mm", "mean_mm", "scale", "rms_least_mm", "rms_most_mm", "scale_sd",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _Kind:
    """Bones of several knees, and the surfaces that they differ from."""

    bones: Bones
    centres: Mapping[str, MeasuredSurface]


class _OneBone(NamedTuple):
    """RMS, 99th percentile and scale of a bone about its mean, and its measures of form."""

    about: tuple[float, float, float]
    forms: dict[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoneComparison:
    """Built bones beside given ones.

    rows    bone, what, bones, rms_mm, p99_mm, and then of means: mean_mm (positive: the built one stands out), scale
            (given over built size); of spreads: least and most RMS of a bone, scale_sd (of sizes)
    forms   of `forms.form_rows`, of bones that are given and drawn more than once
    fits    bone -> how the built mean lies on the given one
    figure  PNG: the built mean with its distance from the given one as colour
    """

    rows: list[Row]
    forms: list[Row]
    fits: dict[str, BoneFit]
    figure: bytes


def built_bones(knee: Knee, tables: AnatomyTables) -> dict[str, Mesh]:
    """Femur, tibia and patella of a right knee, each in its own frame (mm), osteophytes aside.

    tables  that bones are made from
    """
    build = build_of(replace(knee, osteophytes=(), grade=None, grade_table=None), tables)
    femur, tibia = (mesh_of(bone.outer) for bone in (build.mean_femur, build.mean_tibia))
    return {
        "femur": Mesh(stand_femur(femur.vertices, build), femur.faces),
        "tibia": Mesh(stand_tibia(tibia.vertices, build), tibia.faces),
        "patella": mesh_of(patella(build).outer),
    }


def drawn_bones(
    laws: DrawLaws, tables: AnatomyTables, count: int, seed: int, workers: int = 1
) -> dict[str, list[Mesh]]:
    """Bones of drawn knees, osteophytes aside; knee k is the same in any number.

    laws    that knees are drawn by; their grades take turns
    tables  that bones are made from
    raises  InputError for a count below 2
    """
    require_whole("knees", count, 2, 100_000, "")
    drawn = draw_knees(laws, count, seed, side="right")
    knees = ordered_map(built_bones, drawn, shared={"tables": tables}, workers=workers)
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
    mean of people, drawn knees about the built mean. Forms are of each bone laid onto the built mean one.
    raises  InputError for no bone that is known
    """
    names = [name for name in BONES if given.get(name)]
    if not names:
        raise InputError(f"bones = {', '.join(given) or 'none'}; allowed: some of {', '.join(BONES)}")
    means = {name: measured(mean_of(given[name], name)) for name in names}
    fits = {name: fit_bone(built[name], means[name], name) for name in names}
    sized = {name: measured(_sized(built[name], fits[name], name)) for name in names}
    kinds = {_GIVEN: _Kind(bones=given, centres=means), _DRAWN: _Kind(bones=drawn, centres=sized)}
    tasks = [(what, name, bone) for what, kind in kinds.items() for name in names for bone in kind.bones[name]]
    centres = {(what, name): kind.centres[name] for what, kind in kinds.items() for name in names}
    models = {name: measured(near_joint(built[name], name)) for name in names}
    each = ordered_map(_of_bone, tasks, shared={"centres": centres, "models": models}, workers=workers)
    rows, forms = list[Row](), list[Row]()
    for name in names:
        of = {what: [one for one, task in zip(each, tasks, strict=True) if task[:2] == (what, name)] for what in kinds}
        rows.append(_mean_row(name, len(given[name]), sized[name], means[name], fits[name]))
        several = {what: bones for what, bones in of.items() if len(bones) > 1}
        rows += [{"bone": name, "what": what} | _spread_row(bones) for what, bones in several.items()]
        if several.keys() == kinds.keys():
            forms += form_rows(name, [one.forms for one in of[_GIVEN]], [one.forms for one in of[_DRAWN]])
    if {row["bone"] for row in forms} >= {"femur", "patella"} and len(given["femur"]) == len(given["patella"]):
        forms += form_rows("patella", *(_patellae_over_femora(bones) for bones in (given, drawn)))
    figure = bone_figure.draw({name: (fit.placed, fit.off_mm) for name, fit in fits.items()}, _MOST_MM)
    return BoneComparison(
        rows=[dict.fromkeys(_COLUMNS, "") | row for row in rows], forms=forms, fits=fits, figure=figure
    )


def _sized(built: Mesh, fit: BoneFit, name: str) -> Mesh:
    near = near_joint(built, name)
    return Mesh(fit.fit.apply(near.vertices), near.faces)


def _mean_row(name: str, count: int, built: MeasuredSurface, given: MeasuredSurface, fit: BoneFit) -> Row:
    both = surface_distance(built, given, heights_mm=fit.heights_mm)
    row = {"bone": name, "what": "built mean from given mean", "bones": count, "rms_mm": both.rms_mm}
    return row | {"p99_mm": both.p99_mm, "mean_mm": both.mean_mm, "scale": fit.fit.scale}


def _spread_row(bones: Sequence[_OneBone]) -> Row:
    rms, p99, scale = np.array([bone.about for bone in bones]).T
    return {
        "bones": len(bones),
        "rms_mm": float(np.sqrt((rms**2).mean())),
        "p99_mm": float(np.sqrt((p99**2).mean())),
        "rms_least_mm": float(rms.min()),
        "rms_most_mm": float(rms.max()),
        "scale_sd": float(np.std(1 / scale, ddof=1) / np.mean(1 / scale)),
    }


def _patellae_over_femora(bones: Bones) -> list[dict[str, float]]:
    """One dict a knee, whose bones have the same number in either list."""
    return [{"patella's width over the femur's": _width_mm(patella) / _width_mm(femur, _FEMUR_END_MM)}
            for femur, patella in zip(bones["femur"], bones["patella"], strict=True)]  # fmt: skip


def _width_mm(bone: Mesh, low_mm: float = np.inf) -> float:
    """Across a bone, of what lies no higher than so much above its lowest place."""
    height = bone.vertices[:, 2] - bone.vertices[:, 2].min()
    return float(np.ptp(bone.vertices[height < low_mm, 0]))


def _of_bone(
    task: tuple[str, str, Mesh],
    centres: Mapping[tuple[str, str], MeasuredSurface],
    models: Mapping[str, MeasuredSurface],
) -> _OneBone:
    what, name, bone = task
    surface, centre = measured(near_joint(bone, name)), centres[what, name]
    fit = laid_onto(surface, centre, name)
    distance = surface_distance(surface, centre, fit, heights_mm(centre.mesh, name))
    return _OneBone((distance.rms_mm, distance.p99_mm, fit.scale), forms_of(surface, models[name], name))


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
        places, scales = [], []
        for surface in surfaces:
            fit = laid_onto(surface, centre, bone)
            places.append(fit.apply(surface.nearest(fit.undo(mean))[0]))
            scales.append(fit.scale)
        average = np.mean(places, axis=0)
        middle = average.mean(axis=0)
        mean = middle + (average - middle) / np.exp(np.mean(np.log(scales)))
    return mean
