"""Losses of the reader's networks."""

import torch
from torch import Tensor
from torch.nn import functional

from .unet import STRIDE, compute_expected_places

# Standard deviation of the target position of a landmark and of an edge of the locator, in pixels of the input.
_TARGET_SD_PX = 2.5
_EDGE_SD_PX = 4.0
# Weights of the terms of the landmark loss.
_HEAT_WEIGHT = 0.5
_MASK_WEIGHT = 2.0
# Scale of the locator loss.
_EDGE_SCALE = 0.1


def draw_targets(places_px: Tensor, size: int, sd_px: float) -> Tensor:
    """Draw Gaussians around positions.

    Parameters
    ----------
    places_px : (batch, landmarks, 2) tensor
        Row and column in the input of the network, in pixels.
    size : int
        Side of the heat maps, in pixels.
    sd_px : float
        Standard deviation, in pixels of the input.

    Returns
    -------
    (batch, landmarks, size, size) tensor
        Gaussians with height 1.
    """
    axis = STRIDE * torch.arange(size, dtype=places_px.dtype) + (STRIDE - 1) / 2
    along = torch.exp(-((axis - places_px[..., None]) ** 2) / (2 * sd_px**2))
    return along[:, :, 0, :, None] * along[:, :, 1, None, :]


def compute_landmark_loss(
    heat_maps: Tensor, masks: Tensor, places_px: Tensor, visible: Tensor, bones: Tensor, inside: Tensor
) -> Tensor:
    """Compute the loss of landmarks and masks.

    Parameters
    ----------
    heat_maps : (batch, 16, rows, cols) tensor
        Logits of positions.
    masks : (batch, bones, rows, cols) tensor
        Logits of masks.
    places_px : (batch, 16, 2) tensor
        True row and column in the input, in pixels.
    visible : (batch, 16) tensor
        1 if the landmark is inside the image, else 0.
    bones : (batch, bones, rows, cols) tensor
        True masks, 0 to 1.
    inside : (batch, 1, rows, cols) tensor
        1 inside the image, else 0.

    Returns
    -------
    () tensor
        Loss.
    """
    count = visible.sum().clamp(min=1)
    places = compute_expected_places(heat_maps)
    distance = functional.smooth_l1_loss(places, places_px, reduction="none").sum(dim=2)
    target = draw_targets(places_px, heat_maps.shape[-1], _TARGET_SD_PX).flatten(2)
    target = target / target.sum(dim=2, keepdim=True).clamp(min=1e-9)
    entropy = -(target * heat_maps.flatten(2).log_softmax(dim=2)).sum(dim=2)
    positions = ((distance + _HEAT_WEIGHT * entropy) * visible).sum() / count
    weight = inside.expand_as(masks)
    cross = functional.binary_cross_entropy_with_logits(masks, bones, weight=weight, reduction="sum") / weight.sum()
    probability, truth = masks.sigmoid() * inside, bones * inside
    overlap = (2 * (probability * truth).sum(dim=(2, 3)) + 1) / ((probability + truth).sum(dim=(2, 3)) + 1)
    return positions + _MASK_WEIGHT * cross + 1 - overlap.mean()


def compute_edge_loss(heat_maps: Tensor, edges_px: Tensor) -> Tensor:
    """Compute the loss of the network that finds knees (focal cross entropy).

    Parameters
    ----------
    heat_maps : (batch, edges, rows, cols) tensor
        Logits of the presence of an edge at each pixel.
    edges_px : (batch, edges, 2) tensor
        True row and column in the input, in pixels; NaN if the image does not show the edge.

    Returns
    -------
    () tensor
        Loss.
    """
    far = torch.nan_to_num(edges_px, nan=-1000.0)
    target = draw_targets(far, heat_maps.shape[-1], _EDGE_SD_PX)
    weight = (target - heat_maps.sigmoid()) ** 2
    cross = functional.binary_cross_entropy_with_logits(heat_maps, target, reduction="none")
    return _EDGE_SCALE * (cross * weight).sum(dim=(2, 3)).mean()
