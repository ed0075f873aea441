"""Decide between a right and a left knee, from the network that finds knees and the network of the side."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from .knee_finder import KneeCandidate
from .knee_frame import Grey, KneeFrame, normalise_grey
from .networks import Network

# Weight of the logit of the side network relative to that of the network that finds knees (assumed).
_SIDE_WEIGHT = 0.5


def decide_sides(image: Grey, knees: Sequence[KneeCandidate], sides: Network) -> list[tuple[KneeCandidate, float]]:
    """Decide the side of each knee; two knees on one radiograph have different sides.

    Parameters
    ----------
    image : (rows, cols) float32 array
        Grey values.
    knees : sequence of KneeCandidate
        Knees with the side that the first network prefers.
    sides : Network
        Network of the side.

    Returns
    -------
    list of (KneeCandidate, float)
        Each knee with its side, and the probability of the side, 0.5 to 1.
    """
    evidence = [knee.side_logit + _SIDE_WEIGHT * _compute_side_logit(image, knee.frame, sides) for knee in knees]
    if len(knees) > 1:
        evidence = [float(np.mean(evidence))] * len(knees)
    return [
        (knee if logit >= 0 else _exchange_side(knee), float(expit(abs(logit))))
        for knee, logit in zip(knees, evidence, strict=True)
    ]


def _compute_side_logit(image: Grey, frame: KneeFrame, sides: Network) -> float:
    """Compute the logit of the side of a frame, as the mean over the crop and its mirror image."""
    settings = sides.settings
    crop = normalise_grey(*frame.cut_crop(image, settings.plateau_px, settings.crop_px))
    seen, mirrored = (float(sides.run(np.ascontiguousarray(one))[0].squeeze()) for one in (crop, crop[:, ::-1]))
    return (seen - mirrored) / 2


def _exchange_side(knee: KneeCandidate) -> KneeCandidate:
    """Return the knee with the other side."""
    return replace(knee, frame=replace(knee.frame, side="left" if knee.frame.side == "right" else "right"))
