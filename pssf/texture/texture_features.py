"""Features of all texture measures, with names."""

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from ..core.checks import require_choice
from .binary_patterns import POINTS, local_binary_patterns
from .directional_spectrum import spectral_slope
from .fractal_signature import fractal_signature
from .orientation_transforms import (
    OrientationSignature,
    hurst_orientation_transform,
    variance_orientation_transform,
)

# Fractal signature, variance and Hurst orientation transforms, local binary patterns, and spectral exponents.
TEXTURE_FAMILIES = ("fsa", "vot", "hot", "lbp", "spectrum")
# Radii of the local binary patterns, in mm.
_RADII_MM = (0.4, 0.8)
# End of the names of features that change their sign in a mirrored image.
_MIRRORED = "Sine"


def measure_texture_features(
    image: NDArray[np.generic],
    *,
    pixel_mm: float,
    mask: NDArray[np.bool_] | None = None,
    families: Collection[str] = TEXTURE_FAMILIES,
) -> dict[str, float]:
    """Measure the texture features of a region, with names such as `vot_MeanDimension`.

    Orientations are cosine and sine of twice the direction. Of a left knee, `mirror_texture_features` gives the
    features in the frame of a right knee.

    Parameters
    ----------
    image : (rows, cols) array, grey
        Grey values.
    pixel_mm : float
        Pixel size, in mm.
    mask : (rows, cols) bool array, optional
        True for the pixels to measure; None: all pixels.
    families : collection of str, optional
        Families to measure, from TEXTURE_FAMILIES.

    Returns
    -------
    dict of str to float
        Value of each feature, keyed by its name.

    Raises
    ------
    InputError
        A family is unknown, or the image or the mask cannot be measured; see `texture_scales.prepare_region`.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(100, 100))
    >>> list(measure_texture_features(noise, pixel_mm=0.2, families=["spectrum"]))
    ['spectrum_All', 'spectrum_Horizontal', 'spectrum_Vertical']
    """
    for name in families:
        require_choice("family", name, TEXTURE_FAMILIES)
    values: dict[str, float] = {}
    if "fsa" in families:
        values |= _name_signature(image, pixel_mm, mask)
    if "vot" in families:
        values |= _name_orientation("vot", variance_orientation_transform(image, pixel_mm=pixel_mm, mask=mask))
    if "hot" in families:
        values |= _name_orientation("hot", hurst_orientation_transform(image, pixel_mm=pixel_mm, mask=mask))
    if "lbp" in families:
        for radius in _RADII_MM:
            patterns = local_binary_patterns(image, pixel_mm=pixel_mm, mask=mask, radius_mm=radius).tolist()
            names = [*(f"Uniform{count}" for count in range(POINTS + 1)), "Other"]
            values |= {f"lbp_{name}_{radius:g}mm": value for name, value in zip(names, patterns, strict=True)}
    if "spectrum" in families:
        exponents = spectral_slope(image, pixel_mm=pixel_mm, mask=mask)
        values |= {f"spectrum_{name.capitalize()}": value for name, value in exponents.items()}
    return values


def _name_signature(image: NDArray[np.generic], pixel_mm: float, mask: NDArray[np.bool_] | None) -> dict[str, float]:
    """Measure the fractal signature, with names."""
    of = fractal_signature(image, pixel_mm=pixel_mm, mask=mask)
    values: dict[str, float] = {}
    for name, dimension, parabola, by_scale in (
        ("Horizontal", of.horizontal_dimension, of.horizontal_parabola, of.horizontal),
        ("Vertical", of.vertical_dimension, of.vertical_parabola, of.vertical),
    ):
        values[f"fsa_{name}Dimension"] = dimension
        parts = zip(("Level", "Slope", "Curvature"), parabola, strict=True)
        values |= {f"fsa_{name}{part}": value for part, value in parts}
        values |= _name_scales(f"fsa_{name}Dimension", of.scales_mm.tolist(), by_scale.tolist())
    return values


def _name_orientation(family: str, of: OrientationSignature) -> dict[str, float]:
    """Return the features of an orientation transform, with names."""
    scales = of.scales_mm.tolist()
    values = {
        f"{family}_MeanDimension": of.mean_dimension,
        f"{family}_HorizontalDimension": of.horizontal_dimension,
        f"{family}_VerticalDimension": of.vertical_dimension,
        f"{family}_RoughestDimension": of.roughest_dimension,
        f"{family}_AspectRatio": of.aspect_ratio,
        **_name_direction(f"{family}_Orientation", of.orientation_deg),
    }
    for name, by_scale in (
        ("HorizontalDimension", of.dimensions[0]),
        ("VerticalDimension", of.dimensions[len(of.dimensions) // 2]),
        ("RoughestDimension", of.dimensions[int(np.argmax(of.direction_dimensions))]),
        ("AspectRatio", of.aspect_ratios),
    ):
        values |= _name_scales(f"{family}_{name}", scales, by_scale.tolist())
    return values


def _name_direction(name: str, direction_deg: float) -> dict[str, float]:
    """Return cosine and sine of twice a direction, because 0 and 180 degrees are the same direction."""
    double = 2 * np.deg2rad(direction_deg)
    return {f"{name}Cosine": float(np.cos(double)), f"{name}{_MIRRORED}": float(np.sin(double))}


def mirror_texture_features(values: Mapping[str, float]) -> dict[str, float]:
    """Convert the features of a left knee to those of its mirror image.

    Parameters
    ----------
    values : dict of str to float
        Features, keyed by name.

    Returns
    -------
    dict of str to float
        Features of the mirrored region; only the sines of orientations change.
    """
    return {name: -value if name.endswith(f"Orientation{_MIRRORED}") else value for name, value in values.items()}


def _name_scales(name: str, scales_mm: list[float], values: list[float]) -> dict[str, float]:
    """Name one feature per scale."""
    return {f"{name}_{scale:.2f}mm": value for scale, value in zip(scales_mm, values, strict=True)}
