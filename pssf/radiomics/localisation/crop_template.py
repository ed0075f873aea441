"""Cropping of templates to the area that joint localisation uses, which makes them small enough for a model file."""

from dataclasses import replace

import numpy as np

from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import LocalisationSettings
from .templates import MAX_SEARCH_PIXEL_MM, Template

# Margin around an edge patch, in standard deviations of the edge normalisation window.
_TILES = 2.0
# Factor by which the cropped area is larger than an edge patch, to allow for blur and rotation; assumed.
_MORE = 1.15


def crop_template(template: Template, region_mm: float, table: LocalisationSettings) -> Template:
    """Downsample and crop a template to the pixel size and the area that joint localisation uses.

    Apart from rounding errors, localisation gives the same result with the full template and the cropped template.

    Parameters
    ----------
    template : Template
        Template to crop.
    region_mm : float
        Edge length of the region around the joint line that is always retained, in mm, as far as the template contains
        it.
    table : LocalisationSettings
        Search settings, which determine the cropped area.

    Returns
    -------
    Template
        Cropped template.
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
    step = max(1, int(MAX_SEARCH_PIXEL_MM / template.pixel_mm))
    pixels = downsample_by_blocks(template.pixels, step)
    row, col = ((at - (step - 1) / 2) / step for at in (template.row, template.col))
    pitch = template.pixel_mm * step
    top, left = max(0, int(row - up / pitch)), max(0, int(col - side / pitch))
    cut = pixels[top : int(row + down / pitch) + 2, left : int(col + side / pitch) + 2]
    return replace(
        template, pixels=np.ascontiguousarray(cut, np.float32), row=row - top, col=col - left, pixel_mm=pitch
    )
