"""Spike osteophytes: osteophytes on tibial spines and joint surfaces, and small osteophytes on joint margins."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.numba_kernel import kernel
from ...data.anatomy.bone_tables import CentralOsteophyteShape, OsteophyteMargin
from ..meshing.solids import extract_mesh, require_valid_solid
from ..template.template_bone import TemplateBone
from .marginal_osteophytes import Deformation

# Number of interpolated cones between two consecutive base points. All cones together approximate the convex hull of
# the balls at base points and tips.
_CONES_PER_SIDE = 8
# Number of iterations that move the tip to the specified protrusion.
_TURNS = 16
# Finite-difference step for the surface normal, mm.
_STEP_MM = 1e-3
# Lean of spine osteophytes towards each other, as a fraction of their size. On patient radiographs, the spines are 2.7
# mm closer to each other at KL 4 than at KL 0 (Tiulpin et al. 2019).
_LEANS = 1.0
# Largest lean of a spine osteophyte, mm.
_MOST_LEANING_MM = 1.5
# Largest breadth of a spine osteophyte, in mm (assumed). Below this limit, the breadth equals the size. Spine
# osteophytes are ridges that fill the intercondylar saddle between the spines (10 patient radiographs with KL grade 4).
_BROADEST_MM = 2.5
# Largest product of breadth and size of a spine osteophyte, in mm2 (assumed). Tall ridges are therefore narrow and do
# not touch the femur.
_TALL_MM2 = 8.0
# Distance from the top of the spine to the base of the osteophyte ridge in the intercondylar saddle, in mm (assumed).
_INNER_FOOT_MM = 4.0
# Distance from the top of the crest to its anterior and posterior ends, in mm per mm of breadth (assumed).
_CREST_RUNS = 2.2
# Height difference between the top and the ends of the crest, in mm per mm of breadth (assumed).
_CREST_FALLS = 0.45
# Range of distances from the midline within which the top of a spine is searched for, in mm at template size. Beyond
# this range, the margin of a concave plateau may be higher than the spine.
_SPINE_RANGE_MM = (1.0, 16.0)
# Distance of the base points from the joint margin, in the direction away from the joint, in mm at template size.
_FOOT_OFFSET_MM = 3.0
# Number of base points around the central base point of a central osteophyte; the number of tips is the same.
_AROUND = 6
# Order in which interpolated cones connect the base points of a central osteophyte. Number 6 is the central base point;
# its cones fill the inside of the ring.
_STAR = (0, 6, 3, 1, 6, 4, 2, 6, 5, 0)


@dataclass(frozen=True, eq=False)
class SpikeOsteophyte:
    """Spike osteophyte: cones that connect base points in the bone to tips. The farthest tip protrudes by the size.

    Attributes
    ----------
    feet : (k, 3) float64 array
        Base points of the cones (centres of balls), in mm. One cone connects each base point to its tip. Interpolated
        cones fill the gaps between consecutive base points.
    foot_mm : float
        Radius of the balls at the base points, in mm.
    tips : (k, 3) float64 array
        Centres of the balls at the tips, in mm.
    tip_mm : float
        Radius of the balls at the tips, in mm.
    size_mm : float
        Size of the osteophyte at template size, in mm.
    direction : (3,) float64 array
        Unit normal of the surface at the farthest point.
    """

    feet: Array
    foot_mm: float
    tips: Array
    tip_mm: float
    size_mm: float
    direction: Array

    @property
    def tip(self) -> Array:
        """Centre of the farthest tip (3,), in mm."""
        return np.asarray(self.tips[(self.tips @ self.direction).argmax()])

    @property
    def farthest_point(self) -> Array:
        """Farthest point of the osteophyte (3,), in mm."""
        return self.tip + self.tip_mm * self.direction

    @property
    def fillet_mm(self) -> float:
        """Radius of the fillet between osteophyte and bone, in mm.

        The radius is below the size, so the fillet does not move the tip.
        """
        return min(2.0, 0.8 * self.size_mm)

    def is_near(self, points: Array) -> NDArray[np.bool_]:
        """Test which points are close enough for the osteophyte to change the bone surface.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points in the frame of the bone.

        Returns
        -------
        (n,) bool array
            True at points near the osteophyte.
        """
        reach = np.linalg.norm(self.feet - self.tip, axis=1).max() + self.foot_mm + 4.0
        return np.asarray(((points - self.tip) ** 2).sum(axis=1) < reach**2)

    def compute_distance_mm(self, points: Array) -> Array:
        """Compute the approximate signed distance of points from the osteophyte.

        Parameters
        ----------
        points : (n, 3) float64 array, mm
            Points in the frame of the bone.

        Returns
        -------
        (n,) float64 array
            Distance in mm, negative inside.
        """
        away = np.empty(len(points))
        _fill_cone_distances(away, points, *self._cones, self.foot_mm, self.tip_mm)
        return away

    @cached_property
    def _cones(self) -> tuple[Array, Array]:
        """Return base points and tips (cones, 3) of all cones, including the interpolated cones, in mm."""
        corners = np.arange(len(self.feet))
        shares = np.linspace(0.0, corners[-1], _CONES_PER_SIDE * corners[-1] + 1)
        feet, tips = (
            np.stack([np.interp(shares, corners, ends[:, axis]) for axis in range(3)], axis=1)
            for ends in (self.feet, self.tips)
        )
        return feet, tips

    def build_solid(self, inset_mm: float) -> Manifold:
        """Build the convex hull of the balls at base points and tips, with its surface moved inwards by an inset.

        Parameters
        ----------
        inset_mm : float
            Distance by which the surface is moved inwards, in mm. The inset removes the entire tip of a small
            osteophyte.

        Returns
        -------
        Manifold
            Solid in the frame of the bone, in mm.

        Raises
        ------
        InputError
            If the hull is not a valid solid.
        """
        tip_mm = max(self.tip_mm - inset_mm, 0.1)
        middle = self.feet.mean(axis=0)
        inward = (middle - self.tip) / np.linalg.norm(middle - self.tip)
        moved = inward * max(0.0, inset_mm - (self.tip_mm - tip_mm))
        balls = [_build_ball(tip + moved, tip_mm) for tip in np.unique(self.tips, axis=0)]
        balls += [_build_ball(foot, self.foot_mm - inset_mm) for foot in np.unique(self.feet, axis=0)]
        return require_valid_solid(Manifold.batch_hull(balls), "osteophyte")


def build_margin_spike(
    table: OsteophyteMargin, side_sign: float, bare_bone: Manifold, size_mm: float, deform: Deformation
) -> SpikeOsteophyte:
    """Build a spike osteophyte on a joint margin.

    Parameters
    ----------
    table : OsteophyteMargin
        Dimensions of the joint margin.
    side_sign : float
        +1 for the medial compartment, -1 for the lateral compartment.
    bare_bone : Manifold
        Outer solid of the template bone.
    size_mm : float
        Size of the osteophyte at template size, in mm.
    deform : callable
        Deformation that is later applied to the bone. It maps points (n, 3), in mm, to points (n, 3), in mm. The
        osteophyte has the specified size after this deformation.

    Returns
    -------
    SpikeOsteophyte
        Osteophyte in the frame of the template bone.
    """
    points = extract_mesh(bare_bone).vertices
    band = points[(points[:, 2] >= table.band_z[0]) & (points[:, 2] <= table.band_z[1])]
    margin = float((band[:, 0] * side_sign).max())
    tip_mm, foot_mm, width = 0.35 + 0.15 * size_mm, 1.6 + 0.5 * size_mm, 4.0 + 2.0 * size_mm
    inward = margin - foot_mm - 1.2 - 1.5 * np.array([1.0, 0.0, 1.0])
    foot_z = table.at_z - _FOOT_OFFSET_MM * table.joint
    feet = np.column_stack((side_sign * inward, [-width, 0.0, width], np.full(3, foot_z)))

    def shape(stands_mm: float, out: Array) -> SpikeOsteophyte:
        tip = np.array([side_sign * (margin + stands_mm - tip_mm), 0.0, table.at_z])
        return SpikeOsteophyte(feet, foot_mm, np.tile(tip, (len(feet), 1)), tip_mm, size_mm, out)

    way = np.array([side_sign, 0.0, 0.0])
    return _fit_protrusion(shape, way, float((deform(band) @ way).max()), size_mm, deform)


def build_spine_spike(side_sign: float, bare_bone: Manifold, size_mm: float, deform: Deformation) -> SpikeOsteophyte:
    """Build a ridge-shaped osteophyte on a tibial spine.

    Parameters
    ----------
    side_sign : float
        +1 for the medial spine, -1 for the lateral spine.
    bare_bone : Manifold
        Outer solid of the template tibia.
    size_mm : float
        Size of the osteophyte at template size, in mm.
    deform : callable
        Deformation that is later applied to the bone. It maps points (n, 3), in mm, to points (n, 3), in mm. The
        osteophyte has the specified size after this deformation.

    Returns
    -------
    SpikeOsteophyte
        Osteophyte in the frame of the template tibia.
    """
    points = extract_mesh(bare_bone).vertices
    aside_mm = points[:, 0] * side_sign
    side = points[(aside_mm > _SPINE_RANGE_MM[0]) & (aside_mm < _SPINE_RANGE_MM[1])]
    height = deform(side)[:, 2]
    top = side[height.argmax()]
    broad_mm = min(size_mm, _BROADEST_MM, _TALL_MM2 / size_mm)
    tip_mm, foot_mm = 0.35 + 0.35 * broad_mm, 1.2 + 0.6 * broad_mm
    below = np.array([0.0, 0.0, foot_mm + 0.6])
    feet = top - below + np.array([[0.0, -3.0, -0.6], [0.0, 0.0, 0.0], [0.0, 3.0, -0.6]])
    saddle = top[:2] - [side_sign * _INNER_FOOT_MM, 0.0]
    near = points[np.linalg.norm(points[:, :2] - saddle, axis=1) < 2.0]
    inner = np.append(saddle, near[:, 2].max()) - below
    feet = np.vstack((feet[0], inner, feet[2], feet[1], feet[0]))
    crest = broad_mm * np.array([[0.0, way * _CREST_RUNS, -abs(way) * _CREST_FALLS] for way in (-1, 0, 1, 0, -1)])
    inward_mm = min(_LEANS * size_mm, _MOST_LEANING_MM)

    def shape(stands_mm: float, out: Array) -> SpikeOsteophyte:
        tip = top + np.array([-inward_mm * side_sign, 0.0, stands_mm - tip_mm])
        return SpikeOsteophyte(feet, foot_mm, tip + crest, tip_mm, size_mm, out)

    return _fit_protrusion(shape, np.array([0.0, 0.0, 1.0]), float(height.max()), size_mm, deform)


def build_central_spike(
    table: CentralOsteophyteShape,
    location: tuple[float, float],
    bare_bone: TemplateBone,
    size_mm: float,
    deform: Deformation,
) -> SpikeOsteophyte:
    """Build a mound-shaped osteophyte within a joint surface.

    Parameters
    ----------
    table : CentralOsteophyteShape
        Dimensions of central osteophytes.
    location : (float, float)
        Compartment (+1 medial, -1 lateral) and antero-posterior position (-1 anterior to +1 posterior), dimensionless.
    bare_bone : TemplateBone
        Template bone.
    size_mm : float
        Height of the osteophyte above the surrounding bone surface, in mm at template size.
    deform : callable
        Deformation that is later applied to the bone. It maps points (n, 3), in mm, to points (n, 3), in mm. The
        osteophyte has the specified size after this deformation.

    Returns
    -------
    SpikeOsteophyte
        Osteophyte in the frame of the template bone.
    """
    points = extract_mesh(bare_bone.outer).vertices
    side = points[np.abs(points[:, 0] - location[0] * table.across_mm) < table.base_half_width_mm]
    if bare_bone.name == "femur":
        angle = np.deg2rad(np.interp(location[1], (-1.0, 1.0), table.femur_deg))
        way = np.array([0.0, np.sin(angle), -np.cos(angle)])
    else:
        way = np.array([0.0, 0.0, 1.0])
        back = np.interp(location[1], (-1.0, 1.0), table.tibia_mm)
        side = side[(np.abs(side[:, 1] - back) < table.base_half_width_mm) & (side[:, 2] > table.tibia_above_mm)]
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

    def shape(stands_mm: float, out: Array) -> SpikeOsteophyte:
        return SpikeOsteophyte(feet, foot_mm, top + (stands_mm - tip_mm) * way + crest, tip_mm, size_mm, out)

    return _fit_protrusion(shape, way, float(reach.max()), size_mm, deform)


def _fit_protrusion(
    make: Callable[[float, Array], SpikeOsteophyte],
    direction: Array,
    margin_mm: float,
    size_mm: float,
    deform: Deformation,
) -> SpikeOsteophyte:
    """Adjust a spike until its farthest point protrudes by its size beyond the bone without osteophytes.

    The bone and the spike are compared after deformation. The protrusion is measured along `direction` (3,);
    `margin_mm` is the extent of the deformed bone in this direction.
    """
    stands_mm, out = size_mm, direction
    for _ in range(_TURNS):
        shape = make(stands_mm, out)
        near = shape.farthest_point + np.vstack((np.zeros(3), _STEP_MM * np.eye(3)))
        reach = deform(near) @ direction
        # Finite-difference gradient of the deformed coordinate along `direction`. At the farthest point of the sphere
        # at the tip, the surface normal is parallel to this gradient.
        slope = reach[1:] - reach[0]
        out = slope / np.linalg.norm(slope)
        stands_mm += size_mm - (float(reach[0]) - margin_mm)
    return make(stands_mm, out)


@kernel()
def _fill_cone_distances(away: Array, points: Array, feet: Array, tips: Array, foot_mm: float, tip_mm: float) -> None:
    """Write the approximate distances (n,) of points (n, 3) from the nearest cone into `away`, in mm."""
    for i in range(len(points)):
        # The distances are not blended, because blended cones would be too thick where they meet at the tip.
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


def _build_ball(centre_mm: Array, radius_mm: float) -> Manifold:
    """Build a sphere with its centre at a point (3,), in mm."""
    return Manifold.sphere(radius_mm, 32).translate(centre_mm)
