"""Array layout for the density integration: rows of the work array and storage format of the strut lattice."""

from typing import NamedTuple

from ...data.table_records import Triple
from .strut_lattice import VoxelBlock

# Number of segments that are processed side by side in one array.
LANES = 32
# Offsets of the rows of the work array that describe a segment. Each row has LANES elements, one per segment. A segment
# is divided into intervals, in which the smooth density component is linear.
(
    X,  # x coordinate of a point on the line of the segment, in mm
    Y,  # y coordinate of the point on the line of the segment, in mm
    Z,  # z coordinate of the point on the line of the segment, in mm
    DX,  # x component of the unit direction of the segment
    DY,  # y component of the unit direction of the segment
    DZ,  # z component of the unit direction of the segment
    STEP,  # length of a step along the line, in mm
    START,  # position on the line at which the segment begins, in steps
    STOP,  # position on the line at which the segment ends, in steps
    END,  # position on the line at which the current interval ends, in steps
    LENGTH,  # length of the segment, in mm
    TOTAL,  # integral of BV/TV up to the current interval, in steps
    LOW,  # start of the overlap of segment and current interval, in steps from the start of the interval
    HIGH,  # end of the overlap of segment and current interval, in steps from the start of the interval
) = range(0, 14 * LANES, LANES)
# Offsets of three blocks of rows that describe the current interval of each segment. Each block consists of the seven
# rows from A to SCAR.
(
    NEAR,  # values at the near end of the interval
    FAR,  # values at the far end of the interval
    RISE,  # change from one sample to the next
) = range(14 * LANES, 35 * LANES, 7 * LANES)
# Offsets of the rows within a block that describes an interval.
(
    A,  # lattice coordinate along x, in voxels
    B,  # lattice coordinate along z, in voxels
    C,  # lattice coordinate along y, in voxels
    SWING,  # contrast of the struts, in BV/TV
    REST,  # BV/TV minus the contrast of the struts
    OVER,  # height above the physeal scar, as a multiple of half the scar thickness
    SCAR,  # BV/TV that the physeal scar adds
) = range(0, 7 * LANES, LANES)
# Offsets of the rows that describe the current sample and the current interval.
(
    ONE,  # lattice value at the first corner around the sample
    TWO,  # lattice value at the neighbouring corner along z
    THREE,  # lattice value at the neighbouring corner along x
    FOUR,  # lattice value at the diagonally opposite corner
    ADDED,  # integral of BV/TV without struts over the current interval, in steps
) = range(35 * LANES, 40 * LANES, LANES)

# Largest distance from a voxel plane at which a point is treated as on the plane, in voxels. Points on a plane need
# half the computation.
PLANE_TOLERANCE = 1e-6
# Offset that keeps lattice coordinates positive, so that truncation rounds down, in voxels. It is a multiple of all
# lattice periods.
PERIOD_OFFSET = 65536.0


class StrutVoxels(NamedTuple):
    """Strut lattice and its position in one bone.

    Attributes
    ----------
    voxels : ((nx + 1) * (nz + 1) * ny,) uint8 array
        Bone content of the voxels, from 0 (none) to 255 (solid). The first voxel along x and along z is repeated after
        the last voxel.
    size : (int, int, int)
        Numbers of voxels nx, nz and ny in one period; each number is a power of two.
    normalisation : float
        Factor that normalises the mean of the lattice to 1, dimensionless.
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
