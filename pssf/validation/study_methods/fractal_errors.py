"""Error of texture measures on surfaces of known fractal dimension."""

from collections.abc import Callable
from functools import partial
from time import process_time

import numpy as np
from scipy import ndimage

from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...texture import (
    SCALES_MM,
    TEXTURE_FAMILIES,
    fractal_signature,
    hurst_orientation_transform,
    measure_texture_features,
    spectral_slope,
    variance_orientation_transform,
)
from ...texture.directional_variogram import interpolate_variogram
from ...texture.rose_ellipse import fit_ellipse
from ...texture.scaling_laws import fit_slope
from ..raycasting.raycast_engines import Row
from .fractional_surface import make_anisotropic_surface, make_fractional_surface

# Pixel size, in mm: 2 to 8 pixels at the default scales.
_PIXEL_MM = 0.2
_DIMENSIONS = (2.1, 2.2, 2.3, 2.4, 2.5, 2.6, 2.7, 2.8, 2.9)
# Sides of square regions, in pixels: 6.4, 12.8 and 25.6 mm.
_SIDES_PX = (32, 64, 128)
_SURFACES = 100
# Side of the regions, and dimension of the surfaces, for the table of disturbances.
_DISTURBED_PX, _DISTURBED_DIMENSION = 128, 2.5
_DIRECTIONS_DEG = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0)
# Regions of the table of run times, in pixels of 0.15 mm: subchondral region, patch, and square of 38 mm.
_TIMED_SHAPES = ((40, 170), (56, 56), (256, 256))
_TIMED_PIXEL_MM = 0.15
_SMOOTHEST, _ROUGHEST = 2.2, 2.8


def measure_fractal_truth(workers: int = 1) -> list[Row]:
    """Measure bias and spread of the fractal dimension on isotropic surfaces of known dimension.

    Parameters
    ----------
    workers : int, default 1
        Number of processes.

    Returns
    -------
    list of dict
        One row per measure, dimension and size of the region: bias and standard deviation over 100 surfaces.
    """
    cases = [(dimension, side) for side in _SIDES_PX for dimension in _DIMENSIONS]
    measured = map_in_parallel(_measure_case, cases, shared={}, workers=workers)
    return [
        {"measure": name, "dimension": case[0], "side_px": case[1], "bias": float(bias), "sd": float(spread)}
        for case, (biases, spreads) in zip(cases, measured, strict=True)
        for name, bias, spread in zip(_list_measures(), biases, spreads, strict=True)
    ]


def _measure_case(case: tuple[float, int]) -> tuple[Array, Array]:
    """Measure bias and standard deviation (measures,) for one dimension and size."""
    dimension, side = case
    measured = np.array(
        [
            list(
                measure_dimensions(make_fractional_surface(dimension, side, np.random.default_rng([7, seed]))).values()
            )
            for seed in range(_SURFACES)
        ]
    )
    return measured.mean(axis=0) - dimension, measured.std(axis=0, ddof=1)


def measure_dimensions(surface: Array) -> dict[str, float]:
    """Measure the fractal dimension of a surface by each measure.

    Parameters
    ----------
    surface : (rows, cols) array
        Surface with pixels of 0.2 mm.

    Returns
    -------
    dict of str to float
        Dimension by measure.
    """
    signature = fractal_signature(surface, pixel_mm=_PIXEL_MM)
    return {
        "fsa_horizontal": signature.horizontal_dimension,
        "fsa_vertical": signature.vertical_dimension,
        "vot_mean": variance_orientation_transform(surface, pixel_mm=_PIXEL_MM).mean_dimension,
        "hot_mean": hurst_orientation_transform(surface, pixel_mm=_PIXEL_MM).mean_dimension,
        "spectrum": 4.0 - spectral_slope(surface, pixel_mm=_PIXEL_MM)["all"] / 2,
    }


def _list_measures() -> list[str]:
    """List the names of the measures."""
    return list(measure_dimensions(make_fractional_surface(2.5, 32, 1)))


def measure_fractal_disturbances() -> list[Row]:
    """Measure how noise, blur, a gradient, quantisation and a tone curve change the fractal dimension.

    Returns
    -------
    list of dict
        One row per measure and disturbance: mean change of the dimension and its standard deviation over 100 surfaces.
    """
    changes: dict[str, list[list[float]]] = {name: [] for name in _list_disturbances()}
    for seed in range(_SURFACES):
        surface = make_fractional_surface(_DISTURBED_DIMENSION, _DISTURBED_PX, np.random.default_rng([7, seed]))
        surface = (surface - surface.mean()) / surface.std()
        before = np.array(list(measure_dimensions(surface).values()))
        for name, disturb in _list_disturbances().items():
            after = measure_dimensions(disturb(surface, np.random.default_rng([8, seed])))
            changes[name].append((np.array(list(after.values())) - before).tolist())
    return [
        {"measure": measure, "disturbance": name, "change": float(mean), "sd": float(spread)}
        for name, values in changes.items()
        for measure, mean, spread in zip(
            _list_measures(), np.mean(values, axis=0), np.std(values, axis=0, ddof=1), strict=True
        )
    ]


def _list_disturbances() -> dict[str, Callable[[Array, np.random.Generator], Array]]:
    """List functions that disturb a surface with a standard deviation of 1."""
    rows = np.linspace(-0.5, 0.5, _DISTURBED_PX)[:, None]
    return {
        "noise_2": partial(_add_noise, 0.02),
        "noise_10": partial(_add_noise, 0.1),
        "blur_0.1": lambda surface, _: ndimage.gaussian_filter(surface, 0.1 / _PIXEL_MM),
        "blur_0.2": lambda surface, _: ndimage.gaussian_filter(surface, 0.2 / _PIXEL_MM),
        "gradient_3": lambda surface, _: surface + 3.0 * rows,
        "grey_levels_256": lambda surface, _: np.rint((surface - surface.min()) / np.ptp(surface) * 255),
        "tone_curve": lambda surface, _: ((surface - surface.min()) / np.ptp(surface)) ** 0.6,
    }


def _add_noise(spread: float, surface: Array, rng: np.random.Generator) -> Array:
    """Add white noise to a surface (rows, cols)."""
    return surface + spread * rng.normal(size=surface.shape)


def measure_fractal_orientation() -> list[Row]:
    """Measure the orientation and the aspect ratio on surfaces whose dimension depends on the direction.

    Returns
    -------
    list of dict
        One row per direction: mean error and standard deviation of the orientation by both transforms, in degrees, mean
        aspect ratios, and the aspect ratio of the expected mean squares.
    """
    rows: list[Row] = []
    for direction in _DIRECTIONS_DEG:
        errors, ratios, expected = [], [], np.nan
        for seed in range(_SURFACES):
            rng = np.random.default_rng([9, seed])
            surface, squares = make_anisotropic_surface(_SMOOTHEST, _ROUGHEST, direction, _DISTURBED_PX, rng)
            measured = [
                transform(surface, pixel_mm=_PIXEL_MM)
                for transform in (variance_orientation_transform, hurst_orientation_transform)
            ]
            # The texture is smoothest across the direction of its roughest frequencies.
            smoothest = direction + 90.0
            errors.append([(one.orientation_deg - smoothest + 90.0) % 180.0 - 90.0 for one in measured])
            ratios.append([one.aspect_ratio for one in measured])
            expected = expected if seed else _compute_expected_ratio(squares)
        mean, spread, ratio = np.mean(errors, axis=0), np.std(errors, axis=0, ddof=1), np.mean(ratios, axis=0)
        rows.append(
            {
                "direction_deg": direction,
                "vot_error_deg": float(mean[0]),
                "vot_sd_deg": float(spread[0]),
                "hot_error_deg": float(mean[1]),
                "hot_sd_deg": float(spread[1]),
                "vot_ratio": float(ratio[0]),
                "hot_ratio": float(ratio[1]),
                "expected_ratio": expected,
            }
        )
    return rows


def _compute_expected_ratio(squares: Array) -> float:
    """Compute the aspect ratio of the expected mean squares (size, size) of a surface."""
    scales_px = np.array(SCALES_MM) / _PIXEL_MM
    reach = int(np.ceil(scales_px[-1])) + 3
    centred = np.roll(squares, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    directions = np.arange(0.0, 180.0, 5.0)
    hurst = fit_slope(scales_px, interpolate_variogram(centred, directions, scales_px)) / 2
    return fit_ellipse(directions, hurst).aspect_ratio


def measure_fractal_times() -> list[Row]:
    """Measure the run time of each family of texture features for regions of different size.

    Returns
    -------
    list of dict
        One row per region: rows and columns in pixels, and seconds of processor time by family; the shortest of five.
    """
    rows: list[Row] = []
    for shape in _TIMED_SHAPES:
        surface = make_fractional_surface(_DISTURBED_DIMENSION, max(shape), 1)[: shape[0], : shape[1]]
        seconds = {name: min(_time_family(name, surface) for _ in range(5)) for name in TEXTURE_FAMILIES}
        rows.append({"rows_px": shape[0], "cols_px": shape[1], **seconds, "all": sum(seconds.values())})
    return rows


def _time_family(name: str, surface: Array) -> float:
    """Time one family of features, in seconds of processor time."""
    began = process_time()
    measure_texture_features(surface, pixel_mm=_TIMED_PIXEL_MM, families=[name])
    return process_time() - began
