"""Femur, tibia, fibula and patella of a right knee: an outer cortical solid, an inner trabecular one, a canal."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from ..core.checks import Array
from ..data.bones import BoneShape
from ..data.records import Rows
from ..data.shapes import shape_table
from ..geometry.freeform import Lattice, displaced
from ..model.knee import Knee, Osteophyte
from .femur import mean_femur
from .implicit import project_solid
from .mean_bone import INNER_MM
from .osteophytes import BoneWithOsteophytes, grow
from .shape import knee_form, lattices_of
from .solids import checked, column
from .tibia import above, mean_tibia

# Shafts end here, outside the beam of any protocol in the package and within the soft tissue's own length.
SHAFT_END_MM = 180.0
# Straight shafts and canals, whose edge trabeculae blur, are drawn with fewer triangles, within these.
_COARSER_MM = 0.02
_CANAL_MM = 0.05
# Steps of 1.5 mm at most, down to the inside of the thickest cortex.
_INWARD_STEPS = 6


@dataclass(frozen=True)
class Bone:
    """Nested solids of one bone: the cortex lies between outer and inner; the canal, if any, holds marrow."""

    outer: Manifold
    inner: Manifold
    canal: Manifold | None = None


@dataclass(frozen=True)
class Build:
    """What shapes the bones of one knee: size over the mean man's, relative cortex and plate, angles in degrees.

    shape     of the mean man's bones
    lattices  bone -> how this person's differ from those, at the mean man's size, in the bone's frame
    """

    shape: BoneShape
    lattices: Mapping[str, Lattice]
    scale: float
    cortex: float
    plate: float
    slope_deg: float
    femur_valgus_deg: float
    tibia_varus_deg: float

    @property
    def half_ml_mm(self) -> float:
        """Half the medio-lateral width of the tibial plateau."""
        return self.shape.size.male_tibial_ml_mm / 2 * self.scale


def build_of(knee: Knee, shape: BoneShape) -> Build:
    """What a knee's parameters make of the mean man's bones."""
    size = shape.size
    sex_scale = size.female_over_male if knee.sex == "female" else 1.0
    return Build(
        shape=shape,
        lattices=lattices_of(knee.shape, knee_form(shape_table())),
        scale=sex_scale * knee.bone_scale * knee.stature_mm / getattr(size.stature_mm, knee.sex),
        cortex=knee.cortex_scale,
        plate=knee.subchondral_plate,
        slope_deg=knee.tibial_slope_deg,
        femur_valgus_deg=shape.femur.valgus_deg - knee.varus_deg / 2,
        tibia_varus_deg=knee.varus_deg / 2,
    )


def scaled(sections: Rows, scale: float) -> Array:
    """(n, m)  a table of lengths, scaled"""
    return np.asarray(sections, dtype=np.float64) * scale


def thickness(table: Rows, scale: float, factor: float) -> Callable[[Array], Array]:
    """Cortical thickness (mm) as a function of height (mm), from a table of height and thickness."""
    rows = np.asarray(table, dtype=np.float64)
    rows = rows[np.argsort(rows[:, 0])]
    return lambda z_mm: np.interp(z_mm, rows[:, 0] * scale, rows[:, 1]) * factor * scale


def lean(sections: Array, pivot_mm: float, angle_deg: float, direction: int) -> Array:
    """Sections whose centres beyond a pivot height move sideways, so that the shaft leans by an angle.

    sections   (n, 5)  z, half ML, half AP, centre y, centre x
    direction  +1: above the pivot, -1: below it
    """
    leaning = sections.copy()
    leaning[:, 4] += sideways(sections[:, 0], pivot_mm, angle_deg, direction)
    return leaning


def sideways(z_mm: Array, pivot_mm: float, angle_deg: float, direction: int) -> Array:
    """(n,)  how far a leaning shaft is off to the side at heights z"""
    beyond = np.maximum(direction * (z_mm - pivot_mm), 0.0)
    # A smooth start over 15 mm keeps the metaphysis free of a kink.
    return np.asarray(np.tan(np.deg2rad(angle_deg)) * np.where(beyond < 15.0, beyond**2 / 30.0, beyond - 7.5))


def _levels(low_mm: float, high_mm: float, step_mm: float) -> Array:
    return np.linspace(low_mm, high_mm, max(2, round((high_mm - low_mm) / step_mm) + 1))


def _none(z_mm: Array) -> Array:
    return np.zeros_like(z_mm)


def _trimmed(solid: Manifold, direction: int, end_mm: float) -> Manifold:
    """The solid up to a height; direction +1: below it, -1: above it."""
    return solid.trim_by_plane((0.0, 0.0, -float(direction)), -direction * end_mm)


def leaned(solid: Manifold, pivot_mm: float, angle_deg: float, direction: int) -> Manifold:
    """The solid with its shaft leaning sideways by an angle beyond a pivot height, as `lean` does with sections."""

    def move(points: Array) -> Array:
        places = np.array(points)
        places[:, 0] += sideways(places[:, 2], pivot_mm, angle_deg, direction)
        return places

    return solid.warp_batch(move)


def deformed(solid: Manifold, build: Build, bone: str) -> Manifold:
    """A solid of this knee's size, in a bone's frame, with what this person's bone differs by."""
    lattice, s = build.lattices[bone], build.scale
    return solid.warp_batch(lambda points: displaced(np.array(points) / s, lattice) * s)


def grown_femur(build: Build, osteophytes: tuple[Osteophyte, ...]) -> BoneWithOsteophytes:
    """The outer femur at the mean man's size with a straight shaft, osteophytes and all."""
    return grow(
        osteophytes, mean_femur(build.shape.femur), build.shape.osteophytes.femur, build.scale, build.lattices["femur"]
    )


def grown_tibia(build: Build, osteophytes: tuple[Osteophyte, ...]) -> BoneWithOsteophytes:
    """The outer tibia at the mean man's size with a straight shaft and a level plateau, osteophytes and all."""
    return grow(
        osteophytes, mean_tibia(build.shape.tibia), build.shape.osteophytes.tibia, build.scale, build.lattices["tibia"]
    )


def femur(build: Build, grown: BoneWithOsteophytes) -> Bone:
    """Distal femur; z = 0 at the condyles' distal end, shaft leaning laterally by `femur_valgus_deg`."""
    table, s, mean = build.shape.femur, build.scale, mean_femur(build.shape.femur)
    sections = scaled(table.sections, s)
    cortex = thickness(table.cortex, s, build.cortex)
    plate = table.plate_mm * build.cortex * build.plate

    def depth(points: Array) -> Array:
        share = np.clip((table.plate_below_z - points[:, 2]) / 4.0, 0.0, 1.0)
        return ((1 - share) * cortex(points[:, 2] * s) + share * plate) / s

    marrow = project_solid(mean.coarser, mean.field, depth_mm=depth, steps=_INWARD_STEPS)
    canal_levels = _levels(table.canal_from_z_mm * s, SHAFT_END_MM - 4.0, 2.5)
    canal = _canal(sections, cortex, canal_levels, table.canal_full_z_mm * s, "femur canal")

    canal = leaned(deformed(canal, build, "femur"), table.shaft_pivot_z_mm * s, -build.femur_valgus_deg, +1)

    def standing(solid: Manifold, end_mm: float) -> Manifold:
        stood = solid.warp_batch(lambda points: stand_femur(np.array(points), build))
        return checked(_trimmed(stood, +1, end_mm), "femur")

    return Bone(
        outer=standing(grown.outer, SHAFT_END_MM),
        # Simplified before it is bent: bent, its smallest folds may stick out.
        inner=standing(grown.filled(marrow, s).simplify(INNER_MM / s), SHAFT_END_MM - 2.0),
        canal=checked(canal, "femur canal").simplify(_CANAL_MM),
    )


def _canal(sections: Array, cortex: Callable[[Array], Array], levels: Array, full_z_mm: float, name: str) -> Manifold:
    """Marrow: opens from a point in the metaphysis to nearly the cortex at `full_z_mm`."""
    tip = levels[0] if abs(levels[0] - full_z_mm) < abs(levels[-1] - full_z_mm) else levels[-1]
    table = sections[np.argsort(sections[:, 0])]

    def inset(z_mm: Array) -> Array:
        opening = np.clip((z_mm - tip) / (full_z_mm - tip), 0.0, 1.0)
        room = np.minimum(*(np.interp(z_mm, table[:, 0], table[:, k]) for k in (1, 2))) - cortex(z_mm)
        return cortex(z_mm) + 0.4 + (room - 1.0) * (1 - np.sin(opening * np.pi / 2))

    return column(sections, inset, levels, name)


def tibia_column(build: Build, grow_mm: float) -> Manifold:
    """The tibia's shaft and flare alone, grown by `grow_mm`; used to keep the fibula clear of it."""
    table, s = build.shape.tibia, build.scale
    sections = scaled(table.sections, s)
    straight = column(
        sections, lambda z: np.full_like(z, -grow_mm), _levels(-SHAFT_END_MM - 10.0, 4.0, 3.0), "tibia column"
    )
    return leaned(deformed(straight, build, "tibia"), table.shaft_pivot_z_mm * s, build.tibia_varus_deg, -1)


def tibia(build: Build, grown: BoneWithOsteophytes) -> Bone:
    """Proximal tibia; z = 0 at the middle of the plateau, shaft leaning medially by `tibia_varus_deg`."""
    table, s, mean = build.shape.tibia, build.scale, mean_tibia(build.shape.tibia)
    sections = scaled(table.sections, s)
    cortex = thickness(table.cortex, s, build.cortex)
    plate = table.plate_mm * build.cortex * build.plate

    def depth(points: Array) -> Array:
        # The plate under the cartilage passes into the cortex of the sides over its own first millimetres.
        share = np.clip(1 + above(points, table.relief) / 3.0, 0.0, 1.0)
        return ((1 - share) * cortex(points[:, 2] * s) + share * plate) / s

    marrow = project_solid(mean.coarser, mean.field, depth_mm=depth, steps=_INWARD_STEPS)
    canal_levels = _levels(-SHAFT_END_MM + 4.0, table.canal_from_z_mm * s, 2.5)
    canal = _canal(sections, cortex, canal_levels, table.canal_full_z_mm * s, "tibia canal")
    return Bone(
        outer=standing(grown.outer, build),
        inner=standing(grown.filled(marrow, s).simplify(INNER_MM / s), build, 2.0),
        canal=leaned(deformed(canal, build, "tibia"), table.shaft_pivot_z_mm * s, build.tibia_varus_deg, -1).simplify(
            _CANAL_MM
        ),
    )


def standing(solid: Manifold, build: Build, short_mm: float = 0.0) -> Manifold:
    """A solid of the mean man's tibia as it stands in this knee, cut off at its end or short of it."""
    stood = solid.warp_batch(lambda points: stand_tibia(np.array(points), build))
    return checked(_trimmed(stood, -1, -SHAFT_END_MM + short_mm), "tibia")


def stand_tibia(points: Array, build: Build) -> Array:
    """(n, 3)  places of the mean man's tibia in this one: at its size, plateau falling backwards, shaft leaning

    points  (n, 3)  mm
    """
    places = sloped(displaced(points, build.lattices["tibia"]) * build.scale, build)
    pivot_mm = build.shape.tibia.shaft_pivot_z_mm * build.scale
    places[:, 0] += sideways(places[:, 2], pivot_mm, build.tibia_varus_deg, -1)
    return places


def stand_femur(points: Array, build: Build) -> Array:
    """(n, 3)  places of the mean man's femur in this one: at its size, shaft leaning

    points  (n, 3)  mm
    """
    places = displaced(points, build.lattices["femur"]) * build.scale
    pivot_mm = build.shape.femur.shaft_pivot_z_mm * build.scale
    places[:, 0] += sideways(places[:, 2], pivot_mm, -build.femur_valgus_deg, +1)
    return places


def sloped(points_mm: Array, build: Build) -> Array:
    """(n, 3)  places of a tibia whose plateau falls backwards; below the tuberosity the shaft stays as it is

    points_mm  (n, 3)
    """
    places = points_mm.copy()
    fade = np.clip(1 + places[:, 2] / (60.0 * build.scale), 0.0, 1.0) ** 2
    places[:, 2] -= np.tan(np.deg2rad(build.slope_deg)) * places[:, 1] * fade
    return places


def fibula(build: Build) -> Bone:
    """Fibula in the tibia's frame, cut clear of the tibia by a joint gap."""
    table, s = build.shape.fibula, build.scale
    sections = lean(scaled(table.sections, s), -25.0 * s, build.tibia_varus_deg, -1)
    cortex = thickness(table.cortex, s, build.cortex)
    low, high = -SHAFT_END_MM, sections[:, 0].max()
    gap = table.gap_to_tibia_mm
    levels = _levels(low, high, 1.5)
    # Rings at the same heights, so that between them too the inner loft lies within the outer one.
    within = levels[(levels > low + 1.4) & (levels < high - 0.7)]
    outer = column(sections, _none, levels, "fibula", count=64).simplify(_COARSER_MM / 2)
    inner = column(sections, cortex, within, "fibula marrow", count=64)
    # Simplified before they are cut: in the sharp edge that the cut leaves there is no room for it.
    return Bone(
        outer=checked(outer - tibia_column(build, gap), "fibula"),
        inner=checked(inner.simplify(_COARSER_MM) - tibia_column(build, gap + 0.7), "fibula marrow"),
    )


def patella(build: Build) -> Bone:
    """Patella in the femur's frame."""
    table, s = build.shape.patella, build.scale
    sections = scaled(table.sections, s)
    cortex = thickness(table.cortex, s, build.cortex)
    low, high = sections[:, 0].min(), sections[:, 0].max()
    place = tuple(s * c for c in table.centre_mm)
    outer = column(sections, _none, _levels(low, high, 1.0), "patella", power=2.1).simplify(_COARSER_MM / 2)
    inner = column(sections, cortex, _levels(low + 1.2, high - 1.2, 1.0), "patella marrow", power=2.1).simplify(
        _COARSER_MM
    )
    outer, inner = (deformed(solid, build, "patella").translate(place) for solid in (outer, inner))
    return Bone(outer=outer, inner=inner)
