"""Draw the label map of an image and the masks of its joint space."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..anatomy.outlines.projected_contours import COMPARTMENT_RANGE

Masks = Mapping[str, NDArray[np.bool_]]


def add_joint_space_masks(
    masks: Masks, landmarks_px: Mapping[str, tuple[float, float]]
) -> dict[str, NDArray[np.bool_]]:
    """Add the masks ``medial_joint_space`` and ``lateral_joint_space`` in a frontal view.

    A joint space contains the pixels below the femur and above the tibia in the same column. It covers
    the columns in which the JSW is measured: 36 to 85 % of the distance from the middle of the plateau to its edge.

    Parameters
    ----------
    masks : mapping of str to (rows, cols) bool array
        Masks of the bones.
    landmarks_px : mapping of str to (row, column) tuple
        Landmark positions in pixels.

    Returns
    -------
    dict of str to (rows, cols) bool array
        All masks. The joint spaces are absent if the view has no plateau edges or the image shows only one bone.
    """
    edges = [landmarks_px.get(f"{side}_plateau_edge") for side in ("medial", "lateral")]
    if None in edges or not {"femur", "tibia"} <= masks.keys():
        return dict(masks)
    medial_col, lateral_col = (edge[1] for edge in edges if edge is not None)
    femur, tibia = masks["femur"], masks["tibia"]
    rows, cols = np.arange(femur.shape[0])[:, None], np.arange(femur.shape[1])
    below = rows > np.where(femur.any(axis=0), femur.shape[0] - 1 - femur[::-1].argmax(axis=0), femur.shape[0])
    above = rows < np.where(tibia.any(axis=0), tibia.argmax(axis=0), 0)
    middle, made = (medial_col + lateral_col) / 2, dict(masks)
    for side, col in (("medial", medial_col), ("lateral", lateral_col)):
        fraction, (inner, outer) = (cols - middle) / (col - middle), COMPARTMENT_RANGE
        made[f"{side}_joint_space"] = below & above & (fraction >= inner) & (fraction <= outer)
    return made


def draw_label_map(masks: Masks, values: Mapping[str, int], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Draw all masks into one image with one value per class.

    Parameters
    ----------
    masks : mapping of str to (rows, cols) bool array
        Masks keyed by name. The class of a mask is its name, or the end of its name, such as "osteophyte".
    values : mapping of str to int
        Value of each class, in the order in which the classes are drawn.
    shape : tuple of int
        Number of rows and columns.

    Returns
    -------
    (rows, cols) uint8 array
        Label map; 0 is background.
    """
    drawn = np.zeros(shape, np.uint8)
    for kind, value in values.items():
        for name, mask in masks.items():
            if find_mask_class(name, values) == kind:
                drawn[mask] = value
    return drawn


def find_mask_class(name: str, values: Mapping[str, int]) -> str:
    """Return the class of a mask: a bone, ``joint_space``, ``osteophyte``, ``cyst``, or ``implant`` for all others.

    Parameters
    ----------
    name : str
        Name of the mask.
    values : mapping of str to int
        Values keyed by class.

    Returns
    -------
    str
        Class.
    """
    return next((kind for kind in values if name == kind or name.endswith(f"_{kind}")), "implant")
