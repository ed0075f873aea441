"""Smooth density: evaluate the smooth density component and the lattice coordinates at interval ends."""

import math

import numpy as np

from ...core.checks import Array
from ...core.numba_kernel import kernel_helper
from . import segment_rows as r
from .density_region import DensityParameters
from .segment_rows import (
    LANES,
    PERIOD_OFFSET,
    PLANE_TOLERANCE,
    StrutVoxels,
)

# Pi as a sum of two numbers. Multiples of the first number are exact in double precision.
_PI = (3.1415926534682512, 1.2154201013012384e-10)
# Taylor coefficients of the sine from x^21 down to x^3. The truncation error at a quarter turn is 2e-18.
_SINE_COEFFICIENTS = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(10, 0, -1))


@kernel_helper()
def _bell(x: float) -> float:
    """Evaluate a bell-shaped curve, which is 1 at 0 and 0.25 at -1 and +1."""
    fall = 1.0 / (1.0 + x * x)
    return fall * fall


@kernel_helper()
def _evaluate_soft_step(x: float) -> float:
    """Evaluate a smooth step, which is 1 at 0, 0.5 at 1 and approaches 0 at infinity."""
    return 1.0 / (1.0 + x * x * x * x * x * x)


@kernel_helper()
def _sigmoid(x: float) -> float:
    """Evaluate a smooth step that increases from 0 at minus infinity to 1 at plus infinity."""
    return 0.5 + 0.5 * x / math.sqrt(1.0 + x * x)


@kernel_helper()
def _sine(x: float) -> float:
    """Compute the sine with an error of 3e-16, by arithmetic that compiles to vector instructions.

    The argument may be thousands of radians.
    """
    half = np.int32(x * (1.0 / math.pi) + (PERIOD_OFFSET + 0.5))
    # Entire half turns are subtracted in two steps, one for each summand of pi, because the product with the first
    # summand is exact.
    x = (x - (half - PERIOD_OFFSET) * _PI[0]) - (half - PERIOD_OFFSET) * _PI[1]
    square, series = x * x, 0.0
    for term in _SINE_COEFFICIENTS:
        series = term + square * series
    value = x + x * (square * series)
    return value if half & 1 == 0 else -value


@kernel_helper()
def _rim_bone_fraction(x: float, below_mm: float, region: DensityParameters) -> float:
    """Compute the BV/TV factor of the rim of the medial plateau: below 1 inside the rim, and 1 elsewhere."""
    beyond, above = x - region.rim_from_mm, region.rim_mm - below_mm
    return 1.0 - region.rim * _sigmoid(beyond * region.rim_per_mm) * _sigmoid(above * region.rim_per_mm)


@kernel_helper()
def _height_over_scar_mm(x: float, y: float, z: float, region: DensityParameters) -> float:
    """Compute the height of a point above the surface of the physeal scar, in mm."""
    back = y - region.scar_y
    over = z - region.scar_z - region.scar_slope * x - region.scar_bow_per_mm * x * x
    over -= region.scar_dome_per_mm * back * back
    return over - region.scar_ripple_mm * _sine(x * region.scar_ripple_per_mm + region.scar_phase)


@kernel_helper()
def _strut_sway_mm(across: float, up: float, region: DensityParameters) -> float:
    """Compute the sideways displacement of struts, in mm: the sum of two oblique waves without a common period."""
    wave, other = up * region.sway_per_mm + region.sway_phase, across * region.sway_per_mm * region.sway_across
    return region.sway_mm * (_sine(wave + other) + 0.6 * _sine(1.618 * (wave - other)))


@kernel_helper()
def _depth_below_joint_mm(x: float, y: float, z: float, region: DensityParameters) -> float:
    """Compute the depth of a point below the nominal joint surface of its bone, in mm, negative outside the bone."""
    surface = 0.0
    for dip in region.dips:
        surface += dip[2] * _bell((x - dip[0]) * dip[1])
    high, deep = min(z - surface - region.joint[1], region.below), y - region.joint[0]
    return region.joint[2] - math.sqrt(deep * deep + high * high)


@kernel_helper()
def fill_nodes(lanes: Array, region: DensityParameters, struts: StrutVoxels) -> None:
    """Write density and lattice coordinates at the far end of the current ray interval of each lane to the work array.

    Parameters
    ----------
    lanes : (40 * LANES,) float64 array, mm or voxels
        Work array with the rows of `segment_rows`. The block `FAR` is overwritten.
    region : DensityParameters
        Parameters of the smooth density component.
    struts : StrutVoxels
        Strut lattice and its position in the bone.
    """
    for n in range(LANES):
        at = lanes[r.END + n] * lanes[r.STEP + n]
        true_x = lanes[r.X + n] + at * lanes[r.DX + n]
        true_y, true_z = lanes[r.Y + n] + at * lanes[r.DY + n], lanes[r.Z + n] + at * lanes[r.DZ + n]
        x, y, z = true_x * region.per_scale, true_y * region.per_scale, true_z * region.per_scale
        down = max(region.shaft_direction * z, 0.0)
        near, far = region.strut_convergence_mm * region.strut_convergence_mm, down * down
        u = x * (near + far) / (near + (1.0 - region.strut_convergence) * far)
        fade = down * region.fade_per_mm
        fade = 1.0 / (1.0 + fade * fade * fade * fade)
        medial = x / math.sqrt(x * x + region.middle_mm * region.middle_mm)
        side = (abs(u) - region.column_mm) * region.column_per_mm
        mean = region.shaft + (region.bvtv - region.shaft) * fade
        column = (1.0 - side * side) / (1.0 + side * side)
        mean *= (1.0 + region.medial * medial) * (1.0 + region.load * column)
        mean /= 1.0 + (max(abs(x) - region.margin_mm, 0.0) * region.margin_per_mm) ** 2
        below = _depth_below_joint_mm(x, y, z, region)
        depth = max(below, 0.0)
        mean *= _rim_bone_fraction(x, below, region)
        hard = region.hard_medial * (0.5 + 0.5 * medial) + region.hard_lateral * (0.5 - 0.5 * medial)
        rise = region.plate * (1.0 + region.plate_medial * medial)
        rise *= 1.0 - region.between * _bell((x - region.between_mm) * region.between_per_mm)
        plate = rise * _evaluate_soft_step(depth * region.plate_per_mm)
        swing = mean * (region.gain_shaft + (region.gain - region.gain_shaft) * fade)
        swing *= (1.0 + region.plate_struts * plate * fade) * (1.0 + region.gain_load * column)
        swing *= 1.0 + region.struts * _bell(depth * region.struts_per_mm)
        mean *= 1.0 + (plate + hard * _bell(depth * region.hard_per_mm)) * fade
        swing = min(swing, mean)
        across = (u * region.scale + _strut_sway_mm(u, true_z, region)) / region.strut_flattening
        up = true_z * region.strut_flattening
        lanes[r.FAR + r.A + n] = across * struts.per_mm[0] + struts.shift[0] + PERIOD_OFFSET
        lanes[r.FAR + r.B + n] = up * struts.per_mm[1] + struts.shift[1] + PERIOD_OFFSET
        lanes[r.FAR + r.C + n] = true_y * struts.per_mm[2] + struts.shift[2] + PERIOD_OFFSET + PLANE_TOLERANCE / 2
        lanes[r.FAR + r.SWING + n], lanes[r.FAR + r.REST + n] = swing, mean - swing
        lanes[r.FAR + r.OVER + n] = _height_over_scar_mm(x, y, z, region) * region.scar_per_mm
        lateral = region.scar_lateral * _bell((x + region.scar_off_mm) * region.scar_wide_per_mm)
        lanes[r.FAR + r.SCAR + n] = region.scar_bvtv * (
            lateral + region.scar_medial * _bell((x - region.scar_off_mm) * region.scar_wide_per_mm)
        )
