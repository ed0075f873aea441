"""A second knee on a radiograph: the other knee of a bilateral one, of which the joint of one knee was found."""

from collections.abc import Sequence

import numpy as np

from ..core.blocks import block_mean
from ..core.checks import Array
from ..data.localisation import Localisation
from .locate import locate
from .patches import LINEAR_MM, SIDES, Template

# From a medial joint line to the medial skin of the same knee, and the width of a knee that is whole on the film.
_OWN_HALF_MM = 35.0
_KNEE_MM = 90.0


def shows_other_knee(
    density: Array, side: str, col: float, pixel_mm: float, templates: Sequence[Template], table: Localisation
) -> bool:
    """Tell whether the knee of the other side is found medially of a joint that was found.

    Parameters
    ----------
    density : (rows, cols) array, any unit
        Square pixels of values that rise or fall with attenuation.
    side : str
        Of the knee that was found, "right" or "left".
    col : float
        Column of its medial joint line.
    pixel_mm : float
        Side of a pixel, in mm.
    templates, table
        As for `locate`.

    Returns
    -------
    bool
        False too where there is no room for a second knee.
    """
    other, away = SIDES[1 - SIDES.index(side)], round(_OWN_HALF_MM / pixel_mm)
    # Medial is to the right of a right knee.
    beside = density[:, round(col) + away :] if side == SIDES[0] else density[:, : max(0, round(col) - away)]
    step = max(1, int(LINEAR_MM / pixel_mm))
    if beside.shape[1] * pixel_mm < _KNEE_MM or np.ptp(beside) == 0:
        return False
    match = locate(block_mean(beside, step), templates, table, side=other, pixel_mm=pixel_mm * step)
    return match.status == "found" and match.side_evidence > 0
