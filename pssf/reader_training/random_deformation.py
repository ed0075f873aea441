"""Random smooth deformations, by which a network sees bones of more shapes than the simulated ones."""

import torch
from torch import Tensor
from torch.nn import functional

# Points of the coarse grids along each axis at which displacements are drawn, and standard deviation of their
# displacements relative to the first grid.
_GRIDS = ((5, 1.0), (10, 0.5))
# Range of the random factor by which the displacements of one image are multiplied.
_FACTORS = (0.0, 1.5)
# Number of fixed-point iterations. Each reduces the error by the gradient of the displacements, which is about 0.1.
_ITERATIONS = 8


def draw_displacements(count: int, size_px: int, sd: float) -> Tensor:
    """Draw smooth random displacements.

    Parameters
    ----------
    count : int
        Number of images.
    size_px : int
        Side of the images, in pixels.
    sd : float
        Standard deviation of the displacements at the points of the coarsest grid, in the unit of the result.

    Returns
    -------
    (count, 2, size_px, size_px) tensor
        Displacement along rows and columns.
    """
    if sd == 0:
        return torch.zeros(count, 2, size_px, size_px)
    low, high = _FACTORS
    factor = sd * (low + (high - low) * torch.rand(count, 1, 1, 1))
    total = torch.zeros(count, 2, size_px, size_px)
    for points, share in _GRIDS:
        coarse = torch.randn(count, 2, points, points).clamp(-2.5, 2.5)
        total += share * functional.interpolate(coarse, size=(size_px, size_px), mode="bicubic", align_corners=True)
    return factor * total


def undo_displacements(target: Tensor, displacements: Tensor, matrix: Tensor) -> Tensor:
    """Find the points of a crop that a frame and displacements map to given points.

    Parameters
    ----------
    target : (count, n, 2) tensor
        Mapped points, relative to the image of the centre of the crop.
    displacements : (count, 2, size_px, size_px) tensor
        Displacement at each pixel of the crop, along rows and columns, in the unit of `target`.
    matrix : (count, 2, 2) tensor
        Matrix of the frame: a step of one pixel in the crop is mapped to this step.

    Returns
    -------
    (count, n, 2) tensor
        Rows and columns relative to the centre of the crop, in pixels.
    """
    inverse, middle = torch.linalg.inv(matrix), (displacements.shape[-1] - 1) / 2
    places = torch.einsum("bij,bkj->bki", inverse, target)
    for _ in range(_ITERATIONS):
        at = (places / middle).flip(-1)[:, :, None]
        moved = functional.grid_sample(displacements, at, padding_mode="border", align_corners=True)[..., 0]
        places = torch.einsum("bij,bkj->bki", inverse, target - moved.movedim(1, 2))
    return places
