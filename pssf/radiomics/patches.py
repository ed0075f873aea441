"""Edge patches cut out of templates, as they look in a right or left knee, upright or upside down."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from ..core.blocks import block_mean
from ..core.checks import Array, InputError, require
from ..data.localisation import PatchLaw
from .edges import edge_field

Field = NDArray[np.float32]
SIDES = ("right", "left")
WAYS = ("upright", "upside down")
# Linear pixels are averaged up to about this pitch before they are looked at.
LINEAR_MM = 0.3
# Tiles by which a template is cut out wider, so that its edges know what is beside the patch.
_MARGIN_TILES = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Template:
    """A radiograph of a standard right knee without noise.

    pixels      (rows, cols) linear in the signal
    row, col    its medial joint line, pixels
    pixel_mm    pitch of the detector
    plateau_mm  of its tibial plateau, width at the detector; None where it is not known
    severe      whether it is of a knee so unlike others that it is looked for only where no usual one is sure
    raises      InputError for a joint line outside the image, or a pitch or width out of range
    """

    pixels: NDArray[np.integer | np.floating]
    row: float
    col: float
    pixel_mm: float
    plateau_mm: float | None = None
    severe: bool = False

    def __post_init__(self) -> None:
        require("template row", self.row, 0, self.pixels.shape[0] - 1, "px")
        require("template col", self.col, 0, self.pixels.shape[1] - 1, "px")
        require("template pixel_mm", self.pixel_mm, 0.001, 50, "mm")
        if self.plateau_mm is not None:
            require("template plateau_mm", self.plateau_mm, 10, 1000, "mm")

    @property
    def known_plateau_mm(self) -> float:
        """`plateau_mm`; raises InputError where it is not known."""
        if self.plateau_mm is None:
            raise InputError(
                "template plateau_mm = None; allowed: its width, mm, where the pitch of a film is not known"
            )
        return self.plateau_mm

    @property
    def facts(self) -> tuple[float | bool | None, ...]:
        """All but the pixels: what a record depends on that was made with it."""
        return self.row, self.col, self.pixel_mm, self.plateau_mm, self.severe

    @property
    def content(self) -> bytes:
        """The pixels, row by row."""
        return np.ascontiguousarray(self.pixels).tobytes()

    def as_wide_as(self, other: "Template") -> "Template":
        """The same at another magnification: its plateau as wide at the detector as another's.

        raises  InputError where the width of either is not known
        """
        larger = other.known_plateau_mm / self.known_plateau_mm
        return replace(self, pixel_mm=self.pixel_mm * larger, plateau_mm=other.plateau_mm)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Patches of all templates and turns for one side and one way up.

    fields  (2, rows, cols) each, times the weight
    power   sum of weight times squared field, of each
    weight  (rows, cols)
    anchor  row and column of the medial joint line in the patch
    """

    side: str
    way: str
    fields: tuple[Field, ...]
    power: tuple[float, ...]
    weight: Field
    anchor: tuple[int, int]


class Spectra(NamedTuple):
    """A pose's patches and weight, turned round about their anchor and transformed, for correlation by a product.

    fields  (patches, 2, rows, cols // 2 + 1)
    weight  (rows, cols // 2 + 1)
    """

    fields: NDArray[Any]
    weight: NDArray[Any]


def reach_px(law: PatchLaw) -> tuple[int, int, int, int]:
    """Pixels of a patch above its medial joint line, below it, to lateral and to medial."""
    up, down, lateral, medial = (
        round(length / law.pitch_mm) for length in (law.up_mm, law.down_mm, law.lateral_mm, law.medial_mm)
    )
    return up, down, lateral, medial


def density_of(pixels: NDArray[np.generic]) -> Array:
    """(rows, cols)  minus the logarithm of a linear signal: bone bright

    pixels  (rows, cols)  any unit
    """
    return np.asarray(-np.log(np.maximum(pixels, 1.0)), np.float64)


@lru_cache(maxsize=16)  # the same few serve a whole cohort
def poses(templates: tuple[Template, ...], law: PatchLaw) -> tuple[Pose, ...]:
    """Right and left, upright and upside down."""
    up, down, lateral, medial = reach_px(law)
    plain = [_field(template, law, turn) for template in templates for turn in law.turns_deg]
    height = np.exp(-0.5 * (np.arange(-up, down + 1) * law.pitch_mm / law.height_mm) ** 2)
    weight = np.repeat(height[:, None], lateral + medial + 1, axis=1).astype(np.float32)
    patches = []
    for side in SIDES:
        for way in WAYS:
            col = lateral if side == "right" else medial
            row = up if way == "upright" else down
            turned = tuple(posed(one, side, way) for one in plain)
            heavy = weight if way == "upright" else weight[::-1]
            power = tuple(float((heavy * (one**2).sum(axis=0)).sum()) for one in turned)
            weighted = tuple(one * heavy for one in turned)
            patches.append(Pose(side=side, way=way, fields=weighted, power=power, weight=heavy, anchor=(row, col)))
    return tuple(patches)


@lru_cache(maxsize=512)  # of all sizes of images of a few shapes
def spectra(pose: Pose, shape: tuple[int, int]) -> Spectra:
    """Transforms at a shape that holds the patches."""
    to_anchor = [at + 1 - side for side, at in zip(pose.weight.shape, pose.anchor, strict=True)]

    def transformed(part: NDArray[Any]) -> NDArray[Any]:
        still = [(0, 0)] * (part.ndim - 2)
        room = [(0, whole - side) for whole, side in zip(shape, pose.weight.shape, strict=True)]
        return fft.rfft2(np.roll(np.pad(part[..., ::-1, ::-1], still + room), to_anchor, axis=(-2, -1)))

    return Spectra(fields=transformed(np.stack(pose.fields)), weight=transformed(pose.weight))


@lru_cache(maxsize=64)  # templates are looked for alone and beside others
def _field(template: Template, law: PatchLaw, turn_deg: float) -> Field:
    """(2, rows, cols)  edges of a template about its joint line, turned"""
    up, down, lateral, medial = reach_px(law)
    margin = int(np.ceil(_MARGIN_TILES * law.tile_mm / law.pitch_mm))
    soft, row, col, pixel_mm = _soft(template, law)
    rows = np.arange(-up - margin, down + margin + 1) * law.pitch_mm / pixel_mm
    cols = np.arange(-lateral - margin, medial + margin + 1) * law.pitch_mm / pixel_mm
    down_px, right_px = np.meshgrid(rows, cols, indexing="ij")
    cosine, sine = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    places = [row + cosine * down_px - sine * right_px, col + sine * down_px + cosine * right_px]
    cut = ndimage.map_coordinates(soft, places, order=1, mode="nearest")
    return edge_field(cut, law.tile_mm / law.pitch_mm)[:, margin:-margin, margin:-margin]


@lru_cache(maxsize=16)
def _soft(template: Template, law: PatchLaw) -> tuple[Array, float, float, float]:
    """Density (rows, cols) of a template as soft as a law's pitch asks, its joint line there, and its own pitch."""
    step = max(1, int(LINEAR_MM / template.pixel_mm))
    density = density_of(block_mean(template.pixels, step))
    row, col = ((at - (step - 1) / 2) / step for at in (template.row, template.col))
    pixel_mm = template.pixel_mm * step
    return ndimage.gaussian_filter(density, 0.5 * law.pitch_mm / pixel_mm, mode="nearest"), row, col, pixel_mm


def posed(plain: Field, side: str, way: str) -> Field:
    """A field of a right knee upright as one of another side or way, or back: its vectors turn with it.

    plain  (2, rows, cols)  down, right
    """
    if side == "left":
        plain = plain[:, :, ::-1] * np.array([1, -1], np.float32)[:, None, None]
    if way == "upside down":
        plain = plain[:, ::-1] * np.array([-1, 1], np.float32)[:, None, None]
    return plain
