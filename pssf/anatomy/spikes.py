"""Spikes: osteophytes that are no lips: on tibial spines, in the middle of a joint surface, or too small for one."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import kernel
from ..data.bones import CentralShape, Margin
from .lips import Deform
from .mean_bone import MeanBone
from .solids import checked, mesh_of

# Cones from foot to foot that stand for the hull of tips and feet.
_CONES_A_SIDE = 8
# Turns in which a tip is moved to where it belongs, and the step of the slopes that this takes.
_TURNS, _STEP_MM = 16, 1e-3
# Spikes on spines lean towards each other, by this part of their size and so many mm at most: on films of KL 4 spines
# stand 2.7 mm nearer to each other than on those of KL 0 (Tiulpin et al. 2019).
_LEANS, _MOST_LEANING_MM = 1.0, 1.5
# On films of KL 4 they are ridges that fill the saddle between the spines (seen on 10 films; numbers: judgement).
# Breadth grows with size up to the first; one so tall that it would stand in the femur has less, the second over its
# size. So far from a spine's top, in the saddle, is a foot; a crest runs forwards and back by the fourth, where it
# is lower by the fifth, a millimetre of breadth.
_BROADEST_MM, _TALL_MM2, _INNER_FOOT_MM, _CREST_RUNS, _CREST_FALLS = 2.5, 8.0, 4.0, 2.2, 0.45
# Where spines are to either side of the middle, at the mean man's size: the margin of a bowl-shaped plateau is higher.
_SPINES_MM = (1.0, 16.0)
# At a margin its feet are so far from there, away from the joint, at the mean man's size.
_FOOT_MM = 3.0
# In the middle of a joint surface: six feet and tips around one in the middle (6), so that cones leave no hollow.
_AROUND, _STAR = 6, (0, 6, 3, 1, 6, 4, 2, 6, 5, 0)


@dataclass(frozen=True, eq=False)
class Spike:
    """Cones from feet in the bone to tips, whose farthest stands out by its size.

    feet, tips  (k, 3)  centres of the balls there, and their radii; a cone goes from each to its own, and from places
                between one and the next
    out         (3,)    unit vector in which it stands out
    """

    feet: Array
    foot_mm: float
    tips: Array
    tip_mm: float
    size_mm: float
    out: Array

    @property
    def tip(self) -> Array:
        """(3,)  the farthest of its tips"""
        return np.asarray(self.tips[(self.tips @ self.out).argmax()])

    @property
    def farthest(self) -> Array:
        """(3,)  its farthest point"""
        return self.tip + self.tip_mm * self.out

    @property
    def fillet_mm(self) -> float:
        """Less than the size, so that the tip stays where it is."""
        return min(2.0, 0.8 * self.size_mm)

    def near(self, points: Array) -> NDArray[np.bool_]:
        """(n,)  whether points (n, 3), mm, are so near that the bone's surface may be another there"""
        reach = np.linalg.norm(self.feet - self.tip, axis=1).max() + self.foot_mm + 4.0
        return np.asarray(((points - self.tip) ** 2).sum(axis=1) < reach**2)

    def field(self, points: Array) -> Array:
        """(n,)  approximate distance from the spike at points (n, 3), mm"""
        away = np.empty(len(points))
        _fill_cones(away, points, *self._cones, self.foot_mm, self.tip_mm)
        return away

    @cached_property
    def _cones(self) -> tuple[Array, Array]:
        """(cones, 3)  feet and tips of those from foot to foot too"""
        corners = np.arange(len(self.feet))
        shares = np.linspace(0.0, corners[-1], _CONES_A_SIDE * corners[-1] + 1)
        feet, tips = (
            np.stack([np.interp(shares, corners, ends[:, axis]) for axis in range(3)], axis=1)
            for ends in (self.feet, self.tips)
        )
        return feet, tips

    def solid(self, inset_mm: float) -> Manifold:
        """Hull of the balls, drawn in; the cortex takes the whole tip of a small one."""
        tip_mm = max(self.tip_mm - inset_mm, 0.1)
        middle = self.feet.mean(axis=0)
        inward = (middle - self.tip) / np.linalg.norm(middle - self.tip)
        moved = inward * max(0.0, inset_mm - (self.tip_mm - tip_mm))
        balls = [_ball(tip + moved, tip_mm) for tip in np.unique(self.tips, axis=0)]
        balls += [_ball(foot, self.foot_mm - inset_mm) for foot in np.unique(self.feet, axis=0)]
        return checked(Manifold.batch_hull(balls), "osteophyte")


def at_margin(table: Margin, direction: float, bare: Manifold, size_mm: float, deform: Deform) -> Spike:
    """A spike on a joint's margin.

    direction  +1 medial, -1 lateral; likewise below
    deform     what the bone is deformed by afterwards, whose stretching is taken back; likewise below
    """
    points = mesh_of(bare).vertices
    band = points[(points[:, 2] >= table.band_z[0]) & (points[:, 2] <= table.band_z[1])]
    margin = float((band[:, 0] * direction).max())
    tip_mm, foot_mm, width = 0.35 + 0.15 * size_mm, 1.6 + 0.5 * size_mm, 4.0 + 2.0 * size_mm
    inward = margin - foot_mm - 1.2 - 1.5 * np.array([1.0, 0.0, 1.0])
    foot_z = table.at_z - _FOOT_MM * table.joint
    feet = np.column_stack((direction * inward, [-width, 0.0, width], np.full(3, foot_z)))

    def shape(stands_mm: float, out: Array) -> Spike:
        tip = np.array([direction * (margin + stands_mm - tip_mm), 0.0, table.at_z])
        return Spike(feet, foot_mm, np.tile(tip, (len(feet), 1)), tip_mm, size_mm, out)

    way = np.array([direction, 0.0, 0.0])
    return _standing_out(shape, way, float((deform(band) @ way).max()), size_mm, deform)


def on_spine(direction: float, bare: Manifold, size_mm: float, deform: Deform) -> Spike:
    """A ridge on a tibial spine."""
    points = mesh_of(bare).vertices
    aside_mm = points[:, 0] * direction
    side = points[(aside_mm > _SPINES_MM[0]) & (aside_mm < _SPINES_MM[1])]
    height = deform(side)[:, 2]
    top = side[height.argmax()]
    broad_mm = min(size_mm, _BROADEST_MM, _TALL_MM2 / size_mm)
    tip_mm, foot_mm = 0.35 + 0.35 * broad_mm, 1.2 + 0.6 * broad_mm
    below = np.array([0.0, 0.0, foot_mm + 0.6])
    feet = top - below + np.array([[0.0, -3.0, -0.6], [0.0, 0.0, 0.0], [0.0, 3.0, -0.6]])
    saddle = top[:2] - [direction * _INNER_FOOT_MM, 0.0]
    near = points[np.linalg.norm(points[:, :2] - saddle, axis=1) < 2.0]
    inner = np.append(saddle, near[:, 2].max()) - below
    feet = np.vstack((feet[0], inner, feet[2], feet[1], feet[0]))
    crest = broad_mm * np.array([[0.0, way * _CREST_RUNS, -abs(way) * _CREST_FALLS] for way in (-1, 0, 1, 0, -1)])
    inward_mm = min(_LEANS * size_mm, _MOST_LEANING_MM)

    def shape(stands_mm: float, out: Array) -> Spike:
        tip = top + np.array([-inward_mm * direction, 0.0, stands_mm - tip_mm])
        return Spike(feet, foot_mm, tip + crest, tip_mm, size_mm, out)

    return _standing_out(shape, np.array([0.0, 0.0, 1.0]), float(height.max()), size_mm, deform)


def in_middle(table: CentralShape, spot: tuple[float, float], bare: MeanBone, size_mm: float, deform: Deform) -> Spike:
    """A mound within a joint surface, as high as `size_mm` over what is bare about it.

    spot  medial (+1) or lateral (-1), and the place from front (-1) to back (+1)
    """
    points = mesh_of(bare.outer).vertices
    side = points[np.abs(points[:, 0] - spot[0] * table.across_mm) < table.about_mm]
    if bare.name == "femur":
        angle = np.deg2rad(np.interp(spot[1], (-1.0, 1.0), table.femur_deg))
        way = np.array([0.0, np.sin(angle), -np.cos(angle)])
    else:
        way = np.array([0.0, 0.0, 1.0])
        back = np.interp(spot[1], (-1.0, 1.0), table.tibia_mm)
        side = side[(np.abs(side[:, 1] - back) < table.about_mm) & (side[:, 2] > table.tibia_above_mm)]
    reach = deform(side) @ way
    top = side[reach.argmax()]
    tip_mm, foot_mm = (low + more * size_mm for low, more in (table.tip_mm, table.foot_mm))
    wide_mm = table.wide_mm[0] + table.wide_mm[1] * size_mm
    turns, across = np.arange(_AROUND) * 2 * np.pi / _AROUND, np.array([1.0, 0.0, 0.0])
    ring = np.cos(turns)[:, None] * across + np.sin(turns)[:, None] * np.cross(way, across)
    star = np.vstack((ring, np.zeros(3)))[list(_STAR)] * wide_mm
    feet = top - (foot_mm + table.sunk_mm) * way + star
    crest = table.top_share * star
    crest -= np.any(star, axis=1)[:, None] * table.top_falls * size_mm * way

    def shape(stands_mm: float, out: Array) -> Spike:
        return Spike(feet, foot_mm, top + (stands_mm - tip_mm) * way + crest, tip_mm, size_mm, out)

    return _standing_out(shape, way, float(reach.max()), size_mm, deform)


def _standing_out(
    make: Callable[[float, Array], Spike], way: Array, margin_mm: float, size_mm: float, deform: Deform
) -> Spike:
    """The shape whose farthest point, deformed, stands out by its size along a way beyond the deformed bare bone."""
    stands_mm, out = size_mm, way
    for _ in range(_TURNS):
        shape = make(stands_mm, out)
        near = shape.farthest + np.vstack((np.zeros(3), _STEP_MM * np.eye(3)))
        reach = deform(near) @ way
        # On the ball, the point is farthest at which the ball's normal is the gradient of the deformed place.
        slope = reach[1:] - reach[0]
        out = slope / np.linalg.norm(slope)
        stands_mm += size_mm - (float(reach[0]) - margin_mm)
    return make(stands_mm, out)


@kernel()
def _fill_cones(away: Array, points: Array, feet: Array, tips: Array, foot_mm: float, tip_mm: float) -> None:
    """Fill approximate distances (n,) of points (n, 3) from the nearest of cones between balls at feet and at tips."""
    for i in range(len(points)):
        # A plain minimum: blended, the cones would swell where they meet, in the tip.
        nearest = np.inf
        for k in range(len(feet)):
            along, square, squared = 0.0, 0.0, 0.0
            for axis in range(3):
                way = tips[k, axis] - feet[k, axis]
                along += (points[i, axis] - feet[k, axis]) * way
                square += way * way
            share = min(max(along / square, 0.0), 1.0)
            for axis in range(3):
                off = points[i, axis] - feet[k, axis] - share * (tips[k, axis] - feet[k, axis])
                squared += off * off
            nearest = min(nearest, np.sqrt(squared) - foot_mm - share * (tip_mm - foot_mm))
        away[i] = nearest


def _ball(centre_mm: Array, radius_mm: float) -> Manifold:
    return Manifold.sphere(radius_mm, 32).translate(centre_mm)
