"""Region: the smooth part of one bone's density, as numbers that compiled code takes."""

from typing import NamedTuple

from ..data.records import Triple


class Region(NamedTuple):
    """The smooth part of one bone's density, as in `data/trabeculae.toml`; lengths inverted, for divisions take time.

    plate                        relative rise of BV/TV at the subchondral plate
    struts, struts_per_mm        contrast of struts near the joint over that farther on, and how it falls
    hard_medial, hard_lateral    what sclerosis adds to it there, and deeper
    scar_off_mm, scar_y, scar_z  where this bone's scar is, on either side
    scar_phase, scar_bvtv        of its ripple, and how strong it is
    scar_lateral, scar_medial    shares of that on either side
    sway_mm, sway_per_mm         of struts from side to side, and the turn of their waves a mm
    sway_across, sway_phase      share of that turn across, and where in the waves the bone is
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
    fan: float
    fan_mm: float
    squat: float
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
