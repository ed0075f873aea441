"""The sixteen contour landmarks of a knee film, placed on the projected cortical contours as an annotator places them.

Order and names are those of the annotations of Tiulpin et al. 2019 (KNEEL, arXiv 1907.12237): along the tibia's upper
contour and along the femur's lower one, each from lateral to medial. Osteophytes belong to the contour, as they do on a
person's film. All is measured on the detector in millimetres from its centre, so that size and number of pixels, and
the side of the knee, change nothing.

edges           where a line at 30 degrees to the horizontal touches the tibia from above, or the femur from below
spines          the contour's highest places on either side of the plateau's middle
between_spines  the lowest place between them
1, 2            at the shares of the way from edge to spine at which annotators put them: on the contour of the lateral
                plateau, whose middle is its crown; on the floor of the medial one
notch_top       the highest place of the femur's lower contour within the middle quarter of its width
notch           (femur_*_notch) where the contour has risen from condyle to notch top by the share of that way at which
                annotators put it, mean of five grades: .355 (.347 to .363) laterally, .404 (.386 to .422) medially
condyle         on the contour, half way across from edge to notch

The floor is the lowest place of the middle half of the plateau's depth, front to back. Along the outline stand the rims
of the dished medial plateau, some 4 mm higher on people's bones (Clouthier et al. 2019) than annotators put the points.
Laterally the outline of drawn knees is within 0.2 mm of where they put both, and varies as theirs do; the floor of
point 2 would be 2 mm lower.
"""

from dataclasses import dataclass

import numpy as np

from ..core.checks import Array
from ..geometry.mesh import Indices, Mesh
from ..geometry.view import View, project
from .contours import envelope, turned_px
from .solids import crossing_sides

TIBIAL = (
    "tibia_lateral_edge", "tibia_lateral_1", "tibia_lateral_2", "lateral_spine", "between_spines",
    "medial_spine", "tibia_medial_2", "tibia_medial_1", "tibia_medial_edge",
)  # fmt: skip
FEMORAL = (
    "femur_lateral_edge", "femur_lateral_condyle", "femur_lateral_notch", "notch_top",
    "femur_medial_notch", "femur_medial_condyle", "femur_medial_edge",
)  # fmt: skip
CONTOUR_LANDMARKS = TIBIAL + FEMORAL
# Share of the way from edge to spine, along x, at which 150 knees of KL 0 have points 1 and 2 (means of the
# annotations of Tiulpin et al. 2019).
_WAY_TO_SPINE = {"lateral": (0.356, 0.709), "medial": (0.392, 0.779)}
# Spines are looked for within this share of the plateau's width from its middle.
_SPINES = 0.22
_NOTCH_REACH, _NOTCH_RISES = 0.125, (0.355, 0.404)
# Of 25 to 45 degrees, with which the bones of 50 people (Clouthier et al. 2019) in fixed flexion have their landmarks
# where annotators put them: heights are off by 1.2 SD at 45 degrees, 0.9 at 30, hardly less below, where some fail.
_EDGE_DEG = 30.0
# The plateau's depth is where a section stands above a line so far, in shares of its width, under that of the edges.
# Judged on people's bones (Clouthier et al. 2019): at 0.08 the slope in front of the spines is taken for floor.
_PLATEAU_UNDER, _MIDDLE = 0.04, (0.25, 0.75)
# Of any section at least what is within this of its top counts.
_LEAST_MM = 2.0
# Along x on the detector, and along the beam in a section; the contour is exact at each of its places.
_STEP_MM = 0.05


@dataclass(frozen=True, eq=False)
class _Contour:
    """An outline of a bone on the detector: x towards medial and y proximal, mm from the detector's centre.

    x_mm, y_mm  (n,)  places along it, evenly in x
    """

    x_mm: Array
    y_mm: Array

    def at(self, x_mm: float) -> tuple[float, float]:
        """The place nearest in x."""
        return self._place(int(np.abs(self.x_mm - x_mm).argmin()))

    def between(self, first_mm: float, last_mm: float) -> "_Contour":
        """The part between two places in x, whichever is the first."""
        low, high = sorted((first_mm, last_mm))
        part = (self.x_mm >= low) & (self.x_mm <= high)
        return _Contour(self.x_mm[part], self.y_mm[part])

    def highest(self) -> tuple[float, float]:
        return self._place(int(self.y_mm.argmax()))

    def lowest(self) -> tuple[float, float]:
        return self._place(int(self.y_mm.argmin()))

    def _place(self, index: int) -> tuple[float, float]:
        return float(self.x_mm[index]), float(self.y_mm[index])


def contour_landmarks(
    femur: Mesh, tibia: Mesh, view: View, medial: int, lean_deg: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Name -> (row, column) of the sixteen contour landmarks.

    femur, tibia  in the knee frame, mm
    medial        +1 where medial is towards greater x (a right knee), -1 otherwise
    lean_deg      of the leg about y, as it is seen: landmarks go by the leg's own axes
    """
    tibial = _on_tibia(_seen(tibia.vertices, view, medial, lean_deg), tibia)
    femoral = _on_femur(_seen(femur.vertices, view, medial, lean_deg), _sides(femur))
    places = _places_px(tibial + femoral, view, medial, lean_deg)
    return {name: (float(row), float(col)) for name, (row, col) in zip(CONTOUR_LANDMARKS, places, strict=True)}


def plateau_floor(tibia: Mesh, view: View, medial: int, lean_deg: float = 0.0) -> Array:
    """(9, 2)  row and column of the tibia's landmarks, medially along the plateau's floor, in order of columns

    Arguments as in `contour_landmarks`.
    """
    tibial = _on_tibia(_seen(tibia.vertices, view, medial, lean_deg), tibia)
    return _places_px(tibial, view, medial, lean_deg)[::medial]


def _places_px(places_mm: list[tuple[float, float]], view: View, medial: int, lean_deg: float) -> Array:
    """(n, 2)  row and column of places as `_seen` tells them"""
    rows, cols = (view.rows - 1) / 2, (view.cols - 1) / 2
    upright = [(rows - y / view.pixel_mm, cols + medial * x / view.pixel_mm) for x, y in places_mm]
    return turned_px(np.array(upright), view, lean_deg)


def _seen(vertices: Array, view: View, medial: int, lean_deg: float) -> Array:
    """(n, 2)  where vertices are seen, upright: x towards medial and y proximal, mm from the detector's centre"""
    seen = turned_px(project(vertices, view), view, -lean_deg)
    x = (seen[:, 1] - (view.cols - 1) / 2) * view.pixel_mm * medial
    return np.column_stack((x, ((view.rows - 1) / 2 - seen[:, 0]) * view.pixel_mm))


def _sides(mesh: Mesh) -> Indices:
    """(3 m, 2)  sides of all triangles; most come twice, which costs less than to find out which."""
    return mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def _contour(seen: Array, sides: Indices, ends_mm: tuple[float, float], lowest: float) -> _Contour:
    """The lower (+1) or upper (-1) outline between two places in x."""
    first, last = np.ceil(ends_mm[0] / _STEP_MM), np.floor(ends_mm[1] / _STEP_MM)
    places = np.arange(first, last + 1)
    rows = envelope(seen[:, ::-1] / (-_STEP_MM, _STEP_MM), sides, int(first), len(places), lowest)
    return _Contour(places * _STEP_MM, -rows * _STEP_MM)


def _edges(seen: Array, up: float) -> list[tuple[float, float]]:
    """Lateral and medial places that a line at an angle touches first, from above (up = 1) or below (-1)."""
    turn = np.deg2rad(_EDGE_DEG)
    touched = [(seen @ (out * np.sin(turn), up * np.cos(turn))).argmax() for out in (-1.0, 1.0)]
    return [(float(seen[k, 0]), float(seen[k, 1])) for k in touched]


def _on_tibia(seen: Array, tibia: Mesh) -> list[tuple[float, float]]:
    """Places of the tibia's landmarks in their order."""
    lateral, medial = _edges(seen, +1.0)
    contour = _contour(seen, _sides(tibia), (lateral[0], medial[0]), -1.0)
    middle, width = (lateral[0] + medial[0]) / 2, medial[0] - lateral[0]
    spines = [contour.between(middle, middle + out * _SPINES * width).highest() for out in (-1.0, 1.0)]
    ways = {
        side: [edge[0] + share * (spine[0] - edge[0]) for share in _WAY_TO_SPINE[side]]
        for side, edge, spine in (("lateral", lateral, spines[0]), ("medial", medial, spines[1]))
    }
    floors = []
    for x in ways["medial"]:
        line = lateral[1] + (x - lateral[0]) / width * (medial[1] - lateral[1])
        floors.append((x, _floor(_section(seen, tibia, x), line - _PLATEAU_UNDER * width)))
    tops = [contour.at(x) for x in ways["lateral"]]
    valley = contour.between(spines[0][0], spines[1][0]).lowest()
    return [lateral, *tops, spines[0], valley, spines[1], *floors[::-1], medial]


def _section(seen: Array, tibia: Mesh, x_mm: float) -> _Contour:
    """The upper outline of the part of the tibia that is seen at a place in x: depth along the beam, and height."""
    starts, ends, share = crossing_sides(seen[:, 0], tibia.faces, x_mm)
    both = np.column_stack((tibia.vertices[:, 1], seen[:, 1]))
    points = both[starts] + share[:, None] * (both[ends] - both[starts])
    # Two sides of each triangle cross, and what lies between them is of the outline.
    return _contour(points, np.arange(len(points)).reshape(-1, 2), (points[:, 0].min(), points[:, 0].max()), -1.0)


def _floor(section: _Contour, above_mm: float) -> float:
    """Height of the lowest place of the middle half of what stands above a height."""
    depths = section.x_mm[section.y_mm > min(above_mm, section.y_mm.max() - _LEAST_MM)]
    low, high = (depths.min() + share * np.ptp(depths) for share in _MIDDLE)
    return section.between(low, high).lowest()[1]


def _on_femur(seen: Array, sides: Indices) -> list[tuple[float, float]]:
    """Places of the femur's landmarks in their order."""
    lateral, medial = _edges(seen, -1.0)
    contour = _contour(seen, sides, (lateral[0], medial[0]), +1.0)
    middle, reach = (lateral[0] + medial[0]) / 2, _NOTCH_REACH * (medial[0] - lateral[0])
    top = contour.between(middle - reach, middle + reach).highest()
    by_side = []
    for edge, rise in zip((lateral, medial), _NOTCH_RISES, strict=True):
        low = contour.between(edge[0], top[0]).lowest()
        wall = contour.between(low[0], top[0])
        risen = wall.x_mm[wall.y_mm >= low[1] + rise * (top[1] - low[1])]
        # The first place on the way from the condyle inwards.
        notch = wall.at(risen[np.abs(risen - edge[0]).argmin()])
        by_side.append([edge, contour.at((edge[0] + notch[0]) / 2), notch])
    return [*by_side[0], top, *by_side[1][::-1]]
