"""Free-form deformation: displace points by a lattice of control points with uniform cubic B-splines.

The method follows Sederberg and Parry 1986 with the B-splines of Lee, Wolberg and Shin 1997. The displacement field
is smooth up to its second derivative. It is linear in the displacements of the control points, so deformations add.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ..core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
)
from ..core.numba_kernel import kernel

# Number of control points added on each side of the lattice. A cubic B-spline extends two lattice pitches from its
# control point.
_PAD_POINTS = 3
# Number of samples of the Jacobian along each axis of a cell, including both ends.
_SAMPLES_PER_CELL_EDGE = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Lattice:
    """Regular grid of control points with their displacements.

    Parameters
    ----------
    origin_mm : (3,) float64 array
        Position of the first control point, in mm.
    pitch_mm : float
        Distance between control points along every axis, in mm.
    displacements_mm : (nx, ny, nz, 3) float64 array
        Displacement of each control point, in mm.
    shaft_sign : int, default 0
        +1 continues the displacements of the last layer above the lattice, for example along a shaft. -1 continues the
        displacements of the first layer below the lattice. 0 continues neither. On all other sides the displacement
        falls to zero within two lattice pitches.

    Raises
    ------
    InputError
        If an array has the wrong shape or contains values that are not finite, or if a number is out of range.
    """

    origin_mm: Array
    pitch_mm: float
    displacements_mm: Array
    shaft_sign: int = 0

    def __post_init__(self) -> None:
        require_in_range("pitch_mm", self.pitch_mm, 1e-3, 1e3, "mm")
        require_choice("shaft_sign", self.shaft_sign, (-1, 0, 1))
        shape, origin = np.shape(self.displacements_mm), np.shape(self.origin_mm)
        if len(shape) != 4 or shape[3] != 3 or 0 in shape:
            raise InputError(f"displacements_mm must have the shape (nx, ny, nz, 3), got {shape}")
        if origin != (3,):
            raise InputError(f"origin_mm must have the shape (3,), got {origin}")
        for name in ("displacements_mm", "origin_mm"):
            wrong = np.asarray(getattr(self, name))[~np.isfinite(getattr(self, name))]
            if len(wrong):
                raise InputError(f"{name} must be finite, got {wrong[0]:g} mm")

    @property
    def counts(self) -> tuple[int, int, int]:
        """Number of control points along x, y and z."""
        nx, ny, nz, _ = self.displacements_mm.shape
        return nx, ny, nz


def displace_points(points_mm: Array, lattice: Lattice) -> Array:
    """Displace points by the deformation that a lattice defines.

    Parameters
    ----------
    points_mm : (n, 3) float64 array
        Points, in mm.
    lattice : Lattice
        Control points and their displacements.

    Returns
    -------
    (n, 3) float64 array
        Displaced points, in mm.
    """
    points = np.ascontiguousarray(points_mm, np.float64)
    return _apply_displacements(
        points, np.asarray(lattice.origin_mm, np.float64), float(lattice.pitch_mm), _pad_displacements(lattice)
    )


def invert_displacement(points_mm: Array, lattice: Lattice, iterations: int = 30) -> Array:
    """Invert the deformation that a lattice defines: compute original points from displaced points.

    Parameters
    ----------
    points_mm : (n, 3) float64 array
        Displaced points, in mm.
    lattice : Lattice
        Control points and their displacements.
    iterations : int, default 30
        Number of iterations.

    Returns
    -------
    (n, 3) float64 array
        Points before the displacement, in mm.

    Notes
    -----
    The points are found by fixed-point iteration. The iteration converges if, for any two points, the difference in
    displacement is less than the distance between the points.
    """
    places = np.array(points_mm, np.float64)
    for _ in range(iterations):
        places += points_mm - displace_points(places, lattice)
    return places


def replace_displacements(lattice: Lattice, displacements_mm: Array) -> Lattice:
    """Return a copy of a lattice with new displacements.

    Parameters
    ----------
    lattice : Lattice
        Lattice that provides the grid of control points.
    displacements_mm : (nx, ny, nz, 3) float64 array
        New displacements, in mm. A flat array with the same number of values in the same order is also accepted.

    Returns
    -------
    Lattice
        Lattice with the new displacements.
    """
    return replace(lattice, displacements_mm=np.reshape(displacements_mm, lattice.displacements_mm.shape))


def basis_matrix(points_mm: Array, lattice: Lattice) -> sparse.csr_array:
    """Compute the B-spline weight of every control point at a set of points.

    Parameters
    ----------
    points_mm : (n, 3) float64 array
        Points, in mm.
    lattice : Lattice
        Lattice of control points; the displacements are not used.

    Returns
    -------
    (n, nx * ny * nz) sparse array
        Weight of each control point in the displacement of each point, dimensionless.
    """
    counts = lattice.counts
    own = np.pad(np.arange(np.prod(counts)).reshape(counts), _PAD_POINTS, constant_values=-1)
    _extend_along_shaft(own, lattice.shaft_sign)
    scaled = (np.asarray(points_mm) - lattice.origin_mm) / lattice.pitch_mm
    cell = np.clip(np.floor(scaled), -2, counts).astype(np.int64)
    within = np.clip(scaled - cell, 0.0, 1.0)
    x, y, z = np.moveaxis(np.array(_bspline_weights(within)), 0, -1).transpose(1, 0, 2)
    share = np.einsum("ni,nj,nk->nijk", x, y, z)
    i, j, k = (cell + _PAD_POINTS - 1).T[:, :, None] + np.arange(4)
    numbers = own[i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
    row = np.broadcast_to(np.arange(len(scaled))[:, None, None, None], numbers.shape)
    kept = numbers >= 0
    shape = (len(scaled), int(np.prod(counts)))
    return sparse.csr_array((share[kept], (row[kept], numbers[kept])), shape=shape)


def min_jacobian_determinant(lattice: Lattice) -> float:
    """Compute the minimum Jacobian determinant of a deformation; it is positive if the deformation does not fold.

    Parameters
    ----------
    lattice : Lattice
        Control points and their displacements.

    Returns
    -------
    float
        Minimum determinant, dimensionless, over a grid of 4 x 4 x 4 samples in every cell.
    """
    padded = _pad_displacements(lattice)
    values, slopes = zip(*(_axis_basis(n) for n in padded.shape[:3]), strict=True)
    gradient = np.empty((*(len(v) for v in values), 3, 3))
    for axis in range(3):
        part = padded
        for a in range(3):
            share = slopes[a] / lattice.pitch_mm if a == axis else values[a]
            part = np.moveaxis(np.tensordot(share, part, (1, a)), 0, a)
        gradient[..., axis] = part
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(gradient + np.eye(3), (-2, -1), (0, 1))
    return float((a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)).min())


def _axis_basis(count: int) -> tuple[Array, Array]:
    """Return the B-spline weights (samples, count) along an axis, and their derivatives per lattice pitch."""
    cells = count - 3
    places = np.linspace(0, cells, cells * (_SAMPLES_PER_CELL_EDGE - 1) + 1)
    cell = np.minimum(places.astype(np.int64), cells - 1)
    t = places - cell
    value, slope = np.zeros((2, len(places), count))
    rows, columns = np.arange(len(places))[:, None], cell[:, None] + np.arange(4)
    value[rows, columns] = np.stack(_bspline_weights(t), axis=-1)
    slope[rows, columns] = np.stack(
        (-((1 - t) ** 2) / 2, (3 * t**2 - 4 * t) / 2, (-3 * t**2 + 2 * t + 1) / 2, t**2 / 2), axis=-1
    )
    return value, slope


def _pad_displacements(lattice: Lattice) -> Array:
    """Pad the displacements with zeros on all sides, except for copies of the end layer along the shaft."""
    around = np.pad(lattice.displacements_mm, ((_PAD_POINTS, _PAD_POINTS),) * 3 + ((0, 0),)).astype(np.float64)
    _extend_along_shaft(around, lattice.shaft_sign)
    return around


def _extend_along_shaft(padded: np.ndarray, shaft: int) -> None:
    """Copy the end layer of the lattice into the padding at the shaft end, in place."""
    if shaft > 0:
        padded[:, :, -_PAD_POINTS:] = padded[:, :, -_PAD_POINTS - 1, None]
    if shaft < 0:
        padded[:, :, :_PAD_POINTS] = padded[:, :, _PAD_POINTS, None]


@kernel()
def _bspline_weights(t):  # type: ignore[no-untyped-def]
    """Return the uniform cubic B-spline weights of the four nearest control points.

    `t` (0 to 1) is the distance from the second control point, in lattice pitches.
    """
    s = 1 - t
    return s**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (3 * s**3 - 6 * s**2 + 4) / 6, t**3 / 6


@kernel()
def _apply_displacements(points, origin, pitch, padded):  # type: ignore[no-untyped-def]
    """Return points (n, 3) displaced by a padded lattice, in mm."""
    moved = points.copy()
    start, weight = np.empty(3, np.int64), np.empty((3, 4))
    for n in range(len(points)):
        for axis in range(3):
            scaled = (points[n, axis] - origin[axis]) / pitch
            # The displacement is constant outside the padded lattice.
            cell = min(max(np.floor(scaled), -2.0), padded.shape[axis] - 6.0)
            start[axis] = int(cell) + 2
            # The weights are assigned individually, because Numba needs several seconds to compile the assignment of a
            # tuple to an array row.
            a, b, c, d = _bspline_weights(min(max(scaled - cell, 0.0), 1.0))
            weight[axis, 0], weight[axis, 1], weight[axis, 2], weight[axis, 3] = a, b, c, d
        first, second, third = start[0], start[1], start[2]
        x = y = z = 0.0
        for i in range(4):
            for j in range(4):
                across = weight[0, i] * weight[1, j]
                for k in range(4):
                    share = across * weight[2, k]
                    x += share * padded[first + i, second + j, third + k, 0]
                    y += share * padded[first + i, second + j, third + k, 1]
                    z += share * padded[first + i, second + j, third + k, 2]
        moved[n, 0] += x
        moved[n, 1] += y
        moved[n, 2] += z
    return moved
