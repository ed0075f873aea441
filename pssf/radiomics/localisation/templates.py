"""Templates: noise-free radiographs of reference knees, and the edge patches that are cut out of them."""

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
# Pixels are averaged up to about this size before the search, in mm.
MAX_SEARCH_PIXEL_MM = 0.3
# Margin about a patch, in tiles, so that edges near its border are compared with those beyond.
_MARGIN_TILES = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Template:
    """Noise-free radiograph of a right reference knee.

    Parameters
    ----------
    pixels : (rows, cols) array
        Pixels that are linear in the signal, DN.
    row : float
        Row of the medial joint line, in pixels.
    col : float
        Column of the medial joint line, in pixels.
    pixel_mm : float
        Pixel size at the detector, 0.001 to 50 mm.
    plateau_mm : float or None
        Width of the tibial plateau at the detector, 10 to 1000 mm; None if it is not known.
    severe : bool
        Whether the knee is severely deformed. Such knees are only searched for if no usual knee is clear.

    Raises
    ------
    InputError
        The joint line is outside of the image, or a pixel size or width is out of range.
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
        """Width of the tibial plateau at the detector, in mm; raises InputError if it is not known."""
        if self.plateau_mm is None:
            raise InputError(
                "template plateau_mm must be its width in mm, got plateau_mm = None: a pixel size is unknown"
            )
        return self.plateau_mm

    @property
    def scalar_values(self) -> tuple[float | bool | None, ...]:
        """All fields except the pixels, on which a record of features depends."""
        return self.row, self.col, self.pixel_mm, self.plateau_mm, self.severe

    @property
    def pixel_bytes(self) -> bytes:
        """Bytes of the pixels, row by row."""
        return np.ascontiguousarray(self.pixels).tobytes()

    def match_plateau_width(self, other: "Template") -> "Template":
        """Rescale the template to the magnification at which its plateau is as wide as that of another template.

        Parameters
        ----------
        other : Template
            Template that gives the plateau width.

        Returns
        -------
        Template
            Template with another pixel size and plateau width.

        Raises
        ------
        InputError
            The plateau width of either template is not known.
        """
        larger = other.known_plateau_mm / self.known_plateau_mm
        return replace(self, pixel_mm=self.pixel_mm * larger, plateau_mm=other.plateau_mm)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Patches of all templates and rotations for one side and orientation.

    Attributes
    ----------
    side : {"right", "left"}
        Side of the knee.
    orientation : {"upright", "upside down"}
        Orientation of the knee.
    fields : tuple of (2, rows, cols) arrays
        Edge field of each patch times the weight, dimensionless.
    power : tuple of float
        Sum of weight times squared edge field, for each patch.
    weight : (rows, cols) array
        Weight of each pixel, dimensionless.
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
    """Fourier transforms of the patches and of the weight of a pose, reversed about their anchor for correlation.

    Attributes
    ----------
    fields : (patches, 2, rows, cols // 2 + 1) complex array
        Transforms of the edge fields.
    weight : (rows, cols // 2 + 1) complex array
        Transform of the weight.
    """

    fields: NDArray[Any]
    weight: NDArray[Any]


def reach_px(law: PatchSettings) -> tuple[int, int, int, int]:
    """Return the extent of a patch from its medial joint line.

    Parameters
    ----------
    law : PatchSettings
        Settings of the patch.

    Returns
    -------
    tuple of int
        Pixels upwards, downwards, laterally and medially.
    """
    up, down, lateral, medial = (
        round(length / law.pitch_mm) for length in (law.up_mm, law.down_mm, law.lateral_mm, law.medial_mm)
    )
    return up, down, lateral, medial


def compute_density(pixels: NDArray[np.generic]) -> Array:
    """Compute minus the logarithm of a linear signal, in which bone is bright.

    Parameters
    ----------
    pixels : (rows, cols) array, any unit
        Linear signal. Values below 1 count as 1.

    Returns
    -------
    (rows, cols) array
        Minus the natural logarithm, dimensionless.
    """
    return np.asarray(-np.log(np.maximum(pixels, 1.0)), np.float64)


@lru_cache(maxsize=16)  # A whole cohort uses the same few poses.
def make_poses(templates: tuple[Template, ...], law: PatchSettings) -> tuple[Pose, ...]:
    """Make the patches of a right and a left knee, each upright and upside down.

    Parameters
    ----------
    templates : tuple of Template
        Template radiographs.
    law : PatchSettings
        Settings of the patches.

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


@lru_cache(maxsize=512)  # This holds all sizes of images of a few shapes.
def compute_spectra(pose: Pose, shape: tuple[int, int]) -> Spectra:
    """Compute the Fourier transforms of a pose at a size that holds its patches.

    Parameters
    ----------
    pose : Pose
        Pose to transform.
    shape : tuple of int
        Rows and columns of the transform, in pixels.

    Returns
    -------
    Spectra
        Transforms of the patches and of the weight.
    """
    to_anchor = [at + 1 - side for side, at in zip(pose.weight.shape, pose.anchor, strict=True)]

    def transformed(part: NDArray[Any]) -> NDArray[Any]:
        still = [(0, 0)] * (part.ndim - 2)
        room = [(0, whole - side) for whole, side in zip(shape, pose.weight.shape, strict=True)]
        return fft.rfft2(np.roll(np.pad(part[..., ::-1, ::-1], still + room), to_anchor, axis=(-2, -1)))

    return Spectra(fields=transformed(np.stack(pose.fields)), weight=transformed(pose.weight))


@lru_cache(maxsize=64)  # Templates are used alone and together with others.
def _make_template_field(template: Template, law: PatchSettings, turn_deg: float) -> EdgeField:
    """Compute the rotated edge field (2, rows, cols) of a template about its joint line."""
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
    """Reduce and blur the density of a template to match the pixel size of a patch.

    Return the density (rows, cols), the row and column of the joint line in it, and its pixel size in mm.
    """
    step = max(1, int(MAX_SEARCH_PIXEL_MM / template.pixel_mm))
    density = compute_density(downsample_by_blocks(template.pixels, step))
    row, col = ((at - (step - 1) / 2) / step for at in (template.row, template.col))
    pixel_mm = template.pixel_mm * step
    return ndimage.gaussian_filter(density, 0.5 * law.pitch_mm / pixel_mm, mode="nearest"), row, col, pixel_mm


def orient_field(plain: EdgeField, side: str, way: str) -> EdgeField:
    """Convert an edge field between an upright right knee and another side or orientation, in either direction.

    Parameters
    ----------
    plain : (2, rows, cols) float32 array
        Components down and right, dimensionless.
    side : {"right", "left"}
        Side; "left" mirrors the field.
    way : {"upright", "upside down"}
        Orientation; "upside down" flips the field.

    Returns
    -------
    (2, rows, cols) float32 array
        Converted field, with the signs of its components adapted.
    """
    if side == "left":
        plain = plain[:, :, ::-1] * np.array([1, -1], np.float32)[:, None, None]
    if way == "upside down":
        plain = plain[:, ::-1] * np.array([-1, 1], np.float32)[:, None, None]
    return plain
