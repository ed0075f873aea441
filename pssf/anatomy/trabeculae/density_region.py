"""Density parameters: smooth component of the trabecular density of one bone, as numbers for compiled code."""

from typing import NamedTuple

from ...data.table_records import Triple


class DensityParameters(NamedTuple):
    """Smooth component of the trabecular density of one bone, from `data/trabeculae.toml`.

    Lengths that are used only as divisors are stored as inverses, because divisions are slow. Lengths are at template
    size unless stated otherwise. Heights and depths are along z, and the midline is x = 0.

    Attributes
    ----------
    shaft_direction : float
        Direction of the shaft along z, +1 or -1; 0 for a bone without a shaft.
    bvtv : float
        Bone volume fraction (BV/TV) in the epiphysis, dimensionless.
    shaft : float
        BV/TV in the shaft far from the joint, dimensionless.
    fade_per_mm : float
        Inverse of the depth at which BV/TV is halfway between `bvtv` and `shaft`, in 1/mm.
    medial : float
        Relative increase in BV/TV in the medial compartment, and equal decrease in the lateral compartment,
        dimensionless.
    middle_mm : float
        Width of the transition between the medial and lateral compartment, in mm.
    load : float
        Relative increase in BV/TV in the columns below the condyles, and decrease between these columns, dimensionless.
    column_mm : float
        Distance of the columns below the condyles from the midline, in mm.
    column_per_mm : float
        Inverse of the half width of the columns below the condyles, in 1/mm.
    margin_mm : float
        Distance from the midline beyond which BV/TV decreases, in mm.
    margin_per_mm : float
        Inverse of the distance beyond `margin_mm` at which BV/TV has decreased by half, in 1/mm.
    plate : float
        Relative increase in BV/TV at the subchondral bone plate, dimensionless.
    plate_per_mm : float
        Inverse of the depth at which the increase at the subchondral bone plate has decreased by half, in 1/mm.
    plate_struts : float
        Fraction of the increase at the subchondral bone plate that is due to thicker struts, dimensionless.
    plate_medial : float
        Relative increase in `plate` in the medial compartment, and decrease in the lateral compartment, dimensionless.
    between : float
        Fraction of the increase at the subchondral bone plate that is absent below the medial spine, dimensionless.
    between_mm : float
        Position along x of the reduction below the medial spine, in mm.
    between_per_mm : float
        Inverse of the distance from `between_mm` at which the reduction has decreased to a quarter of its maximum, in
        1/mm.
    struts : float
        Relative increase in strut contrast near the joint, dimensionless.
    struts_per_mm : float
        Inverse of the depth at which the increase in strut contrast has decreased to a quarter of its maximum, in 1/mm.
    hard_medial : float
        Relative increase in BV/TV due to sclerosis in the medial compartment, dimensionless.
    hard_lateral : float
        Relative increase in BV/TV due to sclerosis in the lateral compartment, dimensionless.
    hard_per_mm : float
        Inverse of the depth at which the increase due to sclerosis has decreased to a quarter of its maximum, in 1/mm.
    strut_convergence : float
        Fraction by which the struts converge in the shaft far from the joint, dimensionless.
    strut_convergence_mm : float
        Distance from the joint along the shaft at which the struts have completed half of their convergence, in mm.
    strut_flattening : float
        Factor by which horizontal struts are closer together and vertical struts farther apart than in the lattice,
        dimensionless.
    joint : (float, float, float)
        Circle in the sagittal plane that approximates the joint surface: centre y, centre z and radius, in mm.
    below : float
        Height above the centre of the circle `joint` beyond which the joint surface continues vertically, in mm.
    dips : three of (float, float, float)
        Elevations of the joint surface along x: centre in mm, inverse of the half width in 1/mm, and height in mm.
    rim : float
        Fraction of the bone that is absent in the rim of the medial plateau, dimensionless.
    rim_from_mm : float
        Distance from the midline at which the rim begins, in mm.
    rim_mm : float
        Depth below the nominal joint surface at which the rim ends, in mm.
    rim_per_mm : float
        Inverse of the width of the transitions at the two borders of the rim, in 1/mm.
    gain : float
        Contrast of the struts, from 0 (no contrast) to 1 (no bone between the struts).
    gain_load : float
        Relative increase in strut contrast in the columns below the condyles, dimensionless.
    gain_shaft : float
        Contrast of the struts in the shaft far from the joint, from 0 to 1.
    scar_off_mm : float
        Distance from the midline to the strongest medial and lateral points of the physeal scar, in mm.
    scar_y : float
        Centre of the dome of the physeal scar along y, in mm.
    scar_z : float
        Height of the physeal scar at its centre, in mm.
    scar_phase : float
        Phase of the ripple of the physeal scar, in rad.
    scar_slope : float
        Slope of the physeal scar in the medial direction, in mm per mm.
    scar_bow_per_mm : float
        Quadratic coefficient of the mediolateral bow of the physeal scar, in 1/mm: the scar height changes by this
        value times x^2.
    scar_dome_per_mm : float
        Quadratic coefficient of the dome of the physeal scar, in 1/mm: the scar height changes by this value times
        (y - scar_y)^2.
    scar_ripple_mm : float
        Amplitude of the ripple of the physeal scar, in mm.
    scar_ripple_per_mm : float
        Angular frequency of the ripple of the physeal scar along x, in rad/mm.
    scar_bvtv : float
        Largest BV/TV that the physeal scar adds, dimensionless.
    scar_lateral : float
        Fraction of `scar_bvtv` in the lateral compartment, dimensionless.
    scar_medial : float
        Fraction of `scar_bvtv` in the medial compartment, dimensionless.
    scar_per_mm : float
        Inverse of half the thickness of the physeal scar, in 1/mm.
    scar_wide_per_mm : float
        Inverse width of the physeal scar, in 1/mm. The width is the distance along x from each BV/TV peak of the scar
        to the point where the contribution of this peak has fallen to a quarter.
    sway_mm : float
        Amplitude of the sideways waviness of the struts, in mm at actual size.
    sway_per_mm : float
        Angular frequency of the sideways waviness along z, in rad/mm.
    sway_across : float
        Angular frequency of the sideways waviness along x, as a fraction of the frequency along z.
    sway_phase : float
        Phase of the sideways waviness, in rad.
    scale : float
        Size of the bone relative to the template, dimensionless.
    per_scale : float
        Inverse of `scale`, dimensionless.
    marrow : float
        Relative density of bone marrow without bone, dimensionless.
    per_bvtv : float
        Relative density that a BV/TV of 1 adds, dimensionless.
    """

    shaft_direction: float
    bvtv: float
    shaft: float
    fade_per_mm: float
    medial: float
    middle_mm: float
    load: float
    column_mm: float
    column_per_mm: float
    margin_mm: float
    margin_per_mm: float
    plate: float
    plate_per_mm: float
    plate_struts: float
    plate_medial: float
    between: float
    between_mm: float
    between_per_mm: float
    struts: float
    struts_per_mm: float
    hard_medial: float
    hard_lateral: float
    hard_per_mm: float
    strut_convergence: float
    strut_convergence_mm: float
    strut_flattening: float
    joint: Triple
    below: float
    dips: tuple[Triple, Triple, Triple]
    rim: float
    rim_from_mm: float
    rim_mm: float
    rim_per_mm: float
    gain: float
    gain_load: float
    gain_shaft: float
    scar_off_mm: float
    scar_y: float
    scar_z: float
    scar_phase: float
    scar_slope: float
    scar_bow_per_mm: float
    scar_dome_per_mm: float
    scar_ripple_mm: float
    scar_ripple_per_mm: float
    scar_bvtv: float
    scar_lateral: float
    scar_medial: float
    scar_per_mm: float
    scar_wide_per_mm: float
    sway_mm: float
    sway_per_mm: float
    sway_across: float
    sway_phase: float
    scale: float
    per_scale: float
    marrow: float
    per_bvtv: float
