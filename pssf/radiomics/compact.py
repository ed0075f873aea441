"""Templates with no more than localisation reads of them, so that a model can carry its own."""

from dataclasses import replace

import numpy as np

from ..core.blocks import block_mean
from ..data.localisation import Localisation
from .patches import LINEAR_MM, Template

# What blur and turns need beyond a patch and its margin of tiles.
_TILES, _MORE = 2.0, 1.15


def compact(template: Template, region_mm: float, table: Localisation) -> Template:
    """The template averaged to the pitch that it is looked at, and cut to what a patch or a region can reach.

    Joints are found with it as with the whole, to rounding.

    region_mm  side of the region about the joint line that must be in it as well, as far as the whole has it
    table      by which joints are looked for
    """
    laws = (table.wide, table.narrow)
    half = region_mm / 2
    up, down, side = (
        max(half, *(_MORE * (extent(law) + _TILES * law.tile_mm + 2 * law.pitch_mm) for law in laws))
        for extent in (
            lambda law: law.up_mm,
            lambda law: law.down_mm,
            lambda law: max(law.lateral_mm, law.medial_mm),
        )
    )
    step = max(1, int(LINEAR_MM / template.pixel_mm))
    pixels = block_mean(template.pixels, step)
    row, col = ((at - (step - 1) / 2) / step for at in (template.row, template.col))
    pitch = template.pixel_mm * step
    top, left = max(0, int(row - up / pitch)), max(0, int(col - side / pitch))
    cut = pixels[top : int(row + down / pitch) + 2, left : int(col + side / pitch) + 2]
    return replace(
        template, pixels=np.ascontiguousarray(cut, np.float32), row=row - top, col=col - left, pixel_mm=pitch
    )
