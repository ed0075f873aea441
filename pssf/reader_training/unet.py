"""U-Net of the reader: heat maps of landmarks and masks at half the resolution of the input."""

import torch
from monai.networks.nets import BasicUNet
from torch import Tensor, nn

# Number of feature maps at each of five resolutions, relative to the first.
_GROWTH = (1.0, 1.6, 2.4, 3.6, 4.8)
# Factor of the logits of the position. Without it, the softmax over all pixels is nearly uniform for a long time.
_LOGIT_FACTOR = 8.0
STRIDE = 2


class ReaderUNet(nn.Module):
    """Network with one input channel, heat maps and masks.

    Parameters
    ----------
    landmarks : int
        Number of heat maps.
    masks : int
        Number of masks.
    width : int
        Number of feature maps at the highest resolution.
    """

    def __init__(self, landmarks: int, masks: int, width: int) -> None:
        super().__init__()
        features = (*(round(width * growth / 4) * 4 for growth in _GROWTH), width)
        self.landmarks = landmarks
        self.unshuffle = nn.PixelUnshuffle(STRIDE)
        self.body = BasicUNet(
            spatial_dims=2,
            in_channels=STRIDE**2,
            out_channels=landmarks + masks,
            features=features,
            act=("relu", {"inplace": True}),
            norm="batch",
            upsample="nontrainable",
        )

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Compute logits.

        Parameters
        ----------
        image : (batch, 1, rows, cols) tensor
            Normalised grey values.

        Returns
        -------
        heat_maps : (batch, landmarks, rows / 2, cols / 2) tensor
            Logits of the position of each landmark.
        masks : (batch, masks, rows / 2, cols / 2) tensor
            Logits of each mask.
        """
        output = self.body(self.unshuffle(image))
        return _LOGIT_FACTOR * output[:, : self.landmarks], output[:, self.landmarks :]


def compute_expected_places(heat_maps: Tensor) -> Tensor:
    """Compute the expected position of each landmark over the entire heat map.

    Parameters
    ----------
    heat_maps : (batch, landmarks, rows, cols) tensor
        Logits of the position.

    Returns
    -------
    (batch, landmarks, 2) tensor
        Row and column in the input of the network, in pixels.
    """
    rows, cols = heat_maps.shape[2:]
    probability = heat_maps.flatten(2).softmax(dim=2).view(heat_maps.shape)
    row = probability.sum(dim=3) @ torch.arange(rows, dtype=heat_maps.dtype)
    col = probability.sum(dim=2) @ torch.arange(cols, dtype=heat_maps.dtype)
    # With pixel unshuffling, pixel k of the output covers pixels 2 k and 2 k + 1 of the input.
    return STRIDE * torch.stack((row, col), dim=2) + (STRIDE - 1) / 2
