"""Scatter by kernels fitted to the Monte Carlo of `monte_carlo`; on a coarse grid, for it is smooth."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..core.blocks import Rows, block_mean, enlarge
from ..core.checks import Array
from ..data.kernels import ScatterKernel
from ..geometry.scene import Scene
from ..geometry.view import View
from ..raycast.scanline import crossings
from ..raycast.sheets import BAND_ROWS, sheet_of
from ..xray.collimator import is_collimated, open_shares
from ..xray.spectrum import beam_of, heel_factor
from ..xray.technique import Technique

_COARSE_MM = 9.6
# Rays along a side of the field that look for the exit, and those of them in its middle.
_LOOKS, _MIDDLE = 32, slice(12, 20)
# Behind metal hardly anything is left; its logarithm is kept finite.
_LEAST = 1e-5


def scatter_kev(
    primary_kev: NDArray[np.float32], path_mm: Mapping[str, Rows], gap_mm: float, technique: Technique, workers: int = 2
) -> NDArray[np.float32]:
    """(rows, cols)  mean energy absorbed from scattered photons, keV a pixel

    A sum of terms, each in three steps: photons scatter in proportion to powers of the mass crossed and of the primary
    that is left; they spread within the object and are weakened by what lies where they leave; and they spread
    on across the air gap. Form, constants, and how far they hold: `data/scatter.toml` (limbs of 100 to 140 mm, gaps of
    20 to 210 mm); for other objects there is `monte_carlo.scatter_monte_carlo`.
    primary_kev  (rows, cols)
    path_mm      material -> (rows, cols)
    gap_mm       from where the object ends, in the middle of the field, to the detector plane: see `exit_gap_mm`
    workers      threads; the result does not depend on them
    """
    opened, mass, passed, step = coarse(primary_kev, path_mm, technique, workers)
    most = float(opened.max())
    if most == 0 or not mass.any():
        return np.zeros(primary_kev.shape, np.float32)
    state = Crossed(opened=opened / most, mass=mass, passed=passed, cell_mm=step * technique.protocol.pixel_mm)
    share = shares(state, gap_mm, technique.protocol.tube_kv, technique.kernel)
    return enlarge(np.maximum(share, 0) * most, step, primary_kev.shape)


def coarse(
    primary_kev: NDArray[np.float32], path_mm: Mapping[str, Rows], technique: Technique, workers: int = 2
) -> tuple[Array, Array, Array, int]:
    """What the kernel works on, in blocks: open beam (keV a pixel), mass crossed (g/cm2), primary over the open beam

    primary_kev  (rows, cols)  keV a pixel
    path_mm  material -> (rows, cols)
    returns  three maps (rows, cols) and the pixels along the side of a block
    """
    step = max(1, round(_COARSE_MM / technique.protocol.pixel_mm))
    primary = block_mean(primary_kev, step)
    mass = np.zeros_like(primary)
    with ThreadPoolExecutor(workers) as pool:
        means = list(pool.map(lambda lengths: block_mean(lengths, step), path_mm.values()))
    for name, lengths in zip(path_mm, means, strict=True):
        mass += lengths * (technique.material(name).density_g_per_cm3 / 10.0)
    opened = _open_kev(primary.shape, step, technique)
    passed = np.divide(primary, opened, out=np.ones_like(primary), where=opened > 0)
    return opened, np.maximum(mass, 0), np.clip(passed, _LEAST, 1.0), step


def exit_gap_mm(scene: Scene, view: View) -> float:
    """From where rays leave the scene to the detector plane, mm.

    The mean over rays to the middle quarter, in width and in height, of a square around the field. Those that miss the
    scene do not count; if all do, it is the gap behind the box around the scene.
    raises  InputError for a scene whose meshes bound no solid
    """
    side = max(view.rows, view.cols) * view.pixel_mm / _LOOKS
    looks = replace(view, rows=_LOOKS, cols=_LOOKS, pixel_mm=side)
    last = np.zeros((_LOOKS, _LOOKS))
    for surface in scene.surfaces:
        sheet = sheet_of(surface.solid, looks) if surface.outside == scene.ambient else None
        if sheet is None or sheet.rows[0] >= sheet.rows[1] or sheet.cols[0] >= sheet.cols[1]:
            continue
        assert looks.rows <= BAND_ROWS
        crossed = crossings(sheet, *sheet.rows)
        row, col, rows, cols = crossed.window
        met = np.diff(crossed.starts) > 0
        depth = np.zeros(rows * cols)
        depth[met] = crossed.depth[crossed.starts[1:][met] - 1]
        part = last[row : row + rows, col : col + cols]
        np.maximum(part, np.minimum(depth, 1.0).reshape(rows, cols), out=part)
    middle = last[_MIDDLE, _MIDDLE]
    if not middle.any():
        return max(0.0, view.centre_mm[1] - float(scene.bounds_mm[1, 1]))
    return float((1 - middle[middle > 0].mean()) * (view.centre_mm[1] - view.source_mm[1]))


def _open_kev(shape: tuple[int, ...], step: int, technique: Technique) -> Array:
    """(rows, cols)  primary without an object, at the centres of blocks, keV a pixel"""
    protocol, view, beam = technique.protocol, technique.view, beam_of(technique)
    source, corner = view.source_mm, view.corner_mm
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
        opened *= np.outer(*open_shares(technique, step))
    return np.asarray(opened)


@dataclass(frozen=True, kw_only=True)
class Crossed:
    """What the kernel works on, in cells.

    opened   (rows, cols)  open beam over its largest; 1 where that is
    mass     (rows, cols)  crossed, g/cm2
    passed   (rows, cols)  primary over the open beam
    cell_mm  side of a cell of the maps
    """

    opened: Array
    mass: Array
    passed: Array
    cell_mm: float


def shares(crossed: Crossed, gap_mm: float, tube_kv: float, kernel: ScatterKernel) -> Array:
    """(rows, cols)  scatter over the largest of the open beam"""
    opened, passed, plane = crossed.opened, crossed.passed, _Plane(crossed.opened.shape, crossed.cell_mm)
    # Held at the ends of what was fitted: metal is not a limb, and powers of it would grow without bound.
    mass = np.minimum(crossed.mass / kernel.reference_g_per_cm2, kernel.most_mass)
    weight = opened * mass**2
    thickness = float((weight * mass).sum() / weight.sum())
    logarithm = float((weight * np.log(passed)).sum() / weight.sum())
    logarithm = float(np.clip(logarithm, *kernel.logs)) - kernel.reference_log
    kv = (float(np.clip(tube_kv, *kernel.tube_kv)) - kernel.reference_kv) / 10.0
    depth = plane.spectrum(np.log(passed))
    total = np.zeros_like(plane.spectrum(opened))
    for term in kernel.term:
        made = opened * mass**term.mass_power * passed**term.primary_power
        leaving = plane.spread(plane.spectrum(made), term.inner_mm * thickness**kernel.inner_power)
        leaving *= np.exp(term.exit_power * plane.spread(depth, term.exit_mm))
        strength = np.exp(term.log_strength + term.per_10_kv * kv + term.per_log * logarithm)
        total += strength * plane.spectrum(leaving) * plane.gaussian(term.slope * (gap_mm + term.depth_mm))
    return plane.back(total)


class _Plane:
    """Convolutions with normalised Gaussians on a grid; nothing comes from outside the collimated field."""

    def __init__(self, shape: tuple[int, ...], cell_mm: float) -> None:
        self.shape, self.long = shape, [fft.next_fast_len(2 * n, real=True) for n in shape]
        fy, fx = np.fft.fftfreq(self.long[0]), np.fft.rfftfreq(self.long[1])
        self.exponent = -2 * (np.pi / cell_mm) ** 2 * (fy[:, None] ** 2 + fx**2)

    def spectrum(self, image: Array) -> NDArray[np.complex128]:
        """(long rows, long cols / 2 + 1)  transform of an image (rows, cols) of any unit"""
        return np.asarray(fft.rfft2(image, self.long))

    def gaussian(self, sigma_mm: float) -> Array:
        """(long rows, long cols / 2 + 1)  transform of a normalised Gaussian"""
        return np.asarray(np.exp(self.exponent * sigma_mm**2))

    def back(self, spectrum: NDArray[np.complex128]) -> Array:
        """(rows, cols)  the image, of any unit, of a spectrum (long rows, long cols / 2 + 1)"""
        return np.asarray(fft.irfft2(spectrum, self.long)[: self.shape[0], : self.shape[1]])

    def spread(self, spectrum: NDArray[np.complex128], sigma_mm: float) -> Array:
        """(rows, cols)  the image, of any unit, of a spectrum (long rows, long cols / 2 + 1) under a Gaussian"""
        return self.back(spectrum * self.gaussian(sigma_mm))
