"""The panel: blur by focal spot and scintillator, quantum and readout noise, 16-bit numbers, and a view for eyes."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from ..files import tables
from ..geometry import View, magnification
from ..protocol import Protocol
from .coarse import block_mean, enlarge

Map = NDArray[np.float32]
_BAND_ROWS = 256
_MARGIN_PX = 32


def focal_spot_blur(image: Map, focal_spot_mm: float, view: View, workers: int = 2) -> Map:
    """(rows, cols)  blurred by a square spot, magnified as in the joint plane: width a (M - 1)"""
    width_px = focal_spot_mm * (magnification(view) - 1) / view.pixel_mm
    return _filter(image, lambda fy, fx: np.sinc(width_px * fy)[:, None] * np.sinc(width_px * fx), workers)


def detector_blur(image: Map, pixel_mm: float, workers: int = 2, detector: str = "csi") -> Map:
    """(rows, cols)  blurred by the panel's presampled MTF 1 / (1 + (f/f0)^p) (csi: fit to Marshall 2011, Samei 2003)"""
    table = tables.data("detector")[detector]

    def mtf(fy: Map, fx: Map) -> Map:
        # In place: a fresh large array costs more time than the arithmetic.
        scale = pixel_mm * table["mtf_f0_per_mm"]
        value = (fy / scale)[:, None] ** 2 + (fx / scale) ** 2
        np.power(value, table["mtf_power"] / 2, out=value)
        value += 1
        return np.reciprocal(value, out=value)

    return _filter(image, mtf, workers)


def quantum_noise(
    kev: Map, photon_kev: Map, seed: np.random.SeedSequence, workers: int = 2, detector: str = "csi"
) -> Map:
    """(rows, cols)  energy absorbed in one exposure, keV: mean `kev`, variance kev * photon_kev / Swank

    A compound Poisson sum of photons is drawn as a Poisson count of effective quanta of equal energy, so that mean and
    variance are those of the polychromatic beam (Swank 1973).
    photon_kev  (rows, cols)  mean square over mean energy of an absorbed photon
    workers     threads; bands of rows own their streams, so the result does not depend on them
    """
    swank = tables.data("detector")[detector]["swank"]

    def draw(rng: np.random.Generator, rows: slice) -> Map:
        quantum = photon_kev[rows] / np.float32(swank)
        count = np.divide(kev[rows], quantum, out=np.zeros_like(quantum), where=quantum > 0)
        return (rng.poisson(count) * quantum).astype(np.float32)

    return _in_bands(kev.shape, seed, draw, workers)


def readout(kev: Map, protocol: Protocol, seed: np.random.SeedSequence | None, workers: int = 2) -> NDArray[np.uint16]:
    """(rows, cols) uint16  gain, readout noise (Gaussian, electrons), offset, saturation, dead pixels

    A larger pixel holds charge in proportion to its area.
    seed  of the noise; None for none
    """
    table = tables.data("detector")[protocol.detector]
    electrons = kev * np.float32(table["electrons_per_kev"])
    if seed is not None:
        sigma = np.float32(table["readout_electrons"])
        electrons = electrons + sigma * _in_bands(
            kev.shape,
            seed,
            lambda rng, rows: rng.standard_normal((rows.stop - rows.start, kev.shape[1]), np.float32),
            workers,
        )
    per_dn = np.float32(table["electrons_per_dn_mm2"] * protocol.pixel_mm**2)
    pixels = np.clip(np.rint(electrons / per_dn + np.float32(table["offset_dn"])), 0, 65535).astype(np.uint16)
    if protocol.dead_pixels:
        pixels[dead_pixels(protocol)] = 0
    return pixels


def dead_pixels(protocol: Protocol) -> NDArray[np.bool_]:
    """(rows, cols)  which pixels of a protocol's detector read nothing; the same in every exposure"""
    rng = np.random.default_rng(tables.data("detector")[protocol.detector]["dead_seed"])
    return rng.random((protocol.rows, protocol.cols)) < protocol.dead_pixels


def present(pixels: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """(rows, cols) uint8  for eyes: log signal, bone bright, large structures evened out, edges a little sharper"""
    table = tables.data("detector")["csi"]
    signal = np.maximum(pixels.astype(np.float32) - np.float32(table["offset_dn"]), 1.0)
    density = -np.log(signal)
    step = max(1, max(pixels.shape) // 128)
    coarse = enlarge(ndimage.gaussian_filter(block_mean(density, step), 4.0), step, pixels.shape)
    # Part of what is larger than a few centimetres is taken away, so that thigh, knee and calf share one window.
    even = density - 0.45 * coarse + 0.6 * (density - ndimage.gaussian_filter(density, 3.0))
    low, high = np.percentile(even[::4, ::4], [0.5, 99.8])
    scaled = np.clip((even - low) / max(float(high - low), 1e-6), 0, 1.12)
    return np.clip(np.rint(225.0 * scaled**2.2), 0, 255).astype(np.uint8)


def _in_bands(
    shape: tuple[int, ...],
    seed: np.random.SeedSequence,
    draw: Callable[[np.random.Generator, slice], Map],
    workers: int,
) -> Map:
    starts = range(0, shape[0], _BAND_ROWS)
    result = np.empty(shape, np.float32)

    def fill(job: tuple[int, np.random.SeedSequence]) -> None:
        rows = slice(job[0], min(job[0] + _BAND_ROWS, shape[0]))
        result[rows] = draw(np.random.default_rng(job[1]), rows)

    # Children by key, not by spawn(), which would count up a seed that is used twice.
    children = [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(len(starts))]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, zip(starts, children, strict=True)))
    return result


def _filter(image: Map, response: Callable[[Map, Map], Map], workers: int) -> Map:
    """Multiplication in frequency; the margin mirrors the image, so that its far sides do not bleed into each other."""
    shape = [fft.next_fast_len(n + 2 * min(_MARGIN_PX, n), real=True) for n in image.shape]
    before = [(long - n) // 2 for long, n in zip(shape, image.shape, strict=True)]
    margins = [(b, long - n - b) for b, long, n in zip(before, shape, image.shape, strict=True)]
    spectrum = fft.rfft2(np.pad(image, margins, mode="symmetric"), workers=workers)
    fy, fx = (f.astype(np.float32) for f in (np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])))
    spectrum *= response(fy, fx).astype(np.float32, copy=False)
    back = fft.irfft2(spectrum, shape, workers=workers, overwrite_x=True)
    return back[before[0] : before[0] + image.shape[0], before[1] : before[1] + image.shape[1]]
