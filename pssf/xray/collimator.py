"""Collimator: the irradiated field and the penumbra at the edges of the field.

The irradiated field is the collimated field, limited to the detector. An open collimator irradiates the whole detector,
like the automatic collimation of a real system (IEC 60601-1-3; 21 CFR 1020.31 allows a deviation of 3 % of the
source-image distance). The primary signal, the scatter kernel and the Monte Carlo simulation use the same irradiated
field. A smaller detector therefore has less scatter.
"""

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..model.protocol import Protocol
from .resolved_technique import Technique

# Distance from the source to the collimator leaves, in mm (assumed; 200 to 350 mm are plausible).
_SOURCE_TO_COLLIMATOR_MM = 300.0


def is_collimated(protocol: Protocol) -> bool:
    """Check whether collimator leaves limit the field.

    Parameters
    ----------
    protocol : Protocol
        Technique and geometry.

    Returns
    -------
    bool
        True if the width or the height of the field is limited.
    """
    return protocol.field_width_mm > 0 or protocol.field_height_mm > 0


def penumbra_mm(protocol: Protocol) -> float:
    """Compute the width of the penumbra of the collimator on the detector.

    Parameters
    ----------
    protocol : Protocol
        Protocol with the focal spot size and the source-detector distance.

    Returns
    -------
    float
        Width in mm.
    """
    return protocol.focal_spot_mm * max(protocol.sdd_mm / _SOURCE_TO_COLLIMATOR_MM - 1.0, 0.0)


def compute_collimator_transmission(technique: Technique) -> NDArray[np.float32]:
    """Compute the fraction of the focal spot that is visible from each pixel.

    The collimator leaves are opaque. At the edge of the field, half of the focal spot is visible. The fraction
    decreases linearly across the penumbra.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    (rows, cols) float32 array
        Fraction from 0 to 1.
    """
    rows, cols = compute_transmission_factors(technique, 1)
    return np.outer(rows, cols).astype(np.float32)


def compute_transmission_factors(technique: Technique, step: int) -> tuple[Array, Array]:
    """Compute the visible fraction of the focal spot along rows and along columns, for square cells of pixels.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.
    step : int
        Number of pixels along the side of a cell.

    Returns
    -------
    rows : (ceil(rows / step),) float64 array
        Fraction per row of cells, from 0 to 1.
    cols : (ceil(cols / step),) float64 array
        Fraction per column of cells, from 0 to 1.
    """
    protocol, view = technique.protocol, technique.view
    penumbra = penumbra_mm(protocol)
    shares = []
    for count, wide_mm in ((view.rows, protocol.field_height_mm), (view.cols, protocol.field_width_mm)):
        places = np.minimum((np.arange(-(-count // step)) + 0.5) * step - 0.5, count - 1)
        from_edge = wide_mm / 2 - np.abs(places - (count - 1) / 2) * view.pixel_mm
        # The penumbra is at least one pixel wide, even for a point source.
        share = np.clip(from_edge / max(penumbra, view.pixel_mm) + 0.5, 0.0, 1.0)
        shares.append(share if wide_mm > 0 else np.ones(len(places)))
    return shares[0], shares[1]


def field_half_size_mm(technique: Technique) -> tuple[float, float]:
    """Compute half the width and half the height of the irradiated field.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    half_width_mm, half_height_mm : float
        Half the width and half the height of the collimated field on the detector, or of the detector if it is smaller,
        in mm.
    """
    protocol, view = technique.protocol, technique.view
    sizes = (
        (view.cols * view.pixel_mm, protocol.field_width_mm),
        (view.rows * view.pixel_mm, protocol.field_height_mm),
    )
    width, height = (min(whole, wanted) if wanted > 0 else whole for whole, wanted in sizes)
    return width / 2, height / 2
