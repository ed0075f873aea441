"""integrate_density: segments in the knee, a region, a lattice -> integrals of density along them.

So many segments are worked on at a time, side by side in one array: loops over them all compile to vector instructions.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel
from ..data.records import Triple
from .lattice import Block
from .region import Region

LANES = 16
# Rows of the array, in steps of LANES. Of a segment's line: a point, its direction, the length of a step, where on it
# the segment begins and ends and the present piece ends, in steps; the segment's length, the integral so far, and what
# of the present piece is within the segment, in steps.
_X, _Y, _Z, _DX, _DY, _DZ, _STEP, _START, _STOP, _END, _LENGTH, _TOTAL, _LOW, _HIGH = range(0, 14 * LANES, LANES)
# Of the present piece: its near end, its far end, and the change from one sample to the next, each with rows as below.
_NEAR, _FAR, _RISE = range(14 * LANES, 35 * LANES, 7 * LANES)
# Where it is in the lattice (x, z, y, in voxels), the contrast of struts, BV/TV less that, half thicknesses over the
# scar, BV/TV that the scar adds.
_A, _B, _C, _SWING, _REST, _OVER, _SCAR = range(0, 7 * LANES, LANES)
# Of the present sample: the lattice at four corners around it.
_ONE, _TWO, _THREE, _FOUR = range(35 * LANES, 39 * LANES, LANES)

# So near to a plane of voxels (in voxels) a place is taken as on it, which halves the work.
_ON_PLANE = 1e-6
# So many voxels are whole periods, and keep a place positive, where cutting off the fraction rounds down.
_PERIODS = 65536.0
# Nothing is left of the scar so many half thicknesses from it.
_SCAR_ENDS = 30.0

# Pi in two parts, and Taylor's series of the sine from x^21 down to x^3: 2e-18 is left at a quarter turn.
_PI = (3.1415926534682512, 1.2154201013012384e-10)
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(10, 0, -1))

Places = NDArray[np.int32]


class Struts(NamedTuple):
    """The lattice as a bone has it.

    voxels  ((nx + 1) x (nz + 1) x ny,)  bone content of voxels, the first in x and in z once more after the last
    size    (nx, nz, ny), powers of two; the lattice repeats after so many voxels
    unit    what makes its mean 1
    per_mm  voxels in a millimetre, along x, z, y
    shift   where in it the bone's origin is, in voxels, along x, z, y
    """

    voxels: Block
    size: tuple[int, int, int]
    unit: float
    per_mm: Triple
    shift: Triple


class Steps(NamedTuple):
    """Samples a voxel, and samples over which the smooth part is taken as straight."""

    fine: int
    piece: int


@callee()
def _bell(x: float) -> float:
    fall = 1.0 / (1.0 + x * x)
    return fall * fall


@callee()
def _step(x: float) -> float:
    return 1.0 / (1.0 + x * x * x * x * x * x)


@callee()
def _sigmoid(x: float) -> float:
    return 0.5 + 0.5 * x / math.sqrt(1.0 + x * x)


@callee()
def _sine(x: float) -> float:
    """Sine of up to thousands of radians, to 3e-16: as arithmetic, so that loops with it compile to vectors too."""
    half = np.int32(x * (1.0 / math.pi) + (_PERIODS + 0.5))
    # Whole half turns are taken off by pi in two parts, of which the first has room for the product.
    x = (x - (half - _PERIODS) * _PI[0]) - (half - _PERIODS) * _PI[1]
    square, series = x * x, 0.0
    for term in _SINE:
        series = term + square * series
    value = x + x * (square * series)
    return value if half & 1 == 0 else -value


@callee()
def _left_in_rim(x: float, below_mm: float, region: Region) -> float:
    """Share of its bone that a place has: 1 but in the medial plateau's rim, above the floor."""
    beyond, above = x - region.rim_from_mm, region.rim_mm - below_mm
    return 1.0 - region.rim * _sigmoid(beyond * region.rim_per_mm) * _sigmoid(above * region.rim_per_mm)


@callee()
def _over_scar(x: float, y: float, z: float, region: Region) -> float:
    """Height of a place over the sheet of the physeal scar, mm."""
    back = y - region.scar_y
    over = z - region.scar_z - region.scar_slope * x - region.scar_bow_per_mm * x * x
    over -= region.scar_dome_per_mm * back * back
    return over - region.scar_ripple_mm * _sine(x * region.scar_ripple_per_mm + region.scar_phase)


@callee()
def _aside(across: float, up: float, region: Region) -> float:
    """How far struts sway at a place, mm: two waves whose lengths have no common period, leaning to either side."""
    wave, other = up * region.sway_per_mm + region.sway_phase, across * region.sway_per_mm * region.sway_across
    return region.sway_mm * (_sine(wave + other) + 0.6 * _sine(1.618 * (wave - other)))


@callee()
def _nodes(lanes: Array, region: Region, struts: Struts) -> None:
    """Fill in the far ends of pieces."""
    for n in range(LANES):
        at = lanes[_END + n] * lanes[_STEP + n]
        true_x = lanes[_X + n] + at * lanes[_DX + n]
        true_y, true_z = lanes[_Y + n] + at * lanes[_DY + n], lanes[_Z + n] + at * lanes[_DZ + n]
        x, y, z = true_x * region.per_scale, true_y * region.per_scale, true_z * region.per_scale
        down = max(region.shaftward * z, 0.0)
        near, far = region.fan_mm * region.fan_mm, down * down
        u = x * (near + far) / (near + (1.0 - region.fan) * far)
        fade = down * region.fade_per_mm
        fade = 1.0 / (1.0 + fade * fade * fade * fade)
        medial = x / math.sqrt(x * x + region.middle_mm * region.middle_mm)
        side = (abs(u) - region.column_mm) * region.column_per_mm
        mean = region.shaft + (region.bvtv - region.shaft) * fade
        mean *= (1.0 + region.medial * medial) * (1.0 + region.load * (1.0 - side * side) / (1.0 + side * side))
        mean /= 1.0 + (max(abs(x) - region.margin_mm, 0.0) * region.margin_per_mm) ** 2
        surface = 0.0
        for dip in region.dips:
            surface += dip[2] * _bell((x - dip[0]) * dip[1])
        high, deep = min(z - surface - region.joint[1], region.below), y - region.joint[0]
        below = region.joint[2] - math.sqrt(deep * deep + high * high)
        depth = max(below, 0.0)
        mean *= _left_in_rim(x, below, region)
        hard = region.hard_medial * (0.5 + 0.5 * medial) + region.hard_lateral * (0.5 - 0.5 * medial)
        rise = region.plate * (1.0 + region.plate_medial * medial)
        rise *= 1.0 - region.between * _bell((x - region.between_mm) * region.between_per_mm)
        plate = rise * _step(depth * region.plate_per_mm)
        swing = mean * (region.gain_shaft + (region.gain - region.gain_shaft) * fade)
        swing *= (1.0 + region.plate_struts * plate * fade) * (
            1.0 + region.struts * _bell(depth * region.struts_per_mm)
        )
        mean *= 1.0 + (plate + hard * _bell(depth * region.hard_per_mm)) * fade
        swing = min(swing, mean)
        across = (u * region.scale + _aside(u, true_z, region)) / region.squat
        up = true_z * region.squat
        lanes[_FAR + _A + n] = across * struts.per_mm[0] + struts.shift[0] + _PERIODS
        lanes[_FAR + _B + n] = up * struts.per_mm[1] + struts.shift[1] + _PERIODS
        lanes[_FAR + _C + n] = true_y * struts.per_mm[2] + struts.shift[2] + _PERIODS + _ON_PLANE / 2
        lanes[_FAR + _SWING + n], lanes[_FAR + _REST + n] = swing, mean - swing
        lanes[_FAR + _OVER + n] = _over_scar(x, y, z, region) * region.scar_per_mm
        lanes[_FAR + _SCAR + n] = region.scar_bvtv * _bell((x - region.scar_x) * region.scar_wide_per_mm)


@callee()
def _share(x: float) -> float:
    """Twice the area of a hat, which falls from 1 at 0 to 0 at -1 and 1, between 0 and x."""
    x = min(max(x, -1.0), 1.0)
    return x * (2.0 - abs(x))


@callee()
def _sample(lanes: Array, places: Places, struts: Struts, i: int, above: int) -> None:
    """Add what struts give at sample i of the pieces, in the lattice's plane below the place, or above it."""
    (nx, nz, ny), voxels = struts.size, struts.voxels
    row, col, unit = (nz + 1) * ny, ny, 0.5 * struts.unit
    # Of a place so far past a plane, this plane's share: 1 - c for the plane below, c for the one above.
    whole, part = 1.0 - above, 2.0 * above - 1.0
    for n in range(LANES):
        a = np.int32(lanes[_NEAR + _A + n] + i * lanes[_RISE + _A + n])
        b = np.int32(lanes[_NEAR + _B + n] + i * lanes[_RISE + _B + n])
        c = np.int32(lanes[_NEAR + _C + n] + i * lanes[_RISE + _C + n])
        places[n] = (a & (nx - 1)) * row + (b & (nz - 1)) * col + ((c + above) & (ny - 1))
    for n in range(LANES):
        place = np.uint64(places[n])  # unsigned, so that no index is looked at for being negative
        lanes[_ONE + n] = voxels[place]
        lanes[_TWO + n] = voxels[place + np.uint64(col)]
        lanes[_THREE + n] = voxels[place + np.uint64(row)]
        lanes[_FOUR + n] = voxels[place + np.uint64(row + col)]
    for n in range(LANES):
        a = lanes[_NEAR + _A + n] + i * lanes[_RISE + _A + n]
        b = lanes[_NEAR + _B + n] + i * lanes[_RISE + _B + n]
        c = lanes[_NEAR + _C + n] + i * lanes[_RISE + _C + n]
        a, b, c = a - np.int32(a), b - np.int32(b), c - np.int32(c)
        near = lanes[_ONE + n] + b * (lanes[_TWO + n] - lanes[_ONE + n])
        far = lanes[_THREE + n] + b * (lanes[_FOUR + n] - lanes[_THREE + n])
        beyond: float = c if c > _ON_PLANE else 0.0
        weight = (_share(lanes[_HIGH + n] - i) - _share(lanes[_LOW + n] - i)) * (whole + part * beyond)
        swing = lanes[_NEAR + _SWING + n] + i * lanes[_RISE + _SWING + n]
        lanes[_TOTAL + n] += unit * weight * swing * (near + a * (far - near))


@callee()
def _begin(lanes: Array, starts: Array, ends: Array, first: int, into: Array, struts: Struts, steps: Steps) -> None:
    """Fill in the lines of segments from number `first` on; after the last one that again, until all rows are full."""
    (px, pz, py), piece = struts.per_mm, steps.piece
    for n in range(LANES):
        k = min(first + n, len(starts) - 1)
        for axis in range(3):
            point, way = into[axis, 3], 0.0
            for j in range(3):
                point += into[axis, j] * starts[k, j]
                way += into[axis, j] * (ends[k, j] - starts[k, j])
            lanes[_X + axis * LANES + n], lanes[_DX + axis * LANES + n] = point, way
        x, y, z = lanes[_X + n], lanes[_Y + n], lanes[_Z + n]
        dx, dy, dz = lanes[_DX + n], lanes[_DY + n], lanes[_DZ + n]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        lanes[_LENGTH + n] = length
        if length == 0.0:
            dy = length = 1.0
        dx, dy, dz = dx / length, dy / length, dz / length
        along, across = abs(dy) * py, 2.0 * max(abs(dx) * px, abs(dz) * pz)
        start, step = x * dx + y * dy + z * dz, 1.0 / (across * steps.fine)
        if along >= across:
            start, step = (y + struts.shift[2] / py) / dy, 1.0 / (along * steps.fine)
        lanes[_X + n], lanes[_Y + n], lanes[_Z + n] = x - start * dx, y - start * dy, z - start * dz
        lanes[_DX + n], lanes[_DY + n], lanes[_DZ + n], lanes[_STEP + n] = dx, dy, dz, step
        lanes[_START + n], lanes[_STOP + n] = start / step, (start + lanes[_LENGTH + n]) / step
        lanes[_END + n], lanes[_TOTAL + n] = math.floor(lanes[_START + n] / piece) * piece, 0.0


@callee()
def _next_piece(lanes: Array, piece: int) -> tuple[int, int, int]:
    """Fill in the changes over a piece, and add what it gives without struts; returns first and last sample, planes."""
    for k in range(7 * LANES):
        lanes[_RISE + k] = (lanes[_FAR + k] - lanes[_NEAR + k]) / piece
    first, last, planes = piece, -1, 1
    for n in range(LANES):
        begin = lanes[_END + n] - piece
        low, high = max(lanes[_START + n] - begin, 0.0), min(lanes[_STOP + n] - begin, float(piece))
        lanes[_LOW + n], lanes[_HIGH + n] = low, max(low, high)
        if not low < high:
            continue
        first, last = min(first, int(low)), max(last, math.ceil(high))
        # A plane a sample, unless it lies oblique: then between two.
        if abs(abs(lanes[_RISE + _C + n]) - 1.0) > 1e-9:
            planes = 2
        added = (high - low) * (lanes[_NEAR + _REST + n] + (low + high) / 2 * lanes[_RISE + _REST + n])
        over, rise, beyond = lanes[_NEAR + _OVER + n], lanes[_RISE + _OVER + n], lanes[_FAR + _OVER + n]
        # Told of the whole piece, so that its parts add up.
        if min(over, beyond) < _SCAR_ENDS and max(over, beyond) > -_SCAR_ENDS:
            one, two = over + low * rise, over + high * rise
            # The profile (1 + q^2)^-1.5 is the slope of q / sqrt(1 + q^2): exact however thin it is beside a sample.
            mean = (1.0 + one * one) ** -1.5
            if abs(rise) > 1e-7:
                mean = (two / math.sqrt(1.0 + two * two) - one / math.sqrt(1.0 + one * one)) / (two - one)
            added += (high - low) * mean * (lanes[_NEAR + _SCAR + n] + lanes[_FAR + _SCAR + n]) / 2
        lanes[_TOTAL + n] += added
    return first, last, planes


@kernel()
def integrate_density(
    starts: Array, ends: Array, into: Array, struts: Struts, region: Region, steps: Steps, out: Array
) -> None:
    """Write the integral of relative density along each segment to `out`, mm.

    starts, ends  (n, 3)  knee frame, mm
    into          (3, 4)  transform into the bone's frame, mm
    out           (n,)  mm

    Samples keep their places wherever on its line a segment begins, so that its parts add up: for rays about along y
    they are on the planes of the lattice, for others at whole multiples of a step from the point nearest the origin.
    """
    lanes, places = np.zeros(39 * LANES), np.empty(LANES, np.int32)
    for segment in range(0, len(starts), LANES):
        _begin(lanes, starts, ends, segment, into, struts, steps)
        _nodes(lanes, region, struts)
        more = True
        while more:
            for k in range(7 * LANES):
                lanes[_NEAR + k] = lanes[_FAR + k]
            more = False
            for n in range(LANES):
                lanes[_END + n] += steps.piece
                more |= lanes[_END + n] < lanes[_STOP + n]
            _nodes(lanes, region, struts)
            first, last, planes = _next_piece(lanes, steps.piece)
            for i in range(first, last + 1):
                for above in range(planes):
                    _sample(lanes, places, struts, i, above)
        for n in range(min(LANES, len(starts) - segment)):
            part = region.per_bvtv * lanes[_STEP + n] * lanes[_TOTAL + n]
            out[segment + n] = region.marrow * lanes[_LENGTH + n] + part
