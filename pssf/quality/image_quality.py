"""Measure MTF, noise power spectrum, DQE and exposure index on images of a real or simulated system.

The functions take arrays whose values are proportional to the detector signal, such as the linear (For Processing)
pixels of a DICOM file after subtraction of the dark image.
"""

from collections.abc import Sequence

import numpy as np

from ..core.checks import Array, InputError, require_in_range

# Number of bins of the edge spread function per pixel.
_FINER = 8
# Largest distance from the edge that enters the edge spread function, in pixels.
_REACH_PX = 96
# Smallest distance from the edge to the border of the image, in pixels, along the whole edge.
_LEAST_REACH_PX = 16
# Range of the angle between the edge and the pixel rows or columns, in degrees. IEC 62220-1 requires 1.5 to 3.
_EDGE_DEG = (0.5, 20.0)
# Side length of a region of interest for the noise power spectrum, in pixels.
_ROI_PX = 128
# Photons per mm2 and uGy of an RQA5 beam (IEC 62220-1-1, table 2).
RQA5_PHOTONS_PER_MM2_UGY = 30174.0


def measure_edge_mtf(image: Array, pixel_mm: float) -> tuple[Array, Array]:
    """Measure the presampled MTF on the image of a slanted edge (Samei 1998; IEC 62220-1-1).

    The edge is found in the image. The edge spread function is differentiated to the line spread function, whose
    Fourier transform is the MTF.

    Parameters
    ----------
    image : (rows, cols) array, any unit
        Linear image of one straight edge, 0.5 to 20 degrees from the pixel rows or columns.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    frequency_per_mm : (n,) float64 array
        Spatial frequencies up to the Nyquist frequency, in cycles per mm.
    mtf : (n,) float64 array
        Presampled MTF, 1 at frequency 0. It includes the pixel aperture.

    Raises
    ------
    InputError
        If the image is not a two-dimensional array of numbers, or shows no straight edge at an allowed angle.
    """
    values = _require_image(image)
    require_in_range("pixel_mm", pixel_mm, 1e-3, 50, "mm")
    return compute_edge_mtf(values, find_edge_distance(values), pixel_mm)


def find_edge_distance(image: Array) -> Array:
    """Find a straight edge in an image, and compute the distance of each pixel from it.

    Parameters
    ----------
    image : (rows, cols) array, any unit
        Linear image of one straight edge.

    Returns
    -------
    (rows, cols) float64 array
        Distance from the edge, perpendicular to it, in pixels.

    Raises
    ------
    InputError
        If the image shows no straight edge 0.5 to 20 degrees from the pixel rows or columns.
    """
    # The edge crosses the rows if the mean change along the rows is greater.
    changes = [abs(image[:, -8:].mean() - image[:, :8].mean()), abs(image[-8:].mean() - image[:8].mean())]
    turned = changes[1] > changes[0]
    rows = image.T if turned else image
    slope, start = _fit_edge_line(rows)
    line, col = np.arange(rows.shape[0])[:, None], np.arange(rows.shape[1])
    distance = (col - start - slope * line) / np.hypot(1.0, slope)
    angle_deg = abs(float(np.rad2deg(np.arctan(slope))))
    require_in_range("angle of the edge to the pixel rows or columns", round(angle_deg, 3), *_EDGE_DEG, "deg")
    reach = min(float(-distance[:, 0].max()), float(distance[:, -1].min()))
    if reach < _LEAST_REACH_PX:
        raise InputError(
            f"edge must be at least {_LEAST_REACH_PX} pixels from the border on both sides, got {reach:.1f} pixels"
        )
    return np.asarray(distance.T if turned else distance)


def _fit_edge_line(rows: Array) -> tuple[float, float]:
    """Fit the edge position in each row of an image as a straight line; return its slope and start, in pixels."""
    line, col = np.arange(rows.shape[0]), np.arange(rows.shape[1] - 1) + 0.5
    smooth = np.array([np.convolve(row, np.ones(5) / 5, mode="same") for row in rows])
    change = np.diff(smooth, axis=1)[:, 2:-2]
    # The border, where the smoothed values are wrong, does not count.
    col = col[2:-2]
    sign = np.sign(change.sum())
    position = col[np.argmax(sign * change, axis=1)]
    slope, start = np.polyfit(line, position, 1)
    for half in (24.0, 12.0, 8.0):
        near = np.abs(col - (start + slope * line)[:, None]) < half
        weights = np.where(near, change, 0.0)
        total = weights.sum(axis=1)
        used = np.abs(total) > 0.2 * np.abs(np.median(total))
        if used.sum() < max(8, 0.5 * len(used)) or not np.isfinite(total).all():
            raise InputError(f"image must show one straight edge, got an edge in {int(used.sum())} of {len(used)} rows")
        position = (weights[used] * col).sum(axis=1) / total[used]
        slope, start = np.polyfit(line[used], position, 1)
    off = position - (start + slope * line[used])
    if off.std() > 2.0:
        raise InputError(f"image must show one straight edge, got positions that deviate by {off.std():.1f} pixels")
    return float(slope), float(start)


def compute_edge_mtf(pixels: Array, distance_px: Array, pixel_mm: float) -> tuple[Array, Array]:
    """Compute the MTF from pixel values and their distances from an edge.

    Parameters
    ----------
    pixels : (rows, cols) float64 array, any unit
        Linear pixel values.
    distance_px : (rows, cols) float64 array
        Distance from the edge, in px.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    frequency_per_mm : (n,) float64 array
        Spatial frequencies up to the Nyquist frequency, in cycles per mm.
    mtf : (n,) float64 array
        Presampled MTF, 1 at frequency 0.
    """
    place = np.floor((distance_px + _REACH_PX) * _FINER).astype(int)
    inside = (place >= 0) & (place < 2 * _REACH_PX * _FINER)
    count = np.bincount(place[inside], minlength=2 * _REACH_PX * _FINER)
    spread = np.bincount(place[inside], pixels[inside], 2 * _REACH_PX * _FINER) / np.maximum(count, 1)
    # Bins beyond the border of the image are left out.
    used = np.flatnonzero(count)
    line = np.diff(spread[used[0] : used[-1] + 1])
    transform = np.abs(np.fft.rfft(line))
    frequency = np.fft.rfftfreq(len(line), pixel_mm / _FINER)
    # Differentiation and binning each act as an aperture of one bin, so both transfer functions are divided out.
    transform /= np.sinc(frequency * pixel_mm / _FINER) ** 2
    wanted = frequency < 0.5 / pixel_mm
    return np.asarray(frequency[wanted], np.float64), np.asarray(transform[wanted] / transform[0], np.float64)


def measure_flat_nnps(flats: Sequence[Array] | Array, pixel_mm: float) -> tuple[Array, Array]:
    """Measure the normalised noise power spectrum of flat fields, averaged over directions (IEC 62220-1-1).

    Parameters
    ----------
    flats : (count, rows, cols) array, any unit
        At least two linear flat fields of the same exposure, without offset, of at least 128 x 128 pixels.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    frequency_per_mm : (n,) float64 array
        Spatial frequencies up to the Nyquist frequency, in cycles per mm, without the axes.
    nnps_mm2 : (n,) float64 array
        Normalised noise power spectrum, in mm2.

    Raises
    ------
    InputError
        If there are fewer than two images, they have different shapes or are too small, or their mean is not positive.
    """
    images = [_require_image(image) for image in flats]
    require_in_range("pixel_mm", pixel_mm, 1e-3, 50, "mm")
    if len(images) < 2 or len({image.shape for image in images}) > 1:
        shapes = sorted({image.shape for image in images})
        raise InputError(f"flats must be at least two images of the same shape, got {len(images)} of shapes {shapes}")
    counts = [side // _ROI_PX for side in images[0].shape]
    if min(counts) < 1:
        raise InputError(f"flats must have at least {_ROI_PX} x {_ROI_PX} pixels, got {images[0].shape}")
    fields = np.array([image[: counts[0] * _ROI_PX, : counts[1] * _ROI_PX] for image in images])
    mean = float(fields.mean())
    if not mean > 0:
        raise InputError(f"mean of the flats must be above 0, got {mean:g}")
    return average_over_rings(compute_power_spectrum(fields, pixel_mm) / mean**2, pixel_mm)


def compute_power_spectrum(fields: Array, pixel_mm: float) -> Array:
    """Compute the two-dimensional noise power spectrum of flat fields in regions of 128 x 128 pixels.

    Parameters
    ----------
    fields : (count, rows, cols) float64 array, any unit
        Flat fields of the same exposure, whose sides are multiples of 128 pixels.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    (128, 128) float64 array
        Noise power, in the squared unit of the fields times mm2.
    """
    count, rows, cols = fields.shape
    # The mean flat field is subtracted, because the inverse-square fall-off of the beam and the gain pattern of the
    # panel are not quantum noise. The factor corrects for the noise in the mean flat field.
    residual = (fields - fields.mean(axis=0)) * np.sqrt(count / (count - 1))
    regions = residual.reshape(count, rows // _ROI_PX, _ROI_PX, cols // _ROI_PX, _ROI_PX).swapaxes(2, 3)
    # The Hann window prevents leakage of power from low to high frequencies, where the power is thirty times smaller.
    window = np.outer(np.hanning(_ROI_PX), np.hanning(_ROI_PX))
    power = (np.abs(np.fft.fft2(regions * window)) ** 2).mean(axis=(0, 1, 2))
    return np.asarray(power * pixel_mm**2 / (window**2).sum())


def measure_image_dqe(
    mtf: tuple[Array, Array],
    nnps: tuple[Array, Array],
    kerma_ugy: float,
    photons_per_mm2_ugy: float = RQA5_PHOTONS_PER_MM2_UGY,
) -> tuple[Array, Array]:
    """Compute the DQE, MTF^2 / (NNPS q), from a measured MTF and NNPS (IEC 62220-1-1).

    Parameters
    ----------
    mtf : (frequency_per_mm, mtf) tuple of (n,) arrays, 1/mm and dimensionless
        Result of `measure_edge_mtf`.
    nnps : (frequency_per_mm, nnps_mm2) tuple of (m,) arrays, 1/mm and mm2
        Result of `measure_flat_nnps`.
    kerma_ugy : float
        Air kerma at the detector in the flat fields, in uGy.
    photons_per_mm2_ugy : float, default 30174
        Photons per mm2 and uGy of the beam; the default is that of RQA5.

    Returns
    -------
    frequency_per_mm : (m,) float64 array
        Spatial frequencies of the NNPS, in cycles per mm.
    dqe : (m,) float64 array
        DQE, dimensionless.

    Raises
    ------
    InputError
        If a number is out of range.
    """
    require_in_range("kerma_ugy", kerma_ugy, 1e-6, 1e6, "uGy")
    require_in_range("photons_per_mm2_ugy", photons_per_mm2_ugy, 1.0, 1e9, "1/(mm2 uGy)")
    frequency, noise = nnps
    return frequency, np.interp(frequency, *mtf) ** 2 / (noise * kerma_ugy * photons_per_mm2_ugy)


def measure_image_exposure_index(values: Array, signal_per_ugy: float) -> float:
    """Compute the exposure index of an image region from its median (IEC 62494-1).

    Parameters
    ----------
    values : (...) array, any unit
        Linear values of the pixels that show the object.
    signal_per_ugy : float
        Signal per uGy of air kerma of an RQA5 beam, in the unit of `values` per uGy.

    Returns
    -------
    float
        Exposure index: 100 times the air kerma, in uGy, that gives the median value.

    Raises
    ------
    InputError
        If there are no values, or `signal_per_ugy` is not positive.
    """
    require_in_range("signal_per_ugy", signal_per_ugy, 1e-12, 1e12, "1/uGy")
    numbers = np.asarray(values, np.float64)
    if not numbers.size or not np.isfinite(numbers).all():
        raise InputError(f"values must be finite numbers, got {numbers.size} values")
    return 100.0 * float(np.median(numbers)) / signal_per_ugy


def average_over_rings(power: Array, pixel_mm: float) -> tuple[Array, Array]:
    """Average a power spectrum over frequency rings up to the Nyquist frequency, excluding the axes.

    Parameters
    ----------
    power : (128, 128) float64 array, any unit
        Power spectrum, as from `compute_power_spectrum`.
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    frequency_per_mm : (n,) float64 array
        Mean spatial frequency of each ring, in cycles per mm.
    power : (n,) float64 array
        Mean power of each ring, in the unit of `power`.
    """
    radius = ring_frequencies_per_mm(pixel_mm)
    step = radius[0, 1] * 2
    used = (np.arange(len(radius))[:, None] > 0) & (np.arange(len(radius)) > 0) & (radius < 0.5 / pixel_mm)
    ring = np.rint(radius[used] / step).astype(int)
    count = np.bincount(ring)
    kept = count > 0
    return (np.bincount(ring, radius[used]) / np.maximum(count, 1))[kept], (
        np.bincount(ring, power[used]) / np.maximum(count, 1)
    )[kept]


def ring_frequencies_per_mm(pixel_mm: float) -> Array:
    """Compute the spatial frequency of each value of a power spectrum from `compute_power_spectrum`.

    Parameters
    ----------
    pixel_mm : float
        Pixel pitch, in mm.

    Returns
    -------
    (128, 128) float64 array
        Spatial frequencies, in cycles per mm.
    """
    f = np.fft.fftfreq(_ROI_PX, pixel_mm)
    return np.asarray(np.hypot(*np.meshgrid(f, f)))


def _require_image(image: Array) -> Array:
    """Return an image as a float64 array; raise InputError if it is not a two-dimensional array of finite numbers."""
    values = np.asarray(image)
    if values.ndim != 2 or values.dtype.kind not in "uif" or min(values.shape) < 2 * _LEAST_REACH_PX:
        raise InputError(
            f"image must be a two-dimensional array of numbers, of at least {2 * _LEAST_REACH_PX} pixels per side, got "
            f"shape {values.shape} and type {values.dtype}"
        )
    if not np.isfinite(values).all():
        raise InputError(f"image must contain finite numbers, got {int((~np.isfinite(values)).sum())} others")
    return values.astype(np.float64)
