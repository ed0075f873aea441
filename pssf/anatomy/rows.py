"""Rows of the array in which segments are integrated over, side by side; and the lattice as they read it."""

from typing import NamedTuple

from ..data.records import Triple
from .lattice import Block

# Segments at a time.
LANES = 32
# Rows of the array, in steps of LANES. Of a segment's line: a point, its direction, the length of a step, where on it
# the segment begins and ends and the present piece ends, in steps; the segment's length, the integral so far, and what
# of the present piece is within the segment, in steps.
X, Y, Z, DX, DY, DZ, STEP, START, STOP, END, LENGTH, TOTAL, LOW, HIGH = range(0, 14 * LANES, LANES)
# Of the present piece: its near end, its far end, and the change from one sample to the next, each with rows as below.
NEAR, FAR, RISE = range(14 * LANES, 35 * LANES, 7 * LANES)
# Where it is in the lattice (x, z, y, in voxels), the contrast of struts, BV/TV less that, half thicknesses over the
# scar, BV/TV that the scar adds.
A, B, C, SWING, REST, OVER, SCAR = range(0, 7 * LANES, LANES)
# Of the present sample: the lattice at four corners around it. What the present piece adds without struts.
ONE, TWO, THREE, FOUR, ADDED = range(35 * LANES, 40 * LANES, LANES)

# So near to a plane of voxels (in voxels) a place is taken as on it, which halves the work.
ON_PLANE = 1e-6
# So many voxels are whole periods, and keep a place positive, where cutting off the fraction rounds down.
PERIODS = 65536.0


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
