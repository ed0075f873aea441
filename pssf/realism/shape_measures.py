"""Named measures of the form of femur, tibia and patella, by which modes of variation are called.

Bones are in the frame of the mean man's, before they stand: x medial, y posterior, z proximal, mm.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..geometry.mesh import Mesh

_Where = NDArray[np.bool_]
# Heights of a plateau are averaged over squares of this side.
_CELL_MM = 3.0


def between(values: Array, low: float, high: float) -> _Where:
    """(n,)  which values (n,), mm, lie between two"""
    return (values > low) & (values < high)


def _span(values: Array) -> float:
    return float(np.ptp(values))


def _cell_means(points: Array) -> tuple[Array, Array]:
    """(m,), (m,)  y and z of points (n, 3) averaged over cells in x and y, so that a denser mesh counts no more"""
    cells = np.floor(points[:, :2] / _CELL_MM).astype(np.int64)
    _, number = np.unique(cells, axis=0, return_inverse=True)
    count = np.bincount(number)
    return np.bincount(number, points[:, 1]) / count, np.bincount(number, points[:, 2]) / count


def _slope_deg(along: Array, height: Array) -> float:
    return float(np.rad2deg(np.arctan(np.polyfit(along, height, 1)[0])))


def femur_width(points: Array) -> float:
    """Across the epicondyles, mm.

    points  (n, 3)  vertices, mm
    """
    return _span(_femur_end(points)[:, 0])


def tibia_width(points: Array) -> float:
    """Across the plateau, mm.

    points  (n, 3)  vertices, mm
    """
    return _span(_tibia_end(points)[:, 0])


def _femur_end(points: Array) -> Array:
    return points[points[:, 2] < 45]


def _tibia_end(points: Array) -> Array:
    return points[points[:, 2] > -25]


def femur_measures(points: Array) -> dict[str, float]:
    """Measures of a distal femur.

    points  (n, 3)  vertices, mm
    """
    x, y, z = points.T
    end, shaft = _femur_end(points), points[between(z, 82, 96)]
    width = femur_width(points)
    medial, lateral = points[(x > 8) & (z < 45)], points[(x < -8) & (z < 45)]
    back = float(end[:, 1].max())
    front = between(z, 18, 30) & (y < back - 40)
    groove = points[front & (np.abs(x) < 5)][:, 1].min()
    ridges = [points[front & between(side * x, 10, 26)][:, 1].min() for side in (1, -1)]
    notch = points[between(y, back - 28, back - 12) & between(z, 6, 13) & (np.abs(x) < 20)][:, 0]
    return {
        "femoral condyles' depth over width": _span(end[:, 1]) / width,
        "medial condyle lower than lateral": float(lateral[:, 2].min() - medial[:, 2].min()) / width,
        "medial condyle longer behind than lateral": float(medial[:, 1].max() - lateral[:, 1].max()) / width,
        "trochlear groove's depth": float(groove - np.mean(ridges)) / width,
        "lateral trochlear ridge over medial": float(ridges[0] - ridges[1]) / width,
        "notch's width": float(notch[notch > 0].min() - notch[notch < 0].max()) / width,
        "femoral shaft's width over condyles'": _span(shaft[:, 0]) / width,
        "femoral shaft's depth over condyles'": _span(shaft[:, 1]) / width,
        "femoral metaphysis's width over condyles'": _span(points[between(z, 50, 58)][:, 0]) / width,
        "femoral shaft's lean to medial": float(_middle(shaft)[0] - _middle(end)[0]) / width,
        "femoral shaft's lean backwards": float(_middle(shaft)[1] - _middle(end)[1]) / width,
    }


def tibia_measures(points: Array) -> dict[str, float]:
    """Measures of a proximal tibia.

    points  (n, 3)  vertices, mm
    """
    x, y, z = points.T
    end, shaft = _tibia_end(points), points[between(z, -82, -70)]
    width = tibia_width(points)
    top = z > -8
    plateaus = [points[top & between(side * x, 14, 30) & between(y, -14, 16)] for side in (1, -1)]
    medial, lateral = (plateau[plateau[:, 2] > np.median(plateau[:, 2]) - 4] for plateau in plateaus)
    level = (np.median(medial[:, 2]) + np.median(lateral[:, 2])) / 2
    spines = [points[top & between(side * x, 1.5, 14)][:, 2].max() - level for side in (1, -1)]
    front = points[between(z, -50, -34) & (np.abs(x) < 16)]
    return {
        "tibial plateau's depth over width": _span(points[z > -12][:, 1]) / width,
        "medial plateau's fall backwards": -_slope_deg(*_cell_means(medial)),
        "lateral plateau's fall backwards": -_slope_deg(*_cell_means(lateral)),
        "medial plateau higher than lateral": float(np.median(medial[:, 2]) - np.median(lateral[:, 2])) / width,
        "medial spine's height": float(spines[0]) / width,
        "lateral spine's height": float(spines[1]) / width,
        "tibial shaft's width over plateau's": _span(shaft[:, 0]) / width,
        "tibial shaft's depth over plateau's width": _span(shaft[:, 1]) / width,
        "tibial metaphysis's width over plateau's": _span(points[between(z, -44, -36)][:, 0]) / width,
        "tibial shaft's lean to medial": float(_middle(shaft)[0] - _middle(end)[0]) / width,
        "tibial shaft's lean backwards": float(_middle(shaft)[1] - _middle(end)[1]) / width,
        "tibial tuberosity's rise": float(_middle(shaft)[1] - front[:, 1].min()) / width,
    }


def patella_measures(points: Array) -> dict[str, float]:
    """Measures of a patella.

    points  (n, 3)  vertices, mm
    """
    width, depth, height = np.ptp(points, axis=0)
    middle = _middle(points)
    return {
        "patella's height over width": float(height / width),
        "patella's thickness over width": float(depth / width),
        "patellar apex to medial": float(points[points[:, 2].argmin(), 0] - middle[0]) / width,
        "patellar apex backwards": float(points[points[:, 2].argmin(), 1] - middle[1]) / width,
    }


_OF: dict[str, Callable[[Array], dict[str, float]]] = {
    "femur": femur_measures,
    "tibia": tibia_measures,
    "patella": patella_measures,
}


def measures(bones: dict[str, Mesh]) -> dict[str, float]:
    """All measures of the bones of one knee; shares of a bone's width, angles in degrees."""
    return {what: value for name, bone in bones.items() for what, value in _OF[name](bone.vertices).items()}


def _middle(points: Array) -> Array:
    return (points.min(axis=0) + points.max(axis=0)) / 2
