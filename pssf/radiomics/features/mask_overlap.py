"""Mask overlap: agreement of a segmented mask with the true mask."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt


def compute_mask_overlap(segmented: NDArray[np.bool_], true: NDArray[np.bool_], unit_mm: float) -> dict[str, float]:
    """Compute the Dice coefficient (Dice 1945) of two masks, and the distance between their outlines.

    Parameters
    ----------
    segmented : (rows, cols) bool array
        Segmented mask.
    true : (rows, cols) bool array
        True mask.
    unit_mm : float
        Pixel size, in mm.

    Returns
    -------
    dict of str to float
        dice: Dice coefficient. mean_mm and p95_mm: mean and 95th percentile of the distances from the pixels of each
        outline to the other outline (Taha and Hanbury 2015). area: segmented area divided by true area. If a mask is
        empty, all values except dice are NaN.
    """
    both = int(segmented.sum()) + int(true.sum())
    dice = 2 * int((segmented & true).sum()) / both if both else float("nan")
    if not (segmented.any() and true.any()):
        return {"dice": dice, "mean_mm": float("nan"), "p95_mm": float("nan"), "area": float("nan")}
    one, other = _find_outline(segmented), _find_outline(true)
    apart = np.concatenate([distance_transform_edt(~other)[one], distance_transform_edt(~one)[other]]) * unit_mm
    distances = {"mean_mm": float(apart.mean()), "p95_mm": float(np.quantile(apart, 0.95))}
    return {"dice": dice, **distances, "area": float(segmented.sum() / true.sum())}


def _find_outline(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the outline of a mask: the mask pixels (rows, cols) that are adjacent to background pixels.

    The image border does not count as background, unless the mask fills the image.
    """
    inner: NDArray[np.bool_] = binary_erosion(mask, border_value=1)
    # If the mask fills the image, its only outline is the image border.
    return mask & ~inner if (mask & ~inner).any() else mask & ~binary_erosion(mask)
