"""Density integrals: integrate trabecular density along line segments.

A fixed number of segments is processed side by side in one array, so that the compiler vectorises all inner loops. Each
segment is divided into intervals. Within an interval, the smooth component of the density is interpolated linearly.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.numba_kernel import kernel, kernel_helper
from . import segment_rows as r
from .density_region import DensityParameters
from .segment_rows import LANES, PLANE_TOLERANCE, StrutVoxels
from .smooth_density import fill_nodes

# Distance beyond which the physeal scar is negligible, in multiples of half the scar thickness.
_SCAR_REACH = 30.0

VoxelIndices = NDArray[np.int32]


class SamplingSteps(NamedTuple):
    """Number of samples for the integration.

    Parameters
    ----------
    samples_per_voxel : int
        Samples per voxel of the strut lattice.
    samples_per_piece : int
        Samples per interval of a segment. The smooth density component is linear within an interval.
    """

    samples_per_voxel: int
    samples_per_piece: int


@kernel_helper()
def _integrate_hat(x: float) -> float:
    """Compute twice the integral from 0 to x of a hat function, which is 1 at 0 and 0 at -1 and 1."""
    x = min(max(x, -1.0), 1.0)
    return x * (2.0 - abs(x))


@kernel_helper()
def _add_sample(lanes: Array, places: VoxelIndices, struts: StrutVoxels, i: int, above: int) -> None:
    """Add the contribution of the struts at sample `i` of the intervals to the integrals.

    `above` selects the lattice plane: 0 for the plane below the sample, 1 for the plane above the sample.
    """
    (nx, nz, ny), voxels = struts.size, struts.voxels
    row, col, unit = (nz + 1) * ny, ny, 0.5 * struts.normalisation
    # Weights for linear interpolation at a fraction c beyond a plane: 1 - c for the plane below, c for the plane above.
    whole, part = 1.0 - above, 2.0 * above - 1.0
    for n in range(LANES):
        a = np.int32(lanes[r.NEAR + r.A + n] + i * lanes[r.RISE + r.A + n])
        b = np.int32(lanes[r.NEAR + r.B + n] + i * lanes[r.RISE + r.B + n])
        c = np.int32(lanes[r.NEAR + r.C + n] + i * lanes[r.RISE + r.C + n])
        places[n] = (a & (nx - 1)) * row + (b & (nz - 1)) * col + ((c + above) & (ny - 1))
    for n in range(LANES):
        place = np.uint64(places[n])  # An unsigned index avoids the check for negative indices.
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
        beyond: float = c if c > PLANE_TOLERANCE else 0.0
        weight = (_integrate_hat(lanes[r.HIGH + n] - i) - _integrate_hat(lanes[r.LOW + n] - i)) * (
            whole + part * beyond
        )
        swing = lanes[r.NEAR + r.SWING + n] + i * lanes[r.RISE + r.SWING + n]
        lanes[r.TOTAL + n] += unit * weight * swing * (near + a * (far - near))


@kernel_helper()
def _begin_segments(
    lanes: Array,
    starts: Array,
    ends: Array,
    first: int,
    bone_transform: Array,
    struts: StrutVoxels,
    steps: SamplingSteps,
) -> None:
    """Write the line parameters of consecutive segments, starting at number `first`, into the work array.

    The last segment is repeated until all lanes are full. `starts` and `ends` (n, 3) are in the knee frame, in mm;
    `bone_transform` (3, 4) maps them into the frame of the bone.
    """
    (px, pz, py), piece = struts.per_mm, steps.samples_per_piece
    for axis in range(3):
        one, two, three, shift = (
            bone_transform[axis, 0],
            bone_transform[axis, 1],
            bone_transform[axis, 2],
            bone_transform[axis, 3],
        )
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
        step = 1.0 / (along * steps.samples_per_voxel if by_plane else across * steps.samples_per_voxel)
        lanes[r.X + n], lanes[r.Y + n], lanes[r.Z + n] = x - start * dx, y - start * dy, z - start * dz
        lanes[r.DX + n], lanes[r.DY + n], lanes[r.DZ + n], lanes[r.STEP + n] = dx, dy, dz, step
        lanes[r.LENGTH + n], lanes[r.START + n], lanes[r.STOP + n] = (
            whole,
            start / step,
            (start + whole) / step,
        )
        lanes[r.END + n], lanes[r.TOTAL + n] = math.floor(start / step / piece) * piece, 0.0


@kernel_helper()
def _advance_piece(lanes: Array, piece: int) -> tuple[int, int, int]:
    """Compute the changes per sample in the current interval, and integrate the smooth density component.

    Return the first sample, the last sample and the number of lattice planes per sample.
    """
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
            # Each sample is on one lattice plane, or between two planes if the ray is oblique.
            if abs(abs(lanes[r.RISE + r.C + n]) - 1.0) > 1e-9:
                planes = 2
    return int(first), math.ceil(last), planes


@kernel_helper()
def _is_scar_near(lanes: Array, n: int) -> bool:
    """Test whether the physeal scar is near the current interval.

    The test considers the entire interval, so that the integrals of its subintervals add up.
    """
    over, beyond = lanes[r.NEAR + r.OVER + n], lanes[r.FAR + r.OVER + n]
    return (
        (lanes[r.LOW + n] < lanes[r.HIGH + n]) & (min(over, beyond) < _SCAR_REACH) & (max(over, beyond) > -_SCAR_REACH)
    )


@kernel_helper()
def _add_scar(lanes: Array) -> None:
    """Add the contribution of the physeal scar over an interval.

    The density profile of the scar is (1 + q^2)^-1.5, where q is the height above the scar divided by half the scar
    thickness.
    """
    level = 0
    for n in range(LANES):
        low, high, over, rise = (
            lanes[r.LOW + n],
            lanes[r.HIGH + n],
            lanes[r.NEAR + r.OVER + n],
            lanes[r.RISE + r.OVER + n],
        )
        one, two = over + low * rise, over + high * rise
        # The profile is the derivative of q / sqrt(1 + q^2), so the integral is exact for any scar thickness.
        mean = (two / math.sqrt(1.0 + two * two) - one / math.sqrt(1.0 + one * one)) / (two - one)
        added = (high - low) * mean * (lanes[r.NEAR + r.SCAR + n] + lanes[r.FAR + r.SCAR + n]) / 2
        near, steep = _is_scar_near(lanes, n), abs(rise) > 1e-7
        lanes[r.ADDED + n] += added if near & steep else 0.0
        level += near & (not steep)
    for n in range(LANES if level else 0):
        if _is_scar_near(lanes, n) and not abs(lanes[r.RISE + r.OVER + n]) > 1e-7:
            low, high = lanes[r.LOW + n], lanes[r.HIGH + n]
            one = lanes[r.NEAR + r.OVER + n] + low * lanes[r.RISE + r.OVER + n]
            mean = (1.0 + one * one) ** -1.5
            lanes[r.ADDED + n] += (high - low) * mean * (lanes[r.NEAR + r.SCAR + n] + lanes[r.FAR + r.SCAR + n]) / 2


@kernel()
def integrate_density(
    starts: Array,
    ends: Array,
    bone_transform: Array,
    struts: StrutVoxels,
    region: DensityParameters,
    steps: SamplingSteps,
    out: Array,
) -> None:
    """Integrate relative density along each segment and write the results to `out`.

    Parameters
    ----------
    starts : (n, 3) float64 array, mm
        Start points in the knee frame.
    ends : (n, 3) float64 array, mm
        End points in the knee frame.
    bone_transform : (3, 4) float64 array, mm
        Transform from the knee frame to the frame of the bone.
    struts : StrutVoxels
        Strut lattice and its position in the bone.
    region : DensityParameters
        Parameters of the smooth density component.
    steps : SamplingSteps
        Number of samples for the integration.
    out : (n,) float64 array, mm
        Output array, overwritten with the integrals of relative density.

    Notes
    -----
    Sample positions do not depend on where a segment begins on its line, so the integrals of consecutive segments add
    up. If a ray is approximately along y, the samples are on the lattice planes. Otherwise, the samples are at
    multiples of a step from the point on the ray nearest to the origin.
    """
    lanes, places = np.zeros(40 * LANES), np.empty(LANES, np.int32)
    for segment in range(0, len(starts), LANES):
        _begin_segments(lanes, starts, ends, segment, bone_transform, struts, steps)
        fill_nodes(lanes, region, struts)
        more = True
        while more:
            for k in range(7 * LANES):
                lanes[r.NEAR + k] = lanes[r.FAR + k]
            more = False
            for n in range(LANES):
                lanes[r.END + n] += steps.samples_per_piece
                more |= lanes[r.END + n] < lanes[r.STOP + n]
            fill_nodes(lanes, region, struts)
            first, last, planes = _advance_piece(lanes, steps.samples_per_piece)
            for i in range(first, last + 1):
                for above in range(planes):
                    _add_sample(lanes, places, struts, i, above)
        for n in range(min(LANES, len(starts) - segment)):
            part = region.per_bvtv * lanes[r.STEP + n] * lanes[r.TOTAL + n]
            out[segment + n] = region.marrow * lanes[r.LENGTH + n] + part
