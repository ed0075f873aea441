"""Random surfaces with a known fractal dimension, for the test of texture measures."""

import numpy as np

from ...core.checks import Array, RNGLike, require_in_range, require_integer, resolve_generator

# Radius of the disc of the circulant embedding; the surface is exact inside a disc of radius 1 (Stein 2002).
_EMBEDDING_RADIUS = 2.0


def make_fractional_surface(dimension: float, side: int, rng: RNGLike) -> Array:
    """Make an isotropic fractional Brownian surface by circulant embedding (Stein 2002).

    The mean square of the difference between two points at the distance d is proportional to d^(2 H) with H = 3 -
    dimension, exactly for all pixels.

    Parameters
    ----------
    dimension : float
        Fractal dimension, between 2 and 3, exclusive.
    side : int
        Side of the surface, in pixels.
    rng : int or numpy.random.Generator
        Random numbers.

    Returns
    -------
    (side, side) array
        Surface, in arbitrary units.

    Raises
    ------
    InputError
        The dimension or the side is out of range.

    References
    ----------
    Stein ML (2002). Fast and exact simulation of fractional Brownian surfaces. J Comput Graph Stat 11:587.
    """
    require_in_range("dimension", dimension, 2.01, 2.99, "")
    require_integer("side", side, 8, 4096, "pixels")
    generator, power = resolve_generator(rng), 2.0 * (3.0 - dimension)
    # The diagonal of the square has the length 1.
    step = 1.0 / (np.sqrt(2.0) * (side - 1))
    count = int(np.ceil(_EMBEDDING_RADIUS / step)) + 1
    places = np.arange(count) * step
    quarter, trend = _compute_covariance(np.hypot(places[:, None], places), power)
    mirrored = np.r_[np.arange(count), np.arange(count - 2, 0, -1)]
    spectrum = np.fft.fft2(quarter[np.ix_(mirrored, mirrored)]).real
    noise = generator.normal(size=(2, *spectrum.shape))
    # Eigenvalues below 0 are rounding errors, or so small that they do not matter (Stein 2002, table 1).
    field = np.fft.fft2(np.sqrt(np.maximum(spectrum, 0.0) / spectrum.size) * (noise[0] + 1j * noise[1])).real
    rows, cols = generator.normal(size=2) * np.sqrt(2.0 * trend)
    return np.asarray(field[:side, :side] + rows * places[:side, None] + cols * places[:side])


def _compute_covariance(distance: Array, power: float) -> tuple[Array, float]:
    """Return the covariance (n, n) of the field and the variance factor of the random plane (Stein 2002)."""
    radius = _EMBEDDING_RADIUS
    beta, trend = 0.0, power / 2
    offset = 1.0 - power / 2
    if power > 1.5:
        beta = power * (2 - power) / (3 * radius * (radius**2 - 1))
        trend = (power - beta * (radius - 1) ** 2 * (radius + 2)) / 2
        offset = beta * (radius - 1) ** 3 + 1 - trend
    inner = offset - distance**power + trend * distance**2
    outer = beta * np.clip(radius - distance, 0.0, None) ** 3 / np.maximum(distance, 1.0)
    return np.where(distance <= 1.0, inner, outer), trend


def make_anisotropic_surface(
    dimension: float, roughest: float, direction_deg: float, side: int, rng: RNGLike
) -> tuple[Array, Array]:
    """Make a periodic surface whose dimension depends on the direction (Bonami and Estrade 2003).

    The spectrum is f^(-2 H - 2) with H between 3 - roughest and 3 - dimension. H changes with the cosine of twice the
    angle between the frequency and the direction.

    Parameters
    ----------
    dimension : float
        Smallest fractal dimension of the spectrum, for frequencies across the direction.
    roughest : float
        Largest fractal dimension of the spectrum, for frequencies along the direction.
    direction_deg : float
        Direction, in degrees counter-clockwise from the rows of the image.
    side : int
        Side of the surface, in pixels.
    rng : int or numpy.random.Generator
        Random numbers.

    Returns
    -------
    surface : (side, side) array
        Surface, in arbitrary units.
    expected : (2 side, 2 side) array
        Expected mean square of differences by displacement; displacement 0 is at index 0, and negative ones wrap
        around.

    Raises
    ------
    InputError
        A parameter is out of range.
    """
    for name, value in (("dimension", dimension), ("roughest", roughest)):
        require_in_range(name, value, 2.01, 2.99, "")
    require_integer("side", side, 8, 4096, "pixels")
    generator, size = resolve_generator(rng), 2 * side
    rows, cols = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    frequency = np.hypot(rows, cols)
    angle = np.arctan2(-rows, cols) - np.deg2rad(direction_deg)
    along = 0.5 + 0.5 * np.cos(2 * angle)
    hurst = 3.0 - (dimension + (roughest - dimension) * along)
    power = np.zeros_like(frequency)
    # All directions have the same power at the shortest period of two pixels.
    power[frequency > 0] = (2 * frequency[frequency > 0]) ** (-2 * hurst[frequency > 0] - 2)
    covariance = np.fft.fft2(power).real / power.size
    noise = np.fft.fft2(generator.normal(size=power.shape)) / np.sqrt(power.size)
    surface = np.fft.ifft2(np.sqrt(power) * noise).real * np.sqrt(power.size)
    return surface[:side, :side], 2 * (covariance[0, 0] - covariance)
