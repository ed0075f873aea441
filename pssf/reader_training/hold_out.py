"""Measure the errors of the landmark network on simulated radiographs that were not used for training."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..core.checks import Array
from ..core.label_names import CONTOUR_LANDMARKS
from ..geometry.mesh import Indices
from ..reader.joint_measures import measure_joint
from .landmark_batches import LandmarkBatch, make_landmark_batch
from .training_images import BONES, TrainingImages
from .training_settings import ReaderTrainingSettings
from .unet import compute_expected_places

_COMPARTMENTS = ("medial", "lateral")
# Number of images to which the network is applied at once.
_BATCH = 8


@dataclass(frozen=True, kw_only=True)
class HoldOutErrors:
    """Errors of the landmark network, on the detector.

    Attributes
    ----------
    landmark_mm : dict of str to float
        Mean distance of each landmark, in mm.
    jsw_mae_mm, jsw_bias_mm : dict of str to float
        Mean absolute and mean error of the minimum joint space width between the landmarks of each compartment, in mm.
    dice : dict of str to float
        Mean Dice coefficient of each bone mask.
    """

    landmark_mm: dict[str, float]
    jsw_mae_mm: dict[str, float]
    jsw_bias_mm: dict[str, float]
    dice: dict[str, float]

    def rows(self) -> list[dict[str, Any]]:
        """Make table rows.

        Returns
        -------
        list of dict
            One row per error, with the columns error, of and value.
        """
        return [
            {"error": error, "of": name, "value": round(value, 4)}
            for error, named in vars(self).items()
            for name, value in named.items()
        ]


def measure_hold_out(network: nn.Module, images: TrainingImages, settings: ReaderTrainingSettings) -> HoldOutErrors:
    """Measure the errors in the exact frames of simulated knees.

    Parameters
    ----------
    network : torch.nn.Module
        Trained landmark network.
    images : TrainingImages
        Images that were not used for training.
    settings : ReaderTrainingSettings
        Settings of the training.

    Returns
    -------
    HoldOutErrors
        Errors of landmarks, joint spaces and masks.
    """
    found_px, true_px, overlaps = predict_places(
        network, images, np.arange(len(images.crops)), settings.crop_px, settings.plateau_px
    )
    mm_per_px = images.plateau_mm / settings.plateau_px
    distances = np.linalg.norm(found_px - true_px, axis=2) * mm_per_px[:, None]
    wrong = (_measure_jsw_px(found_px) - _measure_jsw_px(true_px)) * mm_per_px[:, None]
    return HoldOutErrors(
        landmark_mm=_name(CONTOUR_LANDMARKS, distances.mean(axis=0)),
        jsw_mae_mm=_name(_COMPARTMENTS, np.abs(wrong).mean(axis=0)),
        jsw_bias_mm=_name(_COMPARTMENTS, wrong.mean(axis=0)),
        dice=_name(BONES, np.nanmean(overlaps, axis=0)),
    )


def predict_places(
    network: nn.Module, images: TrainingImages, chosen: Indices, crop_px: int, plateau_px: float
) -> tuple[Array, Array, Array]:
    """Apply the landmark network in the exact frames of knees.

    Parameters
    ----------
    network : torch.nn.Module
        Trained landmark network.
    images : TrainingImages
        Images.
    chosen : (n,) int array
        Indices of the images.
    crop_px : int
        Side of the crops, in pixels.
    plateau_px : float
        Mean width of the plateau, in pixels.

    Returns
    -------
    found_px, true_px : (n, 16, 2) array
        Row and column of each landmark in the crop: found and true, in pixels.
    dice : (n, masks) array
        Dice coefficient of each mask; NaN if both masks are empty.
    """
    predicted, truths, overlaps = [], [], []
    for part in np.array_split(chosen, -(-len(chosen) // _BATCH)):
        made = make_landmark_batch(images, part, crop_px=crop_px, plateau_px=plateau_px, randomise_grey=None)
        with torch.no_grad():
            heat_maps, masks = network(made.image)
        predicted.append(compute_expected_places(heat_maps).numpy())
        truths.append(made.places_px.numpy())
        overlaps.append(_compute_dice(masks, made))
    return np.concatenate(predicted), np.concatenate(truths), np.concatenate(overlaps)


def _measure_jsw_px(places_px: Array) -> Array:
    """Measure the medial and lateral minimum joint space width (n, 2) between landmarks (n, 16, 2), in pixels."""
    measured = [measure_joint(places, "right") for places in places_px]
    return np.array(
        [np.array([joint.medial_jsw_share, joint.lateral_jsw_share]) * joint.plateau_width_px for joint in measured]
    )


def _compute_dice(masks: Tensor, made: LandmarkBatch) -> Array:
    """Compute the Dice coefficient (batch, masks) of each mask inside the image; NaN if both masks are empty."""
    drawn, truth = ((values > level) & (made.inside > 0) for values, level in ((masks, 0.0), (made.bones, 0.5)))
    common = (drawn & truth).sum(dim=(2, 3))
    dice: Array = (2 * common / (drawn.sum(dim=(2, 3)) + truth.sum(dim=(2, 3)))).numpy()
    return dice


def _name(names: tuple[str, ...], values: Array) -> dict[str, float]:
    """Return values by name."""
    return dict(zip(names, values.tolist(), strict=True))
