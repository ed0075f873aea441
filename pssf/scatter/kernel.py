"""Scatter by kernels fitted to the Monte Carlo of `monte_carlo`; on a coarse grid, for it is smooth."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from ..core.blocks import Rows, block_mean, enlarge
from ..core.checks import Array
from ..data.kernels import ScatterKernel
from ..geometry.scene import Scene
from ..geometry.view import View
from ..model.protocol import Protocol
from ..raycast.scanline import crossings
from ..raycast.sheets import BAND_ROWS, sheet_of
from ..xray.collimator import is_collimated, open_shares
from ..xray.spectrum import beam_of, heel_factor
from ..xray.technique import Technique

_COARSE_MM = 9.6
# Rays along a side of the field that look for the exit, and those of them in its middle.
_LOOKS, _MIDDLE = 32, slice(12, 20)
# Gaps are taken for the same, cell by cell, between whole ones so far apart at most.
_GAP_STEP_MM = 20.0
# How an object leans is told over so many mm (standard deviation).
_LEANING_MM = 20.0
# Side of the plane that the constants were fitted on. On a smaller one, scatter that leaves the object beside the beam
# and reaches the detector would be lost, and Gaussians wider than the plane would come around to it again.
_PLANE_MM = 307.2
# Behind metal hardly anything is left; its logarithm is kept finite.
_LEAST = 1e-5


def scatter_kev(
    primary_kev: NDArray[np.float32],
    path_mm: Mapping[str, Rows],
    gaps_mm: Array | float,
    technique: Technique,
    workers: int = 2,
) -> NDArray[np.float32]:
    """(rows, cols)  mean energy absorbed from scattered photons, keV a pixel

    A sum of terms, each in three steps: photons scatter in proportion to powers of the mass crossed and of the primary
    that is left; they spread within the object and are weakened by what lies where they leave; and they spread
    on across the air gap, each as far as it is there. Where an object leans, what counts is its thickness, not the way
    along the rays. What is irradiated is the collimator's field on the detector, as in the Monte Carlo
    (`xray.collimator`). Form, constants, how far they hold, small fields too: `data/scatter.toml` (limbs of 100 to
    140 mm, gaps of 20 to 210 mm); for other objects there is `monte_carlo.scatter_monte_carlo`.
    primary_kev  (rows, cols)
    path_mm      material -> (rows, cols)
    gaps_mm      (32, 32)  from where the object ends to the detector plane: of `exit_gaps_mm`, or one for all
    workers      threads; the result does not depend on them
    """
    opened, mass, passed, step = coarse(primary_kev, path_mm, technique, workers)
    most = float(opened.max())
    if not (opened * mass).any():  # nothing of the object is irradiated
        return np.zeros(primary_kev.shape, np.float32)
    state = Crossed(opened=opened / most, mass=mass, passed=passed, cell_mm=step * technique.protocol.pixel_mm)
    gaps = gaps_in_cells(gaps_mm, mass.shape, step, technique.view)
    share = _shares_on_plane(state, gaps, technique)
    return enlarge(np.maximum(share, 0) * most, step, primary_kev.shape)


def _shares_on_plane(crossed: "Crossed", gaps_mm: Array, technique: Technique) -> Array:
    """Compute `shares`, for a small detector on a plane as large as the fitted one, unirradiated around it.

    gaps_mm  (rows, cols)  from where the object ends to the detector plane; those at the edge go on beyond it
    """
    shape = crossed.opened.shape
    view, full_mm = technique.view, technique.kernel.full_field_mm
    missing = [max(int(_PLANE_MM / crossed.cell_mm + 1e-6) - n, 0) for n in shape]
    # A detector as large as the smallest field that the kernel holds for is its own plane.
    holds = view.cols * view.pixel_mm >= full_mm[0] and view.rows * view.pixel_mm >= full_mm[1]
    if holds or not any(missing):
        return shares(crossed, gaps_mm, technique.protocol, technique.kernel)
    around = [(more // 2, more - more // 2) for more in missing]
    # The last cells may reach beyond the detector, where nothing is irradiated.
    sides = zip(shape, (view.rows, view.cols), strict=True)
    pixels = crossed.cell_mm / view.pixel_mm
    covered = np.outer(*(np.minimum(count / pixels - np.arange(n), 1.0) for n, count in sides))
    wide = Crossed(
        opened=np.pad(crossed.opened * covered, around),
        mass=np.pad(crossed.mass, around),
        passed=np.pad(crossed.passed, around, constant_values=1.0),
        cell_mm=crossed.cell_mm,
    )
    gaps_mm = np.pad(gaps_mm, around, mode="edge")
    inner = tuple(slice(before, before + n) for (before, _), n in zip(around, shape, strict=True))
    return np.asarray(shares(wide, gaps_mm, technique.protocol, technique.kernel)[inner])


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


def exit_gaps_mm(scene: Scene, view: View) -> Array:
    """(32, 32)  from where rays leave the scene to the detector plane, mm, over a square around the field

    Of a ray that misses the scene it is that of the nearest that meets it; if all do, the gap behind the box around it.
    raises  InputError for a scene whose meshes bound no solid
    """
    looks = replace(view, rows=_LOOKS, cols=_LOOKS, pixel_mm=_look_mm(view))
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
    if not last.any():
        return np.full_like(last, max(0.0, view.centre_mm[1] - float(scene.bounds_mm[1, 1])))
    nearest = distance_transform_edt(last == 0, return_distances=False, return_indices=True)
    return np.asarray((1 - last[tuple(nearest)]) * (view.centre_mm[1] - view.source_mm[1]))


def middle_gap_mm(gaps_mm: Array | float) -> float:
    """Mean of gaps over the middle quarter in width and in height, mm; or the one for all.

    gaps_mm  (32, 32)  of `exit_gaps_mm`
    """
    return float(np.mean(gaps_mm[_MIDDLE, _MIDDLE] if isinstance(gaps_mm, np.ndarray) else gaps_mm))


def _look_mm(view: View) -> float:
    return max(view.rows, view.cols) * view.pixel_mm / _LOOKS


def gaps_in_cells(gaps_mm: Array | float, shape: tuple[int, ...], step: int, view: View) -> Array:
    """Gaps in the cells of the kernel.

    gaps_mm  (32, 32)  of `exit_gaps_mm`, or one for all
    shape    (rows, cols) of the cells
    step     pixels along the side of one
    """
    if not isinstance(gaps_mm, np.ndarray):
        return np.full(shape, float(gaps_mm))
    places = [
        ((np.arange(cells) + 0.5) * step - pixels / 2) * view.pixel_mm / _look_mm(view) + (_LOOKS - 1) / 2
        for cells, pixels in zip(shape, (view.rows, view.cols), strict=True)
    ]
    return np.asarray(map_coordinates(gaps_mm, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest"))


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


def shares(crossed: Crossed, gaps_mm: Array, protocol: Protocol, kernel: ScatterKernel) -> Array:
    """(rows, cols)  scatter over the largest of the open beam

    gaps_mm   (rows, cols)  from where the object ends to the detector plane
    protocol  whose tube voltage and projection count
    """
    opened, passed, plane = crossed.opened, crossed.passed, _Plane(crossed.opened.shape, crossed.cell_mm)
    # Held at the ends of what was fitted: metal is not a limb, and powers of it would grow without bound.
    straight = crossed.mass * _cosines(gaps_mm, crossed.cell_mm) / kernel.reference_g_per_cm2
    mass = np.minimum(straight, kernel.most_mass)
    weight = opened * mass**2
    thickness = float((weight * mass).sum() / weight.sum())
    logarithm = float((weight * np.log(passed)).sum() / weight.sum())
    logarithm = float(np.clip(logarithm, *kernel.logs)) - kernel.reference_log
    kv = (float(np.clip(protocol.tube_kv, *kernel.tube_kv)) - kernel.reference_kv) / 10.0
    parts, depth, fitted = _by_gap(gaps_mm), plane.spectrum(np.log(passed)), kernel.of(protocol.projection)
    total = np.zeros_like(depth)
    for term in fitted.term:
        made = opened * mass**term.mass_power * passed**term.primary_power
        leaving = plane.spread(plane.spectrum(made), term.inner_mm * thickness**fitted.inner_power)
        leaving *= np.exp(term.exit_power * plane.spread(depth, term.exit_mm))
        strength = np.exp(term.log_strength + term.per_10_kv * kv + term.per_log * logarithm)
        for gap_mm, share in parts:
            sigma_mm = term.slope * (gap_mm + term.depth_mm)
            total += strength * plane.spectrum(leaving * share) * plane.gaussian(sigma_mm)
    return plane.back(total)


def _cosines(gaps_mm: Array, cell_mm: float) -> Array:
    """(rows, cols)  of the angle by which an object leans along the beam, by where rays leave it."""
    slope = gaussian_filter(gaps_mm, _LEANING_MM / cell_mm, order=(1, 0), mode="nearest") / cell_mm
    return np.asarray(1 / np.hypot(1.0, slope))


def _by_gap(gaps_mm: Array) -> list[tuple[float, Array]]:
    """A few gaps between the least and the most, and how much of each cell (rows, cols) belongs to either beside it."""
    least, most = float(gaps_mm.min()), float(gaps_mm.max())
    count = int(np.ceil((most - least) / _GAP_STEP_MM)) + 1
    if count == 1:
        return [(least, np.ones_like(gaps_mm))]
    gaps = np.linspace(least, most, count)
    return [(float(gap), np.maximum(1 - np.abs(gaps_mm - gap) / (gaps[1] - gaps[0]), 0.0)) for gap in gaps]


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
