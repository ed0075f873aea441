"""The one form that films are compared in: a right knee about its joint, one size, one field, one histogram.

Films differ in magnification, which is seldom known, and crops are resized. So millimetres here are those of a knee
whose plateau is PLATEAU_MM wide, edge to edge.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from ..core.blocks import area_mean
from ..core.checks import Array, InputError, require, require_choice

# Mean of people on films (Tiulpin et al. 2019, see `data/landmarks.toml`).
PLATEAU_MM = 78.0
# A pitch and a field that fixed-flexion crops of 224 x 224 pixels hold; most films resolve no less.
PITCH_MM = 0.46
ABOVE_MM, BELOW_MM, HALF_MM = 43.0, 34.0, 46.0
# Between these percentiles the greys are stretched over 8 bits: what is brighter or darker is marker or air.
_STRETCH = (1.0, 99.0)


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where on a film the middle of the joint is: on the joint line, half way between the edges of the plateau.

    row, col  pixels
    side      right | left, as the film shows it with columns to the right
    pitch_mm  of the film, at the standard size
    raises    InputError for an unknown side, or a pitch out of range
    """

    row: float
    col: float
    side: str
    pitch_mm: float

    def __post_init__(self) -> None:
        require_choice("side", self.side, ("right", "left"))
        require("pitch_mm", self.pitch_mm, 0.005, 10, "mm")

    def pixels_at(self, below_mm: Array, medial_mm: Array) -> tuple[Array, Array]:
        """Rows and columns of places told in mm from the joint's middle, distally and medially.

        below_mm, medial_mm  (n,) each, or of one shape
        """
        across = medial_mm if self.side == "right" else -medial_mm
        return self.row + below_mm / self.pitch_mm, self.col + across / self.pitch_mm

    def binned(self, pixels: float) -> "Place":
        """The same place on a film whose pixels are so many of this one's wide; 1 / n leads back from n."""
        row, col = ((at + 0.5) / pixels - 0.5 for at in (self.row, self.col))
        return Place(row=row, col=col, side=self.side, pitch_mm=self.pitch_mm * pixels)

    def moved(self, rows: float, cols: float) -> "Place":
        """So many pixels of the standard form farther down and towards medial."""
        row, col = self.pixels_at(np.array(rows * PITCH_MM), np.array(cols * PITCH_MM))
        return Place(row=float(row), col=float(col), side=self.side, pitch_mm=self.pitch_mm)


def made_smaller(film: Array, place: Place, pixels: float) -> tuple[Array, Place]:
    """A film in pixels that are the mean of so many by so many of its own, as crops are made, and a place on it.

    film    (rows, cols) grey, a display value
    pixels  1 or more, not whole in general
    """
    return (film, place) if pixels == 1 else (area_mean(film, pixels), place.binned(pixels))


def field_of(film: Array, place: Place) -> Array:
    """(168, 201) the field about the middle of a joint, as of a right knee: columns run from lateral to medial.

    What lies outside the film repeats its edge.

    film  (rows, cols) grey, a display value, bone bright
    """
    below: Array = np.arange(round(-ABOVE_MM / PITCH_MM), round(BELOW_MM / PITCH_MM) + 1, dtype=np.float64) * PITCH_MM
    half = round(HALF_MM / PITCH_MM)
    across: Array = np.arange(-half, half + 1, dtype=np.float64) * PITCH_MM
    rows, cols = place.pixels_at(below, across)
    # A coarser pixel holds the mean of its own area, as when crops of films are made smaller: by its variance, less
    # that of the pixels it is made of.
    coarser = PITCH_MM / place.pitch_mm
    blur = np.sqrt(max(coarser**2 - 1, 0.0) / 12)
    near, top, left = _about(film, rows, cols, round(5 * blur) + 1)
    smooth = gaussian_filter(near, blur, mode="nearest") if blur else near
    return np.asarray(
        map_coordinates(smooth, np.meshgrid(rows - top, cols - left, indexing="ij"), order=1, mode="nearest")
    )


def _about(film: Array, rows: Array, cols: Array, margin: int) -> tuple[Array, int, int]:
    """The part of a film that holds some rows and columns and a margin, and its first row and column."""
    starts, ends = [], []
    for places, length in ((rows, film.shape[0]), (cols, film.shape[1])):
        starts.append(int(np.clip(np.floor(places.min()) - margin, 0, length - 1)))
        ends.append(int(np.clip(np.ceil(places.max()) + margin + 1, starts[-1] + 1, length)))
    return film[starts[0] : ends[0], starts[1] : ends[1]], starts[0], starts[1]


def stretched(field: Array) -> Array:
    """(rows, cols) greys between the 1st and 99th percentile spread over 0 to 255, in whole numbers.

    field   (rows, cols)  grey
    raises  InputError for an image without contrast
    """
    low, high = np.percentile(field, _STRETCH)
    if not high > low:
        raise InputError(f"film: 98 % of its values lie between {low:g} and {high:g}; allowed: some contrast")
    return np.asarray(np.round(np.clip((field - low) / (high - low), 0, 1) * 255))


def joint_pixel() -> tuple[int, int]:
    """Row and column of the joint's middle in a standard form."""
    return round(ABOVE_MM / PITCH_MM), round(HALF_MM / PITCH_MM)
