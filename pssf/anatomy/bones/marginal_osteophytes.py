"""Marginal osteophytes: tapered bone profiles swept along the joint margin."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Manifold
from numpy.polynomial.polynomial import polyfit, polyval
from numpy.typing import NDArray

from ...core.checks import Array
from ...data.anatomy.bone_tables import MarginalOsteophyteShape, OsteophyteMargin
from ...model.knee import Osteophyte
from ..meshing.implicit_shapes import ScalarField, smooth_intersection
from ..meshing.solids import extract_mesh, loft
from ..template.template_bone import TemplateBone

# A deformation maps points (n, 3), in mm, to deformed points (n, 3), in mm.
Deformation = Callable[[Array], Array]
# Points per cross-section of an osteophyte.
_AROUND = 24
# Distance between two cross-sections, mm.
_SECTION_MM = 1.2
# Number of positions along the joint margin at which the outline of the bone is sampled.
_STATIONS = 9
# Distance of the outermost sampled positions from the centre of the joint margin, in mm.
_FARTHEST_MM = 13.0
# Distance of the sampled joint surface from the margin, in the inward direction, in mm.
_INWARD_MM = 5.0
# Depth below the joint surface at which the margin is sampled, in mm.
_UNDER_MM = 3.0
# Start and end of the lines along which the bone surface is searched for, in mm.
_WAYS_MM = (-12.0, 12.0)
# Number of samples along each line on which the bone surface is searched for.
_SAMPLES = 49
# The centre of the margin is the mean of all points within this distance of the farthest margin point, in mm.
_MARGIN_TOLERANCE_MM = 0.3
# Rounding radius of both ends of an osteophyte, in mm. Most ends are inside the bone.
_END_ROUNDING_MM = 1.0
# Distance from the profile of an osteophyte beyond which the bone is unchanged, mm.
_INFLUENCE_MM = 4.0
# Smallest number of valid positions for the fit of a parabola.
_FEWEST = 4
# Depth of both ends of an osteophyte below the bone surface, in mm. The fillet radius is added to it.
_SUNK_MM = 0.3
# Largest number of iterations that find the farthest point and move it to the specified protrusion.
_TURNS = 60
# Tolerance of the protrusion, mm.
_SETTLED_MM = 1e-9
# Tolerance of the location of the farthest point: mm along the edge and rad around the edge.
_STILL = 1e-4
# Finite-difference steps of the location of the farthest point: mm along the edge and rad around the edge.
_STEPS = (0.02, 0.02)
# Largest change of the location of the farthest point per iteration: mm along the edge and rad around the edge.
_MOST = (2.0, 0.3)
# Largest angle between the farthest point and the outward direction, around the edge, in rad.
_WIDEST = 1.2
# Finite-difference step for the surface normal, mm.
_STEP_MM = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class LipOsteophyte:
    """Marginal osteophyte: a tapered profile swept along an edge that follows the outline of the bone.

    After deformation, its farthest point protrudes by the size of the osteophyte.

    Attributes
    ----------
    origin : (3,) float64 array
        Origin of the local coordinates, at the height of the margin, in mm.
    axes : (3, 3) float64 array
        Unit vectors of the local coordinates, in rows: along the margin, outwards, towards the joint.
    edge_polynomial : (3,) float64 array
        Polynomial (powers 0 to 2) of the position along the margin that gives the outward position of the edge, in mm.
    rise_polynomial : (3,) float64 array
        Polynomial (powers 0 to 2) of the position along the margin that gives the position of the edge towards the
        joint, in mm.
    half_length_mm : float
        Distance from the centre of the osteophyte to either end, in mm. Both ends are inside the bone.
    size_mm : float
        Size of the osteophyte at template size, in mm.
    edge_mm : float
        Radius of the rounded edge, in mm.
    base_mm : float
        Radius of the base of the profile, in mm.
    long_mm : float
        Distance from the edge inwards to the centre of the base, in mm.
    tip_above_foot_mm : float
        Height of the tip above the base, in mm. It is 0 unless the tip is above the joint surface. It is at most the
        size of the osteophyte, so the flank stays clear of the bone.
    bend_tangent : float
        Tangent of the angle by which the profile curves towards the joint, dimensionless.
    farthest_coordinates : (2,) float64 array
        Position of the farthest point: distance along the margin, in mm, and angle around the edge, in rad.
    direction : (3,) float64 array
        Unit normal of the surface at the farthest point.
    """

    origin: Array
    axes: Array
    edge_polynomial: Array
    rise_polynomial: Array
    half_length_mm: float
    size_mm: float
    edge_mm: float
    base_mm: float
    long_mm: float
    tip_above_foot_mm: float
    bend_tangent: float
    farthest_coordinates: Array
    direction: Array

    @property
    def farthest_point(self) -> Array:
        """Farthest point of the osteophyte (3,), in mm."""
        return np.asarray(self.compute_surface_points(self.farthest_coordinates[None])[0])

    @property
    def tip(self) -> Array:
        """Centre of curvature (3,) of the rounded edge at the farthest point, in mm."""
        return self.farthest_point - self.edge_mm * self.direction

    @property
    def fillet_mm(self) -> float:
        """Radius of the fillet between osteophyte and bone, in mm.

        The radius is below the size, so the fillet does not move the tip.
        """
        return fillet_radius_mm(self.size_mm)

    def compute_surface_points(self, spots: Array) -> Array:
        """Compute points on the rounded edge.

        Parameters
        ----------
        spots : (n, 2) float64 array, mm and rad
            Distance along the margin, in mm, and angle around the edge, in rad.

        Returns
        -------
        (n, 3) float64 array
            Points in the frame of the bone, in mm.
        """
        along, angle = spots.T
        outward, up = self.edge_mm * (np.cos(angle) - 1), self.edge_mm * np.sin(angle)
        out = polyval(along, self.edge_polynomial) + outward * self._stretch_factor(along)
        local = np.column_stack(
            (along, out, polyval(along, self.rise_polynomial) + up + self._compute_bend_mm(outward))
        )
        return np.asarray(self.origin + local @ self.axes)

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
        along, out, up = self._convert_to_local(points)
        wide = self.base_mm + _INFLUENCE_MM
        deep, high = -self.long_mm - wide, self.bend_tangent * self.size_mm / 2
        within = (np.abs(along) < self.half_length_mm + _INFLUENCE_MM) & (out > deep) & (out < _INFLUENCE_MM)
        low = min(high, 0.0) - self.tip_above_foot_mm
        return np.asarray(within & (up < wide + max(high, 0.0)) & (up > -2 * wide + low))

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
        along, out, up = self._convert_to_local(points)
        up = up - self._compute_bend_mm(out)
        (foot, foot_mm), (tip, tip_mm) = self._place_profile_balls(0.0)
        axis = tip - foot
        away_out, away_up = out - foot[0], up - foot[1]
        share = np.clip((away_out * axis[0] + away_up * axis[1]) / (axis @ axis), 0.0, 1.0)
        away = np.hypot(away_out - share * axis[0], away_up - share * axis[1])
        profile = away - foot_mm - share * (tip_mm - foot_mm)
        return smooth_intersection(profile, np.abs(along) - self.half_length_mm, _END_ROUNDING_MM)

    def build_solid(self, inset_mm: float) -> Manifold:
        """Build the osteophyte as a loft through its cross-sections, with its surface moved inwards by an inset.

        Parameters
        ----------
        inset_mm : float
            Distance by which the surface is moved inwards, in mm. The inset removes the entire edge of a small
            osteophyte.

        Returns
        -------
        Manifold
            Solid in the frame of the bone, in mm.

        Raises
        ------
        InputError
            If the loft is not a valid solid.
        """
        count = int(np.ceil(2 * self.half_length_mm / _SECTION_MM)) + 1
        along = np.linspace(-self.half_length_mm, self.half_length_mm, count)
        turn = np.arange(_AROUND) * (2 * np.pi / _AROUND)
        ways = np.column_stack((np.cos(turn), np.sin(turn)))
        # The profile is the convex hull of two circles. Its point in each direction is on the circle that extends
        # farther in this direction.
        reach = np.array([ways @ centre + radius for centre, radius in self._place_profile_balls(inset_mm)])
        each = np.array([centre + radius * ways for centre, radius in self._place_profile_balls(inset_mm)])
        section = np.where((reach[0] > reach[1])[:, None], each[0], each[1])
        section[:, 1] += self._compute_bend_mm(section[:, 0])
        rings = np.empty((count, _AROUND, 3))
        rings[..., 0] = (
            section[:, 0] * self._stretch_factor(along)[:, None] + polyval(along, self.edge_polynomial)[:, None]
        )
        rings[..., 1] = section[:, 1] + polyval(along, self.rise_polynomial)[:, None]
        rings[..., 2] = along[:, None]
        sideways, out, up = self.axes
        return loft(rings, "osteophyte").transform(np.column_stack((out, up, sideways, self.origin)))

    def _convert_to_local(self, points: Array) -> tuple[Array, Array, Array]:
        """Convert points (n, 3), mm, to local coordinates (n,) along the margin, outwards and towards the joint.

        The coordinates outwards and towards the joint are measured from the edge, in mm.
        """
        along, out, up = ((points - self.origin) @ self.axes.T).T
        return (
            along,
            (out - polyval(along, self.edge_polynomial)) / self._stretch_factor(along),
            up - polyval(along, self.rise_polynomial),
        )

    def _stretch_factor(self, along: Array) -> Array:
        """Compute the stretch factors (n,) of outward distances.

        A factor exceeds 1 where the edge is oblique to the outward axis.
        """
        return np.asarray(np.hypot(1.0, polyval(along, [self.edge_polynomial[1], 2 * self.edge_polynomial[2]])))

    def _compute_bend_mm(self, out: Array) -> Array:
        """Compute the shift (n,) of the profile towards the joint, mm, at outward distances (n,) from the edge, mm."""
        return np.asarray(self.bend_tangent * np.maximum(out + self.size_mm, 0.0) ** 2 / (2 * self.size_mm))

    def _place_profile_balls(self, inset_mm: float) -> tuple[tuple[Array, float], tuple[Array, float]]:
        """Return the centres and radii of the base circle and the tip circle of the profile, in mm.

        Each centre (2,) contains the distances from the edge in the outward direction and towards the joint.
        """
        tip_mm = max(self.edge_mm - inset_mm, 0.1)
        back = max(0.0, inset_mm - (self.edge_mm - tip_mm))
        foot = np.array([-self.long_mm, self.edge_mm - self.base_mm - self.tip_above_foot_mm])
        tip = np.array([-self.edge_mm, 0.0])
        tip = tip + back * (foot - tip) / np.hypot(*(foot - tip))
        return (foot, self.base_mm - inset_mm), (tip, tip_mm)


def build_lip_osteophyte(
    osteophyte: Osteophyte,
    size_mm: float,
    template: TemplateBone,
    tables: tuple[OsteophyteMargin, MarginalOsteophyteShape],
    deform: Deformation,
) -> LipOsteophyte:
    """Build a marginal osteophyte on a template bone.

    Parameters
    ----------
    osteophyte : Osteophyte
        Site, position along the margin and curvature.
    size_mm : float
        Size of the osteophyte at template size, in mm.
    template : TemplateBone
        Template bone.
    tables : (OsteophyteMargin, MarginalOsteophyteShape)
        Dimensions of the joint margin of this bone, and dimensions of marginal osteophytes.
    deform : callable
        Deformation that is later applied to the bone. It maps points (n, 3), in mm, to points (n, 3), in mm. The
        osteophyte has the specified size after this deformation.

    Returns
    -------
    LipOsteophyte
        Osteophyte in the frame of the template bone.
    """
    margin, form = tables
    side = 1.0 if osteophyte.site.startswith("medial") else -1.0
    turn = np.deg2rad(osteophyte.place * form.turn_deg)
    way = np.array([side * np.cos(turn), np.sin(turn), 0.0])
    up = np.array([0.0, 0.0, margin.joint])
    axes = np.array([np.cross(up, way), way, up])
    points = extract_mesh(template.outer).vertices
    band = points[(points[:, 2] >= margin.band_z[0]) & (points[:, 2] <= margin.band_z[1])]
    reach = deform(band) @ way
    origin = band[reach > reach.max() - _MARGIN_TOLERANCE_MM].mean(axis=0)
    origin[2] = margin.at_z
    outline, rise = _fit_outline(template.field, origin, axes)
    edge_mm = form.edge_mm[0] + form.edge_mm[1] * size_mm
    drop_mm = margin.medial_drop_mm if side > 0 else margin.lateral_drop_mm
    under_mm = drop_mm[0] + drop_mm[1] * size_mm
    rise -= [under_mm + edge_mm, 0.0, 0.0]
    sunk_mm = fillet_radius_mm(size_mm) + _SUNK_MM
    long_mm = min(form.long_mm[0] + form.long_mm[1] * size_mm, form.longest_mm)
    half_mm = long_mm / 2 * np.sqrt((size_mm + sunk_mm) / size_mm)
    over_mm = min(max(0.0, -under_mm), size_mm)
    base_mm = (min(form.base_mm[0] + form.base_mm[1] * size_mm, form.highest_mm) - over_mm) / 2
    lip = LipOsteophyte(
        origin=origin,
        axes=axes,
        edge_polynomial=outline - [0.0, 0.0, (size_mm + sunk_mm) / half_mm**2],
        rise_polynomial=rise,
        half_length_mm=half_mm,
        size_mm=size_mm,
        edge_mm=edge_mm,
        base_mm=base_mm,
        long_mm=base_mm + (1 - form.bulge) * size_mm,
        tip_above_foot_mm=over_mm,
        bend_tangent=float(np.tan(np.deg2rad(osteophyte.curve_deg))),
        farthest_coordinates=np.zeros(2),
        direction=way,
    )
    return _fit_protrusion(lip, way, float(reach.max()), deform)


def _fit_outline(field: ScalarField, origin: Array, axes: Array) -> tuple[Array, Array]:
    """Fit polynomials to the outward edge and to the height of the joint surface of a bone, along its margin.

    Each polynomial has shape (3,).

    `origin` (3,) and `axes` (3, 3) are the attributes `origin` and `axes` of `LipOsteophyte`.
    """
    along = np.linspace(-_FARTHEST_MM, _FARTHEST_MM, _STATIONS)
    ways = np.linspace(*_WAYS_MM, _SAMPLES)
    inside = origin - _INWARD_MM * axes[1] + along[:, None] * axes[0]
    rise = _fit_parabola(along, _find_bone_edge_mm(field, inside, axes[2], ways))
    under = inside + (polyval(along, rise) - _UNDER_MM)[:, None] * axes[2]
    return _fit_parabola(along, _find_bone_edge_mm(field, under, axes[1], ways)) - [_INWARD_MM, 0.0, 0.0], rise


def _find_bone_edge_mm(field: ScalarField, starts: Array, direction: Array, distances_mm: Array) -> Array:
    """Find the distances (n,) from the starting points (n, 3), along a direction, at which lines leave the bone, in mm.

    The distance is nan where a line does not leave the bone.
    """
    places = starts[:, None] + distances_mm[:, None] * direction
    values = field(places.reshape(-1, 3)).reshape(len(starts), -1)
    leaves = (values[:, :-1] < 0) & (values[:, 1:] >= 0)
    last = leaves.shape[1] - 1 - leaves[:, ::-1].argmax(axis=1)
    each = np.arange(len(starts))
    before, after = values[each, last], values[each, last + 1]
    share = before / np.where(before == after, 1.0, before - after)
    return np.where(leaves.any(axis=1), distances_mm[last] + share * (distances_mm[1] - distances_mm[0]), np.nan)


def _fit_parabola(along: Array, values: Array) -> Array:
    """Fit a parabola (3,) to the values (n,) along the margin, ignoring nan.

    If too few values remain, the result is a constant.
    """
    there = ~np.isnan(values)
    if there.sum() < _FEWEST:
        return np.array([np.nanmean(values) if there.any() else 0.0, 0.0, 0.0])
    return np.asarray(polyfit(along[there], values[there], 2))


def _fit_protrusion(lip: LipOsteophyte, direction: Array, margin_mm: float, deform: Deformation) -> LipOsteophyte:
    """Adjust an osteophyte until its farthest point protrudes by its size beyond the bone without osteophytes.

    The bone and the osteophyte are compared after deformation. The protrusion is measured along `direction` (3,).
    Newton's method finds the farthest point.
    """
    steps = np.array(_STEPS)
    around = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)]) * steps
    most = np.array([lip.half_length_mm / 2, _WIDEST])
    for _ in range(_TURNS):
        reach = deform(lip.compute_surface_points(lip.farthest_coordinates + around)) @ direction
        slope = np.array([reach[1] - reach[2], reach[3] - reach[4]]) / (2 * steps)
        bend = np.array([reach[1] + reach[2], reach[3] + reach[4]]) - 2 * reach[0]
        mixed = (reach[5] + reach[6] - reach[1:5].sum() + 2 * reach[0]) / 2
        curved = np.array([[bend[0], mixed], [mixed, bend[1]]]) / np.outer(steps, steps)
        # Newton's method converges only near a maximum, so a gradient step is made where the surface is not concave.
        dome = bend.max() < 0 and np.linalg.det(curved) > 0
        step = -np.linalg.solve(curved, slope) if dome else slope
        step = np.clip(step, -np.array(_MOST), _MOST)
        spot = np.clip(lip.farthest_coordinates + step, -most, most)
        short_mm = lip.size_mm - (float(reach[0]) - margin_mm)
        if abs(short_mm) < _SETTLED_MM and np.abs(spot - lip.farthest_coordinates).max() < _STILL:
            break
        lip = replace(
            lip, farthest_coordinates=spot, edge_polynomial=lip.edge_polynomial + np.array([short_mm, 0.0, 0.0])
        )
    near = lip.farthest_point + np.vstack((np.zeros(3), _STEP_MM * np.eye(3)))
    normal = deform(near) @ direction
    out = normal[1:] - normal[0]
    return replace(lip, direction=out / np.linalg.norm(out))


def fillet_radius_mm(size_mm: float) -> float:
    """Compute the radius of the fillet between a bone and a marginal osteophyte.

    Parameters
    ----------
    size_mm : float
        Size of the osteophyte, in mm.

    Returns
    -------
    float
        Radius in mm: 0.8 of the size, at most 2.5 mm.
    """
    return min(2.5, 0.8 * size_mm)
