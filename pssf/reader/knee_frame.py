"""Position, size, rotation and side of a knee on an image, and crops of the image in this frame.

A crop shows every knee as a right knee, with a horizontal tibial plateau of a fixed width in its middle. A network that
reads crops therefore needs no pixel size.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import Array
from ..core.label_names import CONTOUR_LANDMARKS

Grey = NDArray[np.float32]
# Indices of the lateral and the medial edge of the tibial plateau among the landmarks.
PLATEAU_EDGES = [CONTOUR_LANDMARKS.index(f"tibia_{side}_edge") for side in ("lateral", "medial")]
# Standard deviation of the Gaussian filter before an image is reduced, in pixels of the crop.
_ANTIALIASING_PX = 0.4
# Largest number of image pixels per crop pixel that needs no filter before the image is reduced.
_MAX_UNFILTERED_STEP = 1.2
# Smallest standard deviation of grey values by which a crop is divided.
MIN_GREY_SD = 1e-3


@dataclass(frozen=True, kw_only=True)
class KneeFrame:
    """Frame of a knee on an image.

    Attributes
    ----------
    centre_px : tuple of float
        Row and column of the middle between the lateral and the medial edge of the tibial plateau, in pixels.
    width_px : float
        Width of the plateau, in pixels.
    angle_rad : float
        Angle from the image columns to the line from the viewer's left to the viewer's right plateau edge, in radians,
        clockwise positive.
    side : {"right", "left"}
        Side of the knee. The lateral side of a right knee is on the viewer's left.
    """

    centre_px: tuple[float, float]
    width_px: float
    angle_rad: float
    side: str

    def map_to_image(self, points_px: Array, plateau_px: float, crop_px: int) -> Array:
        """Map points from a crop to the image.

        Parameters
        ----------
        points_px : (n, 2) array or (rows, cols, 2) array
            Rows and columns in the crop, in pixels.
        plateau_px : float
            Width of the plateau in the crop, in pixels.
        crop_px : int
            Side of the crop, in pixels.

        Returns
        -------
        (n, 2) array or (rows, cols, 2) array
            Rows and columns in the image, in pixels.
        """
        return (points_px - (crop_px - 1) / 2) @ self._compute_matrix(plateau_px).T + self.centre_px

    def map_to_crop(self, points_px: Array, plateau_px: float, crop_px: int) -> Array:
        """Map points from the image to a crop; the inverse of `map_to_image`.

        Parameters
        ----------
        points_px : (n, 2) array or (rows, cols, 2) array
            Rows and columns in the image, in pixels.
        plateau_px : float
            Width of the plateau in the crop, in pixels.
        crop_px : int
            Side of the crop, in pixels.

        Returns
        -------
        (n, 2) array or (rows, cols, 2) array
            Rows and columns in the crop, in pixels.
        """
        return (points_px - self.centre_px) @ np.linalg.inv(self._compute_matrix(plateau_px)).T + (crop_px - 1) / 2

    def find_box(self, shape: tuple[int, ...], plateau_px: float, crop_px: int) -> tuple[slice, slice]:
        """Find the rows and columns of the image that a crop shows.

        Parameters
        ----------
        shape : (int, int) tuple
            Rows and columns of the image.
        plateau_px : float
            Width of the plateau in the crop, in pixels.
        crop_px : int
            Side of the crop, in pixels.

        Returns
        -------
        (slice, slice) tuple
            Rows and columns, with a margin of two pixels of the crop.
        """
        margin = 2 * self.width_px / plateau_px
        corners = self.map_to_image(np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * (crop_px - 1.0), plateau_px, crop_px)
        low = np.clip(np.floor(corners.min(axis=0) - margin).astype(int), 0, np.array(shape) - 1)
        high = np.clip(np.ceil(corners.max(axis=0) + margin).astype(int) + 1, low + 1, shape)
        return slice(low[0], high[0]), slice(low[1], high[1])

    def cut_crop(self, image: Grey, plateau_px: float, crop_px: int) -> tuple[Grey, NDArray[np.bool_]]:
        """Cut a crop out of an image.

        Parameters
        ----------
        image : (rows, cols) float32 array
            Grey values.
        plateau_px : float
            Width of the plateau in the crop, in pixels.
        crop_px : int
            Side of the crop, in pixels.

        Returns
        -------
        crop : (crop_px, crop_px) float32 array
            Grey values; 0 outside the image.
        inside : (crop_px, crop_px) bool array
            True inside the image.
        """
        matrix = self._compute_matrix(plateau_px)
        step = self.width_px / plateau_px
        start = np.asarray(self.centre_px) - matrix @ np.full(2, (crop_px - 1) / 2)
        box = self.find_box(image.shape, plateau_px, crop_px)
        part, low = image[box], [along.start for along in box]
        if step > _MAX_UNFILTERED_STEP:
            part = ndimage.gaussian_filter(part, _ANTIALIASING_PX * step, mode="nearest")
        crop = ndimage.affine_transform(
            part, matrix, start - low, output_shape=(crop_px, crop_px), order=1, mode="nearest", prefilter=False
        )
        rows, cols = np.indices((crop_px, crop_px))
        places = self.map_to_image(np.stack((rows, cols), axis=-1), plateau_px, crop_px)
        inside = np.all((places >= -0.5) & (places <= np.array(image.shape) - 0.5), axis=-1)
        return np.where(inside, crop, np.float32(0)), np.asarray(inside, dtype=bool)

    def _compute_matrix(self, plateau_px: float) -> Array:
        """Return the matrix (2, 2) that maps steps in the crop to steps in the image (row, column)."""
        cosine, sine = np.cos(self.angle_rad), np.sin(self.angle_rad)
        mirror = 1.0 if self.side == "right" else -1.0
        return self.width_px / plateau_px * np.array([[cosine, mirror * sine], [-sine, mirror * cosine]])


def normalise_grey(grey: Grey, inside: NDArray[np.bool_]) -> Grey:
    """Scale grey values to zero mean and unit standard deviation inside the image; other values become 0.

    Parameters
    ----------
    grey : (rows, cols) float32 array
        Grey values.
    inside : (rows, cols) bool array
        True inside the image.

    Returns
    -------
    (rows, cols) float32 array
        Normalised grey values.
    """
    values = grey[inside]
    if values.size == 0:
        return np.zeros_like(grey)
    scaled = (grey - values.mean()) / max(float(values.std()), MIN_GREY_SD)
    return np.where(inside, scaled, np.float32(0)).astype(np.float32)


def make_whole_frame(shape: tuple[int, ...], size_px: int, side: str) -> KneeFrame:
    """Return the frame in which a crop with a plateau of one pixel shows the whole image.

    Parameters
    ----------
    shape : (int, int) tuple
        Rows and columns of the image.
    size_px : int
        Side of the crop, in pixels.
    side : {"right", "left"}
        Left: the crop is mirrored.

    Returns
    -------
    KneeFrame
        Frame.
    """
    return KneeFrame(
        centre_px=((shape[0] - 1) / 2, (shape[1] - 1) / 2), width_px=max(shape) / size_px, angle_rad=0.0, side=side
    )


def fit_frame(edges_px: Array, side: str) -> KneeFrame:
    """Return the frame of a knee from the edges of its tibial plateau.

    Parameters
    ----------
    edges_px : (2, 2) array
        Row and column of the lateral and the medial plateau edge, in pixels.
    side : {"right", "left"}
        Side of the knee.

    Returns
    -------
    KneeFrame
        Frame of the knee.
    """
    left, right = edges_px if side == "right" else edges_px[::-1]
    across = right - left
    middle = edges_px.mean(axis=0)
    return KneeFrame(
        centre_px=(float(middle[0]), float(middle[1])),
        width_px=float(np.hypot(*across)),
        angle_rad=float(np.arctan2(across[0], across[1])),
        side=side,
    )


def fit_similarity(points: Array, target: Array) -> Array:
    """Lay points on a target by the least-squares similarity.

    Parameters
    ----------
    points : (n, 2) array
        Points, of any unit.
    target : (n, 2) array
        Target of each point, of any unit.

    Returns
    -------
    (n, 2) array
        Moved points.
    """
    a, b = points - points.mean(axis=0), target - target.mean(axis=0)
    # Points as complex numbers: a rotation with a scale is a complex factor.
    u, v = a[:, 0] + 1j * a[:, 1], b[:, 0] + 1j * b[:, 1]
    moved = u * (np.conj(u) * v).sum() / (np.abs(u) ** 2).sum()
    return np.column_stack((moved.real, moved.imag)) + target.mean(axis=0)
