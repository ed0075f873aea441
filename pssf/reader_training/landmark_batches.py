"""Random batches for the network that finds landmarks and masks."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from ..reader.knee_frame import MIN_GREY_SD
from .random_deformation import draw_displacements, undo_displacements
from .training_images import BONES, STORED_PLATEAU_PX, STORED_PX, TrainingImages
from .unet import STRIDE

# Standard deviations of the random frame around a knee; the frames of the locator vary less (measured on simulations).
_LOG_SIZE_SD = 0.12
_ANGLE_SD_DEG = 5.0
_SHIFT_SD = 0.06  # as a fraction of the plateau width
_MAX_SD = 2.5
# Fraction of batches' images that end near the knee, and distance of their edges from the middle of the plateau, as
# fractions of the plateau width: a crop of patients' radiographs may be little wider than the plateau.
_CROPPED_FRACTION = 0.6
_EDGE_DISTANCES = {"row": (0.45, 0.9), "col": (0.5, 0.9)}
# Least distance of a landmark from the edge of the input that counts as visible, in pixels.
_MARGIN_PX = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class LandmarkBatch:
    """Batch of crops; see `losses.compute_landmark_loss` for the shapes of the labels.

    Attributes
    ----------
    image : (batch, 1, crop_px, crop_px) tensor
        Normalised grey values.
    places_px, visible, bones, inside : tensor
        Labels.
    """

    image: Tensor
    places_px: Tensor
    visible: Tensor
    bones: Tensor
    inside: Tensor


def make_landmark_batch(
    images: TrainingImages,
    chosen: np.ndarray,
    *,
    crop_px: int,
    plateau_px: float,
    randomise_grey: nn.Module | None,
    deformation_sd: float = 0.0,
) -> LandmarkBatch:
    """Make a batch in random frames, or in the exact frames of the knees if grey values are not randomised.

    Parameters
    ----------
    images : TrainingImages
        Images.
    chosen : (batch,) int array
        Indices of the images.
    crop_px : int
        Side of the crops, in pixels.
    plateau_px : float
        Mean width of the plateau, in pixels.
    randomise_grey : torch.nn.Module or None
        Random change of grey values; None makes a batch without any randomness.
    deformation_sd : float, default 0.0
        Standard deviation of random displacements, as a fraction of the plateau width.

    Returns
    -------
    LandmarkBatch
        Batch.
    """
    count = len(chosen)
    matrix, shift = _draw_frames(count, STORED_PLATEAU_PX / plateau_px, randomise_grey is not None)
    middle, stored_middle = (crop_px - 1) / 2, (STORED_PX - 1) / 2
    axis = torch.arange(crop_px, dtype=torch.float32) - middle
    steps = torch.stack(torch.meshgrid(axis, axis, indexing="ij"), dim=-1)
    source = torch.einsum("bij,hwj->bhwi", matrix, steps) + shift[:, None, None]
    moved = draw_displacements(count, crop_px, deformation_sd * STORED_PLATEAU_PX)
    grey, masks = _sample_crops(images, chosen, (source + moved.movedim(1, -1)).flip(-1) / stored_middle)
    landmarks = torch.from_numpy(images.landmarks_px[chosen]) - stored_middle - shift[:, None]
    places = undo_displacements(landmarks, moved, matrix) + middle
    inside = (masks[:, -1:] > 0.5).float()
    if randomise_grey is not None:
        inside = inside * _draw_image_edges(count, crop_px, plateau_px)
        grey = randomise_grey(grey)
    at = functional.grid_sample(inside, (places / middle - 1).flip(-1)[:, :, None], align_corners=True)[:, 0, :, 0]
    visible = ((places > _MARGIN_PX) & (places < crop_px - 1 - _MARGIN_PX)).all(dim=2) & (at > 0.5)
    return LandmarkBatch(
        image=normalise(grey, inside),
        places_px=places,
        visible=visible.float(),
        bones=functional.avg_pool2d(masks[:, : len(BONES)], STRIDE),
        inside=(functional.avg_pool2d(inside, STRIDE) > 0.5).float(),
    )


def _sample_crops(images: TrainingImages, chosen: np.ndarray, grid: Tensor) -> tuple[Tensor, Tensor]:
    """Sample grey values and masks of the bones and of the image area at a grid (batch, rows, cols, 2)."""
    stored = torch.from_numpy(images.crops[chosen]).float()[:, None] / 255
    coded = torch.from_numpy(images.coded_masks[chosen])
    bits = torch.stack([((coded >> bit) & 1).float() for bit in (*range(len(BONES)), 7)], dim=1)
    grey, masks = (functional.grid_sample(values, grid, align_corners=True) for values in (stored, bits))
    return grey, masks


def normalise(grey: Tensor, inside: Tensor) -> Tensor:
    """Scale grey values as `reader.knee_frame.normalise_grey` does.

    Parameters
    ----------
    grey : (batch, 1, rows, cols) tensor
        Grey values.
    inside : (batch, 1, rows, cols) tensor
        1 inside the image, else 0.

    Returns
    -------
    (batch, 1, rows, cols) tensor
        Normalised grey values.
    """
    count = inside.sum(dim=(2, 3), keepdim=True).clamp(min=1)
    mean = (grey * inside).sum(dim=(2, 3), keepdim=True) / count
    sd = (((grey - mean) ** 2 * inside).sum(dim=(2, 3), keepdim=True) / count).sqrt().clamp(min=MIN_GREY_SD)
    return (grey - mean) / sd * inside


def _draw_frames(count: int, step: float, random: bool) -> tuple[Tensor, Tensor]:
    """Draw matrices (count, 2, 2) from steps in the crop to steps in the stored crop, and shifts (count, 2)."""
    if not random:
        return step * torch.eye(2).repeat(count, 1, 1), torch.zeros(count, 2)
    chance = torch.randn(count, 4).clamp(-_MAX_SD, _MAX_SD)
    size = step * torch.exp(_LOG_SIZE_SD * chance[:, 0])
    angle = torch.deg2rad(_ANGLE_SD_DEG * chance[:, 1])
    cosine, sine = size * torch.cos(angle), size * torch.sin(angle)
    matrix = torch.stack((torch.stack((cosine, sine), dim=1), torch.stack((-sine, cosine), dim=1)), dim=1)
    return matrix, _SHIFT_SD * STORED_PLATEAU_PX * chance[:, 2:]


def _draw_image_edges(count: int, crop_px: int, plateau_px: float) -> Tensor:
    """Draw the parts (count, 1, crop_px, crop_px) that random image edges leave over, 1 inside and 0 outside."""
    axis = torch.arange(crop_px, dtype=torch.float32) - (crop_px - 1) / 2
    cropped = (torch.rand(count) < _CROPPED_FRACTION)[:, None]
    kept = []
    for low, high in _EDGE_DISTANCES.values():
        ends = (torch.rand(count, 2) * (high - low) + low) * plateau_px
        kept.append(((axis >= -ends[:, :1]) & (axis <= ends[:, 1:])) | ~cropped)
    return (kept[0][:, :, None] & kept[1][:, None, :]).float()[:, None]
