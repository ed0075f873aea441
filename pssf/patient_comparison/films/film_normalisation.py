"""Normalise radiographs: mirror left knees, centre the joint, and equalise size, field and grey range.

Notes
-----
The magnification of patient radiographs is seldom known, and published crops are resampled. Lengths are therefore
normalised: every tibial plateau is PLATEAU_MM wide from edge to edge.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from ...core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
)
from ...core.resample import downsample_by_area

# Normalised plateau width, in mm: the mean of patient radiographs (Tiulpin et al. 2019, see `data/landmarks.toml`).
PLATEAU_MM = 78.0
# Normalised pixel pitch, in mm. Fixed-flexion crops of 224 x 224 pixels have about this pitch; most radiographs have a
# finer pitch.
PITCH_MM = 0.46
# Height of the field above the joint centre, in mm.
ABOVE_MM = 43.0
# Depth of the field below the joint centre, in mm.
BELOW_MM = 34.0
# Half width of the field, in mm.
HALF_MM = 46.0
# Grey-value percentiles that are mapped to 0 and 255; pixels outside this range show markers or air.
_STRETCH_PERCENTILES = (1.0, 99.0)


@dataclass(frozen=True, kw_only=True)
class JointPosition:
    """Position of the joint centre on a radiograph: on the joint line, midway between the plateau edges.

    Parameters
    ----------
    row : float
        Row coordinate of the joint centre, in pixels.
    col : float
        Column coordinate of the joint centre, in pixels.
    side : {"right", "left"}
        Side of the displayed knee.
    pitch_mm : float
        Pixel pitch in normalised mm, 0.005 to 10 mm.

    Raises
    ------
    InputError
        `side` is unknown or `pitch_mm` is out of range.
    """

    row: float
    col: float
    side: str
    pitch_mm: float

    def __post_init__(self) -> None:
        require_choice("side", self.side, ("right", "left"))
        require_in_range("pitch_mm", self.pitch_mm, 0.005, 10, "mm")

    def to_pixels(self, below_mm: Array, medial_mm: Array) -> tuple[Array, Array]:
        """Convert positions relative to the joint centre to pixels.

        Parameters
        ----------
        below_mm : (n,) array
            Distance distal to the joint centre, in mm.
        medial_mm : (n,) array
            Distance medial to the joint centre, in mm.

        Returns
        -------
        rows : (n,) array
            Row coordinates in pixels.
        cols : (n,) array
            Column coordinates in pixels.
        """
        across = medial_mm if self.side == "right" else -medial_mm
        return self.row + below_mm / self.pitch_mm, self.col + across / self.pitch_mm

    def rebin(self, pixels: float) -> "JointPosition":
        """Convert the joint position to an image with a different pixel size.

        Parameters
        ----------
        pixels : float
            Width of a new pixel in current pixels.

        Returns
        -------
        JointPosition
            Joint position in new pixels.
        """
        row, col = ((at + 0.5) / pixels - 0.5 for at in (self.row, self.col))
        return JointPosition(row=row, col=col, side=self.side, pitch_mm=self.pitch_mm * pixels)

    def shift_by_pixels(self, rows: float, cols: float) -> "JointPosition":
        """Shift the joint position by a number of normalised pixels.

        Parameters
        ----------
        rows : float
            Distal shift in normalised pixels.
        cols : float
            Medial shift in normalised pixels.

        Returns
        -------
        JointPosition
            Shifted position.
        """
        row, col = self.to_pixels(np.array(rows * PITCH_MM), np.array(cols * PITCH_MM))
        return JointPosition(row=float(row), col=float(col), side=self.side, pitch_mm=self.pitch_mm)


def bin_film(film: Array, place: JointPosition, binning: float) -> tuple[Array, JointPosition]:
    """Bin the pixels of a radiograph and convert the joint position to binned pixels.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Radiograph in display values.
    place : JointPosition
        Position of the joint centre.
    binning : float
        Width of a binned pixel in original pixels, 1 or more; fractions are allowed.

    Returns
    -------
    film : (rows, cols) array
        Binned radiograph.
    place : JointPosition
        Position of the joint centre, in binned pixels.
    """
    return (film, place) if binning == 1 else (downsample_by_area(film, binning), place.rebin(binning))


def resample_joint_field(film: Array, place: JointPosition) -> Array:
    """Resample the field around the joint centre, mirrored to a right knee, with columns from lateral to medial.

    Outside the image, the value of the nearest edge pixel is used.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Radiograph in display values, bone bright.
    place : JointPosition
        Position of the joint centre.

    Returns
    -------
    (168, 201) array
        Resampled field in display values.
    """
    below: Array = np.arange(round(-ABOVE_MM / PITCH_MM), round(BELOW_MM / PITCH_MM) + 1, dtype=np.float64) * PITCH_MM
    half = round(HALF_MM / PITCH_MM)
    across: Array = np.arange(-half, half + 1, dtype=np.float64) * PITCH_MM
    rows, cols = place.to_pixels(below, across)
    # A normalised pixel is the mean over its area, as in downsampled crops. The variance of the Gaussian blur is the
    # variance of the normalised pixel minus the variance of the original pixel.
    coarser = PITCH_MM / place.pitch_mm
    blur = np.sqrt(max(coarser**2 - 1, 0.0) / 12)
    near, top, left = _crop_with_margin(film, rows, cols, round(5 * blur) + 1)
    smooth = gaussian_filter(near, blur, mode="nearest") if blur else near
    return np.asarray(
        map_coordinates(smooth, np.meshgrid(rows - top, cols - left, indexing="ij"), order=1, mode="nearest")
    )


def _crop_with_margin(film: Array, rows: Array, cols: Array, margin: int) -> tuple[Array, int, int]:
    """Crop an image to a range of rows and columns plus a margin; return the crop and its first row and column."""
    starts, ends = [], []
    for places, length in ((rows, film.shape[0]), (cols, film.shape[1])):
        starts.append(int(np.clip(np.floor(places.min()) - margin, 0, length - 1)))
        ends.append(int(np.clip(np.ceil(places.max()) + margin + 1, starts[-1] + 1, length)))
    return film[starts[0] : ends[0], starts[1] : ends[1]], starts[0], starts[1]


def stretch_contrast(field: Array) -> Array:
    """Scale the grey values between the 1st and 99th percentiles to integers from 0 to 255.

    Parameters
    ----------
    field : (rows, cols) array, grey
        Radiograph in display values.

    Returns
    -------
    (rows, cols) array
        Grey values from 0 to 255.

    Raises
    ------
    InputError
        The image has no contrast.
    """
    low, high = np.percentile(field, _STRETCH_PERCENTILES)
    if not high > low:
        raise InputError(f"radiograph must have contrast, got 98 % of grey values between {low:g} and {high:g}")
    return np.asarray(np.round(np.clip((field - low) / (high - low), 0, 1) * 255))


def joint_centre_px() -> tuple[int, int]:
    """Return the joint centre of a normalised radiograph.

    Returns
    -------
    tuple of int
        Row and column in pixels.
    """
    return round(ABOVE_MM / PITCH_MM), round(HALF_MM / PITCH_MM)
