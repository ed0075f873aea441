"""A small convolutional network on the region about the joint: a baseline that no feature is chosen for.

Needs PyTorch (extra `cnn`), which is imported where a network is trained and nowhere else.
"""

import math
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.blocks import block_mean
from ...core.checks import Array

SIDE_PX = 64  # of what the network sees: a region of 512 pixels in blocks of 8
_EPOCHS, _BATCH, _RATE, _DECAY = 40, 32, 1e-3, 1e-4
_CHANNELS = (16, 32, 64)
WITHOUT = "not run: PyTorch is not installed (pip install '.[cnn]')"


def is_installed() -> bool:
    """Whether a network can be trained here."""
    return find_spec("torch") is not None


def seen(region: NDArray[np.generic], side: str) -> NDArray[np.float32]:
    """(size, size) logarithm of the signal, size at most SIDE_PX, medial on the right.

    region  (rows, cols) linear, DN
    side    right | left, which is mirrored
    """
    small = block_mean(region.astype(np.float64), math.ceil(region.shape[0] / SIDE_PX))
    grey = np.log(np.maximum(small, 1.0)).astype(np.float32)
    return np.ascontiguousarray(grey if side == "right" else grey[:, ::-1])


def learnt(
    training: tuple[NDArray[np.float32], NDArray[np.int64]],
    validation: tuple[NDArray[np.float32], NDArray[np.int64]],
    classes: int,
    *,
    seed: int,
) -> Any:
    """What gives probabilities (rows, classes) for images (rows, size, size); the same for the same seed.

    Adam on the logarithmic loss with classes weighted alike; of 40 epochs the one that the validation images like best.

    training, validation  images (rows, size, size) of `seen`, dimensionless, class index (rows,); without validation
                          images the last epoch stands
    """
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    mean, spread = float(training[0].mean()), float(training[0].std()) or 1.0

    def tensor(images: NDArray[np.float32]) -> Any:
        return torch.from_numpy((images[:, None] - mean) / spread)

    weight = torch.from_numpy(_balanced(training[1], classes))
    network, loss = _network(classes), torch.nn.CrossEntropyLoss(weight=weight)
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
        with torch.no_grad():
            return np.asarray(torch.softmax(network(tensor(images)), dim=1).numpy(), np.float64)

    return probability


def _balanced(y: NDArray[np.int64], classes: int) -> NDArray[np.float32]:
    counts = np.bincount(y, minlength=classes)
    return (len(y) / (classes * np.maximum(counts, 1))).astype(np.float32)


def _network(classes: int) -> Any:
    """Three blocks of convolution, normalisation and pooling; the mean of what is left; one linear layer."""
    from torch import nn

    layers: list[Any] = []
    for before, after in zip((1, *_CHANNELS), _CHANNELS, strict=False):
        layers += [nn.Conv2d(before, after, 3, padding=1), nn.BatchNorm2d(after), nn.ReLU(), nn.MaxPool2d(2)]
    return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(_CHANNELS[-1], classes))
