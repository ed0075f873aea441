"""Array layout of the density integration: rows of the work array, and the strut lattice as the kernels read it."""

from typing import NamedTuple

from ...data.table_records import Triple
from .strut_lattice import VoxelBlock

# Number of segments that are processed side by side.
LANES = 32
# Offsets of the rows of the work array; each row has LANES elements, one per segment. These rows describe a segment. A
# segment is divided into intervals (pieces), in which the smooth part of the density is linear.
(
    X,  # x of a point on the line of the segment, mm
    Y,  # y of the point on the line, mm
    Z,  # z of the point on the line, mm
    DX,  # x of the unit direction
    DY,  # y of the unit direction
    DZ,  # z of the unit direction
    STEP,  # length of a step along the line, mm
    START,  # position on the line at which the segment begins, in steps
    STOP,  # position on the line at which the segment ends, in steps
    END,  # position on the line at which the current interval ends, in steps
    LENGTH,  # length of the segment, mm
    TOTAL,  # integral of BV/TV so far, in steps
    LOW,  # start of the part of the current interval inside the segment, in steps from the start of the interval
    HIGH,  # end of the part of the current interval inside the segment, in steps from the start of the interval
) = range(0, 14 * LANES, LANES)
# Offsets of three blocks of rows that describe the current interval of each segment. Each block consists of the seven
# rows A to SCAR below.
(
    NEAR,  # values at the near end of the interval
    FAR,  # values at the far end of the interval
    RISE,  # change from one sample to the next
) = range(14 * LANES, 35 * LANES, 7 * LANES)
# Offsets of the rows within each block.
(
    A,  # lattice coordinate along x, voxels
    B,  # lattice coordinate along z, voxels
    C,  # lattice coordinate along y, voxels
    SWING,  # contrast of the struts, BV/TV
    REST,  # BV/TV minus the contrast
    OVER,  # height above the physeal scar, in half thicknesses of the scar
    SCAR,  # BV/TV that the scar adds
) = range(0, 7 * LANES, LANES)
# Offsets of rows for the current sample and the current interval.
(
    ONE,  # lattice value at the first corner around the sample
    TWO,  # lattice value at the next corner along z
    THREE,  # lattice value at the next corner along x
    FOUR,  # lattice value at the opposite corner
    ADDED,  # integral of BV/TV over the current interval without struts, in steps
) = range(35 * LANES, 40 * LANES, LANES)

# Largest distance from a voxel plane at which a point counts as on the plane, in voxels; such points need half the
# work.
PLANE_TOLERANCE = 1e-6
# Offset that keeps lattice coordinates positive, in voxels, so that truncation equals floor. It is a multiple of all
# lattice periods.
PERIOD_OFFSET = 65536.0


class StrutVoxels(NamedTuple):
    """Strut lattice and its position in one bone.

    Attributes
    ----------
    voxels : ((nx + 1) * (nz + 1) * ny,) uint8 array
        Bone content of the voxels. The first voxel in x and in z is repeated after the last one.
    size : (int, int, int)
        Numbers of voxels nx, nz and ny of one period, powers of two.
    normalisation : float
        Factor that makes the mean of the lattice 1, dimensionless.
    per_mm : (float, float, float)
        Voxels per mm along x, z and y.
    shift : (float, float, float)
        Position of the origin of the bone in the lattice along x, z and y, in voxels.
    """

    voxels: VoxelBlock
    size: tuple[int, int, int]
    normalisation: float
    per_mm: Triple
    shift: Triple
