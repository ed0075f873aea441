"""Lips: osteophytes of a joint's margins, a tapered profile swept along an edge that follows the bone's own outline."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Manifold
from numpy.polynomial.polynomial import polyfit, polyval
from numpy.typing import NDArray

from ..core.checks import Array
from ..data.bones import LipShape, Margin
from ..model.knee import Osteophyte
from .implicit import Field, meet
from .mean_bone import MeanBone
from .solids import loft, mesh_of

Deform = Callable[[Array], Array]
# Points around a section of a lip's rough solid, and millimetres from one section to the next.
_AROUND, _SECTION_MM = 24, 1.2
# The bone's outline is sampled at so many stations, no farther than this to either side: its joint surface so far
# inside of it, its margin so far under that, along ways so long.
_STATIONS, _FARTHEST_MM = 9, 13.0
_INWARD_MM, _UNDER_MM, _WAYS_MM, _SAMPLES = 5.0, 3.0, (-12.0, 12.0), 49
# Points of a margin so little short of its farthest are in its middle together.
_LEVEL_MM = 0.3
# Its ends, which lie within most bones, are rounded so far.
_END_MM = 1.0
# Bone farther away than this from a lip's profile is as it was.
_ABOUT_MM = 4.0
# Of stations of an outline at least so many; and a lip's ends lie so far under the bone, beside its fillet.
_FEWEST, _SUNK_MM = 4, 0.3
# Turns in which the farthest point is found and put where it belongs: to so many mm, and so near along and around the
# edge; steps of slopes; how far a turn may move it; and where it may be at most around the edge.
_TURNS, _SETTLED_MM, _STILL = 60, 1e-9, 1e-4
_STEPS, _MOST, _WIDEST, _STEP_MM = (0.02, 0.02), (2.0, 0.3), 1.2, 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class Lip:
    """A tapered profile swept along an edge; its farthest point, deformed, stands out by the osteophyte's size.

    origin  (3,)     of the coordinates: a place of the margin's height
    axes    (3, 3)   rows: along the margin, outwards, towards the joint
    edge    (3,)     polynomial of the edge's place outwards, mm: powers 0 to 2 of the place along the margin
    rise    (3,)     likewise of its place towards the joint
    half_mm          from its middle to its ends, which lie within the bone
    over_mm          how far its tip is above its foot, of what it stands above the joint surface: at most its size, so
                     that its flank keeps clear of the bone's
    spot    (2,)     where it is farthest: place along the margin, mm, and angle around its edge
    out     (3,)     normal of its surface there
    """

    origin: Array
    axes: Array
    edge: Array
    rise: Array
    half_mm: float
    size_mm: float
    edge_mm: float
    base_mm: float
    long_mm: float
    over_mm: float
    bend: float
    spot: Array
    out: Array

    @property
    def farthest(self) -> Array:
        """(3,)  its farthest point"""
        return np.asarray(self.at(self.spot[None])[0])

    @property
    def tip(self) -> Array:
        """(3,)  middle of the edge's rounding at its farthest point"""
        return self.farthest - self.edge_mm * self.out

    @property
    def fillet_mm(self) -> float:
        """Less than the size, so that the tip stays where it is."""
        return fillet_of(self.size_mm)

    def at(self, spots: Array) -> Array:
        """(n, 3)  points of the edge's rounding, mm; spots (n, 2) as `spot` is, mm"""
        along, angle = spots.T
        outward, up = self.edge_mm * (np.cos(angle) - 1), self.edge_mm * np.sin(angle)
        out = polyval(along, self.edge) + outward * self._stretch(along)
        local = np.column_stack((along, out, polyval(along, self.rise) + up + self._bent(outward)))
        return np.asarray(self.origin + local @ self.axes)

    def near(self, points: Array) -> NDArray[np.bool_]:
        """(n,)  whether points (n, 3), mm, are so near that the bone's surface may be another there"""
        along, out, up = self._local(points)
        wide = self.base_mm + _ABOUT_MM
        deep, high = -self.long_mm - wide, self.bend * self.size_mm / 2
        within = (np.abs(along) < self.half_mm + _ABOUT_MM) & (out > deep) & (out < _ABOUT_MM)
        low = min(high, 0.0) - self.over_mm
        return np.asarray(within & (up < wide + max(high, 0.0)) & (up > -2 * wide + low))

    def field(self, points: Array) -> Array:
        """(n,)  approximate distance from the lip at points (n, 3), mm"""
        along, out, up = self._local(points)
        up = up - self._bent(out)
        (foot, foot_mm), (tip, tip_mm) = self._balls(0.0)
        axis = tip - foot
        away_out, away_up = out - foot[0], up - foot[1]
        share = np.clip((away_out * axis[0] + away_up * axis[1]) / (axis @ axis), 0.0, 1.0)
        away = np.hypot(away_out - share * axis[0], away_up - share * axis[1])
        profile = away - foot_mm - share * (tip_mm - foot_mm)
        return meet(profile, np.abs(along) - self.half_mm, _END_MM)

    def solid(self, inset_mm: float) -> Manifold:
        """The lip as a loft of its sections, drawn in; the cortex takes the whole edge of a small one."""
        count = int(np.ceil(2 * self.half_mm / _SECTION_MM)) + 1
        along = np.linspace(-self.half_mm, self.half_mm, count)
        turn = np.arange(_AROUND) * (2 * np.pi / _AROUND)
        ways = np.column_stack((np.cos(turn), np.sin(turn)))
        # Points of a hull of two balls: of either, that which is the farther in a direction.
        reach = np.array([ways @ centre + radius for centre, radius in self._balls(inset_mm)])
        each = np.array([centre + radius * ways for centre, radius in self._balls(inset_mm)])
        section = np.where((reach[0] > reach[1])[:, None], each[0], each[1])
        section[:, 1] += self._bent(section[:, 0])
        rings = np.empty((count, _AROUND, 3))
        rings[..., 0] = section[:, 0] * self._stretch(along)[:, None] + polyval(along, self.edge)[:, None]
        rings[..., 1] = section[:, 1] + polyval(along, self.rise)[:, None]
        rings[..., 2] = along[:, None]
        sideways, out, up = self.axes
        return loft(rings, "osteophyte").transform(np.column_stack((out, up, sideways, self.origin)))

    def _local(self, points: Array) -> tuple[Array, Array, Array]:
        """Of points (n, 3): (n,) along the margin, out from the edge, and towards the joint from it."""
        along, out, up = ((points - self.origin) @ self.axes.T).T
        return along, (out - polyval(along, self.edge)) / self._stretch(along), up - polyval(along, self.rise)

    def _stretch(self, along: Array) -> Array:
        """(n,)  of ways outwards, where the edge runs aslant to them"""
        return np.asarray(np.hypot(1.0, polyval(along, [self.edge[1], 2 * self.edge[2]])))

    def _bent(self, out: Array) -> Array:
        """(n,)  how far the profile is bent towards the joint at places so far out from the edge"""
        return np.asarray(self.bend * np.maximum(out + self.size_mm, 0.0) ** 2 / (2 * self.size_mm))

    def _balls(self, inset_mm: float) -> tuple[tuple[Array, float], tuple[Array, float]]:
        """Foot and tip of the profile: (out, up) from the edge and radius."""
        tip_mm = max(self.edge_mm - inset_mm, 0.1)
        back = max(0.0, inset_mm - (self.edge_mm - tip_mm))
        foot = np.array([-self.long_mm, self.edge_mm - self.base_mm - self.over_mm])
        tip = np.array([-self.edge_mm, 0.0])
        tip = tip + back * (foot - tip) / np.hypot(*(foot - tip))
        return (foot, self.base_mm - inset_mm), (tip, tip_mm)


def lip_at(
    osteophyte: Osteophyte, size_mm: float, mean: MeanBone, tables: tuple[Margin, LipShape], deform: Deform
) -> Lip:
    """The lip that an osteophyte of a margin is, on the mean man's bone.

    size_mm  at the mean man's size
    tables   of the bone's margin, and of the form of lips
    deform   what the bone is deformed by afterwards, (n, 3) -> (n, 3), whose stretching is taken back here
    """
    margin, form = tables
    side = 1.0 if osteophyte.site.startswith("medial") else -1.0
    turn = np.deg2rad(osteophyte.place * form.turn_deg)
    way = np.array([side * np.cos(turn), np.sin(turn), 0.0])
    up = np.array([0.0, 0.0, margin.joint])
    axes = np.array([np.cross(up, way), way, up])
    points = mesh_of(mean.outer).vertices
    band = points[(points[:, 2] >= margin.band_z[0]) & (points[:, 2] <= margin.band_z[1])]
    reach = deform(band) @ way
    origin = band[reach > reach.max() - _LEVEL_MM].mean(axis=0)
    origin[2] = margin.at_z
    outline, rise = _outline(mean.field, origin, axes)
    edge_mm = form.edge_mm[0] + form.edge_mm[1] * size_mm
    drop_mm = margin.medial_drop_mm if side > 0 else margin.lateral_drop_mm
    under_mm = drop_mm[0] + drop_mm[1] * size_mm
    rise -= [under_mm + edge_mm, 0.0, 0.0]
    sunk_mm = fillet_of(size_mm) + _SUNK_MM
    long_mm = min(form.long_mm[0] + form.long_mm[1] * size_mm, form.longest_mm)
    half_mm = long_mm / 2 * np.sqrt((size_mm + sunk_mm) / size_mm)
    over_mm = min(max(0.0, -under_mm), size_mm)
    base_mm = (min(form.base_mm[0] + form.base_mm[1] * size_mm, form.highest_mm) - over_mm) / 2
    lip = Lip(
        origin=origin,
        axes=axes,
        edge=outline - [0.0, 0.0, (size_mm + sunk_mm) / half_mm**2],
        rise=rise,
        half_mm=half_mm,
        size_mm=size_mm,
        edge_mm=edge_mm,
        base_mm=base_mm,
        long_mm=base_mm + (1 - form.bulge) * size_mm,
        over_mm=over_mm,
        bend=float(np.tan(np.deg2rad(osteophyte.curve_deg))),
        spot=np.zeros(2),
        out=way,
    )
    return _standing_out(lip, way, float(reach.max()), deform)


def _outline(field: Field, origin: Array, axes: Array) -> tuple[Array, Array]:
    """Polynomials (3,) of where the bone ends outwards, and of how its joint surface rises, along its margin.

    origin, axes  as of `Lip`
    """
    along = np.linspace(-_FARTHEST_MM, _FARTHEST_MM, _STATIONS)
    ways = np.linspace(*_WAYS_MM, _SAMPLES)
    inside = origin - _INWARD_MM * axes[1] + along[:, None] * axes[0]
    rise = _fitted(along, _last_inside(field, inside, axes[2], ways))
    under = inside + (polyval(along, rise) - _UNDER_MM)[:, None] * axes[2]
    return _fitted(along, _last_inside(field, under, axes[1], ways)) - [_INWARD_MM, 0.0, 0.0], rise


def _last_inside(field: Field, starts: Array, way: Array, ways_mm: Array) -> Array:
    """(n,)  how far along a way from starts (n, 3) a bone ends; nan where none is there"""
    places = starts[:, None] + ways_mm[:, None] * way
    values = field(places.reshape(-1, 3)).reshape(len(starts), -1)
    leaves = (values[:, :-1] < 0) & (values[:, 1:] >= 0)
    last = leaves.shape[1] - 1 - leaves[:, ::-1].argmax(axis=1)
    each = np.arange(len(starts))
    before, after = values[each, last], values[each, last + 1]
    share = before / np.where(before == after, 1.0, before - after)
    return np.where(leaves.any(axis=1), ways_mm[last] + share * (ways_mm[1] - ways_mm[0]), np.nan)


def _fitted(along: Array, values: Array) -> Array:
    """(3,)  the parabola through values (n,) at places along a margin; level where there are too few"""
    there = ~np.isnan(values)
    if there.sum() < _FEWEST:
        return np.array([np.nanmean(values) if there.any() else 0.0, 0.0, 0.0])
    return np.asarray(polyfit(along[there], values[there], 2))


def _standing_out(lip: Lip, way: Array, margin_mm: float, deform: Deform) -> Lip:
    """The lip with its farthest point, deformed, out by its size along a way beyond the deformed bare bone."""
    steps = np.array(_STEPS)
    around = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)]) * steps
    most = np.array([lip.half_mm / 2, _WIDEST])
    for _ in range(_TURNS):
        reach = deform(lip.at(lip.spot + around)) @ way
        slope = np.array([reach[1] - reach[2], reach[3] - reach[4]]) / (2 * steps)
        bend = np.array([reach[1] + reach[2], reach[3] + reach[4]]) - 2 * reach[0]
        mixed = (reach[5] + reach[6] - reach[1:5].sum() + 2 * reach[0]) / 2
        curved = np.array([[bend[0], mixed], [mixed, bend[1]]]) / np.outer(steps, steps)
        # Uphill where the surface is no dome.
        dome = bend.max() < 0 and np.linalg.det(curved) > 0
        step = -np.linalg.solve(curved, slope) if dome else slope
        step = np.clip(step, -np.array(_MOST), _MOST)
        spot = np.clip(lip.spot + step, -most, most)
        short_mm = lip.size_mm - (float(reach[0]) - margin_mm)
        if abs(short_mm) < _SETTLED_MM and np.abs(spot - lip.spot).max() < _STILL:
            break
        lip = replace(lip, spot=spot, edge=lip.edge + np.array([short_mm, 0.0, 0.0]))
    near = lip.farthest + np.vstack((np.zeros(3), _STEP_MM * np.eye(3)))
    normal = deform(near) @ way
    out = normal[1:] - normal[0]
    return replace(lip, out=out / np.linalg.norm(out))


def fillet_of(size_mm: float) -> float:
    """Radius of the fillet between the bone and a lip of a size, mm."""
    return min(2.5, 0.8 * size_mm)
