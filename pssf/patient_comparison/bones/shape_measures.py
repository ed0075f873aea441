"""Compute shape measures of femur, tibia and patella; the shape modes are named after these measures.

Bones are in the frame of the template bone, before posture is applied: x medial, y posterior, z proximal, in mm.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...geometry.mesh import Mesh

_Mask = NDArray[np.bool_]
# Edge length of the square cells over which plateau heights are averaged, in mm.
_CELL_MM = 3.0


def is_between(values: Array, low: float, high: float) -> _Mask:
    """Return which values are between two limits.

    Parameters
    ----------
    values : (n,) array, mm
        Values to compare with the limits.
    low : float
        Lower limit in mm.
    high : float
        Upper limit in mm.

    Returns
    -------
    (n,) bool array
        True for values between the limits.
    """
    return (values > low) & (values < high)


def _span(values: Array) -> float:
    """Return the difference between the highest and the lowest value."""
    return float(np.ptp(values))


def _cell_means(points: Array) -> tuple[Array, Array]:
    """Average the y and z coordinates of points (n, 3) in square xy cells, so that mesh density has no effect.

    Return the mean y and the mean z of m occupied cells, (m,) each, in mm.
    """
    cells = np.floor(points[:, :2] / _CELL_MM).astype(np.int64)
    _, number = np.unique(cells, axis=0, return_inverse=True)
    count = np.bincount(number)
    return np.bincount(number, points[:, 1]) / count, np.bincount(number, points[:, 2]) / count


def _slope_deg(along: Array, height: Array) -> float:
    """Fit a line to heights along a direction and return its slope, in degrees."""
    return float(np.rad2deg(np.arctan(np.polyfit(along, height, 1)[0])))


def femur_width_mm(points: Array) -> float:
    """Measure the width of the femur across the epicondyles.

    Parameters
    ----------
    points : (n, 3) array, mm
        Vertices of the femur.

    Returns
    -------
    float
        Width in mm.
    """
    return _span(_crop_femur_end(points)[:, 0])


def tibia_width_mm(points: Array) -> float:
    """Measure the width of the tibia across the plateau.

    Parameters
    ----------
    points : (n, 3) array, mm
        Vertices of the tibia.

    Returns
    -------
    float
        Width in mm.
    """
    return _span(_crop_tibia_end(points)[:, 0])


def _crop_femur_end(points: Array) -> Array:
    """Crop a femur to its distal 45 mm."""
    return points[points[:, 2] < 45]


def _crop_tibia_end(points: Array) -> Array:
    """Crop a tibia to its proximal 25 mm."""
    return points[points[:, 2] > -25]


def measure_femur(points: Array) -> dict[str, float]:
    """Compute shape measures of a distal femur.

    Parameters
    ----------
    points : (n, 3) array, mm
        Vertices of the femur.

    Returns
    -------
    dict of str to float
        Lengths as fractions of the epicondylar width.
    """
    x, y, z = points.T
    end, shaft = _crop_femur_end(points), points[is_between(z, 82, 96)]
    width = femur_width_mm(points)
    medial, lateral = points[(x > 8) & (z < 45)], points[(x < -8) & (z < 45)]
    back = float(end[:, 1].max())
    front = is_between(z, 18, 30) & (y < back - 40)
    groove = points[front & (np.abs(x) < 5)][:, 1].min()
    ridges = [points[front & is_between(side * x, 10, 26)][:, 1].min() for side in (1, -1)]
    notch = points[is_between(y, back - 28, back - 12) & is_between(z, 6, 13) & (np.abs(x) < 20)][:, 0]
    return {
        "femoral condyles' depth over width": _span(end[:, 1]) / width,
        "medial condyle lower than lateral": float(lateral[:, 2].min() - medial[:, 2].min()) / width,
        "medial condyle longer behind than lateral": float(medial[:, 1].max() - lateral[:, 1].max()) / width,
        "trochlear groove's depth": float(groove - np.mean(ridges)) / width,
        "lateral trochlear ridge over medial": float(ridges[0] - ridges[1]) / width,
        "notch's width": float(notch[notch > 0].min() - notch[notch < 0].max()) / width,
        "femoral shaft's width over condyles'": _span(shaft[:, 0]) / width,
        "femoral shaft's depth over condyles'": _span(shaft[:, 1]) / width,
        "femoral metaphysis's width over condyles'": _span(points[is_between(z, 50, 58)][:, 0]) / width,
        "medial inclination of the femoral shaft": float(_box_centre(shaft)[0] - _box_centre(end)[0]) / width,
        "posterior inclination of the femoral shaft": float(_box_centre(shaft)[1] - _box_centre(end)[1]) / width,
    }


def measure_tibia(points: Array) -> dict[str, float]:
    """Compute shape measures of a proximal tibia.

    Parameters
    ----------
    points : (n, 3) array, mm
        Vertices of the tibia.

    Returns
    -------
    dict of str to float
        Lengths as fractions of the plateau width, and angles in degrees.
    """
    x, y, z = points.T
    end, shaft = _crop_tibia_end(points), points[is_between(z, -82, -70)]
    width = tibia_width_mm(points)
    top = z > -8
    plateaus = [points[top & is_between(side * x, 14, 30) & is_between(y, -14, 16)] for side in (1, -1)]
    medial, lateral = (plateau[plateau[:, 2] > np.median(plateau[:, 2]) - 4] for plateau in plateaus)
    level = (np.median(medial[:, 2]) + np.median(lateral[:, 2])) / 2
    spines = [points[top & is_between(side * x, 1.5, 14)][:, 2].max() - level for side in (1, -1)]
    front = points[is_between(z, -50, -34) & (np.abs(x) < 16)]
    return {
        "tibial plateau's depth over width": _span(points[z > -12][:, 1]) / width,
        "medial plateau's fall backwards": -_slope_deg(*_cell_means(medial)),
        "lateral plateau's fall backwards": -_slope_deg(*_cell_means(lateral)),
        "medial plateau higher than lateral": float(np.median(medial[:, 2]) - np.median(lateral[:, 2])) / width,
        "medial spine's height": float(spines[0]) / width,
        "lateral spine's height": float(spines[1]) / width,
        "tibial shaft's width over plateau's": _span(shaft[:, 0]) / width,
        "tibial shaft's depth over plateau's width": _span(shaft[:, 1]) / width,
        "tibial metaphysis's width over plateau's": _span(points[is_between(z, -44, -36)][:, 0]) / width,
        "medial inclination of the tibial shaft": float(_box_centre(shaft)[0] - _box_centre(end)[0]) / width,
        "posterior inclination of the tibial shaft": float(_box_centre(shaft)[1] - _box_centre(end)[1]) / width,
        "tibial tuberosity's rise": float(_box_centre(shaft)[1] - front[:, 1].min()) / width,
    }


def measure_patella(points: Array) -> dict[str, float]:
    """Compute shape measures of a patella.

    Parameters
    ----------
    points : (n, 3) array, mm
        Vertices of the patella.

    Returns
    -------
    dict of str to float
        Lengths as fractions of the patellar width.
    """
    width, depth, height = np.ptp(points, axis=0)
    middle = _box_centre(points)
    return {
        "patella's height over width": float(height / width),
        "patella's thickness over width": float(depth / width),
        "patellar apex to medial": float(points[points[:, 2].argmin(), 0] - middle[0]) / width,
        "patellar apex backwards": float(points[points[:, 2].argmin(), 1] - middle[1]) / width,
    }


_MEASURES_BY_BONE: dict[str, Callable[[Array], dict[str, float]]] = {
    "femur": measure_femur,
    "tibia": measure_tibia,
    "patella": measure_patella,
}


def measure_bones(bones: dict[str, Mesh]) -> dict[str, float]:
    """Compute shape measures of all bones of a knee.

    Parameters
    ----------
    bones : dict of str to Mesh
        Meshes in mm, keyed by bone name.

    Returns
    -------
    dict of str to float
        Lengths as fractions of the bone width, and angles in degrees.
    """
    return {
        what: value for name, bone in bones.items() for what, value in _MEASURES_BY_BONE[name](bone.vertices).items()
    }


def _box_centre(points: Array) -> Array:
    """Return the centre of the bounding box of points."""
    return (points.min(axis=0) + points.max(axis=0)) / 2
