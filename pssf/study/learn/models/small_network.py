"""Small convolutional network with the joint region as input: a baseline without hand-crafted features.

The network needs PyTorch (``cnn`` extra), which is imported only for training.
"""

import math
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....core.checks import Array
from ....core.resample import downsample_by_blocks

# Side length of the network input, in px: a region of 512 px is averaged over blocks of 8 px.
INPUT_SIDE_PX = 64
# Number of passes over the training images.
_EPOCHS = 40
# Number of images per training step.
_BATCH = 32
# Learning rate of AdamW.
_RATE = 1e-3
# Weight decay of AdamW.
_DECAY = 1e-4
# Channels of the three convolutional blocks.
_CHANNELS = (16, 32, 64)
# Text for a network that was not trained, shown in tables.
PYTORCH_MISSING = "not run: PyTorch is not installed (pip install '.[cnn]')"


def is_pytorch_installed() -> bool:
    """Report whether PyTorch is installed.

    Returns
    -------
    bool
        True if PyTorch is installed, so that a network can be trained.
    """
    return find_spec("torch") is not None


def make_network_input(region: NDArray[np.generic], side: str) -> NDArray[np.float32]:
    """Downsample a region, take the logarithm, and mirror left knees so that the medial side is on the right.

    Parameters
    ----------
    region : (rows, cols) array, DN
        Pixel values of the region, linear in the signal.
    side : str
        Side of the knee: "right" or "left".

    Returns
    -------
    (size, size) float32 array
        Logarithm of the signal, dimensionless; size is at most `INPUT_SIDE_PX`.
    """
    small = downsample_by_blocks(region.astype(np.float64), math.ceil(region.shape[0] / INPUT_SIDE_PX))
    grey = np.log(np.maximum(small, 1.0)).astype(np.float32)
    return np.ascontiguousarray(grey if side == "right" else grey[:, ::-1])


def train_network(
    training: tuple[NDArray[np.float32], NDArray[np.int64]],
    validation: tuple[NDArray[np.float32], NDArray[np.int64]],
    classes: int,
    *,
    seed: int,
) -> Any:
    """Train the network with AdamW on the log loss with equal class weights.

    The weights of the epoch with the lowest validation loss are used. The same seed yields the same network.

    Parameters
    ----------
    training : tuple of (rows, size, size) float32 array, dimensionless, and (rows,) int64 array
        Training images from `make_network_input` and their class indices.
    validation : tuple of (rows, size, size) float32 array, dimensionless, and (rows,) int64 array
        Validation images and their class indices. Without images, the weights of the last epoch are used.
    classes : int
        Number of classes.
    seed : int
        Seed of the initial weights and the image order.

    Returns
    -------
    callable
        Function that predicts class probabilities (rows, classes) from images (rows, size, size).
    """
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    mean, spread = float(training[0].mean()), float(training[0].std()) or 1.0

    def tensor(images: NDArray[np.float32]) -> Any:
        """Standardise images and convert them to a tensor (rows, 1, size, size)."""
        return torch.from_numpy((images[:, None] - mean) / spread)

    weight = torch.from_numpy(_compute_class_weights(training[1], classes))
    network, loss = _build_network(classes), torch.nn.CrossEntropyLoss(weight=weight)
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
    X, y, order = tensor(training[0]), torch.from_numpy(training[1]), np.random.default_rng(seed)
    X_check, y_check = tensor(validation[0]), torch.from_numpy(validation[1])
    best, least = network.state_dict(), float("inf")
    for _ in range(_EPOCHS):
        network.train()
        for batch in np.array_split(order.permutation(len(y)), max(1, len(y) // _BATCH)):
            optimiser.zero_grad()
            loss(network(X[batch]), y[batch]).backward()
            optimiser.step()
        network.eval()
        with torch.no_grad():
            now = float(loss(network(X_check), y_check)) if len(y_check) else -1.0
        if now < least or not len(y_check):
            best, least = {name: value.clone() for name, value in network.state_dict().items()}, now
    network.load_state_dict(best)
    network.eval()

    def probability(images: NDArray[np.float32]) -> Array:
        """Predict the class probabilities (rows, classes) of images."""
        with torch.no_grad():
            return np.asarray(torch.softmax(network(tensor(images)), dim=1).numpy(), np.float64)

    return probability


def _compute_class_weights(y: NDArray[np.int64], classes: int) -> NDArray[np.float32]:
    """Compute class weights (classes,) inversely proportional to class frequency."""
    counts = np.bincount(y, minlength=classes)
    return (len(y) / (classes * np.maximum(counts, 1))).astype(np.float32)


def _build_network(classes: int) -> Any:
    """Build three blocks of convolution, normalisation and pooling, followed by global pooling and a linear layer."""
    from torch import nn

    layers: list[Any] = []
    for before, after in zip((1, *_CHANNELS), _CHANNELS, strict=False):
        layers += [nn.Conv2d(before, after, 3, padding=1), nn.BatchNorm2d(after), nn.ReLU(), nn.MaxPool2d(2)]
    return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(_CHANNELS[-1], classes))
