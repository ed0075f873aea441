"""Scatter by a kernel that depends on thickness, air gap and tube voltage; on a coarse grid, for it is smooth."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..checks import Array
from ..files import tables
from ..protocol import Protocol
from .coarse import block_mean, enlarge
from .materials import density_g_per_cm3

_COARSE_MM = 4.8


def scatter_kev(
    primary_kev: NDArray[np.float32], path_mm: Mapping[str, NDArray[np.float32]], gap_mm: float, protocol: Protocol
) -> NDArray[np.float32]:
    """(rows, cols)  mean energy absorbed from scattered photons, keV a pixel

    primary_kev  (rows, cols)
    path_mm      material -> (rows, cols); scatter is made in proportion to a power of the mass crossed
    gap_mm       from the exit of the object to the detector plane
    """
    step = max(1, round(_COARSE_MM / protocol.pixel_mm))
    primary = block_mean(primary_kev, step)
    mass = np.zeros_like(primary)
    for name, lengths in path_mm.items():
        mass += block_mean(lengths, step) * (density_g_per_cm3(name) / 10.0)
    table = tables.data("scatter")
    power = float(np.interp(protocol.tube_kv, table["tube_kv"], table["kv_factor"]))
    strength = table["limb_factor"] * power * (mass / table["reference_thickness_cm"]) ** table["thickness_power"]
    source = primary * strength
    spread = np.zeros_like(source)
    for weight, width_cm in _kernel(gap_mm):
        spread += weight * _gaussian(source, width_cm * 10.0 / (step * protocol.pixel_mm))
    return enlarge(np.maximum(spread, 0), step, primary_kev.shape)


def _kernel(gap_mm: float) -> list[tuple[float, float]]:
    """Weights and widths (cm) of the two Gaussians at an air gap."""
    rows = np.array(tables.data("scatter")["kernel"])
    w1, s1, w2, s2 = (float(np.interp(gap_mm / 10.0, rows[:, 0], rows[:, k])) for k in range(1, 5))
    return [(w1, s1), (w2, s2)]


def _gaussian(image: Array, sigma_px: float) -> Array:
    """Convolution with a normalised Gaussian; nothing comes from outside the collimated field."""
    shape = [fft.next_fast_len(n + int(np.ceil(4 * sigma_px)), real=True) for n in image.shape]
    spectrum = fft.rfft2(image, shape)
    fy, fx = np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])
    spectrum *= np.exp(-2 * (np.pi * sigma_px) ** 2 * (fy[:, None] ** 2 + fx**2))
    return fft.irfft2(spectrum, shape)[: image.shape[0], : image.shape[1]]
