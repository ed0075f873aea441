"""Random changes of grey values, by which a network does not depend on the appearance of simulated radiographs.

The recipes follow Gao et al. 2023 (SyntheX, Nat Mach Intell 5:294). Geometric changes are part of the batches.
"""

import kornia.augmentation
import kornia.filters
import torch
from torch import Tensor, nn

# Ranges of random parameters (assumed): exponents of the grey values, blur in pixels, noise as a fraction of the grey
# range, and strength of slow shading, for the recipes mild and strong.
_GAMMA = {"mild": (0.6, 1.6), "strong": (0.45, 2.0)}
_NOISE_SD = {"mild": 0.04, "strong": 0.08}
_SHADING = {"mild": 0.15, "strong": 0.3}


class RandomLatitude(nn.Module):
    """Change local contrast: add a random fraction of the difference from a blurred image.

    Parameters
    ----------
    sigma_px : tuple of float
        Range of the standard deviation of the blur, in pixels.
    amount : tuple of float
        Range of the fraction.
    """

    def __init__(self, sigma_px: tuple[float, float], amount: tuple[float, float]) -> None:
        super().__init__()
        self.sigma_px, self.amount = sigma_px, amount

    def forward(self, image: Tensor) -> Tensor:
        """Change local contrast; each image has its own amount, and all have the same blur.

        Parameters
        ----------
        image : (batch, 1, rows, cols) tensor
            Grey values, 0 to 1.

        Returns
        -------
        (batch, 1, rows, cols) tensor
            Changed grey values.
        """
        low, high = self.sigma_px
        sigma = float(torch.rand(()) * (high - low) + low)
        size = 2 * int(3 * sigma) + 1
        amount = torch.rand(len(image), 1, 1, 1) * (self.amount[1] - self.amount[0]) + self.amount[0]
        amount = amount * (torch.rand(len(image), 1, 1, 1) < 0.7)
        blurred = kornia.filters.gaussian_blur2d(image, (size, size), (sigma, sigma), border_type="replicate")
        return image + amount * (image - blurred)


class RandomShading(nn.Module):
    """Multiply by and add slowly varying random fields.

    Parameters
    ----------
    strength : float
        Largest standard deviation of the fields, as a fraction of the grey range.
    """

    def __init__(self, strength: float) -> None:
        super().__init__()
        self.strength = strength

    def forward(self, image: Tensor) -> Tensor:
        """Add and multiply random fields.

        Parameters
        ----------
        image : (batch, 1, rows, cols) tensor
            Grey values, 0 to 1.

        Returns
        -------
        (batch, 1, rows, cols) tensor
            Changed grey values.
        """
        for cells in (4, 6):
            field = nn.functional.interpolate(
                torch.randn(len(image), 1, cells, cells), size=image.shape[2:], mode="bicubic", align_corners=True
            )
            field = field * torch.rand(len(image), 1, 1, 1) * self.strength
            image = image + field if cells == 4 else image * (1 + field)
        return image


def build_grey_randomisation(recipe: str) -> nn.Module:
    """Build the random change of grey values.

    Parameters
    ----------
    recipe : {"none", "mild", "strong"}
        Recipe.

    Returns
    -------
    torch.nn.Module
        Module that changes (batch, 1, rows, cols) grey values between 0 and 1; it uses the global generator of PyTorch.
    """
    if recipe == "none":
        return nn.Identity()
    steps: list[nn.Module] = [
        kornia.augmentation.RandomGamma(_GAMMA[recipe], p=0.8),
        RandomLatitude((0.8, 1.5), (-0.8, 1.2)),
        RandomLatitude((3.0, 12.0), (-0.6, 1.6)),
        RandomShading(_SHADING[recipe]),
        kornia.augmentation.RandomGaussianBlur((7, 7), (0.3, 1.4), p=0.4),
        kornia.augmentation.RandomGaussianNoise(0.0, _NOISE_SD[recipe], p=0.5),
        kornia.augmentation.RandomInvert(p=0.3),
    ]
    if recipe == "strong":
        steps += [
            kornia.augmentation.RandomPlasmaBrightness(intensity=(-0.3, 0.3), p=0.3),
            kornia.augmentation.RandomErasing(scale=(0.005, 0.03), value=0.0, p=0.2),
            kornia.augmentation.RandomErasing(scale=(0.005, 0.03), value=1.0, p=0.2),
        ]
    return nn.Sequential(*steps)
