"""Random batches of whole images and crops, with and without knees, for the network that finds knees."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from ..core.checks import Array
from .landmark_batches import normalise
from .training_images import WHOLE_PX, TrainingImages

# Channels: lateral and medial plateau edge of the right knee and of the left knee.
EDGE_CHANNELS = ("right_lateral", "right_medial", "left_lateral", "left_medial")
# Fractions of images without a knee that could be read, and of images with both knees.
_WITHOUT_KNEE = 0.22
_BOTH_KNEES = 0.23
# Range of the plateau width as a fraction of the longer side of the image: from both legs on one image to a tight crop.
_SINGLE_WIDTHS = (0.18, 0.9)
_BOTH_WIDTHS = (0.14, 0.24)
_ANGLE_SD_RAD = 0.12
# Fraction of images that are not square, and least ratio of their sides.
_OBLONG = 0.4
_LEAST_RATIO = 0.55
# Least distance of a plateau edge from the end of an oblong image, as a fraction of the longer side.
_LEAST_MARGIN = 0.06


@dataclass(eq=False)
class _Canvas:
    """Image that is being composed: grey values, part inside the image, and edges (4, 2) in row and column."""

    grey: Tensor
    inside: Tensor
    edges_px: Array


def make_locator_batch(
    images: TrainingImages, count: int, size: int, rng: np.random.Generator, randomise_grey: nn.Module
) -> tuple[Tensor, Tensor]:
    """Make a batch of images with one knee, both knees or no knee that could be read.

    Parameters
    ----------
    images : TrainingImages
        Images.
    count : int
        Number of images in the batch.
    size : int
        Side of the images, in pixels.
    rng : numpy.random.Generator
        Generator of the geometry; grey values use the global generator of PyTorch.
    randomise_grey : torch.nn.Module
        Random change of grey values.

    Returns
    -------
    image : (count, 1, size, size) tensor
        Normalised grey values.
    edges_px : (count, 4, 2) tensor
        Row and column of each edge in the order of `EDGE_CHANNELS`; NaN if the image does not show it.
    """
    canvases = [_compose(images, size, rng) for _ in range(count)]
    for canvas in canvases:
        _cut_to_oblong(canvas, size, rng)
    grey, inside = (torch.stack([getattr(c, name) for c in canvases])[:, None] for name in ("grey", "inside"))
    edges = torch.from_numpy(np.array([canvas.edges_px for canvas in canvases])).float()
    return normalise(randomise_grey(grey.clamp(0, 1)), inside), edges


def make_wrong_image(images: TrainingImages, size: int, rng: np.random.Generator) -> Array:
    """Make an image on which no knee must be found.

    Parameters
    ----------
    images : TrainingImages
        Images.
    size : int
        Side of the image, in pixels.
    rng : numpy.random.Generator
        Generator; the only source of randomness.

    Returns
    -------
    (size, size) float32 array
        Grey values, 0 to 1.
    """
    canvas = _draw_wrong(images, size, rng)
    return (canvas.grey * canvas.inside).clamp(0, 1).numpy()


def _draw_wrong(images: TrainingImages, size: int, rng: np.random.Generator) -> _Canvas:
    """Draw things that are no knee, or a knee that cannot be read."""
    return _draw_things(size, rng) if rng.random() < 0.5 else _turn_away(images, size, rng)


def _compose(images: TrainingImages, size: int, rng: np.random.Generator) -> _Canvas:
    """Compose one image."""
    chance = rng.random()
    if chance < _WITHOUT_KNEE:
        return _draw_wrong(images, size, rng)
    if chance < _WITHOUT_KNEE + _BOTH_KNEES:
        return _place_both(images, size, rng)
    low, high = np.log(_SINGLE_WIDTHS)
    width = size * np.exp(rng.uniform(low, high))
    free = np.maximum(size / 2 - np.array([0.5, 0.55]) * width, 0)
    return _place(images, size, rng, width, size / 2 + rng.uniform(-1, 1, 2) * free, mirrored=rng.random() < 0.5)


def _place(
    images: TrainingImages,
    size: int,
    rng: np.random.Generator,
    width: float,
    centre: Array,
    *,
    mirrored: bool,
    turn_rad: float = 0.0,
) -> _Canvas:
    """Place a random knee with a plateau of `width` pixels at `centre`; a mirrored knee is a left knee."""
    index = int(rng.integers(len(images.whole)))
    edges = images.whole_edges_px[index].astype(float)
    middle, across = edges.mean(axis=0), edges[1] - edges[0]
    angle = turn_rad + rng.normal(0, _ANGLE_SD_RAD)
    step = float(np.hypot(*across)) / width
    matrix = step * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    source = (np.moveaxis(np.indices((size, size)), 0, -1) - centre) @ matrix.T + middle
    inside = ((source >= 0) & (source <= WHOLE_PX - 1)).all(axis=-1)
    grid = torch.from_numpy((source[..., ::-1] / ((WHOLE_PX - 1) / 2) - 1).astype(np.float32))[None]
    stored = torch.from_numpy(images.whole[index]).float()[None, None] / 255
    grey = functional.grid_sample(stored, grid, align_corners=True)[0, 0]
    there = (edges - middle) @ np.linalg.inv(matrix).T + centre
    placed = np.full((4, 2), np.nan)
    placed[:2] = there
    canvas = _Canvas(grey=grey, inside=torch.from_numpy(inside).float(), edges_px=placed)
    return _mirror(canvas) if mirrored else canvas


def _mirror(canvas: _Canvas) -> _Canvas:
    """Mirror an image, by which a right knee becomes a left knee."""
    edges = canvas.edges_px[[2, 3, 0, 1]]
    edges[:, 1] = canvas.grey.shape[1] - 1 - edges[:, 1]
    return _Canvas(grey=canvas.grey.flip(1), inside=canvas.inside.flip(1), edges_px=edges)


def _place_both(images: TrainingImages, size: int, rng: np.random.Generator) -> _Canvas:
    """Place a right knee on the viewer's left and a left knee on the viewer's right."""
    width = size * rng.uniform(*_BOTH_WIDTHS)
    reach = rng.uniform(0.62, 1.1) * width
    row, col = rng.uniform(0.35, 0.65) * size, size / 2 + rng.normal(0, 0.02 * size)
    right = _place(images, size, rng, width, np.array([row, col - reach]), mirrored=False)
    heights = row + rng.normal(0, 0.02 * size)
    left = _place(images, size, rng, width, np.array([heights, size - 1 - (col + reach)]), mirrored=True)
    first = (torch.arange(size) < col).float()[None]
    return _Canvas(
        grey=right.grey * first + left.grey * (1 - first),
        inside=right.inside * first + left.inside * (1 - first),
        edges_px=np.concatenate((right.edges_px[:2], left.edges_px[2:])),
    )


def _turn_away(images: TrainingImages, size: int, rng: np.random.Generator) -> _Canvas:
    """Show a knee upside down, on its side, or outside the image."""
    kind, width = rng.integers(3), size * np.exp(rng.uniform(*np.log(_SINGLE_WIDTHS)))
    centre, turn = rng.uniform(0.3, 0.7, 2) * size, 0.0
    if kind == 0:
        turn = np.pi
    elif kind == 1:
        turn = np.pi / 2 * rng.choice((-1, 1))
    else:
        away = size / 2 + rng.uniform(0.25, 0.6) * width
        centre = np.array([size / 2 + rng.choice((-1, 1)) * away, size * rng.uniform(0.4, 0.6)])
    canvas = _place(images, size, rng, width, centre, mirrored=rng.random() < 0.5, turn_rad=turn)
    canvas.edges_px[:] = np.nan
    return canvas


def _draw_things(size: int, rng: np.random.Generator) -> _Canvas:
    """Draw rods, ellipsoids and noise, which have the grey values of a radiograph, but are no knee."""
    grey = np.zeros((size, size), np.float32)
    rows, cols = np.indices((size, size))
    for _ in range(rng.integers(0, 9)):
        row, col = rng.uniform(0, size, 2)
        if rng.random() < 0.5:
            angle, radius = rng.uniform(0, np.pi), rng.uniform(0.015, 0.2) * size
            across = (cols - col) * np.sin(angle) - (rows - row) * np.cos(angle)
            along = (cols - col) * np.cos(angle) + (rows - row) * np.sin(angle)
            distance = (across / radius) ** 2 + (np.abs(along) > rng.uniform(0.1, 0.8) * size)
        else:
            radii = rng.uniform(0.04, 0.47, 2) * size
            distance = ((rows - row) / radii[0]) ** 2 + ((cols - col) / radii[1]) ** 2
        grey += (rng.uniform(0.1, 1.0) * np.sqrt(np.clip(1 - distance, 0, 1))).astype(np.float32)
    grey /= max(float(grey.max()), 1.0)
    cells = rng.integers(2, 48, 2).tolist()
    noise = torch.from_numpy(rng.random((1, 1, *cells), dtype=np.float32))
    smooth = functional.interpolate(noise, size=(size, size), mode="bicubic", align_corners=True)[0, 0]
    share = rng.choice((0.05, 0.2, 1.0))
    return _Canvas(
        grey=torch.from_numpy(grey) * (1 - share) + smooth * share,
        inside=torch.ones(size, size),
        edges_px=np.full((4, 2), np.nan),
    )


def _cut_to_oblong(canvas: _Canvas, size: int, rng: np.random.Generator) -> None:
    """Cut a random image to an oblong one in the middle of the square, unless it would lose an edge of a plateau."""
    axis, margin = int(rng.integers(2)), int(size * (1 - rng.uniform(_LEAST_RATIO, 1.0)) / 2)
    if rng.random() >= _OBLONG:
        return
    places = canvas.edges_px[:, axis]
    places = places[~np.isnan(places)]
    margin_px = margin + _LEAST_MARGIN * size
    if places.size and (places.min() <= margin_px or places.max() >= size - 1 - margin_px):
        return
    kept = (torch.arange(size) >= margin) & (torch.arange(size) < size - margin)
    canvas.inside *= kept.float()[:, None] if axis == 0 else kept.float()[None]
