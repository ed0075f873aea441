"""fill_nodes: the smooth part of a bone's density, and where in the lattice its places are, at ends of pieces."""

import math

import numpy as np

from ..core.checks import Array
from ..core.compiled import callee
from . import rows as r
from .region import Region
from .rows import LANES, ON_PLANE, PERIODS, Struts

# Pi in two parts, and Taylor's series of the sine from x^21 down to x^3: 2e-18 is left at a quarter turn.
_PI = (3.1415926534682512, 1.2154201013012384e-10)
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(10, 0, -1))


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
    half = np.int32(x * (1.0 / math.pi) + (PERIODS + 0.5))
    # Whole half turns are taken off by pi in two parts, of which the first has room for the product.
    x = (x - (half - PERIODS) * _PI[0]) - (half - PERIODS) * _PI[1]
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
def _below_joint(x: float, y: float, z: float, region: Region) -> float:
    """How far within the bone a place is from its nominal joint surface, mm; negative outside."""
    surface = 0.0
    for dip in region.dips:
        surface += dip[2] * _bell((x - dip[0]) * dip[1])
    high, deep = min(z - surface - region.joint[1], region.below), y - region.joint[0]
    return region.joint[2] - math.sqrt(deep * deep + high * high)


@callee()
def fill_nodes(lanes: Array, region: Region, struts: Struts) -> None:
    """Fill in the far ends of pieces.

    lanes  (40 x LANES,)  rows as in `rows`; lengths in mm, or in voxels of the lattice
    """
    for n in range(LANES):
        at = lanes[r.END + n] * lanes[r.STEP + n]
        true_x = lanes[r.X + n] + at * lanes[r.DX + n]
        true_y, true_z = lanes[r.Y + n] + at * lanes[r.DY + n], lanes[r.Z + n] + at * lanes[r.DZ + n]
        x, y, z = true_x * region.per_scale, true_y * region.per_scale, true_z * region.per_scale
        down = max(region.shaftward * z, 0.0)
        near, far = region.fan_mm * region.fan_mm, down * down
        u = x * (near + far) / (near + (1.0 - region.fan) * far)
        fade = down * region.fade_per_mm
        fade = 1.0 / (1.0 + fade * fade * fade * fade)
        medial = x / math.sqrt(x * x + region.middle_mm * region.middle_mm)
        side = (abs(u) - region.column_mm) * region.column_per_mm
        mean = region.shaft + (region.bvtv - region.shaft) * fade
        column = (1.0 - side * side) / (1.0 + side * side)
        mean *= (1.0 + region.medial * medial) * (1.0 + region.load * column)
        mean /= 1.0 + (max(abs(x) - region.margin_mm, 0.0) * region.margin_per_mm) ** 2
        below = _below_joint(x, y, z, region)
        depth = max(below, 0.0)
        mean *= _left_in_rim(x, below, region)
        hard = region.hard_medial * (0.5 + 0.5 * medial) + region.hard_lateral * (0.5 - 0.5 * medial)
        rise = region.plate * (1.0 + region.plate_medial * medial)
        rise *= 1.0 - region.between * _bell((x - region.between_mm) * region.between_per_mm)
        plate = rise * _step(depth * region.plate_per_mm)
        swing = mean * (region.gain_shaft + (region.gain - region.gain_shaft) * fade)
        swing *= (1.0 + region.plate_struts * plate * fade) * (1.0 + region.gain_load * column)
        swing *= 1.0 + region.struts * _bell(depth * region.struts_per_mm)
        mean *= 1.0 + (plate + hard * _bell(depth * region.hard_per_mm)) * fade
        swing = min(swing, mean)
        across = (u * region.scale + _aside(u, true_z, region)) / region.squat
        up = true_z * region.squat
        lanes[r.FAR + r.A + n] = across * struts.per_mm[0] + struts.shift[0] + PERIODS
        lanes[r.FAR + r.B + n] = up * struts.per_mm[1] + struts.shift[1] + PERIODS
        lanes[r.FAR + r.C + n] = true_y * struts.per_mm[2] + struts.shift[2] + PERIODS + ON_PLANE / 2
        lanes[r.FAR + r.SWING + n], lanes[r.FAR + r.REST + n] = swing, mean - swing
        lanes[r.FAR + r.OVER + n] = _over_scar(x, y, z, region) * region.scar_per_mm
        lateral = region.scar_lateral * _bell((x + region.scar_off_mm) * region.scar_wide_per_mm)
        lanes[r.FAR + r.SCAR + n] = region.scar_bvtv * (
            lateral + region.scar_medial * _bell((x - region.scar_off_mm) * region.scar_wide_per_mm)
        )
