"""Correlation of edge fields over places, sizes and poses."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..data.localisation import PatchLaw
from .edges import Pyramid
from .patches import Pose, spectra

# Transforms are of lengths in these steps, so that a few serve all sizes.
_STEP_PX = 16
_LEAST_PX = 8
Window = tuple[slice, slice]
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
        field = image.edges(zoom, law.tile_mm / law.pitch_mm)
        if min(field.shape[1:]) >= _LEAST_PX:
            for pose, score in score_maps(field, patches):
                yield from _best(score, _seen(field.shape[1:], pose), least_seen, pose, zoom, unit_mm)


def score_maps(
    field: NDArray[np.float32], patches: Iterable[Pose], within: Window | None = None
) -> Iterator[tuple[Pose, NDArray[np.float32]]]:
    """Of each pose the score of every patch at pixels of the image.

    The denominator is the patch's own power where the image has less: air and plain muscle match nothing well.

    field     (2, rows, cols)  edges down and right at the pitch of the patches, dimensionless
    within    rows and columns that scores are wanted of; None: all
    """
    places = within or _everywhere(field.shape[1:])
    parts = np.stack([*field, (field**2).sum(axis=0)])
    seen_by, spectrum = None, parts
    for pose in patches:
        near, wanted, shape = _region(field.shape[1:], pose, places)
        if seen_by != (near, shape):
            seen_by, spectrum = (near, shape), fft.rfft2(parts[:, *near], shape)
        down, right, squares = spectrum
        ready = spectra(pose, shape)
        power = fft.irfft2(squares * ready.weight, shape)[wanted]
        alike = fft.irfft2(down * ready.fields[:, 0] + right * ready.fields[:, 1], shape)[:, *wanted]
        own = np.array(pose.power, np.float32)[:, None, None]
        yield pose, alike / np.sqrt(own * np.maximum(power, own))


@lru_cache(maxsize=256)  # of the sizes of one image, and others are mostly as large
def _seen(image: tuple[int, ...], pose: Pose) -> NDArray[np.float32]:
    """(rows, cols)  share of the patch's weight that is within an image of such a shape, by where its joint line is"""
    _, wanted, shape = _region(image, pose, _everywhere(image))
    inside = fft.rfft2(np.ones(image, np.float32), shape)
    return np.asarray(fft.irfft2(inside * spectra(pose, shape).weight, shape)[wanted] / pose.weight.sum())


def _everywhere(image: tuple[int, ...]) -> Window:
    rows, cols = image
    return slice(0, rows), slice(0, cols)


def _region(image: tuple[int, ...], pose: Pose, places: Window) -> tuple[Window, Window, tuple[int, int]]:
    """What of an image a patch reaches from some places, these places in it, and what holds it with room beside."""
    near, wanted, shape = [], [], []
    for length, side, before, at in zip(image, pose.weight.shape, pose.anchor, places, strict=True):
        after = side - 1 - before
        first, last = max(0, at.start - before), min(length, at.stop + after)
        beyond = max(0, before - at.start, at.stop + after - length)
        near.append(slice(first, last))
        wanted.append(slice(at.start - first, at.stop - first))
        shape.append(_fast(max(last - first + beyond, side)))
    return (near[0], near[1]), (wanted[0], wanted[1]), (shape[0], shape[1])


def _fast(length: int) -> int:
    return int(fft.next_fast_len(-(-length // _STEP_PX) * _STEP_PX, real=True))


def _best(
    score: NDArray[np.float32], seen: NDArray[np.float32], least_seen: float, pose: Pose, zoom: float, unit_mm: float
) -> Iterator[Match]:
    hidden = seen < least_seen
    for polarity, sign in zip(POLARITIES, (1.0, -1.0), strict=True):
        allowed = np.where(hidden, -1.0, sign * score)
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
