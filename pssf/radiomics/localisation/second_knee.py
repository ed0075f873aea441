"""Detection of a second knee on a radiograph in which one knee joint has been located."""

from collections.abc import Sequence

import numpy as np

from ...core.checks import Array
from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import LocalisationSettings
from .joint_localisation import locate_joint
from .templates import MAX_SEARCH_PIXEL_MM, SIDES, Template

# Distance from the located medial joint line to the medial skin of the same knee, in mm; assumed.
_JOINT_LINE_TO_SKIN_MM = 35.0
# Minimum width of the image area that can show a complete second knee, in mm; assumed.
_KNEE_WIDTH_MM = 90.0


def has_second_knee(
    density: Array, side: str, col: float, pixel_mm: float, templates: Sequence[Template], table: LocalisationSettings
) -> bool:
    """Report whether a second knee is visible medial to a located joint.

    Parameters
    ----------
    density : (rows, cols) array, any unit
        Image values that increase or decrease with attenuation, with square pixels.
    side : {"right", "left"}
        Located knee: right or left.
    col : float
        Column of the medial joint line of the located knee, in pixels.
    pixel_mm : float
        Pixel size, in mm.
    templates : sequence of Template
        Template radiographs; see `locate_joint`.
    table : LocalisationSettings
        Search settings and rejection thresholds.

    Returns
    -------
    bool
        True if a second knee is found. False if none is found or the radiograph is too narrow for two knees.
    """
    other, away = SIDES[1 - SIDES.index(side)], round(_JOINT_LINE_TO_SKIN_MM / pixel_mm)
    # In the radiograph of a right knee, medial is on the right.
    beside = density[:, round(col) + away :] if side == SIDES[0] else density[:, : max(0, round(col) - away)]
    step = max(1, int(MAX_SEARCH_PIXEL_MM / pixel_mm))
    if beside.shape[1] * pixel_mm < _KNEE_WIDTH_MM or np.ptp(beside) == 0:
        return False
    match = locate_joint(downsample_by_blocks(beside, step), templates, table, side=other, pixel_mm=pixel_mm * step)
    return match.status == "found" and match.side_evidence > 0
