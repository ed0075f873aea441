"""How well a mask that was segmented covers the true one."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt


def overlap(segmented: NDArray[np.bool_], true: NDArray[np.bool_], unit_mm: float) -> dict[str, float]:
    """Dice coefficient (Dice 1945), and how far the outlines of two masks lie apart.

    segmented, true  (rows, cols) True where it is
    unit_mm          side of a pixel
    returns          dice; mean_mm and p95_mm of the distances of either outline's pixels to the other outline (Taha and
                     Hanbury 2015, average and 95th percentile of the symmetric distance); area: segmented over true.
                     NaN where a mask is empty
    """
    both = int(segmented.sum()) + int(true.sum())
    dice = 2 * int((segmented & true).sum()) / both if both else float("nan")
    if not (segmented.any() and true.any()):
        return {"dice": dice, "mean_mm": float("nan"), "p95_mm": float("nan"), "area": float("nan")}
    one, other = _outline(segmented), _outline(true)
    apart = np.concatenate([distance_transform_edt(~other)[one], distance_transform_edt(~one)[other]]) * unit_mm
    distances = {"mean_mm": float(apart.mean()), "p95_mm": float(np.quantile(apart, 0.95))}
    return {"dice": dice, **distances, "area": float(segmented.sum() / true.sum())}


def _outline(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(rows, cols)  pixels of a mask that touch what is not; the edge of the image is no outline."""
    inner: NDArray[np.bool_] = binary_erosion(mask, border_value=1)
    # A mask that fills the image has none: then its edge stands for it.
    return mask & ~inner if (mask & ~inner).any() else mask & ~binary_erosion(mask)
