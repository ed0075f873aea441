"""Osteophytes: lips of the joint margins and spikes on the spines that flow into the bone, each with a cortex."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..data.bones import Margin, Margins
from ..model.knee import Osteophyte
from .implicit import blend
from .lips import Deform, Lip, lip_at
from .mean_bone import MeanBone
from .remesh import laplacian_smooth
from .solids import box_about, checked, mesh_of

_CORTEX_MM = 0.3
# Large ones have more of it, by this part of their size.
_THICKENING = 0.06
# Bone of each kind of site.
BONE = {"femur": "femur", "tibia": "tibia", "spine": "tibia"}
# Rounds of evening out the mesh; cones from foot to foot that stand for the hull of tips and feet.
_ROUNDS = 3
_CONES_A_SIDE = 8
# Turns in which a tip is moved to where it belongs, and the step of the slopes that this takes.
_TURNS, _STEP_MM = 12, 1e-3
_EDGE_MM, _ROUGH_EDGE_MM = 2.0, 1.2
_DRAWN_IN_MM = 0.3
# Spikes on spines lean towards each other, by this part of their size and so many mm at most: on films of KL 4 spines
# stand 2.7 mm nearer to each other than on those of KL 0 (Tiulpin et al. 2019).
_LEANS, _MOST_LEANING_MM = 1.0, 1.5
# On films of KL 4 they are ridges that fill the saddle between the spines (seen on 10 films; numbers: judgement).
# Breadth grows with size up to the first; one so tall that it would stand in the femur has less, the second over its
# size. So far from a spine's top, in the saddle, is a foot; a crest runs forwards and back by the fourth, where it
# is lower by the fifth, a millimetre of breadth.
_BROADEST_MM, _TALL_MM2, _INNER_FOOT_MM, _CREST_RUNS, _CREST_FALLS = 2.5, 8.0, 4.0, 2.2, 0.45
# At a margin, at the mean man's size; and how far its feet are from there, away from the joint.
_SMALL_MM, _FOOT_MM = 0.38, 3.0


@dataclass(frozen=True)
class Spike:
    """On a spine, or too small for a lip: cones from feet in the bone to tips, whose farthest stands out by its size.

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
        corners = np.arange(len(self.feet))
        shares = np.linspace(0.0, corners[-1], _CONES_A_SIDE * corners[-1] + 1)
        feet, tips = (
            np.stack([np.interp(shares, corners, ends[:, axis]) for axis in range(3)], axis=1)
            for ends in (self.feet, self.tips)
        )
        # A plain minimum: blended, the cones would swell where they meet, in the tip.
        return np.asarray(_cones(points, feet, self.foot_mm, tips, self.tip_mm).min(axis=0))

    def solid(self, inset_mm: float) -> Manifold:
        """Hull of the balls, drawn in; the cortex takes the whole tip of a small one."""
        tip_mm = max(self.tip_mm - inset_mm, 0.1)
        middle = self.feet.mean(axis=0)
        inward = (middle - self.tip) / np.linalg.norm(middle - self.tip)
        moved = inward * max(0.0, inset_mm - (self.tip_mm - tip_mm))
        balls = [_ball(tip + moved, tip_mm) for tip in np.unique(self.tips, axis=0)]
        balls += [_ball(foot, self.foot_mm - inset_mm) for foot in np.unique(self.feet, axis=0)]
        return checked(Manifold.batch_hull(balls), "osteophyte")


# Either has its farthest point, a field, a solid, and what is near it.
OsteophyteShape = Lip | Spike


@dataclass(frozen=True)
class BoneWithOsteophytes:
    """A bone's outer solid with its osteophytes, in its frame at the mean man's size."""

    outer: Manifold
    shapes: tuple[OsteophyteShape, ...] = ()

    def filled(self, inner: Manifold, scale: float) -> Manifold:
        """The trabecular solid of the bone with what is inside its osteophytes."""
        for shape in self.shapes:
            within = shape.solid(_CORTEX_MM / scale + _THICKENING * shape.size_mm)
            about = self.outer ^ box_about(within, 2 * _DRAWN_IN_MM)
            # A rounded margin may not hold the feet of a small one; what is outside of the bone, drawn in, is cut off.
            if (within - about).volume() > 0:
                within = within ^ about
                for way in (*np.eye(3), *-np.eye(3), -shape.out):
                    # One after the other: of two copies of the bone the surfaces cross everywhere.
                    within.status()
                    within = within ^ about.translate(_DRAWN_IN_MM * way)
            # With edges short enough to bend with the bone.
            inner = inner + within.refine_to_length(_EDGE_MM)
        return inner


def grow(
    osteophytes: tuple[Osteophyte, ...], mean: MeanBone, margins: Margins, scale: float, deform: Deform
) -> BoneWithOsteophytes:
    """A bone with the osteophytes that belong to it.

    margins  where they are, and their form
    scale    of the knee, whose osteophytes are as large as they say
    deform   what the bone is deformed by afterwards, (n, 3) -> (n, 3), whose stretching is taken back here
    raises   InputError where one hides the farthest point of another
    """
    shapes: list[OsteophyteShape] = []
    for osteophyte in osteophytes:
        side, where = osteophyte.site.split("_")
        if BONE[where] == mean.name:
            size_mm = osteophyte.size_mm / scale
            if where == "spine":
                shapes.append(_on_spine(1.0 if side == "medial" else -1.0, mean.outer, size_mm, deform))
            else:
                margin = {"femur": margins.femur, "tibia": margins.tibia}[where]
                if size_mm < _SMALL_MM and osteophyte.place == 0:
                    shapes.append(_at_margin(margin, 1.0 if side == "medial" else -1.0, mean.outer, size_mm, deform))
                else:
                    shapes.append(lip_at(osteophyte, size_mm, mean, (margin, margins.lip), deform))
    if not shapes:
        return BoneWithOsteophytes(mean.outer)
    _refuse_hidden(osteophytes, shapes, mean.name)

    def whole(points: Array) -> Array:
        bare = mean.field(points)
        joined = bare.copy()
        for shape in shapes:
            close = shape.near(points)
            # Each is blended with the bone alone: blended with each other, one would lift the tip of its neighbour.
            with_it = blend(bare[close], shape.field(points[close]), shape.fillet_mm)
            joined[close] = np.minimum(joined[close], with_it)
        return joined

    def near(points: Array) -> NDArray[np.bool_]:
        return np.asarray(np.any([shape.near(points) for shape in shapes], axis=0))

    rough = mean.outer
    for shape in shapes:
        rough = rough + shape.solid(0.0).refine_to_length(_ROUGH_EDGE_MM)
    even = laplacian_smooth(rough, whole, _ROUNDS, near, [shape.farthest for shape in shapes])
    return BoneWithOsteophytes(checked(even, f"{mean.name} with osteophytes"), tuple(shapes))


def _refuse_hidden(osteophytes: tuple[Osteophyte, ...], shapes: list[OsteophyteShape], bone: str) -> None:
    for shape in shapes:
        for other in shapes:
            if other is not shape and float(other.field(shape.farthest[None])[0]) < 0:
                names = ", ".join(f"{one.site} {one.size_mm:g} mm at {one.place:g}" for one in osteophytes)
                raise InputError(
                    f"osteophytes of the {bone} ({names}): one hides the farthest point of another; allowed: smaller "
                    "ones, or places farther apart"
                )


def _at_margin(table: Margin, direction: float, bare: Manifold, size_mm: float, deform: Deform) -> Spike:
    """What is too small for a lip, whose profile would be thinner than triangles are long, is a spike."""
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


def _on_spine(direction: float, bare: Manifold, size_mm: float, deform: Deform) -> Spike:
    points = mesh_of(bare).vertices
    side = points[points[:, 0] * direction > 1.0]
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


def _cones(points: Array, feet: Array, foot_mm: float, tips: Array, tip_mm: float) -> Array:
    """(cones, n)  approximate distances of points (n, 3) from cones between balls at feet and at tips (cones, 3)"""
    axes = tips - feet
    away = points - feet[:, None]
    shares = np.clip((away @ axes[:, :, None])[..., 0] / (axes[:, None] @ axes[:, :, None])[..., 0], 0.0, 1.0)
    away -= shares[..., None] * axes[:, None]
    away *= away
    # A sum over so short an axis takes numpy several times as long.
    return np.asarray(np.sqrt(away[..., 0] + away[..., 1] + away[..., 2]) - foot_mm - shares * (tip_mm - foot_mm))


def _ball(centre_mm: Array, radius_mm: float) -> Manifold:
    return Manifold.sphere(radius_mm, 32).translate(centre_mm)
