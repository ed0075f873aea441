"""Network that tells a right from a left knee, and its training."""

import torch
from torch import Tensor, nn
from torch.nn import functional

# Number of feature maps after each halving of the resolution.
_FEATURES = (24, 40, 56, 72, 96)
_DROPOUT = 0.3


class SideNetwork(nn.Module):
    """Network with one input channel and one logit, which is positive for a right knee."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.PixelUnshuffle(2)]
        inputs = 4
        for features in _FEATURES:
            layers += [_make_block(inputs, features, 1), _make_block(features, features, 2)]
            inputs = features
        self.body = nn.Sequential(*layers)
        self.dropout = nn.Dropout(_DROPOUT)
        self.head = nn.Linear(inputs, 1)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Compute logits, in the form of one heat map of one pixel and no mask.

        Parameters
        ----------
        image : (batch, 1, rows, cols) tensor
            Normalised grey values.

        Returns
        -------
        logits : (batch, 1, 1, 1) tensor
            Positive for a right knee.
        masks : (batch, 0, 1, 1) tensor
            No mask.
        """
        logits = self.head(self.dropout(self.body(image).mean(dim=(2, 3))))[:, :, None, None]
        return logits, logits[:, :0]


def compute_side_loss(network: nn.Module, image: Tensor) -> Tensor:
    """Compute the loss of crops of right knees, half of which are mirrored at random.

    Parameters
    ----------
    network : torch.nn.Module
        Network.
    image : (batch, 1, rows, cols) tensor
        Normalised crops of right knees.

    Returns
    -------
    scalar tensor
        Binary cross-entropy.
    """
    left = torch.rand(len(image)) < 0.5
    seen = torch.where(left[:, None, None, None], image.flip(3), image)
    logits, _ = network(seen)
    return functional.binary_cross_entropy_with_logits(logits[:, 0, 0, 0], (~left).float())


def _make_block(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    """Make a convolution with normalisation."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )
