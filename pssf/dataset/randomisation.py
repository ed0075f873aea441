"""Domain randomisation: random transforms of a simulated image and its labels.

The transforms follow Gao et al. 2023 (SyntheX, Nat Mach Intell 5:294), who trained networks on simulated radiographs
alone: noise, gamma, affine transform, inversion, boxes, blur, contrast curves and coarse dropout.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import InputError, require_choice
from .label_map import draw_label_map

if TYPE_CHECKING:
    from .sample import Sample

Grey = NDArray[np.float32]
Generator = np.random.Generator


def randomise(sample: "Sample", transforms: Sequence[str], rng: Generator, label_values: Mapping[str, int]) -> "Sample":
    """Apply random transforms to an image of a data set.

    Transforms of grey levels change only the image for display. The affine transform also changes linear image, masks,
    maps and landmarks.

    Parameters
    ----------
    sample : Sample
        Image with its labels.
    transforms : sequence of str
        Names of transforms and recipes, in the order in which they are applied.
    rng : numpy.random.Generator
        Generator; the only source of randomness.
    label_values : mapping of str to int
        Value of each class in the label map.

    Returns
    -------
    Sample
        Changed image. Its label ``randomised`` lists the transforms; some act only with a certain
        probability.

    Raises
    ------
    InputError
        If a transform is unknown.
    """
    grey: Grey = sample.display.astype(np.float32) / np.float32(255)
    names = resolve_transforms(transforms)
    # Each transform has a generator of its own, so that adding a transform does not change the others.
    for name, chance in zip(names, rng.spawn(len(names)), strict=True):
        if name == AFFINE:
            sample, grey = _transform_affine(sample, grey, chance, label_values)
        else:
            grey = GREY_TRANSFORMS[name](grey, chance)
    display = np.rint(np.clip(grey, 0, 1) * 255).astype(np.uint8)
    return replace(sample, display=display, labels={**sample.labels, "randomised": list(names)})


def resolve_transforms(names: Sequence[str]) -> tuple[str, ...]:
    """Replace the names of recipes by the names of their transforms.

    Parameters
    ----------
    names : sequence of str
        Names of transforms and recipes.

    Returns
    -------
    tuple of str
        Names of transforms.

    Raises
    ------
    InputError
        If a name is unknown or a transform is listed twice.
    """
    for name in names:
        require_choice("randomise", name, (*RECIPES, *TRANSFORMS))
    resolved = tuple(one for name in names for one in RECIPES.get(name, (name,)))
    twice = next((name for name in resolved if resolved.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"randomise must list each transform once, got {twice} twice")
    return resolved


def _add_noise(grey: Grey, rng: Generator) -> Grey:
    """Add Gaussian noise with a standard deviation of 0.005 to 0.1 of the grey range."""
    return grey + rng.uniform(0.005, 0.1) * rng.standard_normal(grey.shape, dtype=np.float32)


def _change_gamma(grey: Grey, rng: Generator) -> Grey:
    """Raise the grey levels to a power between 0.7 and 1.3."""
    changed: Grey = np.clip(grey, 0, 1) ** np.float32(rng.uniform(0.7, 1.3))
    return changed


def _invert(grey: Grey, rng: Generator) -> Grey:
    """Invert the grey levels with probability 0.5."""
    return 1 - grey if rng.random() < 0.5 else grey


def _blur(grey: Grey, rng: Generator) -> Grey:
    """Blur with a Gaussian of 0 to 0.4 % of the image height."""
    blurred: Grey = ndimage.gaussian_filter(grey, rng.uniform(0, 0.004) * grey.shape[0])
    return blurred


def _draw_boxes(grey: Grey, rng: Generator) -> Grey:
    """Cover the image by up to four boxes of one grey level each, such as labels and edges."""
    changed = grey.copy()
    for _ in range(int(rng.integers(0, 5))):
        changed[_sample_box(grey.shape, (0.03, 0.2), rng)] = rng.uniform(0, 1)
    return changed


def _drop_cells(grey: Grey, rng: Generator) -> Grey:
    """Replace up to 10 % of the squares of a coarse grid by noise (coarse dropout)."""
    side = max(1, round(grey.shape[0] * rng.uniform(0.01, 0.05)))
    cells = rng.random([-(-length // side) for length in grey.shape]) < rng.uniform(0, 0.1)
    dropped = np.kron(cells, np.ones((side, side), bool))[: grey.shape[0], : grey.shape[1]]
    noise = rng.random(grey.shape, dtype=np.float32)
    return np.where(dropped, noise, grey)


def _apply_contrast_curve(grey: Grey, rng: Generator) -> Grey:
    """Map the grey levels by a monotone curve through random points."""
    steps = rng.dirichlet(np.full(6, 4.0))
    curve = np.concatenate(([0.0], np.cumsum(steps)))
    low, high = rng.uniform(0, 0.1), rng.uniform(0.9, 1)
    return (low + (high - low) * np.interp(grey, np.linspace(0, 1, 7), curve)).astype(np.float32)


def _sample_box(shape: tuple[int, ...], fractions: tuple[float, float], rng: Generator) -> tuple[slice, ...]:
    """Return the slices of a box; its sides are fractions of the sides of the image."""
    slices = []
    for length in shape:
        side = max(1, round(length * rng.uniform(*fractions)))
        first = int(rng.integers(0, length - side + 1))
        slices.append(slice(first, first + side))
    return tuple(slices)


def _transform_affine(
    sample: "Sample", grey: Grey, rng: Generator, label_values: Mapping[str, int]
) -> tuple["Sample", Grey]:
    """Rotate by up to 10 degrees, scale by 0.9 to 1.1 and shift by up to 5 % of the image about its centre."""
    angle, scale = np.deg2rad(rng.uniform(-10, 10)), rng.uniform(0.9, 1.1)
    shape = np.array(grey.shape)
    centre, shift = (shape - 1) / 2, rng.uniform(-0.05, 0.05, 2) * shape
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    offset = centre + shift - matrix @ centre
    inverse = np.linalg.inv(matrix)

    def resample(image: NDArray[Any], order: int) -> NDArray[Any]:
        """Resample an image; pixels outside have the value of its edge."""
        moved: NDArray[Any] = ndimage.affine_transform(
            image, inverse, -inverse @ offset, order=order, mode="nearest", output=image.dtype
        )
        return moved

    def move_mask(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Move a mask and keep its pixels for which the interpolated mask is at least one half."""
        return ndimage.affine_transform(
            mask.astype(np.float32), inverse, -inverse @ offset, order=1, mode="nearest"
        ) >= 0.5  # fmt: skip

    places = {name: matrix @ np.array(place) + offset for name, place in sample.landmarks_px.items()}
    masks = {name: move_mask(mask) for name, mask in sample.masks.items()}
    applied = {"matrix": matrix.round(6).tolist(), "offset_px": offset.round(4).tolist()}
    moved = replace(
        sample,
        linear=np.rint(resample(sample.linear.astype(np.float32), 1)).astype(np.uint16),
        label_map=draw_label_map(masks, label_values, grey.shape),
        masks=masks,
        maps={name: resample(image, 1) for name, image in sample.maps.items()},
        landmarks_px={name: (float(row), float(col)) for name, (row, col) in places.items()},
        pixel_mm=sample.pixel_mm / scale,
        labels={**sample.labels, "affine": applied},
    )
    return moved, np.asarray(resample(grey, 1), np.float32)


# Name of the transform that also moves linear image, masks, maps and landmarks.
AFFINE = "affine"
# Transforms of grey levels, keyed by name.
GREY_TRANSFORMS: dict[str, Callable[[Grey, Generator], Grey]] = {
    "contrast": _apply_contrast_curve,
    "gamma": _change_gamma,
    "inversion": _invert,
    "blur": _blur,
    "boxes": _draw_boxes,
    "dropout": _drop_cells,
    "noise": _add_noise,
}
TRANSFORMS = (AFFINE, *GREY_TRANSFORMS)
# Recipes: lists of transforms, keyed by name.
RECIPES: dict[str, tuple[str, ...]] = {
    "mild": (AFFINE, "gamma", "blur", "noise"),
    "strong": TRANSFORMS,
}
