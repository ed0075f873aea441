"""Templates: noise-free radiographs of reference knees, and edge patches cut out of the templates."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from ...core.checks import Array, InputError, require_in_range
from ...core.resample import downsample_by_blocks
from ...data.analysis.localisation_table import PatchSettings
from .edge_field import compute_edge_field

EdgeField = NDArray[np.float32]
SIDES = ("right", "left")
ORIENTATIONS = ("upright", "upside down")
# Maximum pixel size after downsampling an image for the search, in mm.
MAX_SEARCH_PIXEL_MM = 0.3
# Margin around a patch whose edges contribute to the normalisation, in standard deviations of the window.
_MARGIN_TILES = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Template:
    """Noise-free radiograph of a right reference knee.

    Parameters
    ----------
    pixels : (rows, cols) array
        Linear pixel values, in DN.
    row : float
        Row of the medial joint line, in pixels.
    col : float
        Column of the medial joint line, in pixels.
    pixel_mm : float
        Pixel size at the detector, 0.001 to 50 mm.
    plateau_mm : float or None
        Width of the tibial plateau at the detector, 10 to 1000 mm; None if unknown.
    severe : bool
        True for a severely deformed knee. Severe templates are used only if other templates give a low score.

    Raises
    ------
    InputError
        The joint line is outside the image, or `pixel_mm` or `plateau_mm` is out of range.
    """

    pixels: NDArray[np.integer | np.floating]
    row: float
    col: float
    pixel_mm: float
    plateau_mm: float | None = None
    severe: bool = False

    def __post_init__(self) -> None:
        """Check the position of the joint line, the pixel size and the plateau width."""
        require_in_range("template row", self.row, 0, self.pixels.shape[0] - 1, "px")
        require_in_range("template col", self.col, 0, self.pixels.shape[1] - 1, "px")
        require_in_range("template pixel_mm", self.pixel_mm, 0.001, 50, "mm")
        if self.plateau_mm is not None:
            require_in_range("template plateau_mm", self.plateau_mm, 10, 1000, "mm")

    @property
    def known_plateau_mm(self) -> float:
        """Width of the tibial plateau at the detector, in mm; InputError is raised if it is unknown."""
        if self.plateau_mm is None:
            raise InputError(
                "template plateau_mm must be the width in mm, got plateau_mm = None: "
                "the width is needed to estimate the pixel size"
            )
        return self.plateau_mm

    @property
    def scalar_values(self) -> tuple[float | bool | None, ...]:
        """All template fields except the pixels, for the settings hash of feature records."""
        return self.row, self.col, self.pixel_mm, self.plateau_mm, self.severe

    @property
    def pixel_bytes(self) -> bytes:
        """Bytes of the pixel array, in row-major order."""
        return np.ascontiguousarray(self.pixels).tobytes()

    def match_plateau_width(self, other: "Template") -> "Template":
        """Scale the pixel size so that the tibial plateau has the same width as in another template.

        Parameters
        ----------
        other : Template
            Template with the required plateau width.

        Returns
        -------
        Template
            Template with the scaled pixel size and plateau width.

        Raises
        ------
        InputError
            The plateau width of one of the two templates is unknown.
        """
        larger = other.known_plateau_mm / self.known_plateau_mm
        return replace(self, pixel_mm=self.pixel_mm * larger, plateau_mm=other.plateau_mm)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Edge patches of all templates and rotations, for one side and one orientation.

    Attributes
    ----------
    side : {"right", "left"}
        Left or right knee.
    orientation : {"upright", "upside down"}
        Orientation of the knee.
    fields : tuple of (2, rows, cols) arrays
        Edge field of each patch multiplied by the weight, dimensionless.
    power : tuple of float
        Edge power of each patch: sum of weight times squared edge field.
    weight : (rows, cols) array
        Weight of each patch pixel, dimensionless.
    anchor : tuple of int
        Row and column of the medial joint line in the patch, in pixels.
    """

    side: str
    orientation: str
    fields: tuple[EdgeField, ...]
    power: tuple[float, ...]
    weight: EdgeField
    anchor: tuple[int, int]


class Spectra(NamedTuple):
    """Fourier transforms of the edge patches and weights of a pose, reversed about the anchor for correlation.

    Attributes
    ----------
    fields : (patches, 2, rows, cols // 2 + 1) complex array
        Fourier transforms of the edge fields of the patches.
    weight : (rows, cols // 2 + 1) complex array
        Fourier transform of the patch weights.
    """

    fields: NDArray[Any]
    weight: NDArray[Any]


def reach_px(law: PatchSettings) -> tuple[int, int, int, int]:
    """Return the extent of a patch from the medial joint line in all four directions.

    Parameters
    ----------
    law : PatchSettings
        Patch settings.

    Returns
    -------
    tuple of int
        Extent in the upward, downward, lateral and medial direction, in pixels.
    """
    up, down, lateral, medial = (
        round(length / law.pitch_mm) for length in (law.up_mm, law.down_mm, law.lateral_mm, law.medial_mm)
    )
    return up, down, lateral, medial


def compute_density(pixels: NDArray[np.generic]) -> Array:
    """Compute the negative logarithm of a linear signal, in which bone is bright.

    Parameters
    ----------
    pixels : (rows, cols) array, any unit
        Linear signal. Values below 1 are replaced by 1.

    Returns
    -------
    (rows, cols) array
        Negative natural logarithm, dimensionless.
    """
    return np.asarray(-np.log(np.maximum(pixels, 1.0)), np.float64)


@lru_cache(maxsize=16)  # Poses are cached, because all radiographs use the same poses.
def make_poses(templates: tuple[Template, ...], law: PatchSettings) -> tuple[Pose, ...]:
    """Make the poses of right and left knees, upright and upside down, with their edge patches.

    Parameters
    ----------
    templates : tuple of Template
        Template radiographs.
    law : PatchSettings
        Patch settings.

    Returns
    -------
    tuple of Pose
        Four poses, each with the patches of all templates and rotations.
    """
    up, down, lateral, medial = reach_px(law)
    plain = [_make_template_field(template, law, turn) for template in templates for turn in law.turns_deg]
    height = np.exp(-0.5 * (np.arange(-up, down + 1) * law.pitch_mm / law.height_mm) ** 2)
    weight = np.repeat(height[:, None], lateral + medial + 1, axis=1).astype(np.float32)
    patches = []
    for side in SIDES:
        for way in ORIENTATIONS:
            col = lateral if side == "right" else medial
            row = up if way == "upright" else down
            turned = tuple(orient_field(one, side, way) for one in plain)
            heavy = weight if way == "upright" else weight[::-1]
            power = tuple(float((heavy * (one**2).sum(axis=0)).sum()) for one in turned)
            weighted = tuple(one * heavy for one in turned)
            patches.append(
                Pose(side=side, orientation=way, fields=weighted, power=power, weight=heavy, anchor=(row, col))
            )
    return tuple(patches)


@lru_cache(maxsize=512)  # The cache size is sufficient for all knee sizes tested in images of several shapes.
def compute_spectra(pose: Pose, shape: tuple[int, int]) -> Spectra:
    """Compute the Fourier transforms of the edge patches and weights of a pose, padded to a shape.

    Parameters
    ----------
    pose : Pose
        Pose to transform.
    shape : tuple of int
        Rows and columns of the Fourier transform, in pixels; at least those of the patches.

    Returns
    -------
    Spectra
        Fourier transforms of the patches and the weights.
    """
    to_anchor = [at + 1 - side for side, at in zip(pose.weight.shape, pose.anchor, strict=True)]

    def transformed(part: NDArray[Any]) -> NDArray[Any]:
        still = [(0, 0)] * (part.ndim - 2)
        room = [(0, whole - side) for whole, side in zip(shape, pose.weight.shape, strict=True)]
        return fft.rfft2(np.roll(np.pad(part[..., ::-1, ::-1], still + room), to_anchor, axis=(-2, -1)))

    return Spectra(fields=transformed(np.stack(pose.fields)), weight=transformed(pose.weight))


@lru_cache(maxsize=64)  # Fields are cached, because different sets of templates share templates.
def _make_template_field(template: Template, law: PatchSettings, turn_deg: float) -> EdgeField:
    """Compute the edge field (2, rows, cols) of a template, rotated about the joint line."""
    up, down, lateral, medial = reach_px(law)
    margin = int(np.ceil(_MARGIN_TILES * law.tile_mm / law.pitch_mm))
    soft, row, col, pixel_mm = _blur_template(template, law)
    rows = np.arange(-up - margin, down + margin + 1) * law.pitch_mm / pixel_mm
    cols = np.arange(-lateral - margin, medial + margin + 1) * law.pitch_mm / pixel_mm
    down_px, right_px = np.meshgrid(rows, cols, indexing="ij")
    cosine, sine = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    places = [row + cosine * down_px - sine * right_px, col + sine * down_px + cosine * right_px]
    cut = ndimage.map_coordinates(soft, places, order=1, mode="nearest")
    return compute_edge_field(cut, law.tile_mm / law.pitch_mm)[:, margin:-margin, margin:-margin]


@lru_cache(maxsize=16)
def _blur_template(template: Template, law: PatchSettings) -> tuple[Array, float, float, float]:
    """Downsample and blur the log signal of a template to match the pixel size of a patch.

    Return the negative log signal (rows, cols), row and column of the joint line, and the pixel size in mm.
    """
    step = max(1, int(MAX_SEARCH_PIXEL_MM / template.pixel_mm))
    density = compute_density(downsample_by_blocks(template.pixels, step))
    row, col = ((at - (step - 1) / 2) / step for at in (template.row, template.col))
    pixel_mm = template.pixel_mm * step
    return ndimage.gaussian_filter(density, 0.5 * law.pitch_mm / pixel_mm, mode="nearest"), row, col, pixel_mm


def orient_field(plain: EdgeField, side: str, way: str) -> EdgeField:
    """Convert an edge field between an upright right knee and another side or orientation.

    Parameters
    ----------
    plain : (2, rows, cols) float32 array
        Edge field to convert: downward and rightward component, dimensionless.
    side : {"right", "left"}
        Left or right knee; "left" mirrors the field.
    way : {"upright", "upside down"}
        Orientation; "upside down" flips the field.

    Returns
    -------
    (2, rows, cols) float32 array
        Converted edge field; mirrored components change sign.
    """
    if side == "left":
        plain = plain[:, :, ::-1] * np.array([1, -1], np.float32)[:, None, None]
    if way == "upside down":
        plain = plain[:, ::-1] * np.array([-1, 1], np.float32)[:, None, None]
    return plain
