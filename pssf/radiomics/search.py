"""Correlation of edge fields over places, sizes and poses."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..core.checks import Array
from ..data.localisation import PatchLaw
from .edges import Pyramid, edge_field
from .patches import Pose, spectra

# Transforms are of lengths in these steps, so that a few serve all sizes.
_STEP_PX = 16
_LEAST_PX = 8
POLARITIES = ("bone bright", "bone dark")


@dataclass(frozen=True, kw_only=True)
class Match:
    """The best place for one patch.

    score     correlation of edges, -1 to 1; with less structure than the template has it falls
    row, col  medial joint line, pixels of the image
    unit_mm   mm of the template a pixel of the image
    seen      share of the patch's weight within the image
    chance    score that chance may give, where sizes are to be weighed against each other
    """

    score: float
    side: str
    way: str
    polarity: str
    row: float
    col: float
    unit_mm: float
    seen: float
    chance: float = 0.0

    @property
    def excess(self) -> float:
        """By how much the score is beyond chance."""
        return self.score - self.chance


def matches(
    image: Pyramid, units_mm: Iterable[float], patches: Iterable[Pose], law: PatchLaw, least_seen: float
) -> Iterator[Match]:
    """The best place of each pose, polarity and size; nothing for a size at which the image is hardly there.

    units_mm    mm of the template a pixel of the image
    least_seen  share of the patch that must be within the image
    """
    patches = tuple(patches)
    for unit_mm in units_mm:
        zoom = unit_mm / law.pitch_mm
        at_pitch = image.at(zoom)
        if min(at_pitch.shape) >= _LEAST_PX:
            for pose, score, seen in score_maps(at_pitch, patches, law):
                yield from _best(score, seen, least_seen, pose, zoom, unit_mm)


def score_maps(
    at_pitch: Array, patches: Iterable[Pose], law: PatchLaw
) -> Iterator[tuple[Pose, NDArray[np.float32], NDArray[np.float32]]]:
    """Of each pose the score of every patch at every pixel of the image, and the share of the patch that is within.

    The denominator is the patch's own power where the image has less: air and plain muscle match nothing well.

    at_pitch  (rows, cols)  density at the pitch of the patches, any unit
    """
    field = edge_field(at_pitch, law.tile_mm / law.pitch_mm)
    cached = None
    for pose in patches:
        if cached is None or cached[0] != pose.weight.shape:
            cached = (pose.weight.shape, *_transforms(field, pose.weight.shape))
        _, shape, edges, squares, inside = cached
        ready = spectra(pose, shape)
        corner = [side - 1 - at for side, at in zip(pose.weight.shape, pose.anchor, strict=True)]
        window = tuple(slice(at, at + length) for at, length in zip(corner, at_pitch.shape, strict=True))
        power = fft.irfft2(squares * ready.weight, shape)[window]
        seen = fft.irfft2(inside * ready.weight, shape)[window] / pose.weight.sum()
        score = np.stack([
            fft.irfft2((edges * one).sum(axis=0), shape)[window] / np.sqrt(own * np.maximum(power, own))
            for one, own in zip(ready.fields, pose.power, strict=True)
        ])  # fmt: skip
        yield pose, score, seen


def _transforms(
    field: NDArray[np.float32], patch: tuple[int, ...]
) -> tuple[tuple[int, int], NDArray, NDArray, NDArray]:
    rows, cols = (
        fft.next_fast_len(-(-(length + side - 1) // _STEP_PX) * _STEP_PX, real=True)
        for length, side in zip(field.shape[1:], patch, strict=True)
    )
    whole = np.ones(field.shape[1:], np.float32)
    parts = (field, (field**2).sum(axis=0), whole)
    edges, squares, inside = (fft.rfft2(part, (rows, cols)) for part in parts)
    return (rows, cols), edges, squares, inside


def _best(
    score: NDArray[np.float32], seen: NDArray[np.float32], least_seen: float, pose: Pose, zoom: float, unit_mm: float
) -> Iterator[Match]:
    for polarity, sign in zip(POLARITIES, (1.0, -1.0), strict=True):
        allowed = np.where(seen >= least_seen, sign * score, -1.0)
        patch, row, col = (int(at) for at in np.unravel_index(np.argmax(allowed), allowed.shape))
        peak = allowed[patch]
        yield Match(
            score=float(peak[row, col]),
            side=pose.side,
            way=pose.way,
            polarity=polarity,
            row=(row + vertex(peak[:, col], row) + 0.5) / zoom - 0.5,
            col=(col + vertex(peak[row, :], col) + 0.5) / zoom - 0.5,
            unit_mm=unit_mm,
            seen=float(seen[row, col]),
        )


def vertex(score: NDArray[np.floating], at: int) -> float:
    """Offset from `at` of the vertex of the parabola through the peak and its neighbours; 0 at an edge.

    score  (n,)  dimensionless
    """
    if not 0 < at < len(score) - 1:
        return 0.0
    before, peak, after = (float(value) for value in score[at - 1 : at + 2])
    bend = before - 2 * peak + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
