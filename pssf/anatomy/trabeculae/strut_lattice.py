"""Strut lattice: synthesise the trabecular struts of a knee from a seed, as a periodic block, by FFT."""

from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ...data.anatomy.trabecular_table import StrutLattice

VoxelBlock = NDArray[np.uint8]
# Largest exponent. At an exponent of 80, the bone content is 0; above 88, the exponential overflows.
_EXPONENT_LIMIT = np.float32(80.0)
# Number of planes that are processed together. Their float32 data fit into the processor cache.
_PLANES_PER_CHUNK = 8
# Largest deviation of one person from the median, in standard deviations. Larger deviations are clipped to this value.
_MAX_SD = 2.0
# Number of cached lattices: those of both knees of a bilateral radiograph, which is computed in bands.
_CACHE_SIZE = 2
# Lock for the cache.
_LOCK = Lock()
_CACHE: dict[tuple[int, StrutLattice], tuple[VoxelBlock, float]] = {}


def make_strut_lattice(seed: int, table: StrutLattice) -> tuple[VoxelBlock, float]:
    """Make the strut lattice of a knee, or return a cached lattice.

    Parameters
    ----------
    seed : int
        Texture seed of the knee.
    table : StrutLattice
        Voxel size, power spectrum and threshold, from `data/trabeculae.toml`.

    Returns
    -------
    block : (nx + 1, nz + 1, ny) uint8 array
        Bone content of the voxels, from 0 (none) to 255 (solid), read-only and periodic. The first voxel along x and
        along z is repeated after the last voxel, so that every voxel has its neighbours at the same offsets.
    normalisation : float
        Factor that normalises the mean of the lattice to 1.

    Notes
    -----
    The lattice is a Gaussian random field with a soft threshold: bone where the field is high, and almost no bone
    elsewhere. The y axis is the last axis in memory, because rays are approximately parallel to it. The last two
    lattices are cached.
    """
    with _LOCK:  # If another thread is making the lattice, wait until it is finished.
        if (seed, table) not in _CACHE:
            while len(_CACHE) >= _CACHE_SIZE:
                del _CACHE[next(iter(_CACHE))]
            _CACHE[seed, table] = _synthesise_lattice(seed, table)
        return _CACHE[seed, table]


def sample_personal_factor(spread: float, rng: np.random.Generator) -> float:
    """Sample the ratio between the value of one person and the median, from a lognormal distribution.

    Parameters
    ----------
    spread : float
        Standard deviation of the logarithm of the factor.
    rng : numpy.random.Generator
        Random generator.

    Returns
    -------
    float
        Factor, dimensionless. Deviations are limited to two standard deviations.
    """
    return float(np.exp(spread * np.clip(rng.standard_normal(), -_MAX_SD, _MAX_SD)))


def _synthesise_lattice(seed: int, table: StrutLattice) -> tuple[VoxelBlock, float]:
    """Synthesise the block (nx + 1, nz + 1, ny) uint8, and compute the factor that normalises its mean to 1."""
    nx, nz, ny = table.voxels
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    usual, spread = table.patches
    share = usual * sample_personal_factor(spread, rng)
    struts, patches = _compute_power_spectra(table)
    amplitude = np.sqrt((1 - share) * struts + share * patches, dtype=np.float32)
    waves = rng.standard_normal((nx, nz, 2 * amplitude.shape[2]), np.float32).view(np.complex64)
    # The power is equal at f and -f. An FFT stores negative frequencies in its second half, in reverse order.
    across, up = (np.minimum(np.arange(n), n - np.arange(n)) for n in (nx, nz))
    for i, wave in enumerate(waves):
        wave *= amplitude[across[i], up]
    waves = fft.ifft2(waves, axes=(0, 1), norm="forward", workers=2, overwrite_x=True)
    block = np.empty((nx + 1, nz + 1, ny), np.uint8)
    for i in range(0, nx, _PLANES_PER_CHUNK):
        field = fft.irfft(waves[i : i + _PLANES_PER_CHUNK], ny, axis=2, norm="forward", workers=2)
        field -= np.float32(table.threshold_sd)
        field *= np.float32(-1 / table.softness)
        np.minimum(field, _EXPONENT_LIMIT, out=field)
        np.exp(field, out=field)
        field += 1
        block[i : i + _PLANES_PER_CHUNK, :nz] = np.rint(np.divide(255, field, out=field), out=field)
    block[nx], block[:, nz] = block[0], block[:, 0]
    block.setflags(write=False)
    return block, 1 / float(block[:nx, :nz].mean())


@lru_cache(maxsize=2)
def _compute_power_spectra(table: StrutLattice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the power spectra of the struts and of the patches, each normalised to variance 1.

    Each spectrum has shape (nx / 2 + 1, nz / 2 + 1, waves along y) and contains only non-negative frequencies.
    """
    steps = (np.fft.rfftfreq(n, d).astype(np.float32) for n, d in zip(table.voxels, table.voxel_mm, strict=True))
    fx, fz, fy = np.meshgrid(*steps, indexing="ij", sparse=True)
    fy = fy[..., : table.waves_y] * np.float32(table.stretch_y)
    across, along = fx**2 + fy**2, np.float32(table.length_per_mm)
    total = across + fz**2
    up = np.exp(-(fz**2) / (2 * (along + table.angular_spread_rad * np.sqrt(across)) ** 2))
    level = np.exp(-across / (2 * (along + table.angular_spread_rad * fz) ** 2))
    power = (total + np.float32(table.low_per_mm) ** 2) ** np.float32(table.low_frequency_exponent / 2)
    power /= 1 + (total / np.float32(table.high_per_mm) ** 2) ** np.float32(table.high_frequency_exponent / 2)
    power *= table.vertical_power * up + table.horizontal_power * level + table.isotropic_power
    # Patches of dense and sparse bone have equal extents along x and y, and a larger extent along z.
    tall, deep = np.float32(table.patch_aspect_ratio), np.float32(table.stretch_y)
    patches = np.exp(-(fx**2 + (fz * tall) ** 2 + (fy / deep) ** 2) / (2 * table.patch_per_mm**2))
    return _normalise_variance(power, table), _normalise_variance(patches, table)


def _normalise_variance(power: NDArray[np.float32], table: StrutLattice) -> NDArray[np.float32]:
    """Normalise a power spectrum (nx / 2 + 1, nz / 2 + 1, waves along y) in place, so that the field has variance 1."""
    power[0, 0, 0] = 0
    # Along x and z, each frequency represents both signs; only 0 and the highest frequency occur once. Along y, the
    # array contains the half spectrum of a real transform. This transform treats one half of the plane fy = 0 as the
    # mirror image of the other half. The power of the plane is therefore doubled.
    of = [np.where((np.arange(n // 2 + 1) == 0) | (np.arange(n // 2 + 1) == n // 2), 1, 2) for n in table.voxels[:2]]
    held = np.einsum("i,j,ijk->k", *of, power, dtype=np.float64) * np.where(np.arange(power.shape[2]), 4, 2)
    power /= np.float32(held.sum())
    power[..., 0] *= 2
    return power
