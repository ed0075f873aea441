"""Find the knees on a radiograph or a crop of it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ..core.checks import Array
from .knee_frame import Grey, KneeFrame, fit_frame, make_whole_frame, normalise_grey
from .networks import Network

# Half the side of the window around the highest value, in pixels of the heat map, from which the position is computed.
_WINDOW_PX = 4
# Distance between the middles of two knees below which both are the same knee, as a fraction of the larger plateau.
_SAME_KNEE = 0.7
# Largest logit of a side, which is also that of a knee at whose place the other side was not found.
_LARGEST_LOGIT = 4.0


@dataclass(frozen=True, kw_only=True)
class KneeCandidate:
    """Knee that the network found.

    Attributes
    ----------
    frame : KneeFrame
        Frame of the knee on the image.
    score : float
        Lower of the scores of both plateau edges, 0 to 1.
    side_logit : float
        Logit of the score minus that of the other side at the same place; positive if the network prefers this side.
    """

    frame: KneeFrame
    score: float
    side_logit: float


def find_knees(image: Grey, locator: Network, min_score: float) -> list[KneeCandidate]:
    """Find up to one right and one left knee.

    Parameters
    ----------
    image : (rows, cols) float32 array
        Grey values.
    locator : Network
        Network that finds knees.
    min_score : float
        Least score of a knee, 0 to 1.

    Returns
    -------
    list of KneeCandidate
        Knees from the viewer's left to the viewer's right; empty if no knee has the score.
    """
    size = locator.settings.crop_px
    whole = make_whole_frame(image.shape, size, "right")
    heat_maps, _ = locator.run(normalise_grey(*whole.cut_crop(image, 1.0, size)))
    scores = expit(heat_maps)
    candidates = []
    stride = locator.settings.stride
    for side, pair in (("right", scores[:2]), ("left", scores[2:])):
        edges = np.array([_find_peak(score) for score in pair]) * stride + (stride - 1) / 2
        frame = fit_frame(whole.map_to_image(edges, 1.0, size), side)
        score = float(pair.max(axis=(1, 2)).min())
        # The lateral edge of a right knee is on the viewer's left; the network may exchange the edges of another thing.
        if frame.width_px > 0 and abs(frame.angle_rad) < np.pi / 2:
            candidates.append(KneeCandidate(frame=frame, score=score, side_logit=_LARGEST_LOGIT))
    knees = [knee for knee in _drop_second_side(candidates) if knee.score >= min_score]
    return sorted(knees, key=lambda knee: knee.frame.centre_px[1])


def _find_peak(score: NDArray[np.floating]) -> Array:
    """Return row and column of the highest value, as the mean position near it weighted by the score."""
    row, col = np.unravel_index(int(score.argmax()), score.shape)
    rows = slice(max(int(row) - _WINDOW_PX, 0), int(row) + _WINDOW_PX + 1)
    cols = slice(max(int(col) - _WINDOW_PX, 0), int(col) + _WINDOW_PX + 1)
    weight = score[rows, cols] ** 2
    places = np.moveaxis(np.indices(weight.shape), 0, -1) + np.array([rows.start, cols.start])
    return (places * weight[..., None]).sum(axis=(0, 1)) / weight.sum()


def _drop_second_side(knees: list[KneeCandidate]) -> list[KneeCandidate]:
    """Keep the side with the higher score if both candidates are at the same place."""
    if len(knees) == 2:
        first, second = knees
        distance = np.hypot(*np.subtract(first.frame.centre_px, second.frame.centre_px))
        if distance < _SAME_KNEE * max(first.frame.width_px, second.frame.width_px):
            other, knee = sorted(knees, key=lambda knee: knee.score)
            margin = logit(np.clip([knee.score, other.score], 1e-6, 1 - 1e-6)) @ (1, -1)
            return [replace(knee, side_logit=min(float(margin), _LARGEST_LOGIT))]
    return knees
