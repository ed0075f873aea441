"""Femur and tibia of a right knee: an outer cortical solid, an inner trabecular one, a canal."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import FemurShape, TibiaShape
from ..geometry.cut import up_to
from ..geometry.mesh import Mesh
from ..model.knee import Osteophyte
from .bone_build import Build, formed, formed_femur_stood, formed_tibia_stood, scaled
from .mean_bone import MeanBone
from .osteophytes import BoneWithOsteophytes, grow
from .solids import column, mesh_of, solid_of, thickness
from .uneven import MOST_SD, uneven_share

# Shafts end here, outside the beam of any protocol in the package and within the soft tissue's own length.
SHAFT_END_MM = 180.0
# Canals are made longer by this before they are bent and cut.
_SPARE_MM = 20.0
# Canals, whose edge trabeculae blur, have rings so far apart of so many points: their triangles lie within 0.05 mm.
_RING_MM, _AROUND = 5.0, 48
# Between a canal and a cortex of mean thickness, beside what the cortex is uneven by.
_CLEAR_MM = 0.4


@dataclass(frozen=True)
class Bone:
    """Nested solids of one bone: the cortex lies between outer and inner; the canal, if any, holds marrow."""

    outer: Manifold
    inner: Manifold
    canal: Manifold | None = None


def levels(low_mm: float, high_mm: float, step_mm: float) -> Array:
    """(n,)  heights of a loft's rings, about a step apart"""
    return np.linspace(low_mm, high_mm, max(2, round((high_mm - low_mm) / step_mm) + 1))


def grown_femur(build: Build, osteophytes: tuple[Osteophyte, ...]) -> BoneWithOsteophytes:
    """The outer femur at the mean man's size, in its own frame, osteophytes and all."""
    mean, margins = build.mean_femur, build.shape.osteophytes
    return grow(osteophytes, mean, margins, build.scale, partial(formed, form=build.femur))


def grown_tibia(build: Build, osteophytes: tuple[Osteophyte, ...]) -> BoneWithOsteophytes:
    """The outer tibia at the mean man's size, in its own frame, osteophytes and all."""
    mean, margins = build.mean_tibia, build.shape.osteophytes
    return grow(osteophytes, mean, margins, build.scale, partial(formed, form=build.tibia))


def prepare(build: Build) -> None:
    """Make the mean man's bones now, or read them, where that is still to be done."""
    # The first knee after an installation waits seconds for both; they need not wait for each other.
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(MeanBone.prepare, (build.mean_femur, build.mean_tibia)))


def shells_mm(build: Build) -> tuple[Array, Array]:
    """Of the mean man's femur and tibia: (n,) how thick cortex and plate are on the ways inwards."""
    uneven = partial(uneven_share, table=build.shape.unevenness, seed=build.seed)
    return (
        build.mean_femur.depth_mm(build.cortex, build.plates, partial(uneven, bone="femur")),
        build.mean_tibia.depth_mm(build.cortex, build.plates, partial(uneven, bone="tibia")),
    )


def femur(build: Build, grown: BoneWithOsteophytes, shell_mm: Array) -> Bone:
    """Distal femur; z = 0 near the condyles' distal end, shaft leaning laterally by `femur_valgus_deg`.

    shell_mm  (n,)  of `shells_mm`
    """
    table, s, mean = build.shape.femur, build.scale, build.mean_femur
    marrow = mean.inner(shell_mm)
    heights = levels(table.canal_from_z_mm, (SHAFT_END_MM + _SPARE_MM) / s, _RING_MM)
    return _standing(build, "femur", grown, grown.filled(marrow, s), _canal(build, table, heights))


def tibia(build: Build, grown: BoneWithOsteophytes, shell_mm: Array) -> Bone:
    """Proximal tibia; z = 0 near the middle of the plateau, shaft leaning medially by `tibia_varus_deg`.

    shell_mm  (n,)  of `shells_mm`
    """
    table, s, mean = build.shape.tibia, build.scale, build.mean_tibia
    marrow = mean.inner(shell_mm)
    heights = levels(-(SHAFT_END_MM + _SPARE_MM) / s, table.canal_from_z_mm, _RING_MM)
    return _standing(build, "tibia", grown, grown.filled(marrow, s), _canal(build, table, heights))


def _standing(build: Build, name: str, grown: BoneWithOsteophytes, inner: Mesh, canal: Manifold) -> Bone:
    """Surfaces of the mean man's size as they stand in this knee, the inner ones cut off the shorter."""
    up, stood = (1, formed_femur_stood) if name == "femur" else (-1, formed_tibia_stood)
    marrow = mesh_of(canal)
    solids = []
    for formed_mm, faces, short_mm in (
        (grown.formed, grown.mesh.faces, 0.0),
        (grown.deform(inner.vertices), inner.faces, 2.0),
        (grown.deform(marrow.vertices), marrow.faces, 4.0),
    ):
        cut = up_to(Mesh(stood(formed_mm, build), faces), up, up * (SHAFT_END_MM - short_mm))
        solids.append(solid_of(*cut, name))
    return Bone(*solids)


def _canal(build: Build, shaft: FemurShape | TibiaShape, heights: Array) -> Manifold:
    """Marrow: opens from a point in the metaphysis to nearly the cortex at `canal_full_z_mm`."""
    cortex, full_z_mm = thickness(shaft.cortex, build.cortex), shaft.canal_full_z_mm
    clear_mm = _CLEAR_MM + MOST_SD * build.shape.unevenness.sd * build.shape.unevenness.thin_mm * build.cortex
    tip = heights[0] if abs(heights[0] - full_z_mm) < abs(heights[-1] - full_z_mm) else heights[-1]
    table = scaled(shaft.sections, 1.0)
    table = table[np.argsort(table[:, 0])]

    def inset(z_mm: Array) -> Array:
        opening = np.clip((z_mm - tip) / (full_z_mm - tip), 0.0, 1.0)
        room = np.minimum(*(np.interp(z_mm, table[:, 0], table[:, k]) for k in (1, 2))) - cortex(z_mm)
        return cortex(z_mm) + clear_mm + (room - _CLEAR_MM - clear_mm) * (1 - np.sin(opening * np.pi / 2))

    return column(table, inset, heights, "canal", count=_AROUND, across=True)
