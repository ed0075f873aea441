"""Free-form deformation: places moved by a lattice of control points, blended by uniform cubic B-splines.

After Sederberg and Parry 1986, with the B-splines of Lee, Wolberg and Shin 1997: smooth to the second derivative, and
linear in the displacements of the control points, so that deformations add up.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ..core.checks import Array, InputError, require, require_choice
from ..core.compiled import kernel

# A cubic B-spline ends two pitches from its control point.
_PAD = 3
# The Jacobian is looked at so often along each edge of a cell, ends included.
_PER_CELL = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Lattice:
    """Control points on a regular grid, and how far each is moved.

    origin_mm         (3,)            of the first
    pitch_mm          from one to the next along every axis
    displacements_mm  (nx, ny, nz, 3)
    shaft             +1: the last layer's displacements go on without end above it, as a shaft does; -1: the first
                      layer's below it; 0: neither. On all other sides displacement fades to nothing in two pitches.
    """

    origin_mm: Array
    pitch_mm: float
    displacements_mm: Array
    shaft: int = 0

    def __post_init__(self) -> None:
        require("pitch_mm", self.pitch_mm, 1e-3, 1e3, "mm")
        require_choice("shaft", self.shaft, (-1, 0, 1))
        shape, origin = np.shape(self.displacements_mm), np.shape(self.origin_mm)
        if len(shape) != 4 or shape[3] != 3 or 0 in shape:
            raise InputError(f"displacements_mm: shape = {shape}; allowed: (nx, ny, nz, 3)")
        if origin != (3,):
            raise InputError(f"origin_mm: shape = {origin}; allowed: (3,)")
        for name in ("displacements_mm", "origin_mm"):
            wrong = np.asarray(getattr(self, name))[~np.isfinite(getattr(self, name))]
            if len(wrong):
                raise InputError(f"{name} holds {wrong[0]:g} mm; allowed: finite, mm")

    @property
    def counts(self) -> tuple[int, int, int]:
        """Control points along x, y and z."""
        nx, ny, nz, _ = self.displacements_mm.shape
        return nx, ny, nz


def displaced(points_mm: Array, lattice: Lattice) -> Array:
    """(n, 3)  where a lattice moves points

    points_mm  (n, 3)
    """
    points = np.ascontiguousarray(points_mm, np.float64)
    return _moved(points, np.asarray(lattice.origin_mm, np.float64), float(lattice.pitch_mm), _padded(lattice))


def placed_before(points_mm: Array, lattice: Lattice, rounds: int = 30) -> Array:
    """(n, 3)  the places that a lattice moves to points: the inverse of `displaced`, by fixed-point iteration

    It converges where displacements differ by less than the distance between any two places.
    points_mm  (n, 3)
    """
    places = np.array(points_mm, np.float64)
    for _ in range(rounds):
        places += points_mm - displaced(places, lattice)
    return places


def with_displacements(lattice: Lattice, displacements_mm: Array) -> Lattice:
    """The same lattice with other displacements.

    displacements_mm  (nx, ny, nz, 3), or as many numbers in that order
    """
    return replace(lattice, displacements_mm=np.reshape(displacements_mm, lattice.displacements_mm.shape))


def basis_matrix(points_mm: Array, lattice: Lattice) -> sparse.csr_array:
    """(n, nx ny nz)  share of each control point's displacement in that of points

    points_mm  (n, 3)
    """
    counts = lattice.counts
    own = np.pad(np.arange(np.prod(counts)).reshape(counts), _PAD, constant_values=-1)
    _go_on(own, lattice.shaft)
    scaled = (np.asarray(points_mm) - lattice.origin_mm) / lattice.pitch_mm
    cell = np.clip(np.floor(scaled), -2, counts).astype(np.int64)
    within = np.clip(scaled - cell, 0.0, 1.0)
    x, y, z = np.moveaxis(np.array(_weights(within)), 0, -1).transpose(1, 0, 2)
    share = np.einsum("ni,nj,nk->nijk", x, y, z)
    i, j, k = (cell + _PAD - 1).T[:, :, None] + np.arange(4)
    numbers = own[i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
    row = np.broadcast_to(np.arange(len(scaled))[:, None, None, None], numbers.shape)
    kept = numbers >= 0
    shape = (len(scaled), int(np.prod(counts)))
    return sparse.csr_array((share[kept], (row[kept], numbers[kept])), shape=shape)


def least_jacobian(lattice: Lattice) -> float:
    """Least determinant of a deformation's Jacobian, at four places along each edge of every cell; above 0: no fold."""
    padded = _padded(lattice)
    values, slopes = zip(*(_along(n) for n in padded.shape[:3]), strict=True)
    gradient = np.empty((*(len(v) for v in values), 3, 3))
    for axis in range(3):
        part = padded
        for a in range(3):
            share = slopes[a] / lattice.pitch_mm if a == axis else values[a]
            part = np.moveaxis(np.tensordot(share, part, (1, a)), 0, a)
        gradient[..., axis] = part
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(gradient + np.eye(3), (-2, -1), (0, 1))
    return float((a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)).min())


def _along(count: int) -> tuple[Array, Array]:
    """(places, count), (places, count)  shares of control points along an axis, and their slopes per pitch"""
    cells = count - 3
    places = np.linspace(0, cells, cells * (_PER_CELL - 1) + 1)
    cell = np.minimum(places.astype(np.int64), cells - 1)
    t = places - cell
    value, slope = np.zeros((2, len(places), count))
    rows, columns = np.arange(len(places))[:, None], cell[:, None] + np.arange(4)
    value[rows, columns] = np.stack(_weights(t), axis=-1)
    slope[rows, columns] = np.stack(
        (-((1 - t) ** 2) / 2, (3 * t**2 - 4 * t) / 2, (-3 * t**2 + 2 * t + 1) / 2, t**2 / 2), axis=-1
    )
    return value, slope


def _padded(lattice: Lattice) -> Array:
    """Displacements with those of the control points beyond the lattice that still matter."""
    around = np.pad(lattice.displacements_mm, ((_PAD, _PAD),) * 3 + ((0, 0),)).astype(np.float64)
    _go_on(around, lattice.shaft)
    return around


def _go_on(padded: np.ndarray, shaft: int) -> None:
    if shaft > 0:
        padded[:, :, -_PAD:] = padded[:, :, -_PAD - 1, None]
    if shaft < 0:
        padded[:, :, :_PAD] = padded[:, :, _PAD, None]


@kernel()
def _weights(t):  # type: ignore[no-untyped-def]
    """Uniform cubic B-splines of the four control points around a place that is t of a pitch beyond the second."""
    s = 1 - t
    return s**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (3 * s**3 - 6 * s**2 + 4) / 6, t**3 / 6


@kernel()
def _moved(points, origin, pitch, padded):  # type: ignore[no-untyped-def]
    moved = points.copy()
    start, weight = np.empty(3, np.int64), np.empty((3, 4))
    for n in range(len(points)):
        for axis in range(3):
            scaled = (points[n, axis] - origin[axis]) / pitch
            # Beyond the padding nothing changes any more.
            cell = min(max(np.floor(scaled), -2.0), padded.shape[axis] - 6.0)
            start[axis] = int(cell) + 2
            # One by one: to assign a tuple to a row takes numba seconds to compile.
            a, b, c, d = _weights(min(max(scaled - cell, 0.0), 1.0))
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
