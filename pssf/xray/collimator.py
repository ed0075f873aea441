"""The collimator: what part of the beam its leaves let through.

What is irradiated is the collimated field, and never more than the detector: an open collimator covers the detector to
its edge, as the automatic collimation of a real system does (IEC 60601-1-3; 21 CFR 1020.31 allows 3 % of the distance).
Primary, the kernel of scatter and the Monte Carlo share this definition, so a smaller detector has less scatter.
"""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..model.protocol import Protocol
from .technique import Technique

# From the source to the leaves (judgement: 200 to 350 mm).
_LEAVES_MM = 300.0


def is_collimated(protocol: Protocol) -> bool:
    """Whether leaves are in the beam."""
    return protocol.field_width_mm > 0 or protocol.field_height_mm > 0


def penumbra_mm(protocol: Protocol) -> float:
    """Give the width on the detector of the half-shadow of a leaf, which the focal spot's size makes, in mm."""
    return protocol.focal_spot_mm * max(protocol.sdd_mm / _LEAVES_MM - 1.0, 0.0)


def field_of_view(technique: Technique) -> NDArray[np.float32]:
    """(rows, cols)  share of the focal spot that a pixel sees between the leaves

    The leaves are black. About the edge of the field, which is where half of the spot is seen, the share falls in
    proportion over the shadow of the spot.
    """
    rows, cols = open_shares(technique, 1)
    return np.outer(rows, cols).astype(np.float32)


def open_shares(technique: Technique, step: int) -> tuple[Array, Array]:
    """(ceil(rows/step),), (ceil(cols/step),)  shares of the spot seen from rows and columns of cells of pixels"""
    protocol, view = technique.protocol, technique.view
    penumbra = penumbra_mm(protocol)
    shares = []
    for count, wide_mm in ((view.rows, protocol.field_height_mm), (view.cols, protocol.field_width_mm)):
        places = np.minimum((np.arange(-(-count // step)) + 0.5) * step - 0.5, count - 1)
        from_edge = wide_mm / 2 - np.abs(places - (count - 1) / 2) * view.pixel_mm
        # A point casts a sharp shadow; a pixel has a width all the same.
        share = np.clip(from_edge / max(penumbra, view.pixel_mm) + 0.5, 0.0, 1.0)
        shares.append(share if wide_mm > 0 else np.ones(len(places)))
    return shares[0], shares[1]


def field_half_mm(technique: Technique) -> tuple[float, float]:
    """Half the width and half the height of the irradiated field: of the collimator's, or of the detector if less."""
    protocol, view = technique.protocol, technique.view
    sizes = (
        (view.cols * view.pixel_mm, protocol.field_width_mm),
        (view.rows * view.pixel_mm, protocol.field_height_mm),
    )
    width, height = (min(whole, wanted) if wanted > 0 else whole for whole, wanted in sizes)
    return width / 2, height / 2
