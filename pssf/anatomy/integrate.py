"""integrate_density: segments in the knee, a region, a lattice -> integrals of density along them.

So many segments are worked on at a time, side by side in one array: loops over them all compile to vector instructions.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel
from . import rows as r
from .region import Region
from .rows import LANES, ON_PLANE, Struts
from .smooth import fill_nodes

# Nothing is left of the scar so many half thicknesses from it.
_SCAR_ENDS = 30.0

Places = NDArray[np.int32]


class Steps(NamedTuple):
    """Samples a voxel, and samples over which the smooth part is taken as straight."""

    fine: int
    piece: int


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
        a = np.int32(lanes[r.NEAR + r.A + n] + i * lanes[r.RISE + r.A + n])
        b = np.int32(lanes[r.NEAR + r.B + n] + i * lanes[r.RISE + r.B + n])
        c = np.int32(lanes[r.NEAR + r.C + n] + i * lanes[r.RISE + r.C + n])
        places[n] = (a & (nx - 1)) * row + (b & (nz - 1)) * col + ((c + above) & (ny - 1))
    for n in range(LANES):
        place = np.uint64(places[n])  # unsigned, so that no index is looked at for being negative
        lanes[r.ONE + n] = voxels[place]
        lanes[r.TWO + n] = voxels[place + np.uint64(col)]
        lanes[r.THREE + n] = voxels[place + np.uint64(row)]
        lanes[r.FOUR + n] = voxels[place + np.uint64(row + col)]
    for n in range(LANES):
        a = lanes[r.NEAR + r.A + n] + i * lanes[r.RISE + r.A + n]
        b = lanes[r.NEAR + r.B + n] + i * lanes[r.RISE + r.B + n]
        c = lanes[r.NEAR + r.C + n] + i * lanes[r.RISE + r.C + n]
        a, b, c = a - np.int32(a), b - np.int32(b), c - np.int32(c)
        near = lanes[r.ONE + n] + b * (lanes[r.TWO + n] - lanes[r.ONE + n])
        far = lanes[r.THREE + n] + b * (lanes[r.FOUR + n] - lanes[r.THREE + n])
        beyond: float = c if c > ON_PLANE else 0.0
        weight = (_share(lanes[r.HIGH + n] - i) - _share(lanes[r.LOW + n] - i)) * (whole + part * beyond)
        swing = lanes[r.NEAR + r.SWING + n] + i * lanes[r.RISE + r.SWING + n]
        lanes[r.TOTAL + n] += unit * weight * swing * (near + a * (far - near))


@callee()
def _begin(lanes: Array, starts: Array, ends: Array, first: int, into: Array, struts: Struts, steps: Steps) -> None:
    """Fill in the lines of segments from number `first` on; after the last one that again, until all rows are full."""
    (px, pz, py), piece = struts.per_mm, steps.piece
    for axis in range(3):
        one, two, three, shift = into[axis, 0], into[axis, 1], into[axis, 2], into[axis, 3]
        for n in range(LANES):
            k = min(first + n, len(starts) - 1)
            x, y, z = starts[k, 0], starts[k, 1], starts[k, 2]
            lanes[r.X + axis * LANES + n] = shift + one * x + two * y + three * z
            lanes[r.DX + axis * LANES + n] = one * (ends[k, 0] - x) + two * (ends[k, 1] - y) + three * (ends[k, 2] - z)
    for n in range(LANES):
        x, y, z = lanes[r.X + n], lanes[r.Y + n], lanes[r.Z + n]
        dx, dy, dz = lanes[r.DX + n], lanes[r.DY + n], lanes[r.DZ + n]
        whole = math.sqrt(dx * dx + dy * dy + dz * dz)
        length = whole if whole > 0.0 else 1.0
        dy = dy if whole > 0.0 else 1.0
        dx, dy, dz = dx / length, dy / length, dz / length
        along, across = abs(dy) * py, 2.0 * max(abs(dx) * px, abs(dz) * pz)
        by_plane = along >= across
        start = (y + struts.shift[2] / py) / dy if by_plane else x * dx + y * dy + z * dz
        step = 1.0 / (along * steps.fine if by_plane else across * steps.fine)
        lanes[r.X + n], lanes[r.Y + n], lanes[r.Z + n] = x - start * dx, y - start * dy, z - start * dz
        lanes[r.DX + n], lanes[r.DY + n], lanes[r.DZ + n], lanes[r.STEP + n] = dx, dy, dz, step
        lanes[r.LENGTH + n], lanes[r.START + n], lanes[r.STOP + n] = (
            whole,
            start / step,
            (start + whole) / step,
        )
        lanes[r.END + n], lanes[r.TOTAL + n] = math.floor(start / step / piece) * piece, 0.0


@callee()
def _next_piece(lanes: Array, piece: int) -> tuple[int, int, int]:
    """Fill in the changes over a piece, and add what it gives without struts; returns first and last sample, planes."""
    for k in range(7 * LANES):
        lanes[r.RISE + k] = (lanes[r.FAR + k] - lanes[r.NEAR + k]) / piece
    for n in range(LANES):
        begin = lanes[r.END + n] - piece
        low, high = max(lanes[r.START + n] - begin, 0.0), min(lanes[r.STOP + n] - begin, float(piece))
        high = max(low, high)
        lanes[r.LOW + n], lanes[r.HIGH + n] = low, high
        lanes[r.ADDED + n] = (high - low) * (lanes[r.NEAR + r.REST + n] + (low + high) / 2 * lanes[r.RISE + r.REST + n])
    _add_scar(lanes)
    first, last, planes = float(piece), -1.0, 1
    for n in range(LANES):
        lanes[r.TOTAL + n] += lanes[r.ADDED + n]
        if lanes[r.LOW + n] < lanes[r.HIGH + n]:
            first, last = min(first, lanes[r.LOW + n]), max(last, lanes[r.HIGH + n])
            # A plane a sample, unless it lies oblique: then between two.
            if abs(abs(lanes[r.RISE + r.C + n]) - 1.0) > 1e-9:
                planes = 2
    return int(first), math.ceil(last), planes


@callee()
def _scar_is_near(lanes: Array, n: int) -> bool:
    """Whether the physeal scar is near: told of the whole piece, so that its parts add up."""
    over, beyond = lanes[r.NEAR + r.OVER + n], lanes[r.FAR + r.OVER + n]
    return (lanes[r.LOW + n] < lanes[r.HIGH + n]) & (min(over, beyond) < _SCAR_ENDS) & (max(over, beyond) > -_SCAR_ENDS)


@callee()
def _add_scar(lanes: Array) -> None:
    """Add what the physeal scar gives over a piece, whose profile is (1 + q^2)^-1.5."""
    level = 0
    for n in range(LANES):
        low, high, over, rise = (
            lanes[r.LOW + n],
            lanes[r.HIGH + n],
            lanes[r.NEAR + r.OVER + n],
            lanes[r.RISE + r.OVER + n],
        )
        one, two = over + low * rise, over + high * rise
        # The profile is the slope of q / sqrt(1 + q^2): exact however thin it is beside a sample.
        mean = (two / math.sqrt(1.0 + two * two) - one / math.sqrt(1.0 + one * one)) / (two - one)
        added = (high - low) * mean * (lanes[r.NEAR + r.SCAR + n] + lanes[r.FAR + r.SCAR + n]) / 2
        near, steep = _scar_is_near(lanes, n), abs(rise) > 1e-7
        lanes[r.ADDED + n] += added if near & steep else 0.0
        level += near & (not steep)
    for n in range(LANES if level else 0):
        if _scar_is_near(lanes, n) and not abs(lanes[r.RISE + r.OVER + n]) > 1e-7:
            low, high = lanes[r.LOW + n], lanes[r.HIGH + n]
            one = lanes[r.NEAR + r.OVER + n] + low * lanes[r.RISE + r.OVER + n]
            mean = (1.0 + one * one) ** -1.5
            lanes[r.ADDED + n] += (high - low) * mean * (lanes[r.NEAR + r.SCAR + n] + lanes[r.FAR + r.SCAR + n]) / 2


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
    lanes, places = np.zeros(40 * LANES), np.empty(LANES, np.int32)
    for segment in range(0, len(starts), LANES):
        _begin(lanes, starts, ends, segment, into, struts, steps)
        fill_nodes(lanes, region, struts)
        more = True
        while more:
            for k in range(7 * LANES):
                lanes[r.NEAR + k] = lanes[r.FAR + k]
            more = False
            for n in range(LANES):
                lanes[r.END + n] += steps.piece
                more |= lanes[r.END + n] < lanes[r.STOP + n]
            fill_nodes(lanes, region, struts)
            first, last, planes = _next_piece(lanes, steps.piece)
            for i in range(first, last + 1):
                for above in range(planes):
                    _sample(lanes, places, struts, i, above)
        for n in range(min(LANES, len(starts) - segment)):
            part = region.per_bvtv * lanes[r.STEP + n] * lanes[r.TOTAL + n]
            out[segment + n] = region.marrow * lanes[r.LENGTH + n] + part
