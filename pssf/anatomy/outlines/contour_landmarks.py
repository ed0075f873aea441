"""Sixteen contour landmarks on the projected cortical contours of femur and tibia.

Order and names follow the annotations of Tiulpin et al. 2019 (KNEEL, arXiv 1907.12237). The landmarks follow the upper
contour of the tibia and the lower contour of the femur, each from lateral to medial. As on patient radiographs,
osteophytes belong to the contour. All distances are measured on the detector in mm from its centre. Pixel size, image
size and the side of the knee therefore do not affect the result.

``*_edge``
    Point at which an oblique line touches the tibia from above or the femur from below. The line is at 30 degrees to
    the horizontal for both edges of the tibia, at 50 degrees for the lateral edge of the femur, and at 40 degrees for
    its medial edge. Among angles from 25 to 65 degrees, these two agree best with the annotations.

    The edge of the tibia is the same place of the bone in every view: it is near the point that is touched if the rims
    of the medial plateau are superimposed. On the whole contour, it would jump from the margin to a rim when the beam
    angle changes.
``*_spine``
    Highest peak of the contour on each side of the centre of the plateau. A peak rises above its surroundings by at
    least 0.5 mm; without a peak, it is the highest point. On a tilted plateau, the highest point may be at the centre.
``between_spines``
    Point on the contour at a fixed fraction of the distance along x from the lateral to the medial spine, as in the
    annotations. The lowest point would be 1.1 mm further lateral, with twice the variation of the annotations.
``tibia_*_1``, ``tibia_*_2``
    Points at fixed fractions of the distance from edge to spine, as in the annotations. The lateral points are on the
    contour, and the medial points are on the floor of the plateau.
``femur_*_notch``
    Point at which the contour has risen by a fixed fraction of the height from the condyle to the highest point of the
    notch: 0.39 laterally and 0.38 medially. The highest point is searched for within the central quarter of the femoral
    width.
``notch_top``
    Point on the contour halfway along x between the lateral and the medial notch point. In each KL grade, the mean of
    the annotations is within 0.3 mm of this position. The roof of the notch is flat, so that its highest point varies.
``femur_*_condyle``
    Point on the contour halfway along x between edge and notch.

The floor of the plateau is the lowest point within the central half of its antero-posterior depth. The medial plateau
is concave. On the outlines of real bones (Clouthier et al. 2019), its rims are about 4 mm higher than the annotated
points. The lateral outline of sampled knees agrees with the two annotated lateral points within 0.2 mm and has the same
variation. The lateral floor would be 2 mm lower than the lateral outline at point 2.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from ...core.checks import Array
from ...core.label_names import CONTOUR_LANDMARKS
from ...geometry.mesh import Indices, Mesh
from ...geometry.view import View, project_points
from ..meshing.solids import find_crossing_sides
from .projected_contours import compute_outline_rows, rotate_px

# Positions of points 1 and 2 along x as fractions of the distance from edge to spine. The fractions are means of the
# annotations of 150 knees with KL grade 0 (Tiulpin et al. 2019).
_EDGE_TO_SPINE_FRACTIONS = {"lateral": (0.356, 0.709), "medial": (0.392, 0.779)}
# Search range for a spine on each side of the plateau centre, as a fraction of the plateau width.
_SPINE_SEARCH_FRACTION = 0.22
# Least height of a spine above its surroundings in the search range, in mm (assumed).
_PEAK_PROMINENCE_MM = 0.5
# Position of the point between the spines along x, as a fraction of the distance from the lateral to the medial spine:
# mean of the annotations over five KL grades (0.465 to 0.492; Tiulpin et al. 2019).
_BETWEEN_SPINES_FRACTION = 0.475
# Search range for the notch top on each side of the femoral centre, as a fraction of the femoral width.
_NOTCH_REACH = 0.125
# Heights of the lateral and medial notch points above the condyle, as fractions of the height of the notch top above
# the condyle. For 80 sampled knees with KL grades 0 to 4, the RMS distance between the mean positions of a grade and
# those of the annotations (Tiulpin et al. 2019), over the five landmarks that depend on them, is 0.75 mm. With the mean
# heights of the annotations, 0.355 and 0.404, it would be 0.94 mm.
_NOTCH_RISES = (0.39, 0.38)
# Angles between the horizontal and the tangents that touch a bone at its lateral and medial edge, in degrees. For the
# tibia, angles from 25 to 45 degrees were tested on the bones of 50 subjects (Clouthier et al. 2019) in fixed flexion.
# The edge heights deviate from annotated landmarks by 1.2 SD at 45 degrees and by 0.9 SD at 30 degrees. Angles below 30
# degrees reduce the deviation only slightly and fail for some bones. For the femur, angles from 25 to 65 degrees were
# tested on 100 sampled knees with KL grades 0 to 4. The RMS distance between the mean positions of a grade and those of
# the annotations is 0.8 mm (50 degrees, lateral) and 1.1 mm (40 degrees, medial); at 30 degrees, it is 1.6 and 1.3 mm.
_TIBIAL_TANGENTS_DEG = (30.0, 30.0)
_FEMORAL_TANGENTS_DEG = (50.0, 40.0)
# Largest depth of plateau points below the line through the medial and lateral edges, as a fraction of the plateau
# width; lower points are not part of the plateau. With a fraction of 0.08, the slope anterior to the spines would count
# as floor (bones of Clouthier et al. 2019).
_PLATEAU_UNDER = 0.04
# Height of the part of the tibia that contains the rims of the plateau, from the top of the spines downwards, as a
# fraction of the width of the tibia. The tuberosity is below it.
_PLATEAU_HEIGHT = 0.25
# Number of steps in which the slope of the plateau is approached; four change it by less than 1e-6.
_SLOPE_STEPS = 6
# Semi-axes of the ellipsoid that contains the edge of the plateau in every view, around the point that is touched if
# the rims are superimposed: mediolateral, anteroposterior and along the leg, in mm. In fixed flexion, the edges of 24
# sampled knees with KL grades 1 to 4 are those of the whole contour. When the beam angle of the view ap_standing is
# changed by one degree, an edge moves by at most 0.4 mm; the point of the whole contour moves by up to 4.6 mm.
_EDGE_REACH_MM = (3.0, 8.0, 3.0)
# Anteroposterior range of the search for the plateau floor, as fractions of the anteroposterior plateau depth.
_MIDDLE = (0.25, 0.75)
# All points down to this distance below the top of a section belong to the plateau, in mm.
_MIN_SECTION_DEPTH_MM = 2.0
# Distance between the points of a contour, along x on the detector or along the beam in a section, in mm. The contour
# is exact at each point.
_STEP_MM = 0.05


@dataclass(frozen=True, eq=False)
class _Contour:
    """Outline of a bone on the detector, or outline of a sagittal section.

    `x_mm` and `y_mm`, both (n,), are the coordinates of points at equal steps in x. On the detector, x is the medial
    and y the proximal direction, in mm from the detector centre. In a section, x is the depth along the beam.
    """

    x_mm: Array
    y_mm: Array

    def find_nearest_point(self, x_mm: float) -> tuple[float, float]:
        """Return the contour point whose x is nearest to `x_mm`, in mm."""
        return self._place(int(np.abs(self.x_mm - x_mm).argmin()))

    def crop_between(self, first_mm: float, last_mm: float) -> "_Contour":
        """Return the contour between two values of x, in mm; the values may be in either order."""
        low, high = sorted((first_mm, last_mm))
        part = (self.x_mm >= low) & (self.x_mm <= high)
        return _Contour(self.x_mm[part], self.y_mm[part])

    def find_highest_point(self) -> tuple[float, float]:
        """Return the contour point with the largest y, in mm."""
        return self._place(int(self.y_mm.argmax()))

    def find_highest_peak(self) -> tuple[float, float]:
        """Return the peak with the largest y, or else the point with the largest y, in mm."""
        peaks, _ = signal.find_peaks(self.y_mm, prominence=_PEAK_PROMINENCE_MM)
        return self._place(int(peaks[self.y_mm[peaks].argmax()])) if len(peaks) else self.find_highest_point()

    def find_lowest_point(self) -> tuple[float, float]:
        """Return the contour point with the smallest y, in mm."""
        return self._place(int(self.y_mm.argmin()))

    def _place(self, index: int) -> tuple[float, float]:
        """Return the coordinates of the contour point at an index, in mm."""
        return float(self.x_mm[index]), float(self.y_mm[index])


def find_contour_landmarks(
    femur: Mesh, tibia: Mesh, view: View, medial_sign: int, lean_deg: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Find the sixteen contour landmarks on a radiograph.

    Parameters
    ----------
    femur : Mesh
        Outer surface of the femur in the knee frame, in mm.
    tibia : Mesh
        Outer surface of the tibia in the knee frame, in mm.
    view : View
        Source and detector.
    medial_sign : int
        +1 if the medial side is towards +x (a right knee), else -1.
    lean_deg : float, default 0.0
        Lean of the leg in the image, in degrees, clockwise positive. Landmarks refer to the axes of the leg.

    Returns
    -------
    dict of str to tuple of float
        Row and column of each landmark, in pixels.
    """
    tibial = _find_tibial_landmarks(
        _project_upright_mm(tibia.vertices, view, medial_sign, lean_deg), tibia, medial_sign
    )
    femoral = _find_femoral_landmarks(
        _project_upright_mm(femur.vertices, view, medial_sign, lean_deg), _list_triangle_sides(femur)
    )
    places = _convert_to_px(tibial + femoral, view, medial_sign, lean_deg)
    return {name: (float(row), float(col)) for name, (row, col) in zip(CONTOUR_LANDMARKS, places, strict=True)}


def find_plateau_floor(tibia: Mesh, view: View, medial_sign: int, lean_deg: float = 0.0) -> Array:
    """Find the nine tibial landmarks as a polyline that follows the floor of the medial plateau.

    Parameters
    ----------
    tibia : Mesh
        Outer surface of the tibia in the knee frame, in mm.
    view : View
        Source and detector.
    medial_sign : int
        +1 if the medial side is towards +x (a right knee), else -1.
    lean_deg : float, default 0.0
        Lean of the leg in the image, in degrees, clockwise positive.

    Returns
    -------
    (9, 2) float64 array
        Row and column of the nine tibial landmarks, in pixels, in the order of increasing columns.
    """
    tibial = _find_tibial_landmarks(
        _project_upright_mm(tibia.vertices, view, medial_sign, lean_deg), tibia, medial_sign
    )
    return _convert_to_px(tibial, view, medial_sign, lean_deg)[::medial_sign]


def _convert_to_px(places_mm: list[tuple[float, float]], view: View, medial_sign: int, lean_deg: float) -> Array:
    """Convert points returned by `_project_upright_mm` to rows and columns (n, 2), in pixels."""
    rows, cols = (view.rows - 1) / 2, (view.cols - 1) / 2
    upright = [(rows - y / view.pixel_mm, cols + medial_sign * x / view.pixel_mm) for x, y in places_mm]
    return rotate_px(np.array(upright), view, lean_deg)


def _project_upright_mm(vertices: Array, view: View, medial_sign: int, lean_deg: float) -> Array:
    """Project vertices (n, 3) onto the detector and remove the lean of the leg.

    The columns of the result (n, 2) are x towards medial and y towards proximal, in mm from the detector centre.
    """
    seen = rotate_px(project_points(vertices, view), view, -lean_deg)
    x = (seen[:, 1] - (view.cols - 1) / 2) * view.pixel_mm * medial_sign
    return np.column_stack((x, ((view.rows - 1) / 2 - seen[:, 0]) * view.pixel_mm))


def _list_triangle_sides(mesh: Mesh) -> Indices:
    """List the edges (3 m, 2) of all triangles. Duplicates remain, because removing them would take longer."""
    return mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def _trace_contour(points_mm: Array, sides: Indices, ends_mm: tuple[float, float], outline_sign: float) -> _Contour:
    """Trace the lower (+1) or upper (-1) outline of points (n, 2) between two values of x, in mm."""
    first, last = np.ceil(ends_mm[0] / _STEP_MM), np.floor(ends_mm[1] / _STEP_MM)
    places = np.arange(first, last + 1)
    rows = compute_outline_rows(
        points_mm[:, ::-1] / (-_STEP_MM, _STEP_MM), sides, int(first), len(places), outline_sign
    )
    return _Contour(places * _STEP_MM, -rows * _STEP_MM)


def _find_edges(points_mm: Array, touch_sign: float, tangents_deg: tuple[float, float]) -> list[tuple[float, float]]:
    """Find the lateral and medial points at which oblique lines touch a bone from above (+1) or below (-1)."""
    touched = [
        _find_touched(points_mm, touch_sign, out, turn) for out, turn in zip((-1.0, 1.0), tangents_deg, strict=True)
    ]
    return [(float(points_mm[k, 0]), float(points_mm[k, 1])) for k in touched]


def _find_touched(points_mm: Array, touch_sign: float, out: float, tangent_deg: float) -> int:
    """Return the index of the point that an oblique line touches on the lateral (`out` -1) or medial (+1) side."""
    turn = np.deg2rad(tangent_deg)
    return int((points_mm @ (out * np.sin(turn), touch_sign * np.cos(turn))).argmax())


def _find_tibial_landmarks(points_mm: Array, tibia: Mesh, medial_sign: int) -> list[tuple[float, float]]:
    """Find the nine tibial landmarks in the order of `TIBIAL_LANDMARKS`, in mm."""
    lateral, medial = _find_plateau_edges(points_mm, tibia, medial_sign)
    contour = _trace_contour(points_mm, _list_triangle_sides(tibia), (lateral[0], medial[0]), -1.0)
    middle, width = (lateral[0] + medial[0]) / 2, medial[0] - lateral[0]
    spines = [
        contour.crop_between(middle, middle + out * _SPINE_SEARCH_FRACTION * width).find_highest_peak()
        for out in (-1.0, 1.0)
    ]
    ways = {
        side: [edge[0] + share * (spine[0] - edge[0]) for share in _EDGE_TO_SPINE_FRACTIONS[side]]
        for side, edge, spine in (("lateral", lateral, spines[0]), ("medial", medial, spines[1]))
    }
    floors = []
    for x in ways["medial"]:
        line = lateral[1] + (x - lateral[0]) / width * (medial[1] - lateral[1])
        floors.append((x, _find_floor_height_mm(_cut_section(points_mm, tibia, x), line - _PLATEAU_UNDER * width)))
    tops = [contour.find_nearest_point(x) for x in ways["lateral"]]
    valley = contour.find_nearest_point(spines[0][0] + _BETWEEN_SPINES_FRACTION * (spines[1][0] - spines[0][0]))
    return [lateral, *tops, spines[0], valley, spines[1], *floors[::-1], medial]


def _find_plateau_edges(points_mm: Array, tibia: Mesh, medial_sign: int) -> list[tuple[float, float]]:
    """Find the lateral and medial edge of the tibia near the points that they have if the rims are superimposed.

    Along an oblique beam, a rim of the plateau may be higher than the edge, and the tangent would touch the rim.
    """
    side, depth, height = (tibia.vertices * (medial_sign, 1.0, 1.0)).T
    aligned = np.column_stack((side, height - _measure_plateau_slope(side, depth, height) * depth))
    edges = []
    for out, turn in zip((-1.0, 1.0), _TIBIAL_TANGENTS_DEG, strict=True):
        centre = tibia.vertices[_find_touched(aligned, +1.0, out, turn)]
        near = points_mm[np.linalg.norm((tibia.vertices - centre) / _EDGE_REACH_MM, axis=1) < 1.0]
        x, y = near[_find_touched(near, +1.0, out, turn)]
        edges.append((float(x), float(y)))
    return edges


def _measure_plateau_slope(side: Array, depth: Array, height: Array) -> float:
    """Return the slope (height over depth) along which the rims of the medial plateau are superimposed.

    `side`, `depth` and `height` (n,) are the coordinates of the tibia in mm; `side` increases towards medial.
    """
    rims = (side > side.max() / 3) & (height > height.max() - _PLATEAU_HEIGHT * np.ptp(side))
    depths, heights = depth[rims], height[rims]
    front, rear = (depths.min() + share * np.ptp(depths) for share in _MIDDLE)
    slope = 0.0
    for _ in range(_SLOPE_STEPS):
        level = heights - slope * depths
        first, last = (np.where(part, level, -np.inf).argmax() for part in (depths < front, depths > rear))
        slope += (level[last] - level[first]) / (depths[last] - depths[first])
    return float(slope)


def _cut_section(points_mm: Array, tibia: Mesh, x_mm: float) -> _Contour:
    """Cut the tibia at the projected position `x_mm` and return the upper outline of the section.

    The outline is the height on the detector as a function of depth along the beam, in mm.
    """
    starts, ends, share = find_crossing_sides(points_mm[:, 0], tibia.faces, x_mm)
    both = np.column_stack((tibia.vertices[:, 1], points_mm[:, 1]))
    points = both[starts] + share[:, None] * (both[ends] - both[starts])
    # Two edges of each triangle intersect the plane. The segment between the two intersection points belongs to the
    # section.
    return _trace_contour(points, np.arange(len(points)).reshape(-1, 2), (points[:, 0].min(), points[:, 0].max()), -1.0)


def _find_floor_height_mm(section: _Contour, above_mm: float) -> float:
    """Return the lowest height in the central half of a section, ignoring points below the height `above_mm`, in mm."""
    depths = section.x_mm[section.y_mm > min(above_mm, section.y_mm.max() - _MIN_SECTION_DEPTH_MM)]
    low, high = (depths.min() + share * np.ptp(depths) for share in _MIDDLE)
    return section.crop_between(low, high).find_lowest_point()[1]


def _find_femoral_landmarks(points_mm: Array, sides: Indices) -> list[tuple[float, float]]:
    """Find the seven femoral landmarks in the order of `FEMORAL_LANDMARKS`, in mm."""
    lateral, medial = _find_edges(points_mm, -1.0, _FEMORAL_TANGENTS_DEG)
    contour = _trace_contour(points_mm, sides, (lateral[0], medial[0]), +1.0)
    middle, reach = (lateral[0] + medial[0]) / 2, _NOTCH_REACH * (medial[0] - lateral[0])
    top = contour.crop_between(middle - reach, middle + reach).find_highest_point()
    by_side = []
    for edge, rise in zip((lateral, medial), _NOTCH_RISES, strict=True):
        low = contour.crop_between(edge[0], top[0]).find_lowest_point()
        wall = contour.crop_between(low[0], top[0])
        risen = wall.x_mm[wall.y_mm >= low[1] + rise * (top[1] - low[1])]
        # The notch landmark is the first point from the condyle towards the notch that exceeds the specified height.
        notch = wall.find_nearest_point(risen[np.abs(risen - edge[0]).argmin()])
        by_side.append([edge, contour.find_nearest_point((edge[0] + notch[0]) / 2), notch])
    middle_of_notch = contour.find_nearest_point((by_side[0][-1][0] + by_side[1][-1][0]) / 2)
    return [*by_side[0], middle_of_notch, *by_side[1][::-1]]
