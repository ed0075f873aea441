"""Femur, tibia, fibula and patella of a right knee: an outer cortical solid, an inner trabecular one, a canal."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from ..checks import Array
from ..files import tables
from .solids import checked, column, height_field, hull, loft, ring

# Shafts end here, outside the beam of any protocol in the package and within the soft tissue's own length.
SHAFT_END_MM = 180.0


@dataclass(frozen=True)
class Bone:
    """Nested solids of one bone: the cortex lies between outer and inner; the canal, if any, holds marrow."""

    outer: Manifold
    inner: Manifold
    canal: Manifold | None = None


@dataclass(frozen=True)
class Build:
    """What shapes the bones of one knee: size over the mean man's, relative cortex and plate, angles in degrees."""

    scale: float
    cortex: float
    plate: float
    slope_deg: float
    femur_valgus_deg: float
    tibia_varus_deg: float


def scaled(sections: list[list[float]], scale: float) -> Array:
    """(n, m)  a table of lengths, scaled"""
    return np.asarray(sections, dtype=np.float64) * scale


def thickness(table: list[list[float]], scale: float, factor: float) -> Callable[[Array], Array]:
    """Cortical thickness (mm) as a function of height (mm), from a table of height and thickness."""
    rows = np.asarray(table, dtype=np.float64)
    rows = rows[np.argsort(rows[:, 0])]
    return lambda z_mm: np.interp(z_mm, rows[:, 0] * scale, rows[:, 1]) * factor


def lean(sections: Array, pivot_mm: float, angle_deg: float, direction: int) -> Array:
    """Sections whose centres beyond a pivot height move sideways, so that the shaft leans by an angle.

    sections   (n, 5)  z, half ML, half AP, centre y, centre x
    direction  +1: above the pivot, -1: below it
    """
    leaning = sections.copy()
    beyond = np.maximum(direction * (sections[:, 0] - pivot_mm), 0.0)
    # A smooth start over 15 mm keeps the metaphysis free of a kink.
    beyond = np.where(beyond < 15.0, beyond**2 / 30.0, beyond - 7.5)
    leaning[:, 4] += np.tan(np.deg2rad(angle_deg)) * beyond
    return leaning


def _levels(low_mm: float, high_mm: float, step_mm: float) -> Array:
    return np.linspace(low_mm, high_mm, max(2, round((high_mm - low_mm) / step_mm) + 1))


def _none(z_mm: Array) -> Array:
    return np.zeros_like(z_mm)


def condyle(side: str, build: Build, inset_mm: float) -> Manifold:
    """One femoral condyle: sagittal arcs of three radii carried across its width, drawn in by `inset_mm`."""
    table = tables.data("anatomy")["condyles"]
    part, s = table[side], build.scale
    back, front = np.deg2rad(table["posterior_from_deg"]), np.deg2rad(-table["anterior_from_deg"])
    distal = part["distal"]
    arcs = []
    for radius, shift, start, end in (
        (distal, 0.0, front, back),
        (part["posterior"], part["back_y"], back, np.deg2rad(125)),
        (part["anterior"], part["front_y"], np.deg2rad(-110), front),
    ):
        angle = np.linspace(start, end, 40)
        # The smaller circles touch the distal one from inside where the arcs meet.
        meet = back if radius == part["posterior"] else front
        cy = shift + (distal - radius) * np.sin(meet) if radius != distal else 0.0
        cz = distal - (distal - radius) * np.cos(meet) if radius != distal else distal
        arcs.append((cy, cz, radius, angle))
    u = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 41))
    outward = u * np.sign(part["centre_x"])
    drop = sum(fall * np.maximum(outward, 0) ** power for fall, power in table["outer_fall"])
    drop += sum(fall * np.maximum(-outward, 0) ** power for fall, power in table["inner_fall"])
    points = []
    for offset, fall in zip(u, drop, strict=True):
        x = part["centre_x"] * s + offset * (part["half_width"] * s - inset_mm)
        for cy, cz, radius, angle in arcs:
            r = (radius - fall) * s - inset_mm
            points.append(
                np.column_stack((np.full(len(angle), x), cy * s + r * np.sin(angle), cz * s - r * np.cos(angle)))
            )
    return hull(np.vstack(points), f"femur {side} condyle")


def _notch(build: Build, grow_mm: float) -> Manifold:
    table, s = tables.data("anatomy")["notch"], build.scale
    (y0, z0), (y1, z1) = table["roof_front"], table["roof_back"]
    slope = (z1 - z0) / (y1 - y0)
    ends = np.array([y0 * s - grow_mm, 45.0 * s])
    rings = []
    for y in ends:
        roof = (z0 + slope * (y / s - y0)) * s + grow_mm
        low = -25.0 * s
        half = table["half_width_mm"] * s + grow_mm
        arch = ring(half, (roof - low) / 2, (0.0, (roof + low) / 2, 0.0), 3.0, 64)
        # Drawn in x-y, then stood up: its y becomes z, so that the loft runs along y.
        rings.append(np.column_stack((arch[:, 0], np.full(len(arch), y), arch[:, 1])))
    return loft(np.array(rings)[::-1], "femur notch")


def femur(build: Build) -> Bone:
    """Distal femur; z = 0 at the condyles' distal end, shaft leaning laterally by `femur_valgus_deg`."""
    table, s = tables.data("anatomy")["femur"], build.scale
    sections = lean(scaled(table["sections"], s), table["shaft_pivot_z_mm"] * s, -build.femur_valgus_deg, +1)
    cortex = thickness(table["cortex"], s, build.cortex)
    plate = table["plate_mm"] * build.cortex
    low, high = sections[0, 0], SHAFT_END_MM

    def assembled(levels: Array, inset: Callable[[Array], Array], shell_mm: float) -> Manifold:
        # The underside is nearly flat: there the shell is a rise of the sections, not only a drawing in.
        rise = shell_mm * np.clip((30.0 * s - sections[:, :1]) / (10.0 * s), 0, 1)
        body = column(sections + rise * np.eye(5)[0], inset, levels, "femur body")
        both = condyle("medial", build, shell_mm) + condyle("lateral", build, shell_mm)
        return checked(body + both - _notch(build, shell_mm), "femur")

    canal_levels = _levels(table["canal_from_z_mm"] * s, high - 4.0, 2.5)
    return Bone(
        outer=assembled(_levels(low, high, 2.0), _none, 0.0),
        inner=assembled(_levels(low + plate, high - 2.0, 2.0), cortex, plate),
        canal=_canal(sections, cortex, canal_levels, table["canal_full_z_mm"] * s, "femur canal"),
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


def relief(x_mm: Array, y_mm: Array, build: Build) -> Array:
    """(nx, ny)  height of the tibial plateau: slope, a concave medial and a convex lateral side, two spines, a rim"""
    table, s = tables.data("anatomy")["tibia"], build.scale
    x, y = np.meshgrid(np.asarray(x_mm) / s, np.asarray(y_mm) / s, indexing="ij")
    half_x, half_y = table["sections"][1][1:3]
    height = -np.tan(np.deg2rad(build.slope_deg)) * y
    height -= table["medial_dish_mm"] * np.maximum(0, 1 - ((x - 22) / 16) ** 2 - (y / 23) ** 2)
    height -= table["lateral_dish_mm"] * np.maximum(0, 1 - ((x + 22) / 15) ** 2) * (x < 0)
    height += table["lateral_crown_mm"] * np.maximum(0, 1 - (y / 21) ** 2) * np.clip(-x / 12, 0, 1)
    for bump in (table["medial_spine"], table["lateral_spine"], {"x": 0.0, "y": 0.0, **table["eminence"]}):
        height += bump["height"] * np.exp(
            -(((x - bump["x"]) / bump["half_x"]) ** 2) - ((y - bump["y"]) / bump["half_y"]) ** 2
        )
    radius = (np.abs(x / half_x) ** 2.3 + np.abs(y / half_y) ** 2.3) ** (1 / 2.3)
    height -= table["rim_mm"] * np.clip((radius - 0.88) / 0.12, 0, 2) ** 2
    return height * s


def tibia_column(build: Build, grow_mm: float) -> Manifold:
    """The tibia without its relief, grown by `grow_mm`; used to keep the fibula clear of it."""
    sections = _tibia_sections(build)
    return column(
        sections, lambda z: np.full_like(z, -grow_mm), _levels(-SHAFT_END_MM - 10.0, 4.0, 3.0), "tibia column"
    )


def _tibia_sections(build: Build) -> Array:
    table, s = tables.data("anatomy")["tibia"], build.scale
    return lean(scaled(table["sections"], s), table["shaft_pivot_z_mm"] * s, build.tibia_varus_deg, -1)


def tibia(build: Build) -> Bone:
    """Proximal tibia; z = 0 at the middle of the plateau, shaft leaning medially by `tibia_varus_deg`."""
    table, s = tables.data("anatomy")["tibia"], build.scale
    sections = _tibia_sections(build)
    cortex = thickness(table["cortex"], s, build.cortex)
    plate = table["plate_mm"] * build.cortex * build.plate
    low, high = -SHAFT_END_MM, sections[:, 0].max()
    x, y = np.linspace(-44 * s, 44 * s, 111), np.linspace(-30 * s, 30 * s, 76)
    top = relief(x, y, build)
    bottom = low - 10.0

    def capped(shaft: Manifold, drop_mm: float) -> Manifold:
        return checked(shaft ^ height_field(x, y, top - drop_mm, bottom, "tibial plateau"), "tibia")

    canal_levels = _levels(low + 4.0, table["canal_from_z_mm"] * s, 2.5)
    return Bone(
        outer=capped(column(sections, _none, _levels(low, high, 2.0), "tibia shaft"), 0.0),
        inner=capped(column(sections, cortex, _levels(low + 2.0, high, 2.0), "tibia marrow"), plate),
        canal=_canal(sections, cortex, canal_levels, table["canal_full_z_mm"] * s, "tibia canal"),
    )


def fibula(build: Build) -> Bone:
    """Fibula in the tibia's frame, cut clear of the tibia by a joint gap."""
    table, s = tables.data("anatomy")["fibula"], build.scale
    sections = lean(scaled(table["sections"], s), -25.0 * s, build.tibia_varus_deg, -1)
    cortex = thickness(table["cortex"], s, build.cortex)
    low, high = -SHAFT_END_MM, sections[:, 0].max()
    gap = table["gap_to_tibia_mm"]
    outer = column(sections, _none, _levels(low, high, 1.5), "fibula", count=64) - tibia_column(build, gap)
    inner = column(sections, cortex, _levels(low + 2.0, high - 0.8, 1.5), "fibula marrow", count=64)
    return Bone(outer=checked(outer, "fibula"), inner=checked(inner - tibia_column(build, gap + 0.7), "fibula marrow"))


def patella(build: Build) -> Bone:
    """Patella in the femur's frame."""
    table, s = tables.data("anatomy")["patella"], build.scale
    sections = scaled(table["sections"], s)
    cortex = thickness(table["cortex"], s, build.cortex)
    low, high = sections[:, 0].min(), sections[:, 0].max()
    place = tuple(s * c for c in table["centre_mm"])
    outer = column(sections, _none, _levels(low, high, 1.0), "patella", power=2.1)
    inner = column(sections, cortex, _levels(low + 1.2, high - 1.2, 1.0), "patella marrow", power=2.1)
    return Bone(outer=outer.translate(place), inner=inner.translate(place))
