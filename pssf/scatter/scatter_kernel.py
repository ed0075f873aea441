"""Scatter kernel fitted to Monte Carlo results, applied on a coarse grid of cells because scatter is smooth."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from ..core.checks import Array
from ..core.resample import RowSliceable, downsample_by_blocks, upsample_linear
from ..data.imaging.scatter_table import ScatterKernel
from ..geometry.scene import Scene
from ..geometry.view import View
from ..model.protocol import Protocol
from ..raycast.engines.projected_surface import BAND_ROWS, project_surface
from ..raycast.engines.scanline import find_crossings
from ..xray.collimator import compute_transmission_factors, is_collimated
from ..xray.resolved_technique import Technique
from ..xray.spectrum import compute_beam, heel_factor
from .detector_correction import compute_detector_factor, convert_to_fitted_detector

# Side length of a coarse grid cell, in mm.
_CELL_MM = 9.6
# Number of rays along each side of the square around the field, for the computation of air gaps.
_LOOKS = 32
# Index range of the rays in the middle quarter of the square, for rows and columns.
_MIDDLE = slice(12, 20)
# Maximum spacing of the air gaps for which the kernel is computed, in mm; scatter at other gaps is interpolated.
_GAP_STEP_MM = 20.0
# Standard deviation of the Gaussian filter that smooths the air gaps before the object tilt is computed, in mm.
_TILT_SIGMA_MM = 20.0
# Side length of the detector plane for which the kernel constants were fitted, in mm. A smaller plane would lose
# scatter that leaves the object outside the beam and reaches the detector. Gaussians wider than the plane would wrap
# around.
_FITTED_PLANE_MM = 307.2
# Lower limit of the transmission, dimensionless; it keeps the logarithm finite behind metal.
_MIN_TRANSMISSION = 1e-5


def compute_kernel_scatter_kev(
    primary_kev: NDArray[np.float32],
    path_mm: Mapping[str, RowSliceable],
    air_gaps_mm: Array | float,
    technique: Technique,
    workers: int = 2,
) -> NDArray[np.float32]:
    """Compute the scatter signal with the fitted scatter kernel.

    Parameters
    ----------
    primary_kev : (rows, cols) float32 array, keV
        Primary signal, in keV per pixel.
    path_mm : mapping of str to (rows, cols) array, mm
        Path length per material.
    air_gaps_mm : (32, 32) array, mm, or float
        Distance from the exit point of each ray to the detector plane, from `compute_air_gaps_mm`, or one distance for
        all rays.
    technique : Technique
        Resolved protocol.
    workers : int, default 2
        Number of threads; it does not change the result.

    Returns
    -------
    (rows, cols) float32 array
        Mean energy absorbed from scattered photons, in keV per pixel.

    Notes
    -----
    The scatter is a sum of terms, each with three steps. First, photons scatter in proportion to powers of the mass per
    area and of the primary transmission. Second, scattered photons spread within the object and are attenuated on the
    way out. Third, scattered photons spread across the air gap, which varies with position. For an object tilted
    against the beam, the mass per area along the ray is multiplied by the cosine of the tilt.

    The irradiated area is the collimated field on the detector, as in the Monte Carlo simulation (see
    `xray.collimator`).

    The equation, its constants and their valid range are in ``data/scatter.toml``, which also gives the error in small
    fields. The constants are valid for limbs of 100 to 140 mm and gaps of 20 to 210 mm. For other objects, use
    `monte_carlo.compute_monte_carlo_scatter_kev`.
    """
    opened, mass, passed, step = coarsen_kernel_input(primary_kev, path_mm, technique, workers)
    most = float(opened.max())
    if not (opened * mass).any():  # Without an irradiated object, there is no scatter.
        return np.zeros(primary_kev.shape, np.float32)
    passed = convert_to_fitted_detector(passed, technique)
    state = KernelInput(
        open_beam=opened / most, mass_g_per_cm2=mass, transmission=passed, cell_mm=step * technique.protocol.pixel_mm
    )
    gaps = interpolate_air_gaps_mm(air_gaps_mm, mass.shape, step, technique.view)
    share = _compute_padded_scatter_fraction(state, gaps, technique)
    weight = opened * mass**2
    log_transmission = float((weight * np.log(passed)).sum() / weight.sum())
    most *= compute_detector_factor(log_transmission, central_air_gap_mm(air_gaps_mm), technique)
    return upsample_linear(np.maximum(share, 0) * most, step, primary_kev.shape)


def _compute_padded_scatter_fraction(kernel_input: "KernelInput", air_gaps_mm: Array, technique: Technique) -> Array:
    """Compute the scatter fraction; a small detector is padded to the fitted plane with unirradiated cells.

    `air_gaps_mm` (rows, cols) is the distance from the exit point of the rays to the detector plane; padding repeats
    the edge values.
    """
    shape = kernel_input.open_beam.shape
    view, full_mm = technique.view, technique.kernel.full_field_mm
    missing = [max(int(_FITTED_PLANE_MM / kernel_input.cell_mm + 1e-6) - n, 0) for n in shape]
    # A detector at least as large as the smallest fitted field needs no padding.
    holds = view.cols * view.pixel_mm >= full_mm[0] and view.rows * view.pixel_mm >= full_mm[1]
    if holds or not any(missing):
        return compute_scatter_fraction(kernel_input, air_gaps_mm, technique.protocol, technique.kernel)
    around = [(more // 2, more - more // 2) for more in missing]
    # The last row and column of cells may extend beyond the detector, where no cell area is irradiated.
    sides = zip(shape, (view.rows, view.cols), strict=True)
    pixels = kernel_input.cell_mm / view.pixel_mm
    covered = np.outer(*(np.minimum(count / pixels - np.arange(n), 1.0) for n, count in sides))
    wide = KernelInput(
        open_beam=np.pad(kernel_input.open_beam * covered, around),
        mass_g_per_cm2=np.pad(kernel_input.mass_g_per_cm2, around),
        transmission=np.pad(kernel_input.transmission, around, constant_values=1.0),
        cell_mm=kernel_input.cell_mm,
    )
    air_gaps_mm = np.pad(air_gaps_mm, around, mode="edge")
    inner = tuple(slice(before, before + n) for (before, _), n in zip(around, shape, strict=True))
    return np.asarray(compute_scatter_fraction(wide, air_gaps_mm, technique.protocol, technique.kernel)[inner])


def coarsen_kernel_input(
    primary_kev: NDArray[np.float32], path_mm: Mapping[str, RowSliceable], technique: Technique, workers: int = 2
) -> tuple[Array, Array, Array, int]:
    """Average the input maps of the scatter kernel over cells.

    Parameters
    ----------
    primary_kev : (rows, cols) float32 array, keV
        Primary signal, in keV per pixel.
    path_mm : mapping of str to (rows, cols) array, mm
        Path length per material.
    technique : Technique
        Resolved protocol.
    workers : int, default 2
        Number of threads; it does not change the result.

    Returns
    -------
    open_beam : (cells, cells) float64 array
        Signal of the open beam, in keV per pixel.
    mass : (cells, cells) float64 array
        Mass per area along the rays, in g/cm2.
    transmission : (cells, cells) float64 array
        Primary signal divided by the open-beam signal, from 1e-5 to 1.
    step : int
        Number of pixels along the side of a cell.
    """
    step = max(1, round(_CELL_MM / technique.protocol.pixel_mm))
    primary = downsample_by_blocks(primary_kev, step)
    mass = np.zeros_like(primary)
    with ThreadPoolExecutor(workers) as pool:
        means = list(pool.map(lambda lengths: downsample_by_blocks(lengths, step), path_mm.values()))
    for name, lengths in zip(path_mm, means, strict=True):
        mass += lengths * (technique.material(name).density_g_per_cm3 / 10.0)
    opened = _open_beam_kev(primary.shape, step, technique)
    passed = np.divide(primary, opened, out=np.ones_like(primary), where=opened > 0)
    return opened, np.maximum(mass, 0), np.clip(passed, _MIN_TRANSMISSION, 1.0), step


def compute_air_gaps_mm(scene: Scene, view: View) -> Array:
    """Compute the air gaps from the ray exit points to the detector plane, for a square grid of rays.

    The grid is centred on the field, and its side is the longer side of the field.

    Parameters
    ----------
    scene : Scene
        Closed surfaces.
    view : View
        Source and detector.

    Returns
    -------
    (32, 32) float64 array
        Air gaps, in mm. A ray that misses the scene has the air gap of the nearest ray that hits the scene. If all rays
        miss the scene, the air gap is the distance from the scene bounding box to the detector plane.

    Raises
    ------
    InputError
        If a mesh does not bound a solid.
    """
    looks = replace(view, rows=_LOOKS, cols=_LOOKS, pixel_mm=_gap_pitch_mm(view))
    last = np.zeros((_LOOKS, _LOOKS))
    for surface in scene.surfaces:
        sheet = project_surface(surface.solid, looks) if surface.outside == scene.ambient else None
        if sheet is None or sheet.rows[0] >= sheet.rows[1] or sheet.cols[0] >= sheet.cols[1]:
            continue
        assert looks.rows <= BAND_ROWS
        crossed = find_crossings(sheet, *sheet.rows)
        row, col, rows, cols = crossed.window
        met = np.diff(crossed.starts) > 0
        depth = np.zeros(rows * cols)
        depth[met] = crossed.depth[crossed.starts[1:][met] - 1]
        part = last[row : row + rows, col : col + cols]
        np.maximum(part, np.minimum(depth, 1.0).reshape(rows, cols), out=part)
    if not last.any():
        return np.full_like(last, max(0.0, view.centre_mm[1] - float(scene.bounds_mm[1, 1])))
    nearest = distance_transform_edt(last == 0, return_distances=False, return_indices=True)
    return np.asarray((1 - last[tuple(nearest)]) * (view.centre_mm[1] - view.source_mm[1]))


def central_air_gap_mm(air_gaps_mm: Array | float) -> float:
    """Compute the mean air gap in the central quarter of the field width and height.

    Parameters
    ----------
    air_gaps_mm : (32, 32) array, mm, or float
        Air gaps from `compute_air_gaps_mm`, or one air gap for all rays.

    Returns
    -------
    float
        Mean air gap, in mm.
    """
    return float(np.mean(air_gaps_mm[_MIDDLE, _MIDDLE] if isinstance(air_gaps_mm, np.ndarray) else air_gaps_mm))


def _gap_pitch_mm(view: View) -> float:
    """Compute the spacing of the air-gap rays on the detector, in mm."""
    return max(view.rows, view.cols) * view.pixel_mm / _LOOKS


def interpolate_air_gaps_mm(air_gaps_mm: Array | float, shape: tuple[int, ...], step: int, view: View) -> Array:
    """Interpolate air gaps at the cell centres.

    Parameters
    ----------
    air_gaps_mm : (32, 32) array, mm, or float
        Air gaps from `compute_air_gaps_mm`, or one air gap for all rays.
    shape : tuple of int
        Number of rows and columns of cells.
    step : int
        Number of pixels along the side of a cell.
    view : View
        Source and detector.

    Returns
    -------
    (rows, cols) float64 array
        Air gap per cell, in mm.
    """
    if not isinstance(air_gaps_mm, np.ndarray):
        return np.full(shape, float(air_gaps_mm))
    places = [
        ((np.arange(cells) + 0.5) * step - pixels / 2) * view.pixel_mm / _gap_pitch_mm(view) + (_LOOKS - 1) / 2
        for cells, pixels in zip(shape, (view.rows, view.cols), strict=True)
    ]
    return np.asarray(map_coordinates(air_gaps_mm, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest"))


def _open_beam_kev(shape: tuple[int, ...], step: int, technique: Technique) -> Array:
    """Compute the open-beam signal at the centres of cells (rows, cols), in keV per pixel."""
    protocol, view, beam = technique.protocol, technique.view, compute_beam(technique)
    source, corner = view.source_mm, view.first_pixel_mm
    places = [(np.arange(n) + 0.5) * step - 0.5 for n in shape]
    dz = corner[2] - np.minimum(places[0], view.rows - 1) * view.pixel_mm - source[2]
    dx = corner[0] + np.minimum(places[1], view.cols - 1) * view.pixel_mm - source[0]
    depth = corner[1] - source[1]
    distance2 = dx**2 + depth**2 + dz[:, None] ** 2
    signal = float((beam.photons_per_mm2 * beam.signal_kev).sum())
    opened = signal * view.pixel_mm**2 * 1e6 * depth / distance2**1.5
    if protocol.heel != "none":
        opened *= np.interp(places[0], np.arange(protocol.rows), heel_factor(technique))[:, None]
    if is_collimated(protocol):
        opened *= np.outer(*compute_transmission_factors(technique, step))
    return np.asarray(opened)


@dataclass(frozen=True, kw_only=True)
class KernelInput:
    """Input maps of the scatter kernel, per cell.

    Attributes
    ----------
    open_beam : (rows, cols) float64 array
        Open-beam signal divided by its maximum, from 0 to 1.
    mass_g_per_cm2 : (rows, cols) float64 array
        Mass per area along the rays, in g/cm2.
    transmission : (rows, cols) float64 array
        Primary signal divided by the open-beam signal.
    cell_mm : float
        Side length of a cell, in mm.
    """

    open_beam: Array
    mass_g_per_cm2: Array
    transmission: Array
    cell_mm: float


def compute_scatter_fraction(
    kernel_input: KernelInput, air_gaps_mm: Array, protocol: Protocol, kernel: ScatterKernel
) -> Array:
    """Compute the scatter signal relative to the maximum of the open-beam signal.

    Parameters
    ----------
    kernel_input : KernelInput
        Open beam, mass per area and transmission, per cell.
    air_gaps_mm : (rows, cols) array, mm
        Distance from the exit surface of the object to the detector plane, per cell.
    protocol : Protocol
        Protocol with the tube voltage and the projection.
    kernel : ScatterKernel
        Fitted constants.

    Returns
    -------
    (rows, cols) float64 array
        Scatter signal divided by the maximum of the open-beam signal, dimensionless.
    """
    opened, passed, plane = (
        kernel_input.open_beam,
        kernel_input.transmission,
        _FourierPlane(kernel_input.open_beam.shape, kernel_input.cell_mm),
    )
    # The mass per area is limited to the fitted range; powers of very large values behind metal would be far too large.
    straight = (
        kernel_input.mass_g_per_cm2 * _tilt_cosines(air_gaps_mm, kernel_input.cell_mm) / kernel.reference_g_per_cm2
    )
    mass = np.minimum(straight, kernel.most_mass)
    weight = opened * mass**2
    thickness = float((weight * mass).sum() / weight.sum())
    logarithm = float((weight * np.log(passed)).sum() / weight.sum())
    logarithm = float(np.clip(logarithm, *kernel.log_primary_range)) - kernel.reference_log
    kv = (float(np.clip(protocol.tube_kv, *kernel.tube_kv)) - kernel.reference_kv) / 10.0
    parts, depth, fitted = (
        _split_by_gap(air_gaps_mm),
        plane.transform_image(np.log(passed)),
        kernel.for_projection(protocol.projection),
    )
    total = np.zeros_like(depth)
    for term in fitted.term:
        made = opened * mass**term.mass_power * passed**term.primary_power
        leaving = plane.blur_spectrum(plane.transform_image(made), term.inner_mm * thickness**fitted.inner_power)
        leaving *= np.exp(term.exit_power * plane.blur_spectrum(depth, term.exit_mm))
        strength = np.exp(term.log_strength + term.per_10_kv * kv + term.per_log * logarithm)
        for gap_mm, share in parts:
            sigma_mm = term.slope * (gap_mm + term.depth_mm)
            total += strength * plane.transform_image(leaving * share) * plane.gaussian_transfer(sigma_mm)
    return plane.invert_transform(total)


def _tilt_cosines(air_gaps_mm: Array, cell_mm: float) -> Array:
    """Compute the tilt cosine (rows, cols) of an object relative to the beam, from the gradient of its air gaps."""
    slope = gaussian_filter(air_gaps_mm, _TILT_SIGMA_MM / cell_mm, order=(1, 0), mode="nearest") / cell_mm
    return np.asarray(1 / np.hypot(1.0, slope))


def _split_by_gap(air_gaps_mm: Array) -> list[tuple[float, Array]]:
    """Select a few air gaps from the smallest to the largest, in mm, each with interpolation weights (rows, cols)."""
    least, most = float(air_gaps_mm.min()), float(air_gaps_mm.max())
    count = int(np.ceil((most - least) / _GAP_STEP_MM)) + 1
    if count == 1:
        return [(least, np.ones_like(air_gaps_mm))]
    gaps = np.linspace(least, most, count)
    return [(float(gap), np.maximum(1 - np.abs(air_gaps_mm - gap) / (gaps[1] - gaps[0]), 0.0)) for gap in gaps]


class _FourierPlane:
    """Convolution with normalised Gaussians on a grid of cells, with zeros outside the grid."""

    def __init__(self, shape: tuple[int, ...], cell_mm: float) -> None:
        self.shape, self.padded_shape = shape, [fft.next_fast_len(2 * n, real=True) for n in shape]
        fy, fx = np.fft.fftfreq(self.padded_shape[0]), np.fft.rfftfreq(self.padded_shape[1])
        self.exponent = -2 * (np.pi / cell_mm) ** 2 * (fy[:, None] ** 2 + fx**2)

    def transform_image(self, image: Array) -> NDArray[np.complex128]:
        """Compute the Fourier transform of an image.

        Parameters
        ----------
        image : (rows, cols) float64 array, any unit
            Image on the grid.

        Returns
        -------
        (padded rows, padded cols / 2 + 1) complex128 array
            Fourier transform of the image, padded with zeros.
        """
        return np.asarray(fft.rfft2(image, self.padded_shape))

    def gaussian_transfer(self, sigma_mm: float) -> Array:
        """Compute the transfer function (Fourier transform) of a normalised Gaussian.

        Parameters
        ----------
        sigma_mm : float
            Standard deviation of the Gaussian, in mm.

        Returns
        -------
        (padded rows, padded cols / 2 + 1) float64 array
            Transfer factor at each frequency, from 0 to 1.
        """
        return np.asarray(np.exp(self.exponent * sigma_mm**2))

    def invert_transform(self, spectrum: NDArray[np.complex128]) -> Array:
        """Compute an image from its Fourier transform.

        Parameters
        ----------
        spectrum : (padded rows, padded cols / 2 + 1) complex128 array, any unit
            Fourier transform of the padded image.

        Returns
        -------
        (rows, cols) float64 array
            Image, in the unit of the input.
        """
        return np.asarray(fft.irfft2(spectrum, self.padded_shape)[: self.shape[0], : self.shape[1]])

    def blur_spectrum(self, spectrum: NDArray[np.complex128], sigma_mm: float) -> Array:
        """Compute an image from its Fourier transform, blurred by a normalised Gaussian.

        Parameters
        ----------
        spectrum : (padded rows, padded cols / 2 + 1) complex128 array, any unit
            Fourier transform of the padded image.
        sigma_mm : float
            Standard deviation of the Gaussian, in mm.

        Returns
        -------
        (rows, cols) float64 array
            Blurred image, in the unit of the input.
        """
        return self.invert_transform(spectrum * self.gaussian_transfer(sigma_mm))
