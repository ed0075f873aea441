"""integrate_density: segments in the knee, a region, struts -> integrals of density along them."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ..core.checks import Array
from .lattice import Block

# So near to a plane of voxels (in voxels) a place is taken as on it, which halves the work.
_ON_PLANE = 1e-6
# Nothing is left of the scar so many half thicknesses from it.
_FAR = 30.0

Triple = tuple[float, float, float]
Size = tuple[int, int, int]
Node = tuple[float, float, float, float, float, float, float]


class Region(NamedTuple):
    """The smooth part of one bone's density, as in `data/trabeculae.toml`; lengths inverted, for divisions take time.

    plate_medial, plate_lateral  relative rise of BV/TV at the subchondral plate, sclerosis included
    scar_x, scar_z, scar_bvtv    where this bone's scar is, and how strong
    marrow, per_bvtv             density without bone, and what a BV/TV of 1 adds to it
    """

    shaftward: float
    bvtv: float
    shaft: float
    fade_per_mm: float
    medial: float
    middle_mm: float
    load: float
    column_mm: float
    column_per_mm: float
    plate_medial: float
    plate_lateral: float
    plate_per_mm: float
    fan: float
    fan_mm: float
    joint: Triple
    below: float
    dips: tuple[Triple, Triple, Triple]
    gain: float
    gain_shaft: float
    scar_x: float
    scar_z: float
    scar_slope: float
    scar_bow_per_mm: float
    scar_bvtv: float
    scar_per_mm: float
    scar_wide_per_mm: float
    scale: float
    per_scale: float
    marrow: float
    per_bvtv: float


class Struts(NamedTuple):
    """The lattice, and where in it a bone lies.

    block   flat, of `size` voxels (x, z, y); times `unit`, its mean is 1
    per_mm  (3,)  voxels in a millimetre
    shift   (3,)  where in the lattice the bone's origin is, voxels
    """

    block: Block
    size: Size
    unit: float
    per_mm: Array
    shift: Array


class Steps(NamedTuple):
    """Samples a voxel, and samples over which the smooth part is taken as straight."""

    fine: int
    piece: int


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bell(x: float) -> float:
    fall = 1.0 / (1.0 + x * x)
    return fall * fall


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _smooth(region: Region, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Of a place in the bone: x in the fan of struts (mm), BV/TV, its swing, half thicknesses over the scar, scar."""
    x, y, z = x * region.per_scale, y * region.per_scale, z * region.per_scale
    down = max(region.shaftward * z, 0.0)
    near, far = region.fan_mm * region.fan_mm, down * down
    u = x * (near + far) / (near + (1.0 - region.fan) * far)
    fade = down * region.fade_per_mm
    fade = 1.0 / (1.0 + fade * fade * fade * fade)
    medial = x / math.sqrt(x * x + region.middle_mm * region.middle_mm)
    side = (abs(u) - region.column_mm) * region.column_per_mm
    mean = region.shaft + (region.bvtv - region.shaft) * fade
    mean *= (1.0 + region.medial * medial) * (1.0 + region.load * (1.0 - side * side) / (1.0 + side * side))
    surface = 0.0
    for dip in region.dips:
        if dip[2] != 0.0:
            surface += dip[2] * _bell((x - dip[0]) * dip[1])
    high, deep = min(z - surface - region.joint[1], region.below), y - region.joint[0]
    depth = max(region.joint[2] - math.sqrt(deep * deep + high * high), 0.0) * region.plate_per_mm
    plate = region.plate_medial * (0.5 + 0.5 * medial) + region.plate_lateral * (0.5 - 0.5 * medial)
    mean *= 1.0 + plate * fade * _bell(depth)
    swing = mean * (region.gain_shaft + (region.gain - region.gain_shaft) * fade)
    over = z - region.scar_z - region.scar_slope * x - region.scar_bow_per_mm * x * x
    scar = region.scar_bvtv * _bell((x - region.scar_x) * region.scar_wide_per_mm)
    return u * region.scale, mean, swing, over * region.scar_per_mm, scar


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _node(region: Region, per_mm: Array, shift: Array, x: float, y: float, z: float) -> Node:
    """Of a place in the bone: where it is in the lattice (x, z, y, voxels), and the rest of `_smooth`."""
    u, mean, swing, over, scar = _smooth(region, x, y, z)
    # So many voxels are whole periods, and keep a place positive, where cutting off the fraction rounds down.
    a, b, c = u * per_mm[0] + shift[0], z * per_mm[1] + shift[1], y * per_mm[2] + shift[2]
    return a + 65536.0, b + 65536.0, c + 65536.0 + _ON_PLANE / 2, mean, swing, over, scar


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _on_plane(block: Block, size: Size, a: float, b: float, k: int) -> float:
    """The lattice in one of its planes across y, at a place in voxels, all positive; linear between voxels."""
    i, j = int(a), int(b)
    k &= size[2] - 1
    near, far = (i & (size[0] - 1)) * size[1] * size[2], ((i + 1) & (size[0] - 1)) * size[1] * size[2]
    low, high = (j & (size[1] - 1)) * size[2] + k, ((j + 1) & (size[1] - 1)) * size[2] + k
    # Unsigned, so that no index is looked at for being negative.
    one, two = np.float64(block[np.uint64(near + low)]), np.float64(block[np.uint64(near + high)])
    three, four = np.float64(block[np.uint64(far + low)]), np.float64(block[np.uint64(far + high)])
    one += (b - j) * (two - one)
    return one + (a - i) * (three + (b - j) * (four - three) - one)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _value(struts: Struts, near: Node, step: Node, i: int) -> float:
    """BV/TV without the scar, i steps on from a node: mean + swing (lattice - 1)."""
    a, b, c = near[0] + i * step[0], near[1] + i * step[1], near[2] + i * step[2]
    k = int(c)
    strut = _on_plane(struts.block, struts.size, a, b, k)
    if c - k > _ON_PLANE:
        strut += (c - k) * (_on_plane(struts.block, struts.size, a, b, k + 1) - strut)
    return near[3] + i * step[3] + (near[4] + i * step[4]) * (struts.unit * strut - 1.0)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sum(struts: Struts, near: Node, step: Node, first: int, last: int) -> float:
    """Sum of the values from sample `first` up to, without it, `last`."""
    block, size, unit = struts.block, struts.size, struts.unit
    total, k, up = 0.0, int(near[2]), 1 if step[2] > 0.0 else -1
    # A plane a sample, which no other rays have: the same as below in two thirds of the time.
    if abs(step[2] - up) < 1e-9:
        for i in range(first, last):
            strut = _on_plane(block, size, near[0] + i * step[0], near[1] + i * step[1], k + i * up)
            total += near[3] + i * step[3] + (near[4] + i * step[4]) * (unit * strut - 1.0)
        return total
    for i in range(first, last):
        total += _value(struts, near, step, i)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _between(struts: Struts, near: Node, far: Node, start: float, stop: float, piece: int) -> float:
    """Integral of BV/TV over a piece from start to stop, in samples (0 to `piece`), straight between them."""
    by = 1.0 / piece
    x, z, y, mean = by * (far[0] - near[0]), by * (far[1] - near[1]), by * (far[2] - near[2]), by * (far[3] - near[3])
    step = (x, z, y, mean, by * (far[4] - near[4]), by * (far[5] - near[5]), by * (far[6] - near[6]))
    first, last = int(start), math.ceil(stop)
    low, high = _value(struts, near, step, first), _value(struts, near, step, last)
    total = (low + high) / 2 if last > first else 0.0
    total += _sum(struts, near, step, first + 1, last)
    # What of the first and the last step is outside.
    if start > first:
        then = _value(struts, near, step, first + 1)
        total -= (start - first) * (low + (then - low) * (start - first) / 2)
    if stop < last:
        then = _value(struts, near, step, last - 1)
        total -= (last - stop) * (high + (then - high) * (last - stop) / 2)
    if min(near[5], far[5]) > _FAR or max(near[5], far[5]) < -_FAR:
        return total
    # The scar's profile (1 + q^2)^-1.5 is the slope of q / sqrt(1 + q^2): exact however thin it is beside a sample.
    scar, one, two = (near[6] + far[6]) / 2, near[5] + start * step[5], near[5] + stop * step[5]
    if abs(step[5]) < 1e-7:
        return total + scar * (stop - start) * (1.0 + one * one) ** -1.5
    return total + scar * (two / math.sqrt(1.0 + two * two) - one / math.sqrt(1.0 + one * one)) / step[5]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _turned(into: Array, x: float, y: float, z: float, shifted: float) -> Triple:
    """A place in the knee frame as one in the bone's, or a way (shifted = 0)."""
    return (
        into[0, 0] * x + into[0, 1] * y + into[0, 2] * z + into[0, 3] * shifted,
        into[1, 0] * x + into[1, 1] * y + into[1, 2] * z + into[1, 3] * shifted,
        into[2, 0] * x + into[2, 1] * y + into[2, 2] * z + into[2, 3] * shifted,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def integrate_density(
    starts: Array, ends: Array, into: Array, struts: Struts, region: Region, steps: Steps, out: Array
) -> None:
    """Write the integral of relative density along each segment to `out`, mm.

    starts, ends  (n, 3)  knee frame, mm
    into          (3, 4)  transform into the bone's frame
    out           (n,)

    Samples keep their places wherever on its line a segment begins, so that its parts add up: for rays about along y
    they are on the planes of the lattice, for others at whole multiples of a step from the point nearest the origin.
    """
    per_mm, shift, fine, piece = struts.per_mm, struts.shift, steps.fine, steps.piece
    for n in range(len(starts)):
        x, y, z = _turned(into, starts[n, 0], starts[n, 1], starts[n, 2], 1.0)
        dx, dy, dz = _turned(into, ends[n, 0] - starts[n, 0], ends[n, 1] - starts[n, 1], ends[n, 2] - starts[n, 2], 0.0)
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        out[n] = region.marrow * length
        if length == 0.0:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        along, across = abs(dy) * per_mm[2], 2.0 * max(abs(dx) * per_mm[0], abs(dz) * per_mm[1])
        start, gap = x * dx + y * dy + z * dz, 1.0 / (across * fine)
        if along >= across:
            start, gap = (y + shift[2] / per_mm[2]) / dy, 1.0 / (along * fine)
        x, y, z = x - start * dx, y - start * dy, z - start * dz
        start, stop = start / gap, (start + length) / gap
        number, total = math.floor(start / piece) * piece, 0.0
        near = _node(region, per_mm, shift, x + number * gap * dx, y + number * gap * dy, z + number * gap * dz)
        while number < stop:
            then = (number + piece) * gap
            far = _node(region, per_mm, shift, x + then * dx, y + then * dy, z + then * dz)
            low, high = max(start - number, 0.0), min(stop - number, float(piece))
            total += _between(struts, near, far, low, high, piece)
            near, number = far, number + piece
        out[n] += region.per_bvtv * gap * total
